"""The walk as a learning problem: genes, fitness and judgement, pure functions.

Fitness wants a walk that follows its commands with joints that stay within Sony's speeds, at
little torque and power, that goes on walking on a slippery carpet and with weak servos, and that
does not fall when commands jump.
"""

import dataclasses
import json
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from envs.base import Task
from envs.quadruped import measure
from envs.quadruped.environment import Quadruped
from envs.quadruped.locomotion import Gait, as_number, load_gait, slip_terms
from envs.quadruped.rigid_body import Variation


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
    Gene("height", "m", 0.075, 0.120),
    Gene("tilt", "m", -0.020, 0.020),
    Gene("fore_x", "m", -0.030, 0.060),
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
    + [[0, 0, 0.25], [0.12, 0, 0.5], [0.08, 0.05, -0.5], [-0.08, 0, 0.6]],
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


def gait_of(base: Gait, theta: Float[Array, " genes"]) -> Gait:
    """A gait from genes in (-5, 5): linear in the ranges of `GENES`."""
    share = (theta + 5) / 10
    values = {g.name: g.low + share[n] * (g.high - g.low) for n, g in enumerate(GENES)}
    return dataclasses.replace(base, **values)


def init(key) -> tuple:
    """No memory."""
    del key
    return ()


class Aims(NamedTuple):
    """What a style is evolved for: weights of the costs.

    walk: everything that makes a good walk.  push: tilt after a push to the side.  joints: joint
    speed.  slow: what is missing to 0.3 m/s.  effort: torque.  stride: length of a period.
    height: of the trunk.  shake: roll and pitch rates.  energy: power at 0.15 m/s.
    """

    walk: Any = 1.0
    push: Any = 0.0
    joints: Any = 0.0
    slow: Any = 0.0
    effort: Any = 0.0
    stride: Any = 0.0
    height: Any = 0.0
    shake: Any = 0.0
    energy: Any = 0.0


# Sony's nine names.  Each is evolved for what it alone is judged by (`experiments.locomotion`).
STYLES = {
    "DEFAULT": Aims(),
    "STABLE": Aims(walk=0.3, push=20.0),
    "SLOW": Aims(walk=0.3, joints=10.0),
    "FAST": Aims(walk=0.1, slow=20.0),
    "OFFLOAD": Aims(walk=0.3, effort=10.0),
    "BABY": Aims(walk=0.3, stride=5.0),
    "LIZARD": Aims(walk=0.3, height=10.0),
    "CREEP": Aims(walk=0.3, shake=10.0),
    "TROT": Aims(walk=0.3, energy=10.0),
}


def fitness(
    env: Quadruped, key, theta: Float[Array, "P genes"], memory=(), progress=0.0, aims=Aims()
) -> tuple[Float[Array, " P"], tuple]:
    """10 / (0.1 + cost) of each genome; see `cost`."""
    del progress
    costs = jax.vmap(lambda t: cost(dataclasses.replace(env, gait=gait_of(env.gait, t)), key, aims))
    return 10 / (0.1 + costs(theta)), memory


def cost(env: Quadruped, key, aims: Aims = Aims()) -> Float[Array, ""]:
    """What is wrong with the walk, weighted by the style's aims.

    walk: errors in units of the tolerances 0.012 m/s and 0.05 rad/s; the time that joints are above
    1.2 times Sony's speed in per cent, and set-points at their limit in tens of per cent; torque
    above 1 N m and power in units of 5 W; speed lost on a carpet with friction 0.6 and, separately,
    with 0.7 of the servos' gain in units of 20 %; a fall 20.
    """
    steps = round(SECONDS / env.dt)
    num, hard = len(TRAIN), len(HARD)
    jumps = measure.random_sequences(key, 2, steps)
    held = jnp.asarray(np.concatenate([TRAIN, HARD, HARD, [[0.3, 0, 0], [0.1, 0, 0], [0, 0, 0]]]))
    held = jnp.concatenate([jnp.repeat(held[:, None], steps, axis=1), jumps])
    friction = jnp.asarray([1.0] * num + [0.6] * hard + [1.0] * (hard + 5))
    gain = jnp.asarray([1.0] * (num + hard) + [0.7] * hard + [1.0] * 5)
    pushed = slice(num + 2 * hard + 1, num + 2 * hard + 3)
    push = jnp.zeros((len(held), 2)).at[pushed, 1].set(jnp.asarray([0.7, -0.7]))

    def one(held, friction, gain, push):
        varied = dataclasses.replace(env, variation=Variation(friction, gain))
        return measure.walk(varied, held, push)

    walks = jax.vmap(one)(held, friction, gain, push)
    train = jax.tree.map(lambda x: x[:num], walks)
    v, omega = measure.errors(train, jnp.asarray(TRAIN))
    too_fast = jnp.max(jnp.mean(walks.speed > 1.2, axis=(1, 2)), axis=-1)
    got = walks.velocity[num : num + 2 * hard] / jnp.asarray(measure.RANGE)
    share = jnp.stack([got[0, 0], got[1, 2], got[2, 0], got[3, 2]])
    walk = jnp.mean(v / 0.012 + omega / 0.05) + 0.3 * jnp.max(v / 0.012 + omega / 0.05)
    walk += jnp.mean(too_fast[:num]) / 0.01 + jnp.mean(train.clipped) / 0.1
    walk += jnp.mean(jax.nn.relu(train.torque - 1.0)) / 0.1
    walk += jnp.mean(train.power) / 5.0 + jnp.mean(train.swing) / 0.03
    walk += jnp.mean(jax.nn.relu(0.9 - share)) / 0.2
    upright = jnp.where(walks.fallen, 0.0, walks.upright)
    costs = Aims(
        walk=walk,
        push=jnp.mean(1 - upright[pushed]),
        joints=jnp.mean(jnp.sqrt(jnp.mean(train.speed**2, axis=(1, 2, 3)))),
        slow=1 - walks.velocity[num + 2 * hard, 0] / 0.3 + 10 * too_fast[num + 2 * hard],
        effort=jnp.mean(train.effort) / 0.3,
        stride=env.gait.period / 0.5,
        height=jnp.mean(train.height) / 0.1,
        shake=jnp.mean(train.shake) / 0.5,
        energy=train.power[2] / 2.0,
    )
    total = sum(weight * part for weight, part in zip(aims, costs))
    # Sequences that jump, and nothing that a style may buy with falls.
    stays = jnp.ones(len(held)).at[pushed].set(0.0)
    falls = 20.0 * walks.fallen + 10 * jax.nn.relu(0.95 - walks.upright)
    return total + jnp.mean(stays * falls)


def judge(env: Quadruped, commands=TABLE) -> measure.Track:
    """Walks of the commands that no gait was evolved on.  Leaves [commands]."""
    return jax.jit(partial(measure.steady, commands=commands))(env)


def calibrate(env: Quadruped, key) -> Gait:
    """The gait with the calibration under which it walks as commanded: what it was asked for,
    as a linear function of what came out (least squares over 60 commands drawn from the key and
    `ALONG`)."""
    gait = dataclasses.replace(env.gait, calibration=Gait().calibration)
    asked = np.concatenate([measure.random_sequences(key, 60, 1)[:, 0], ALONG])
    walks = measure.steady_native(dataclasses.replace(env, gait=gait), asked, "lean")
    up = ~np.asarray(walks.fallen)
    v, v_y, omega = np.asarray(walks.velocity, float)[up].T
    terms = slip_terms(v, v_y, omega, np)
    rows = [np.linalg.lstsq(np.stack(t, 1), asked[up, n])[0] for n, t in enumerate(terms)]
    return dataclasses.replace(gait, calibration=as_number(np.round(rows, 4)))


def document(gait: Gait, origin: str) -> str:
    """A gait as the text of its JSON file, which `locomotion.load_gait` reads."""
    values = {
        f.name: as_number(np.round(getattr(gait, f.name), 5)) for f in dataclasses.fields(gait)
    }
    file = {"format": "fntg-gait", "version": 2, "origin": origin, "gait": values}
    return json.dumps(file, indent=2, allow_nan=False) + "\n"


def task() -> Task:
    """The walk as a task of the trainer, from the shipped gait without its calibration.

    Judged on the commands of `TABLE`, which no fitness is computed from: a score (errors in units
    of the tolerances, falls 20), mean errors and the share of walks that fell.
    """
    plain = dataclasses.replace(load_gait(), calibration=Gait().calibration)
    env = Quadruped(gait=plain)
    low, high = (jnp.asarray([getattr(g, n) for g in GENES]) for n in ("low", "high"))

    def own(theta):
        values = {g.name: theta[n] for n, g in enumerate(GENES)}
        return dataclasses.replace(env, gait=dataclasses.replace(plain, **values))

    def fitness_fn(key, theta, memory, progress):
        return fitness(env, key, 10 * (theta - low) / (high - low) - 5, memory, progress)

    def judge_fn(key, theta, memory):
        del key, memory

        def one(theta):
            walks = measure.steady(own(theta), TABLE)
            v, omega = measure.errors(walks, jnp.asarray(TABLE))
            fell = jnp.mean(walks.fallen.astype(v.dtype))
            cost = jnp.mean(v) / 0.012 + jnp.mean(omega) / 0.05 + 20 * fell
            return {
                "score": 10 / (0.1 + cost),
                "v_error": jnp.mean(v),
                "omega_error": jnp.mean(omega),
                "fallen": fell,
            }

        return jax.vmap(one)(theta)

    def files(genes):
        gait = dataclasses.replace(plain, **genes)
        return {"gait.json": document(gait, "fntg train --task gait, not calibrated")}

    return Task("gait", GENES, fitness_fn, judge=judge_fn, files=files)
