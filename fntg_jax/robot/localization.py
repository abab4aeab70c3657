"""The match's Localization: an extended Kalman filter over displacement and landmarks.

Robust against what happens in a match: a landmark with a wrong name is told by its distance from
what was expected; a robot that begins anywhere, or was lifted, finds its pose again from the last
two different landmarks.  Elementwise arithmetic on scalars and on six numbers of a symmetric 3 x 3,
so that batches in trailing axes (or under `vmap`) become straight vector code.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fntg_jax.robot.geometry import angle, length, unit
from fntg_jax.robot.messages import Displacement, Pose, Scalar, Seen


class Noise(NamedTuple):
    """What the filter takes its senses for; the distances' noise comes with `Seen`.

    motion: of a displacement, a share of it, at random; skid: m and turn_skid: rad, of a step of
    0.1 s, even at rest: standard deviations.  Wide enough to cover systematic errors of 8 % and
    0.02 rad/s, which this filter does not estimate.  bearing: of a sighting, rad.
    """

    motion: float = 0.3
    skid: float = 0.002
    turn_skid: float = 0.008
    bearing: float = 0.035


GATE = 16.0  # squared distance beyond which a sighting is not believed: 3e-4 of the right ones
# Doubt: 1 more for a sighting not believed, half for one believed.  From LOST on the pose is not
# used any more; a pose found anew is on trial.  Chosen by experiments/localization.py's logs.
LOST, ON_TRIAL = 3.5, 2.5
MEMORY = 3.0  # s for which a sighting helps to find a lost robot's pose
FORGOTTEN = 1e6  # s, age of what never was


class Remembered(NamedTuple):
    """A landmark that was seen: in the robot's present frame x, y (m), on the map map_x, map_y (m),
    age (s)."""

    x: Scalar
    y: Scalar
    map_x: Scalar
    map_y: Scalar
    age: Scalar


class Belief(NamedTuple):
    """x, y (m), heading as a unit vector, covariance of x, y, heading (m, rad; h the heading),
    doubt, and the last two different landmarks."""

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    xx: Scalar
    xy: Scalar
    xh: Scalar
    yy: Scalar
    yh: Scalar
    hh: Scalar
    doubt: Scalar
    newest: Remembered
    other: Remembered


def unknown(shape: tuple[int, ...] = ()) -> Belief:
    """Lost: nothing is known of the pose.  shape: of the batch."""
    zero = jnp.zeros(shape, jnp.float32)
    nothing = Remembered(zero, zero, zero, zero, zero + FORGOTTEN)
    return Belief(
        zero,
        zero,
        zero + 1,
        zero,
        *(zero + 0.7, zero, zero, zero + 0.3, zero, zero + 3.0),
        doubt=zero + LOST,
        newest=nothing,
        other=nothing,
    )


def begin(pose: Float[Array, "3"], sd: float = 0.03, sd_heading: float = 0.1) -> Belief:
    """A robot that was put at x, y (m), heading (rad): within standard deviations of sd (m) and
    sd_heading (rad)."""
    nobody = unknown(jnp.shape(pose[0]))
    zero = jnp.zeros_like(nobody.x)
    cos, sin = unit(pose[2])
    return nobody._replace(
        x=pose[0] + zero,
        y=pose[1] + zero,
        cos=cos + zero,
        sin=sin + zero,
        xx=zero + sd**2,
        yy=zero + sd**2,
        hh=zero + sd_heading**2,
        doubt=zero,
    )


def lifted(belief: Belief, when: Bool[Array, ""]) -> Belief:
    """Where somebody says that the robot was lifted: neither its pose nor what it remembers counts
    any more."""
    return _select(
        when,
        belief._replace(
            doubt=jnp.full_like(belief.doubt, LOST),
            newest=belief.newest._replace(age=jnp.full_like(belief.x, FORGOTTEN)),
            other=belief.other._replace(age=jnp.full_like(belief.x, FORGOTTEN)),
        ),
        belief,
    )


def pose(belief: Belief) -> Pose:
    """What the Planner is told; a robot that is lost says so by standard deviations of 1 m and
    2 rad."""
    lost = belief.doubt >= LOST
    sd = jnp.sqrt(0.5 * (belief.xx + belief.yy))
    return Pose(
        belief.x,
        belief.y,
        belief.cos,
        belief.sin,
        jnp.where(lost, 1.0, sd),
        jnp.where(lost, 2.0, jnp.sqrt(belief.hh)),
    )


def update(
    belief: Belief,
    way: Displacement,
    seen: Seen,
    marks: Float[Array, "L 2"],
    noise: Noise = Noise(),
    dt: float = 0.1,
) -> Belief:
    """One step: displacement, then the landmarks in sight.

    way: m, rad, since the last step.  seen: landmarks alone, leaves [L, ...] in the order of marks;
    its `spread` is the distances' standard deviation, a share.  marks: x, y of every landmark on
    the map (m, the frame of the pose).  dt: s.
    """
    belief = _moved(belief, way, noise, dt)
    newest, other = belief.newest, belief.other
    gauss, doubt = belief, belief.doubt
    for n in range(len(marks)):
        map_x, map_y = marks[n][0], marks[n][1]
        one = Seen(*(leaf[n] for leaf in seen))
        gauss, doubt = _sighted(gauss, doubt, one, map_x, map_y, noise)
        zero = jnp.zeros_like(one.distance)
        mark = Remembered(
            one.distance * one.cos, one.distance * one.sin, zero + map_x, zero + map_y, zero
        )
        another = one.visible & ((newest.map_x != map_x) | (newest.map_y != map_y))
        other = _select(another, newest, other)
        newest = _select(one.visible, mark, newest)
    belief = gauss._replace(doubt=doubt, newest=newest, other=other)
    found, fits = _found(belief)
    return _select((doubt >= LOST) & fits, found, belief)


def _select(condition, new, old):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def _turned(cos: Scalar, sin: Scalar, by: Scalar) -> tuple[Scalar, Scalar]:
    """A unit vector turned by an angle (rad), exact to 1e-3 within 0.5: by its tangent's series."""
    t = by + by * by * by / 3
    norm = jax.lax.rsqrt(1 + t * t)
    return (cos - t * sin) * norm, (sin + t * cos) * norm


def _moved(b: Belief, way: Displacement, noise: Noise, dt: float) -> Belief:
    """The Kalman filter's prediction: half of the turn, the way, the other half."""
    half_cos, half_sin = _turned(b.cos, b.sin, 0.5 * way.turn)
    cos, sin = _turned(half_cos, half_sin, 0.5 * way.turn)
    dx, dy = half_cos * way.x - half_sin * way.y, half_sin * way.x + half_cos * way.y
    # Covariance: x' = x - dy h, y' = y + dx h, then the noise of the motion, in the field's frame.
    xh, yh = b.xh - dy * b.hh, b.yh + dx * b.hh
    xx = b.xx - dy * (b.xh + xh)
    yy = b.yy + dx * (b.yh + yh)
    xy = b.xy + dx * b.xh - dy * yh
    along = (noise.motion * way.x) ** 2 + noise.skid**2
    across = (noise.motion * way.y) ** 2 + noise.skid**2
    cc, ss, cs = half_cos * half_cos, half_sin * half_sin, half_cos * half_sin
    turn_cos, turn_sin = _turned(jnp.ones_like(way.turn), jnp.zeros_like(way.turn), way.turn)

    def carried(m: Remembered) -> Remembered:
        # The robot's step, and its turn, seen from the robot.
        x, y = m.x - way.x, m.y - way.y
        return m._replace(
            x=turn_cos * x + turn_sin * y, y=turn_cos * y - turn_sin * x, age=m.age + dt
        )

    return b._replace(
        x=b.x + dx,
        y=b.y + dy,
        cos=cos,
        sin=sin,
        xx=xx + cc * along + ss * across,
        xy=xy + cs * (along - across),
        xh=xh,
        yy=yy + ss * along + cc * across,
        yh=yh,
        hh=b.hh + (noise.motion * way.turn) ** 2 + noise.turn_skid**2,
        newest=carried(b.newest),
        other=carried(b.other),
    )


def _sighted(b: Belief, doubt: Scalar, one: Seen, map_x: Scalar, map_y: Scalar, noise: Noise):
    """The correction by one landmark's distance and direction, jointly, if it is to be believed."""
    dx, dy = map_x - b.x, map_y - b.y
    expected = length(dx, dy)
    ux, uy = dx / expected, dy / expected
    # Expected direction in the robot's frame against the one seen.
    ex, ey = b.cos * ux + b.sin * uy, b.cos * uy - b.sin * ux
    off_d = one.distance - expected
    off_a = angle(ex * one.cos + ey * one.sin, ex * one.sin - ey * one.cos)
    tx, ty = uy / expected, -ux / expected  # of the direction by x and y; by the heading: -1
    dx_, dy_, dh_ = (
        -ux * b.xx - uy * b.xy,
        -ux * b.xy - uy * b.yy,
        -ux * b.xh - uy * b.yh,
    )
    ax_, ay_, ah_ = (
        tx * b.xx + ty * b.xy - b.xh,
        tx * b.xy + ty * b.yy - b.yh,
        tx * b.xh + ty * b.yh - b.hh,
    )
    # The noise is a share of the true distance, not of the measured one (see `hypotheses`).
    dd = -ux * dx_ - uy * dy_ + (one.spread * expected) ** 2
    da = -ux * ax_ - uy * ay_
    aa = tx * ax_ + ty * ay_ - ah_ + noise.bearing**2
    inverse = 1 / (dd * aa - da * da)
    square = (aa * off_d * off_d - 2 * da * off_d * off_a + dd * off_a * off_a) * inverse
    believed = one.visible & (square < GATE) & (doubt < LOST)
    share = jnp.where(believed, inverse, 0.0)
    kdx, kax = (aa * dx_ - da * ax_) * share, (dd * ax_ - da * dx_) * share
    kdy, kay = (aa * dy_ - da * ay_) * share, (dd * ay_ - da * dy_) * share
    kdh, kah = (aa * dh_ - da * ah_) * share, (dd * ah_ - da * dh_) * share
    cos, sin = _turned(b.cos, b.sin, kdh * off_d + kah * off_a)
    change = jnp.where(believed, -0.5 * doubt, jnp.where(one.visible, 1.0, 0.0))
    least = 1e-8  # whatever rounding does
    return b._replace(
        x=b.x + kdx * off_d + kax * off_a,
        y=b.y + kdy * off_d + kay * off_a,
        cos=cos,
        sin=sin,
        xx=jnp.maximum(b.xx - kdx * dx_ - kax * ax_, least),
        xy=b.xy - kdx * dy_ - kax * ay_,
        xh=b.xh - kdx * dh_ - kax * ah_,
        yy=jnp.maximum(b.yy - kdy * dy_ - kay * ay_, least),
        yh=b.yh - kdy * dh_ - kay * ah_,
        hh=jnp.maximum(b.hh - kdh * dh_ - kah * ah_, least),
    ), jnp.minimum(doubt + change, LOST + 1)


def _found(b: Belief) -> tuple[Belief, Scalar]:
    """The pose in which the last two different landmarks agree with the map, and whether they do.

    Their difference on the map over that in the robot's frame, as complex numbers, is the heading.
    """
    one, two = b.newest, b.other
    mx, my = two.map_x - one.map_x, two.map_y - one.map_y
    rx, ry = two.x - one.x, two.y - one.y
    on_map, in_sight = length(mx, my), length(rx, ry)
    scale = 1 / (on_map * in_sight)
    cos, sin = (mx * rx + my * ry) * scale, (my * rx - mx * ry) * scale
    norm = jax.lax.rsqrt(jnp.maximum(cos * cos + sin * sin, 1e-12))
    cos, sin = cos * norm, sin * norm
    x, y = 0.5 * (one.x + two.x), 0.5 * (one.y + two.y)
    far = length(one.x, one.y) + length(two.x, two.y)
    # A tenth of the mean distance, and what odometry adds.
    sd = 0.05 * far + 0.03 * (one.age + two.age)
    fits = (two.age < MEMORY) & (jnp.abs(on_map - in_sight) < 3 * sd) & (in_sight > 0.3)
    variance, zero = sd * sd, jnp.zeros_like(sd)
    return b._replace(
        x=0.5 * (one.map_x + two.map_x) - (cos * x - sin * y),
        y=0.5 * (one.map_y + two.map_y) - (sin * x + cos * y),
        cos=cos,
        sin=sin,
        xx=variance,
        xy=zero,
        xh=zero,
        yy=variance,
        yh=zero,
        hh=2 * variance / jnp.maximum(on_map * on_map, 1e-6),
        doubt=zero + ON_TRIAL,
    ), fits
