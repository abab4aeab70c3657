"""Localization: an extended Kalman filter of the pose over landmarks and displacement.

Six numbers of a symmetric covariance, landmarks one after the other, all of it arithmetic on
scalars that batches turn into vector code.  A sighting that does not fit is left out; when too many
do not fit, the robot admits that it is lost and its covariance grows until they do.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fntg_jax.robot.geometry import length
from fntg_jax.robot.messages import Displacement, Pose, Scalar

_WALK = 0.10  # random error of the displacement, a share of it (SOCCER facts: 10-20 %)
_TURN = 0.12  # of the turn
_CREEP = 0.01  # m and rad, by root of a second, that nothing measures (assumed)
_BEARING = 0.04  # rad, standard deviation of a landmark's direction (assumed)
_GATE = 11.0  # normalised error squared (2 numbers) above which a sighting is left out: 0.4 %
_DOUBT = 4  # sightings in a row left out until the robot takes itself for lost


class Belief(NamedTuple):
    """Mean x, y (m), heading as a unit vector; covariance of x, y, heading: xx, xy, yy, xt, yt, tt;
    doubt: sightings left out in a row."""

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    xx: Scalar
    xy: Scalar
    yy: Scalar
    xt: Scalar
    yt: Scalar
    tt: Scalar
    doubt: Scalar


def begin(pose: Float[Array, "3"]) -> Belief:
    """A robot that was put at x, y, heading (m, rad): within about 3 cm and 0.1 rad."""
    zero = jnp.zeros_like(pose[0])
    return Belief(
        pose[0],
        pose[1],
        jnp.cos(pose[2]),
        jnp.sin(pose[2]),
        zero + 1e-3,
        zero,
        zero + 1e-3,
        zero,
        zero,
        zero + 1e-2,
        zero,
    )


def _turned(b: Belief, angle: Scalar) -> Belief:
    """The heading turned by a small angle (rad): a rational approximation of cosine and sine."""
    h = 0.5 * angle
    d = 1 / (1 + h * h)
    c, s = (1 - h * h) * d, 2 * h * d
    return b._replace(cos=b.cos * c - b.sin * s, sin=b.sin * c + b.cos * s)


def update(
    b: Belief,
    way: Displacement,
    turn: tuple[Scalar, Scalar],
    distance: Float[Array, "6"],
    cos: Float[Array, "6"],
    sin: Float[Array, "6"],
    visible: Bool[Array, "6"],
    spread: Float[Array, "6"],
    landmarks: Float[Array, "6 2"],
) -> Belief:
    """The belief after a step: displacement first, then what was seen of the landmarks.

    way: m and rad, robot's frame; turn: cosine and sine of its turn; distance: m; cos, sin:
    direction in the robot's frame; spread: relative standard deviation of the distance; landmarks:
    m, in the team's frame.
    """
    dx, dy = b.cos * way.x - b.sin * way.y, b.sin * way.x + b.cos * way.y
    far = length(dx, dy)
    q, r = (_WALK * far) ** 2 + _CREEP**2 * 0.1, (_TURN * way.turn) ** 2 + _CREEP**2 * 0.1
    # F = [1 0 -dy; 0 1 dx; 0 0 1]
    xt, yt = b.xt - dy * b.tt, b.yt + dx * b.tt
    b = Belief(
        x=b.x + dx,
        y=b.y + dy,
        cos=b.cos * turn[0] - b.sin * turn[1],
        sin=b.sin * turn[0] + b.cos * turn[1],
        xx=b.xx - dy * (b.xt + xt) + q,
        xy=b.xy + dx * b.xt - dy * yt,
        yy=b.yy + dx * (b.yt + yt) + q,
        xt=xt,
        yt=yt,
        tt=b.tt + r,
        doubt=b.doubt,
    )
    for n in range(landmarks.shape[0]):
        b = _see(b, distance[n], cos[n], sin[n], visible[n], spread[n], landmarks[n])
    lost = b.doubt >= _DOUBT
    wide = lambda old, new: jnp.where(lost, jnp.maximum(old, new), old)  # noqa: E731
    none = lambda old: jnp.where(lost, 0.0, old)  # noqa: E731
    return b._replace(
        xx=wide(b.xx, 0.5),
        yy=wide(b.yy, 0.5),
        tt=wide(b.tt, 1.0),
        xy=none(b.xy),
        xt=none(b.xt),
        yt=none(b.yt),
        doubt=none(b.doubt),
    )


def _see(b: Belief, far, cos, sin, visible, spread, mark) -> Belief:
    """One landmark: its direction and distance are made two numbers along and across the line of
    sight as it is expected, where they are nearly linear."""
    ex, ey = mark[0] - b.x, mark[1] - b.y
    d = length(ex, ey)
    ux, uy = ex / d, ey / d  # line of sight, team's frame
    # The measured direction in the team's frame, and its error against the expected one.
    mx, my = b.cos * cos - b.sin * sin, b.sin * cos + b.cos * sin
    along = far - d
    ahead, across = ux * mx + uy * my, ux * my - uy * mx
    turn = across / jnp.maximum(0.5 * (1 + ahead), 0.1)  # about the angle; 2 tan(a / 2)
    # h1 = d: gradient (-ux, -uy, 0); h2 = direction - heading: gradient (uy/d, -ux/d, -1)
    ax, ay = -ux, -uy
    bx, by, bt = uy / d, -ux / d, -1.0
    pax, pay, pat = b.xx * ax + b.xy * ay, b.xy * ax + b.yy * ay, b.xt * ax + b.yt * ay
    pbx = b.xx * bx + b.xy * by + b.xt * bt
    pby = b.xy * bx + b.yy * by + b.yt * bt
    pbt = b.xt * bx + b.yt * by + b.tt * bt
    ra, rb = (spread * far) ** 2 + 1e-4, _BEARING**2
    saa = ax * pax + ay * pay + ra
    sab = bx * pax + by * pay + bt * pat
    sbb = bx * pbx + by * pby + bt * pbt + rb
    det = saa * sbb - sab * sab
    iaa, iab, ibb = sbb / det, -sab / det, saa / det
    error = along * along * iaa + 2 * along * turn * iab + turn * turn * ibb
    fits = error < _GATE
    used = visible & fits
    # Gain times innovation.
    wa, wb = iaa * along + iab * turn, iab * along + ibb * turn
    keep = jnp.where(used, 1.0, 0.0)
    kxa, kxb = pax * iaa + pbx * iab, pax * iab + pbx * ibb
    kya, kyb = pay * iaa + pby * iab, pay * iab + pby * ibb
    kta, ktb = pat * iaa + pbt * iab, pat * iab + pbt * ibb
    new = b._replace(
        x=b.x + keep * (pax * wa + pbx * wb),
        y=b.y + keep * (pay * wa + pby * wb),
        xx=jnp.maximum(b.xx - keep * (kxa * pax + kxb * pbx), 1e-6),
        xy=b.xy - keep * (kxa * pay + kxb * pby),
        yy=jnp.maximum(b.yy - keep * (kya * pay + kyb * pby), 1e-6),
        xt=b.xt - keep * (kxa * pat + kxb * pbt),
        yt=b.yt - keep * (kya * pat + kyb * pbt),
        tt=jnp.maximum(b.tt - keep * (kta * pat + ktb * pbt), 1e-6),
        doubt=jnp.where(visible, jnp.where(fits, 0.0, b.doubt + 1), b.doubt),
    )
    return _turned(new, keep * (pat * wa + pbt * wb))


def pose(b: Belief) -> Pose:
    """Where the robot believes it stands."""
    return Pose(b.x, b.y, b.cos, b.sin, jnp.sqrt(jnp.maximum(b.xx, b.yy)), jnp.sqrt(b.tt))
