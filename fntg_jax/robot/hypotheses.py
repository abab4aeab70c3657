"""Localization of a robot that nobody calibrated: weighted extended Kalman filters.

Each filter estimates the pose and what is wrong with the odometry.  A sum of them stands for what a
single one cannot say: how noisy the sensors are (a grid of noise levels), and where else the robot
could be (slots).  One more hypothesis says "lost": anywhere.  All compete by how well they foresee
the sightings.  For logs; the match has the smaller `fntg_jax.robot.localization`.

State of a filter: x, y (m), heading (rad), and the odometry's errors s, k, b: from dx, dy, turn of
a row that covers dt the robot moved (1 + s)(dx, dy) and turned (1 + k) turn - b dt.
"""

import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

SLOTS = 4  # poses kept at once
# Noise levels, each a factor of about 1.7 from the next: what lies between loses next to nothing.
RANGE_NOISE = (0.025, 0.042, 0.07, 0.12, 0.21, 0.35)  # share of the distance
BEARING_NOISE = tuple(math.radians(x) for x in (0.7, 1.2, 2.0, 3.5, 6.0, 10.0))
# Random errors of the odometry: a share of a row's motion, and m and rad in a second of none.
ODOMETRY_NOISE = ((0.07, 0.002, 0.002), (0.15, 0.004, 0.004), (0.3, 0.01, 0.01))
RANGE_FLOOR = 0.005  # m, assumed: no distance is better than that
# Standard deviations at the start (assumed): of a pose that the log gives, of s, k and b.
START_SD = (0.015, 0.015, 0.02)
ODOMETRY_SD = (0.1, 0.1, 0.03)
DRIFT = (0.003, 0.003, 0.001)  # of s, k, b in a second, assumed: they change slowly
ACROSS = 0.25  # of the random error of a motion, at right angles to it, assumed
# Shares of the sightings, assumed: another landmark than named; no landmark at all.
MISNAMED, CLUTTER = 0.05, 0.02
KIDNAP_RATE = 1e-5  # of being lifted, in a second, assumed
NEW_SD = (2.0, 2.0, 1.5)  # m, m, rad: of a new hypothesis before its two sightings count
BLUR = 0.03  # rad, and share of the distance, by which a remembered sighting fades in a second
MEMORY = 5.0  # s for which a sighting helps to find a lost robot's pose


class Map(NamedTuple):
    """Landmarks' positions, m: arrays [M]."""

    x: Float[Array, " M"]
    y: Float[Array, " M"]


class Event(NamedTuple):
    """A piece of a log: motion, then maybe a sighting.  Leaves [N] for N events.

    dx, dy, turn: m, rad, as odometry has it; dt: s that it took; share: of the odometry row that
    this is a part of, in (0, 1].  landmark: index into the map, -1 for none; distance: m; bearing:
    rad.  started: the pose is known to be `start` (x, y, heading).
    """

    dx: Float[Array, ""]
    dy: Float[Array, ""]
    turn: Float[Array, ""]
    dt: Float[Array, ""]
    share: Float[Array, ""]
    landmark: Int[Array, ""]
    distance: Float[Array, ""]
    bearing: Float[Array, ""]
    started: Bool[Array, ""]
    start: Float[Array, "3"]


class Belief(NamedTuple):
    """Gaussians [slot, noise level], their log weights, that of being lost, and a memory of each
    landmark's last sighting: where it was in the robot's present frame (m), and its age (s)."""

    mean: Float[Array, "6 P G"]
    covariance: Float[Array, "6 6 P G"]
    log_weight: Float[Array, "P G"]
    log_lost: Float[Array, " G"]
    seen_x: Float[Array, " M"]
    seen_y: Float[Array, " M"]
    seen_age: Float[Array, " M"]


class Estimate(NamedTuple):
    """Mean and covariance of x, y (m), heading (rad) over all hypotheses, and the probability of
    being lost."""

    pose: Float[Array, "3"]
    covariance: Float[Array, "3 3"]
    lost: Float[Array, ""]


class _Noise(NamedTuple):
    distance: Float[Array, " G"]
    bearing: Float[Array, " G"]
    motion: Float[Array, " G"]
    skid: Float[Array, " G"]
    skid_turn: Float[Array, " G"]


def _noise() -> _Noise:
    levels = itertools.product(RANGE_NOISE, BEARING_NOISE, ODOMETRY_NOISE)
    table = np.array([(r, b, *odometry) for r, b, odometry in levels], np.float32)
    return _Noise(*jnp.asarray(table.T))


def wrap(angle):
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def initial(landmarks: Map) -> Belief:
    """Lost, and not calibrated."""
    noise, slots = _noise().distance.size, SLOTS
    covariance = jnp.diag(jnp.asarray((*START_SD, *ODOMETRY_SD), jnp.float32) ** 2)[..., None, None]
    return Belief(
        jnp.zeros((6, slots, noise)),
        jnp.broadcast_to(covariance, (6, 6, slots, noise)),
        jnp.full((slots, noise), -jnp.inf),
        jnp.full(noise, -math.log(noise)),
        *(jnp.zeros_like(landmarks.x),) * 2,
        jnp.full_like(landmarks.x, jnp.inf),
    )


def update(belief: Belief, event: Event, landmarks: Map) -> tuple[Belief, Estimate]:
    """What is believed after one event, and the estimate made of it."""
    noise = _noise()
    belief = _predict(belief, event, noise)
    belief = jax.tree.map(
        lambda new, old: jnp.where(event.started, new, old), _start(belief, event), belief
    )
    sighted = _sight(belief, event, landmarks, noise)
    belief = jax.tree.map(
        lambda new, old: jnp.where(event.landmark >= 0, new, old), sighted, belief
    )
    total = jax.nn.logsumexp(jnp.append(belief.log_weight.ravel(), belief.log_lost))
    belief = belief._replace(log_weight=belief.log_weight - total, log_lost=belief.log_lost - total)
    return belief, estimate(belief, landmarks)


def run(events: Event, landmarks: Map) -> Estimate:
    """Estimates [N] after each of N events, from nothing known."""

    def step(belief, event):
        return update(belief, event, landmarks)

    return jax.lax.scan(step, initial(landmarks), events)[1]


def _room(landmarks: Map):
    """Centre and size (m) of what the landmarks span, at least a metre each way."""
    corners = [(jnp.min(z), jnp.max(z)) for z in landmarks]
    return [(low + high) / 2 for low, high in corners], [
        jnp.maximum(high - low, 1.0) for low, high in corners
    ]


def estimate(belief: Belief, landmarks: Map) -> Estimate:
    """Moments of the whole sum; being lost counts as anywhere between the landmarks."""
    (cx, cy), (width, height) = _room(landmarks)
    weight = jnp.exp(belief.log_weight)
    lost = jnp.sum(jnp.exp(belief.log_lost))
    x = jnp.sum(weight * belief.mean[0]) + lost * cx
    y = jnp.sum(weight * belief.mean[1]) + lost * cy
    heading = belief.mean[2]
    turned = jnp.arctan2(jnp.sum(weight * jnp.sin(heading)), jnp.sum(weight * jnp.cos(heading)))
    pose = jnp.stack([x, y, turned])
    off = belief.mean[:3] - pose[:, None, None]
    off = off.at[2].set(wrap(off[2]))
    anywhere = jnp.stack([cx - x, cy - y, jnp.zeros_like(x)])
    uniform = jnp.stack([width**2 / 12, height**2 / 12, jnp.full_like(x, math.pi**2 / 3)])
    covariance = jnp.sum(
        weight * (belief.covariance[:3, :3] + off[:, None] * off), axis=(2, 3)
    ) + lost * (jnp.diag(uniform) + jnp.outer(anywhere, anywhere))
    return Estimate(pose, covariance, lost)


def _predict(belief: Belief, event: Event, noise: _Noise) -> Belief:
    """The Kalman filter's prediction: the robot's motion and its uncertainty."""
    mean = belief.mean
    _, _, heading, s, k, b = mean
    turn = (1 + k) * event.turn - b * event.dt
    cos, sin = jnp.cos(heading + turn / 2), jnp.sin(heading + turn / 2)
    ahead_x, ahead_y = cos * event.dx - sin * event.dy, sin * event.dx + cos * event.dy
    dx, dy = (1 + s) * ahead_x, (1 + s) * ahead_y
    moved = jnp.stack([mean[0] + dx, mean[1] + dy, wrap(heading + turn), s, k, b])

    def carried(p):
        # The Jacobian times p [6, ...]; half of the turn happens before the motion.
        half = p[2] + event.turn / 2 * p[4] - event.dt / 2 * p[5]
        return jnp.concatenate(
            [
                (p[0] - dy * half + ahead_x * p[3])[None],
                (p[1] + dx * half + ahead_y * p[3])[None],
                (p[2] + event.turn * p[4] - event.dt * p[5])[None],
                p[3:],
            ]
        )

    covariance = carried(jnp.swapaxes(carried(belief.covariance), 0, 1))
    # Random errors in the robot's frame: a share of each motion, and a little of that across.
    skid, skid_turn = noise.skid**2 * event.dt, noise.skid_turn**2 * event.dt
    share = noise.motion**2 / jnp.maximum(event.share, 1e-3)
    along = share * (event.dx**2 + ACROSS**2 * event.dy**2) + skid
    across = share * (event.dy**2 + ACROSS**2 * event.dx**2) + skid
    covariance = covariance.at[0, 0].add(cos**2 * along + sin**2 * across)
    covariance = covariance.at[1, 1].add(sin**2 * along + cos**2 * across)
    mixed = cos * sin * (along - across)
    covariance = covariance.at[0, 1].add(mixed).at[1, 0].add(mixed)
    covariance = covariance.at[2, 2].add(share * event.turn**2 + skid_turn)
    for n, sd in enumerate(DRIFT, start=3):
        covariance = covariance.at[n, n].add(sd**2 * event.dt)
    # What was seen moves the other way in the robot's frame; the best guess of s, k, b corrects it.
    weight = jnp.exp(belief.log_weight)
    s, k, b = jnp.sum(weight * mean[3:], axis=(1, 2)) / jnp.maximum(jnp.sum(weight), 1e-9)
    turn = (1 + k) * event.turn - b * event.dt
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    half_cos, half_sin = jnp.cos(turn / 2), jnp.sin(turn / 2)
    x = belief.seen_x - (1 + s) * (half_cos * event.dx - half_sin * event.dy)
    y = belief.seen_y - (1 + s) * (half_sin * event.dx + half_cos * event.dy)
    # Somebody may have lifted the robot in the meantime.
    kept = jnp.log1p(-KIDNAP_RATE * jnp.minimum(event.dt, 1.0))
    lifted = jnp.log(KIDNAP_RATE * jnp.minimum(event.dt, 1.0))
    log_lost = jnp.logaddexp(belief.log_lost, jax.nn.logsumexp(belief.log_weight, axis=0) + lifted)
    return Belief(
        moved,
        covariance,
        belief.log_weight + kept,
        log_lost,
        cos * x + sin * y,
        cos * y - sin * x,
        belief.seen_age + event.dt,
    )


def _start(belief: Belief, event: Event) -> Belief:
    """The log says where the robot is; what is known of odometry and noise stays."""
    all_weights = jnp.concatenate([belief.log_weight, belief.log_lost[None]])
    noise = jax.nn.logsumexp(all_weights, axis=0)
    mean = belief.mean.at[:3].set(event.start[:, None, None])
    covariance = belief.covariance.at[:3].set(0).at[:, :3].set(0)
    for n, sd in enumerate(START_SD):
        covariance = covariance.at[n, n].set(sd**2)
    return belief._replace(
        mean=mean,
        covariance=covariance,
        log_weight=jnp.full_like(belief.log_weight, -jnp.inf).at[0].set(noise),
        log_lost=jnp.full_like(belief.log_lost, -jnp.inf),
        seen_age=jnp.full_like(belief.seen_age, jnp.inf),
    )


class _Foreseen(NamedTuple):
    """How Gaussians foresee a landmark: the innovation (m, rad), P H' [6] by distance and by
    bearing, the innovation's covariance and the log density."""

    off_distance: Array
    off_bearing: Array
    by_distance: Array
    by_bearing: Array
    dd: Array
    db: Array
    bb: Array
    log_density: Array


def _foresee(mean, covariance, distance, bearing, x, y, sd_distance, sd_bearing) -> _Foreseen:
    """Linearised measurement of a landmark at x, y by Gaussians, mean [6, ...] and covariance
    [6 or 3, 6, ...]; sd_distance is a share, sd_bearing in rad."""
    dx, dy = x - mean[0], y - mean[1]
    square = jnp.maximum(dx * dx + dy * dy, 1e-4)
    expected = jnp.sqrt(square)
    off_distance = distance - expected
    off_bearing = wrap(bearing - jnp.arctan2(dy, dx) + mean[2])
    # Derivatives of distance and bearing by x and y (of the bearing by the heading: -1).
    ux, uy, tx, ty = -dx / expected, -dy / expected, dy / square, -dx / square
    by_distance = ux * covariance[0] + uy * covariance[1]
    by_bearing = tx * covariance[0] + ty * covariance[1] - covariance[2]
    # The noise is a share of the true distance: taken of the measured one, short measurements
    # would count for more than long ones.
    dd = ux * by_distance[0] + uy * by_distance[1] + (sd_distance * expected) ** 2 + RANGE_FLOOR**2
    db = ux * by_bearing[0] + uy * by_bearing[1]
    bb = tx * by_bearing[0] + ty * by_bearing[1] - by_bearing[2] + sd_bearing**2
    determinant = jnp.maximum(dd * bb - db * db, 1e-12)
    square = bb * off_distance**2 - 2 * db * off_distance * off_bearing + dd * off_bearing**2
    log_density = -0.5 * (square / determinant + jnp.log(determinant)) - math.log(2 * math.pi)
    return _Foreseen(off_distance, off_bearing, by_distance, by_bearing, dd, db, bb, log_density)


def _correct(mean, covariance, f: _Foreseen):
    """The Kalman filter's correction: mean [6, ...] and covariance [6, 6, ...]."""
    determinant = jnp.maximum(f.dd * f.bb - f.db * f.db, 1e-12)
    k_distance = (f.bb * f.by_distance - f.db * f.by_bearing) / determinant
    k_bearing = (f.dd * f.by_bearing - f.db * f.by_distance) / determinant
    mean = mean + k_distance * f.off_distance + k_bearing * f.off_bearing
    covariance = covariance - (
        k_distance[:, None] * f.by_distance + k_bearing[:, None] * f.by_bearing
    )
    # The diagonal stays positive whatever rounding does.
    for n in range(6):
        covariance = covariance.at[n, n].max(1e-10)
    return mean.at[2].set(wrap(mean[2])), (covariance + jnp.swapaxes(covariance, 0, 1)) / 2


def _sight(belief: Belief, event: Event, landmarks: Map, noise: _Noise) -> Belief:
    """One sighting: weights, corrected filters, and a new hypothesis in the weakest slot."""
    num = landmarks.x.size
    named = jnp.arange(num) == event.landmark
    _, (width, height) = _room(landmarks)
    # Density of a sighting that says nothing: any direction, any distance in the room.
    nothing = -jnp.log(2 * math.pi * jnp.hypot(width, height))
    # Every landmark might be the one that was seen: [M, P, G].
    seen = event.distance, event.bearing
    x, y = landmarks.x[:, None, None], landmarks.y[:, None, None]
    foreseen = _foresee(
        belief.mean[:, None], belief.covariance[:3, :3, None], *seen, x, y, *noise[:2]
    )
    other = math.log(MISNAMED / max(num - 1, 1))
    prior = jnp.where(named, math.log(1 - MISNAMED - CLUTTER), other)
    score = foreseen.log_density + prior[:, None, None]
    evidence = jnp.logaddexp(jax.nn.logsumexp(score, axis=0), nothing + math.log(CLUTTER))
    best = jnp.argmax(score, axis=0)
    foreseen = _foresee(
        belief.mean, belief.covariance, *seen, landmarks.x[best], landmarks.y[best], *noise[:2]
    )
    mean, covariance = _correct(belief.mean, belief.covariance, foreseen)
    # An ambiguous sighting corrects nothing.
    sure = jnp.max(score, axis=0) - evidence > math.log(0.8)
    corrected = belief._replace(
        mean=jnp.where(sure, mean, belief.mean),
        covariance=jnp.where(sure, covariance, belief.covariance),
        log_weight=belief.log_weight + evidence,
        log_lost=belief.log_lost + nothing,
    )
    born = _bear(belief, corrected, event, landmarks, noise, nothing)
    x, y = event.distance * jnp.cos(event.bearing), event.distance * jnp.sin(event.bearing)
    return born._replace(
        seen_x=jnp.where(named, x, belief.seen_x),
        seen_y=jnp.where(named, y, belief.seen_y),
        seen_age=jnp.where(named, 0.0, belief.seen_age),
    )


def _bear(
    before: Belief, after: Belief, event: Event, landmarks: Map, noise: _Noise, nothing
) -> Belief:
    """A new hypothesis: the pose in which this sighting and the last one of another landmark agree.

    It grows out of being lost: its weight is that of being lost, times how well the two agree.
    """
    named = jnp.arange(landmarks.x.size) == event.landmark
    age = jnp.where(named, jnp.inf, before.seen_age)
    other = jnp.argmin(age)
    age = age[other]
    # Heading: from the direction between the two landmarks on the map and in the robot's frame.
    here = (event.distance * jnp.cos(event.bearing), event.distance * jnp.sin(event.bearing))
    there = before.seen_x[other], before.seen_y[other]
    x1, y1 = landmarks.x[event.landmark], landmarks.y[event.landmark]
    x2, y2 = landmarks.x[other], landmarks.y[other]
    heading = jnp.arctan2(y2 - y1, x2 - x1) - jnp.arctan2(there[1] - here[1], there[0] - here[0])
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    middle = (here[0] + there[0]) / 2, (here[1] + there[1]) / 2
    x = (x1 + x2) / 2 - (cos * middle[0] - sin * middle[1])
    y = (y1 + y2) / 2 - (sin * middle[0] + cos * middle[1])
    # What is known of the odometry is taken from all filters of the same noise level.
    weight = jax.nn.softmax(jnp.maximum(after.log_weight, -1e3), axis=0)
    levels = noise.distance.size
    pose = jnp.broadcast_to(jnp.stack([x, y, wrap(heading)])[:, None], (3, levels))
    mean = jnp.concatenate([pose, jnp.sum(weight * after.mean[3:], axis=1)])
    # From next to nothing known, the two sightings make the covariance; the older one counts as
    # less exact, as the robot has moved since.
    covariance = jnp.zeros((6, 6, levels))
    covariance = covariance.at[3:, 3:].set(jnp.sum(weight * after.covariance[3:, 3:], axis=2))
    for n, sd in enumerate(NEW_SD):
        covariance = covariance.at[n, n].set(sd**2)
    blur = BLUR * jnp.where(jnp.isfinite(age), age, 0.0)
    log_density = jnp.zeros(levels)
    for (seen_x, seen_y), (map_x, map_y), more in (
        (here, (x1, y1), 0.0),
        (there, (x2, y2), blur),
    ):
        foreseen = _foresee(
            mean,
            covariance,
            jnp.hypot(seen_x, seen_y),
            jnp.arctan2(seen_y, seen_x),
            map_x,
            map_y,
            jnp.hypot(noise.distance, more),
            jnp.hypot(noise.bearing, more),
        )
        mean, covariance = _correct(mean, covariance, foreseen)
        log_density += foreseen.log_density
    # Against any pose in the room: the prior above is broader than the room, by this factor.
    _, (width, height) = _room(landmarks)
    broader = 3 * math.log(math.sqrt(2 * math.pi)) + math.log(math.prod(NEW_SD))
    log_density += broader - jnp.log(width * height * 2 * math.pi)
    log_weight = before.log_lost + log_density + jnp.log(1 - MISNAMED - CLUTTER)
    # The older sighting was already counted as saying nothing.
    log_weight -= nothing
    # No second hypothesis where there is one.
    off = after.mean[:3] - mean[:3, None]
    near = (jnp.hypot(off[0], off[1]) < 0.3) & (jnp.abs(wrap(off[2])) < 0.3)
    strength = jax.nn.logsumexp(after.log_weight, axis=1)
    share = jax.nn.softmax(after.log_weight, axis=1)
    share = jnp.where(jnp.isfinite(strength)[:, None], share, 0.0)
    known = jnp.any(
        (jnp.sum(share * near, axis=1) > 0.5)
        & (strength > jax.nn.logsumexp(log_weight) + math.log(0.1))
    )
    weakest = jnp.argmin(strength)
    fits = (age < MEMORY) & ~known & (strength[weakest] < jax.nn.logsumexp(log_weight))
    place = ((jnp.arange(SLOTS) == weakest) & fits)[:, None]
    return after._replace(
        mean=jnp.where(place, mean[:, None], after.mean),
        covariance=jnp.where(place, covariance[:, :, None], after.covariance),
        log_weight=jnp.where(place, log_weight, after.log_weight),
    )
