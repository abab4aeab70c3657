"""The walk as a learning problem: genes, fitness and judgement, pure functions.

Fitness wants a walk that follows its commands with joints that stay within Sony's speeds, at
little torque and power, that goes on walking on a slippery carpet and with weak servos, and that
does not fall when commands jump.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from envs.base import Task
from envs.quadruped import measure
from envs.quadruped.environment import Quadruped, standing
from envs.quadruped.locomotion import load_gait
from envs.quadruped.rigid_body import Variation
from envs.quadruped.styles import document


class Gene(NamedTuple):
    """A gene: name (a field of `Gait`), unit, least and largest value."""

    name: str
    unit: str
    low: float
    high: float


GENES = (
    Gene("period", "s", 0.30, 0.90),
    Gene("duty", "1", 0.50, 0.75),
    Gene("lift", "m", 0.006, 0.030),
    Gene("ramp", "1", 0.10, 0.50),
    Gene("height", "m", 0.055, 0.120),
    Gene("tilt", "m", -0.020, 0.020),
    Gene("fore_x", "m", -0.030, 0.080),
    Gene("hind_x", "m", -0.060, 0.030),
    Gene("fore_y", "m", 0.0, 0.030),
    Gene("hind_y", "m", 0.0, 0.030),
    Gene("gain_x", "1", 0.8, 1.6),
    Gene("gain_y", "1", 0.8, 1.6),
    Gene("gain_omega", "1", 0.8, 1.6),
    Gene("full_lift", "m/s", 0.010, 0.150),
)

# v_x, v_y (m/s), omega (rad/s), inside the ellipsoid of `measure.RANGE`.
TRAIN = np.array(
    [[v, 0, 0] for v in (0.05, 0.10, 0.15, -0.06, -0.15)]
    + [[0, 0.08, 0], [0, -0.04, 0], [0, 0, 0.5], [0, 0, -1.0], [0.10, 0, 0.7]]
    + [[0, 0, 0.25], [0.12, 0, 0.5], [0.08, 0.05, -0.5], [-0.11, 0, 0.6]],
    np.float32,
)
# Judged on: other commands, in the ellipsoid and on its surface.
TABLE = np.array(
    [[v, 0, 0] for v in (0.03, 0.06, 0.09, 0.12, 0.15, -0.05, -0.10, -0.15)]
    + [[0, v, 0] for v in (0.04, 0.08, -0.04, -0.08)]
    + [[0, 0, w] for w in (0.25, 0.5, 0.75, 1.0, -0.25, -0.5, -0.75, -1.0)]
    + [[0.05, 0, 0.9], [0.10, 0, -0.7], [0.13, 0, 0.45], [0.14, 0, -0.3], [-0.10, 0, 0.7]]
    + [[0.10, 0.05, 0], [0.10, -0.03, 0.6], [0.06, 0.06, -0.5], [-0.06, -0.05, 0.6]],
    np.float32,
)
# Along the axes, for calibrating.
ALONG = np.array(
    [[v, 0, 0] for v in (0.02, 0.045, 0.075, 0.105, 0.135, 0.16, -0.03, -0.075, -0.12, -0.16)]
    + [[0, v, 0] for v in (0.03, 0.06, 0.085, -0.03, -0.06, -0.085)]
    + [[0, 0, w] for w in (0.15, 0.35, 0.6, 0.85, 1.05, -0.15, -0.35, -0.6, -0.85, -1.05)],
    np.float32,
)
HARD = np.array([[0.15, 0, 0], [0, 0, 1.0]], np.float32)
SECONDS = 5.0


class Aims(NamedTuple):
    """What a style is evolved for: weights of the costs (`cost`).

    share: of the ellipsoid of commands that it must follow.  walk: everything that makes a good
    walk.  push: tilt after a push to the side.  slow: what is missing to 0.3 m/s.  And, walking
    ahead at `PACE`: joints: their speed; effort: torque; stride: the time of a step; height: of
    the trunk; shake: roll and pitch rates; energy: for a metre.
    """

    share: Any = 1.0
    walk: Any = 1.0
    push: Any = 0.0
    slow: Any = 0.0
    joints: Any = 0.0
    effort: Any = 0.0
    stride: Any = 0.0
    height: Any = 0.0
    shake: Any = 0.0
    energy: Any = 0.0


# Sony's nine names; what each is for is ours.
STYLES = {
    "DEFAULT": Aims(),
    "STABLE": Aims(0.7, 0.3, push=20.0),
    "SLOW": Aims(0.95, 0.3, joints=10.0),
    "FAST": Aims(0.7, 0.1, slow=20.0),
    "OFFLOAD": Aims(0.7, 0.3, effort=10.0),
    "BABY": Aims(0.6, 0.3, stride=5.0),
    "LIZARD": Aims(0.6, 0.3, height=10.0),
    "CREEP": Aims(0.6, 0.3, shake=10.0),
    "TROT": Aims(0.7, 0.3, energy=10.0),
}
PACE = 0.08  # m/s


class Cost(NamedTuple):
    """total: what is wrong with the walk, weighted by the style's aims.  Of the commands alone:
    v_error (m/s), omega_error (rad/s), fallen: means."""

    total: Float[Array, ""]
    v_error: Float[Array, ""]
    omega_error: Float[Array, ""]
    fallen: Float[Array, ""]


def cost(env: Quadruped, key, aims: Aims = Aims(), commands=TRAIN) -> Cost:
    """What is wrong with the walk.

    walk: errors in units of the tolerances 0.012 m/s and 0.05 rad/s; the time that joints are above
    1.2 times Sony's speed in per cent, and set-points at their limit in units of 5 %; torque
    above 1 N m and power in units of 5 W; speed lost on a carpet with friction 0.6 and, separately,
    with 0.7 of the servos' gain in units of 20 %; a fall 20.
    """
    steps = round(SECONDS / env.dt)
    num, hard = len(commands), len(HARD)
    asked = aims.share * jnp.asarray(np.concatenate([commands, HARD, HARD]))
    alone = jnp.asarray([[0.3, 0, 0], [PACE, 0, 0], [0.1, 0, 0], [0, 0, 0]])
    held = jnp.repeat(jnp.concatenate([asked, alone])[:, None], steps, axis=1)
    held = jnp.concatenate([held, aims.share * measure.random_sequences(key, 2, steps)])
    friction = jnp.asarray([1.0] * num + [0.6] * hard + [1.0] * (hard + 6))
    gain = jnp.asarray([1.0] * (num + hard) + [0.7] * hard + [1.0] * 6)
    fast = num + 2 * hard  # then that at `PACE`, two that are pushed
    pushed = slice(fast + 2, fast + 4)
    push = jnp.zeros((len(held), 2)).at[pushed, 1].set(jnp.asarray([0.7, -0.7]))

    def one(held, friction, gain, push):
        varied = dataclasses.replace(env, variation=Variation(friction, gain))
        return measure.walk(varied, held, push)

    walks = jax.vmap(one)(held, friction, gain, push)
    train = jax.tree.map(lambda x: x[:num], walks)
    at_pace = jax.tree.map(lambda x: x[fast + 1], walks)
    v, omega = measure.errors(train, asked[:num])
    too_fast = jnp.max(jnp.mean(walks.speed > 1.2, axis=(1, 2)), axis=-1)
    got = walks.velocity[num:fast] / (aims.share * jnp.asarray(measure.RANGE))
    share = jnp.stack([got[0, 0], got[1, 2], got[2, 0], got[3, 2]])
    walk = jnp.mean(v / 0.012 + omega / 0.05) + 0.3 * jnp.max(v / 0.012 + omega / 0.05)
    walk += jnp.mean(too_fast[:num]) / 0.01 + jnp.mean(train.clipped) / 0.05
    walk += jnp.mean(jax.nn.relu(train.torque - 1.0)) / 0.1
    walk += jnp.mean(train.power) / 5.0 + jnp.mean(train.swing) / 0.03
    walk += jnp.mean(jax.nn.relu(0.9 - share)) / 0.2
    upright = jnp.where(walks.fallen, 0.0, walks.upright)
    # At the pace it must come forward, or what it costs means nothing.
    ahead = jnp.clip(at_pace.velocity[0] / PACE, 0.1, 1.0)
    costs = Aims(
        walk=walk,
        push=jnp.mean(1 - upright[pushed]),
        slow=1 - walks.velocity[fast, 0] / 0.3 + 10 * too_fast[fast],
        joints=jnp.sqrt(jnp.mean(at_pace.speed**2)) + walks.clipped[num],
        effort=at_pace.effort / 0.3,
        stride=env.gait.period / 0.5,
        height=at_pace.height / 0.1,
        shake=at_pace.shake / 0.5,
        energy=at_pace.power / PACE / 15.0,
    )
    total = sum(weight * part for weight, part in zip(aims[1:], costs[1:]))
    total += 10 * (1 - ahead)
    # Sequences that jump, and nothing that a style may buy with falls.
    stays = jnp.ones(len(held)).at[pushed].set(0.0)
    falls = 20.0 * walks.fallen + 10 * jax.nn.relu(0.95 - walks.upright)
    fell = jnp.mean(train.fallen.astype(v.dtype))
    return Cost(total + jnp.mean(stays * falls), jnp.mean(v), jnp.mean(omega), fell)


def task(style: float = 0) -> Task:
    """A walk as a task of the trainer.  style: index into `STYLES`.

    Judged on the commands of `TABLE`, which no fitness is computed from: a score (the style's
    fitness on them), mean errors of velocity and turning, and the share of walks that fell.
    Raises ValueError for a style that there is not.
    """
    names = list(STYLES)
    if style not in range(len(names)):
        allowed = ", ".join(f"{n} ({name})" for n, name in enumerate(names))
        raise ValueError(f"task option style = {style:g}: allowed are {allowed}")
    name = names[int(style)]
    aims = STYLES[name]
    # A genome is judged from the stand of the gait that its ranges lie around.
    env = standing(dataclasses.replace(load_gait(), calibration=None))

    def own(theta):
        values = {g.name: theta[n] for n, g in enumerate(GENES)}
        return dataclasses.replace(env, gait=dataclasses.replace(env.gait, **values))

    # The aims are the task's memory, so that all styles are one compiled program.
    def init_fn(key):
        del key
        return Aims(*map(jnp.float32, aims))

    def fitness_fn(key, theta, memory, progress):
        del progress
        costs = jax.vmap(lambda t: cost(own(t), key, memory))(theta)
        return 10 / (0.1 + costs.total), memory

    def judge_fn(key, theta, memory):
        costs = jax.vmap(lambda t: cost(own(t), key, memory, TABLE))(theta)
        return {"score": 10 / (0.1 + costs.total), **costs._asdict()}

    def files(genes):
        gait = dataclasses.replace(env.gait, **genes)
        origin = f"fntg train --task gait --task-options style {style:g}"
        return {"gait.json": document(gait, f"{origin}, not calibrated", style=name)}

    return Task("gait", GENES, fitness_fn, init_fn, judge_fn, files)
