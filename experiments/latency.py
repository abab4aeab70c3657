"""One robot in real time: how long a control step takes, from the camera's picture to the command.

    python -m experiments.latency [--steps 1000] [--json]

The whole of `fntg_jax.robot` for one robot, compiled, batch 1, on one core, fed with the senses of
a match.  pixels: pictures of 176 x 144 are given to Vision in every step; the camera of the paper's
robot makes 25 a second, so a step has 40 ms.  objects: the step alone.
"""

import dataclasses
import json
import os
import time

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from envs.field import FIELD
from envs.soccer import Match, image
from experiments import script
from fntg_jax import robot
from fntg_jax.robot import colours, vision
from fntg_jax.running import xla
from fntg_jax.teams import cerberus, team_file

LIMIT = 0.040  # s, a camera's picture at 25 Hz


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to time."""

    steps: int = 1000
    """control steps."""
    json: bool = False
    """print JSON instead of a table."""


def senses_of_a_match(num: int):
    """Senses and pictures of one robot in `num` steps of a match whose robots stand, its head
    turning from step to step."""
    match = Match(players=3)
    state = match.reset(0, 1)
    head = np.zeros((num, 3), np.float32)
    head[:, 0] = -0.3 + 0.3 * np.sin(0.31 * np.arange(num))
    head[:, 1] = 1.3 * np.sin(0.05 * np.arange(num))
    r = state.robots
    poses = jnp.stack([r.x, r.y, jnp.arctan2(r.sin, r.cos)], -1)
    scene = image.Scene(
        jnp.asarray([state.ball.x, state.ball.y, FIELD.ball_radius]),
        poses[jnp.arange(6) != 1],
        jnp.asarray([0, 0, 1, 1, 1]),
        jnp.ones(5, bool),
    )

    @jax.jit
    def one(head):
        picture = image.render(scene, image.eye(poses[1], head), image.Light(noise=3.0, seed=1))
        turned = r._replace(tilt=r.tilt + head[0], pan=r.pan + head[1])
        senses = jax.tree.map(lambda a: a[1], match.sense(state._replace(robots=turned)))
        return senses, picture

    return [jax.block_until_ready(one(h)) for h in head]


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    with script.lines():
        script.check_least(options, steps=100)
    xla.configure()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    table, bands = colours.load("ers210"), vision.bands(FIELD)
    file = team_file.load(cerberus.SHIPPED)
    team = cerberus.of(file.genes, file.bioa, Match(), 0)
    begin = robot.begin(team, jnp.int32(1), jnp.zeros(3))
    given = senses_of_a_match(min(options.steps, 200))

    @jax.jit
    def pixels(memory, senses, picture):
        frame = vision.see(picture, table, vision.Team(), bands).frame
        return robot.control(team, memory, senses._replace(frame=frame))

    @jax.jit
    def objects(memory, senses, picture):
        return robot.control(team, memory, senses)

    rows = {}
    for name, step in (("pixels", pixels), ("objects", objects)):
        memory = jax.block_until_ready(step(begin, *given[0]))[0]  # compiled
        times = np.zeros(options.steps)
        for n in range(options.steps):
            senses, picture = given[n % len(given)]
            start = time.perf_counter()
            memory, _ = jax.block_until_ready(step(memory, senses, picture))
            times[n] = time.perf_counter() - start
        rows[name] = {
            "median_ms": 1e3 * float(np.median(times)),
            "p99_ms": 1e3 * float(np.quantile(times, 0.99)),
            "worst_ms": 1e3 * float(times.max()),
            "in_time": float(np.mean(times < LIMIT)),
        }
    if options.json:
        print(json.dumps({"steps": options.steps, "limit_ms": 40, **rows}, allow_nan=False))
        return
    for name, row in rows.items():
        print(
            f"{name:8s} median {row['median_ms']:.2f} ms, 99 % within {row['p99_ms']:.2f}, worst "
            f"{row['worst_ms']:.2f} ms; within 40 ms: {100 * row['in_time']:.1f} %"
        )


if __name__ == "__main__":
    main()
