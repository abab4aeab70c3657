"""How dogs, carpets and senses differ from the model: drawn anew for every trial from its seed.

Every number is traced, so that one compiled program serves all of them.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import Observation, Scalar
from envs.quadruped.rigid_body import Variation

PUSH_EVERY = 40  # control steps from one push to the next
NUM_PAST = 4  # observations that are remembered: latency up to 0.3 s


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Nature:
    """What is uncertain.

    friction_low, friction_high: of the carpet, uniform.  mass, gain, torque: half width of the
    uniform factor around 1 on all masses, on the servos' P and on their torque.  latency: age of
    what is seen, s, up to 0.3.  angle_noise (rad), range_noise (share of the distance): standard
    deviations of what is seen, anew every control step.  push: standard deviation of the sudden
    change of the trunk's velocity along each axis that comes every 4 s, m/s.  pose: half width of
    what joints are off at the start, rad.
    """

    friction_low: Scalar = 1.0
    friction_high: Scalar = 1.0
    mass: Scalar = 0.0
    gain: Scalar = 0.0
    torque: Scalar = 0.0
    latency: Scalar = 0.0
    angle_noise: Scalar = 0.0
    range_noise: Scalar = 0.0
    push: Scalar = 0.0
    pose: Scalar = 0.0


class Fate(NamedTuple):
    """What a trial drew.  seed: of its noise.  time: control steps.  variation: this dog's.  past:
    the last `NUM_PAST` observations, newest first, leaves [NUM_PAST]."""

    seed: Array
    time: Array
    variation: Variation
    past: Observation


def draw(nature: Nature, seed: Any, seen: Observation) -> Fate:
    """The fate of the trial with this seed.  seen: what is true at its start."""
    seed = jnp.asarray(seed, jnp.uint32)
    u = jax.random.uniform(jax.random.key(seed), (4,), jnp.result_type(seen.d_ball))
    around = 2 * u - 1
    variation = Variation(
        friction=nature.friction_low + u[0] * (nature.friction_high - nature.friction_low),
        mass=1 + nature.mass * around[1],
        gain=1 + nature.gain * around[2],
        torque=1 + nature.torque * around[3],
    )
    past = jax.tree.map(lambda x: jnp.full(NUM_PAST, x), seen)
    return Fate(seed, jnp.zeros_like(seed), variation, past)


def _key(fate: Fate, channel: int):
    """The key of a channel's noise in this control step."""
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(fate.seed), channel), fate.time)


def first_pose(nature: Nature, fate: Fate, qpos: Float[Array, "19"]) -> Float[Array, "19"]:
    """The start with every joint a little off, lifted so that no foot is in the floor."""
    key = jax.random.fold_in(jax.random.key(fate.seed), 1)
    off = jax.random.uniform(key, (12,), qpos.dtype, -1, 1) * nature.pose
    return qpos.at[7:].add(off).at[2].add(0.1 * nature.pose)


def push(nature: Nature, fate: Fate, qvel: Float[Array, "18"]) -> Float[Array, "18"]:
    """The speeds after a push, if one comes in this control step."""
    key = _key(fate, 2)
    hit = fate.time % PUSH_EVERY == PUSH_EVERY - 1
    change = nature.push * jax.random.normal(key, (2,), qvel.dtype)
    return qvel.at[:2].add(jnp.where(hit, change, 0.0))


def remember(fate: Fate, seen: Observation) -> Fate:
    """The fate one control step later."""
    past = jax.tree.map(lambda old, x: jnp.concatenate([x[None], old[:-1]]), fate.past, seen)
    return fate._replace(time=fate.time + 1, past=past)


def sense(nature: Nature, fate: Fate, dt: float) -> Observation:
    """What is seen: late, and with noise."""
    age = jnp.clip(nature.latency / dt, 0, NUM_PAST - 1)
    # Between two observations; angles by the shorter way round.
    older = jnp.minimum(jnp.floor(age).astype(int) + 1, NUM_PAST - 1)
    share = age - jnp.floor(age)

    def between(past, angle):
        new, old = past[jnp.floor(age).astype(int)], past[older]
        way = old - new
        return new + share * (wrap(way) if angle else way)

    angles = Observation(False, False, True, True)
    seen = Observation(*map(between, fate.past, angles))
    key = _key(fate, 3)
    noise = jax.random.normal(key, (4,), jnp.result_type(seen.d_ball))
    far, turn = nature.range_noise, nature.angle_noise
    return Observation(
        d_ball=seen.d_ball * (1 + far * noise[0]),
        d_obstacle=seen.d_obstacle * (1 + far * noise[1]),
        theta_ball=wrap(seen.theta_ball + turn * noise[2]),
        theta_obstacle=wrap(seen.theta_obstacle + turn * noise[3]),
    )


def wrap(angle: Scalar) -> Array:
    """An angle within a turn of it, in (-pi, pi]."""
    angle = jnp.asarray(angle)
    return angle - 2 * jnp.pi * jnp.ceil((angle - jnp.pi) / (2 * jnp.pi))
