"""Monte Carlo localization with resetting: the filter that the Kalman filter is compared with.

Particles follow the displacement with noise and are weighed by the landmarks; when these fit badly,
some particles are drawn anew from what is seen (sensor resetting: Lenser and Veloso 2000).
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from fntg_jax.robot.geometry import wrap
from fntg_jax.robot.localization import Noise
from fntg_jax.robot.messages import Displacement, Pose, Seen

CLUTTER = 0.02  # least likelihood of a sighting, as a share of the best one's: wrong names
# A mean likelihood below this share of the usual one of particles in the right place begins to
# replace particles (assumed); it is forgotten within some SLOWNESS sightings.
FITTING, SLOWNESS = 0.3, 0.2


class Particles(NamedTuple):
    """x, y (m), heading (rad): [N]; fit: the recent sightings' mean likelihood, as a share of the
    best one's."""

    x: Float[Array, " N"]
    y: Float[Array, " N"]
    heading: Float[Array, " N"]
    fit: Float[Array, ""]


def unknown(key: Array, num: int, length: float, width: float) -> Particles:
    """Anywhere on a field of that size (m)."""
    half = jnp.array([[length / 2], [width / 2], [math.pi]])
    x, y, heading = half * jax.random.uniform(key, (3, num), minval=-1)
    return Particles(x, y, heading, jnp.ones(()))


def known(
    key: Array, num: int, start: Float[Array, "3"], sd: float, sd_heading: float
) -> Particles:
    """About a pose x, y (m), heading (rad); standard deviations in m and rad."""
    spread = jnp.array([[sd], [sd], [sd_heading]])
    x, y, heading = start[:, None] + spread * jax.random.normal(key, (3, num))
    return Particles(x, y, heading, jnp.ones(()))


def moved(key: Array, p: Particles, way: Displacement, noise: Noise) -> Particles:
    """Every particle after the displacement, with its own random error."""
    e = jax.random.normal(key, (3, p.x.size))
    dx, dy = (v + jnp.hypot(noise.motion * v, noise.skid) * e[n] for n, v in enumerate(way[:2]))
    turn = way.turn + jnp.hypot(noise.motion * way.turn, noise.turn_skid) * e[2]
    middle = p.heading + turn / 2
    cos, sin = jnp.cos(middle), jnp.sin(middle)
    return p._replace(
        x=p.x + cos * dx - sin * dy, y=p.y + sin * dx + cos * dy, heading=wrap(p.heading + turn)
    )


def log_likelihood(p: Particles, seen: Seen, map_x, map_y, noise: Noise):
    """Of one landmark's distance and direction (leaves of seen: scalars), [N]; at best 0."""
    dx, dy = map_x - p.x, map_y - p.y
    expected = jnp.sqrt(dx * dx + dy * dy + 1e-9)
    off = jnp.arctan2(seen.sin, seen.cos) - jnp.arctan2(dy, dx) + p.heading
    share = (seen.distance / expected - 1) / seen.spread
    # The spread grows with the distance; 1 m stands for the best.
    return -0.5 * share**2 - 0.5 * (wrap(off) / noise.bearing) ** 2 - jnp.log(expected)


def resampled(key: Array, p: Particles, log_weight: Float[Array, " N"]) -> Particles:
    """Particles drawn by weight with one random number for all (systematic resampling)."""
    num = p.x.size
    total = jnp.cumsum(jax.nn.softmax(log_weight))
    points = (jnp.arange(num) + jax.random.uniform(key)) / num
    chosen = jnp.minimum(jnp.searchsorted(total, points), num - 1)
    return p._replace(x=p.x[chosen], y=p.y[chosen], heading=p.heading[chosen])


def update(
    key: Array,
    p: Particles,
    way: Displacement,
    seen: Seen,
    marks: Float[Array, "L 2"],
    noise: Noise = Noise(),
) -> Particles:
    """One step: displacement, landmarks (leaves of seen [L]), resampling, resetting.

    marks: m; noise: as the Kalman filter's.
    """
    keys = jax.random.split(key, 3)
    p = moved(keys[0], p, way, noise)
    num_seen = jnp.sum(seen.visible)
    each = jax.vmap(lambda one, mark: log_likelihood(p, one, mark[0], mark[1], noise))(seen, marks)
    robust = jnp.where(seen.visible[:, None], jnp.logaddexp(each, math.log(CLUTTER)), 0.0)
    p_next = resampled(keys[1], p, jnp.sum(robust, axis=0))
    # How well the particles foresaw this: their best tenth's mean, so that spread costs nothing.
    likelihood = jnp.where(seen.visible[:, None], jnp.exp(each), 0.0)
    now = jnp.sum(jnp.max(likelihood, axis=1)) / jnp.maximum(num_seen, 1)
    fit = p.fit + jnp.where(num_seen > 0, SLOWNESS * (jnp.minimum(now, 1.0) - p.fit), 0.0)
    # Replaced ones stand on the circle about a landmark in sight, and see it where it was seen.
    draw = jax.random.uniform(keys[2], (3, p.x.size))
    which = jax.random.categorical(
        keys[2], jnp.where(seen.visible, 0.0, -jnp.inf), shape=(p.x.size,)
    )
    about = 2 * math.pi * draw[0]
    x = marks[which, 0] + seen.distance[which] * jnp.cos(about)
    y = marks[which, 1] + seen.distance[which] * jnp.sin(about)
    heading = about + math.pi - jnp.arctan2(seen.sin, seen.cos)[which]
    new = (draw[1] < jnp.maximum(1 - fit / FITTING, 0.0)) & (num_seen > 0)
    return Particles(
        jnp.where(new, x, p_next.x),
        jnp.where(new, y, p_next.y),
        jnp.where(new, wrap(heading), p_next.heading),
        fit,
    )


def pose(p: Particles) -> Pose:
    """Mean and spread of all particles."""
    cos, sin = jnp.mean(jnp.cos(p.heading)), jnp.mean(jnp.sin(p.heading))
    r = jnp.maximum(jnp.hypot(cos, sin), 1e-6)
    sd = jnp.sqrt(0.5 * (jnp.var(p.x) + jnp.var(p.y)))
    sd_heading = jnp.sqrt(-2 * jnp.log(jnp.minimum(r, 1.0)))
    return Pose(jnp.mean(p.x), jnp.mean(p.y), cos / r, sin / r, sd, sd_heading)
