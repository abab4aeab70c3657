"""The same controller on wheels: success in the equations and in MuJoCo, and the body's table.

    python -m experiments.wheeled [--scenes 500] [--controller bioa.json] [--table wheels.json]

success: share of held-out scenes with a Wilson 95 % interval, in `envs.wheeled` (its equations) and
in MuJoCo's C code (with the ball and the obstacles as bodies; suites whose obstacles rest).  table:
speeds, lag and slip of the match's body "wheels", fitted by `envs.soccer.identify` to a log of
random commands in MuJoCo, and what the kicker does.
"""

import argparse
import json
from pathlib import Path

import jax
import numpy as np

from envs.base import Command
from fntg_jax.running import xla

SUITES = ("open", "blocked")
FAR = 0.5  # m/s and 4 rad/s: more than it can


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--controller", type=Path, default=None)
    parser.add_argument("--table", type=Path, default=None, help="write the body's table here")
    options = parser.parse_args()
    xla.configure()
    from fntg_jax import export

    controller = export.load(options.controller or export.shipped("bioa"))
    for suite in SUITES:
        for world, rate in success(controller, suite, options.scenes).items():
            print(f"{suite:10s}{world:10s}{rate}")
    fitted, kicks = table()
    for name, value in fitted.items():
        print(f"table     {name:10s}{value:8.4f}")
    print(f"kick      speed {np.mean(kicks[0]):.3f} m/s, spread {np.std(kicks[0]):.3f}, direction")
    print(f"          {np.mean(kicks[1]):+.3f} rad, spread {np.std(kicks[1]):.3f}")
    if options.table is not None:
        options.table.write_text(document(fitted, kicks))


def success(controller, suite: str, num: int) -> dict:
    """Rates by world."""
    from envs.wheeled import native, world
    from fntg_jax.learning import fitness, rollout
    from fntg_jax.running import evaluation
    from fntg_jax.running.statistics import wilson

    env = evaluation.environment_for(controller, world)
    lean = evaluation.evaluate(controller, world, suite, num, env=env).rates["success"]
    scenes = jax.tree.map(np.asarray, evaluation.held_out_scenes(world, suite, num))
    seen, v, omega = native.episodes(scenes, lambda o: controller(*o))
    judge = jax.vmap(rollout.outcome_of, in_axes=(1, 1, 0))
    outcome = judge(
        seen, Command(jax.numpy.asarray(v), jax.numpy.asarray(omega)), np.zeros(num, bool)
    )
    parts = fitness.success(outcome)
    return {"equations": lean, "MuJoCo": wilson(int(np.sum(np.asarray(parts.success))), num)}


def log(seed: int = 0, num: int = 3000):
    """A log of random commands in MuJoCo: `identify.Log`."""
    from envs.soccer import identify
    from envs.wheeled.native import Robot

    rng = np.random.default_rng(seed)
    hold = np.cumsum(rng.uniform(size=num) < 0.08)
    drawn = rng.uniform(-1, 1, (hold[-1] + 1, 3)) * [FAR, 0.0, 8 * FAR]
    command, robot, poses = drawn[hold], Robot(ball=False), []
    robot.put((0, 0, 0))
    for v, _, omega in command:
        poses.append(robot.pose)
        robot.step(v, omega)
    starts = np.arange(num) == 0
    return identify.Log(0.1, np.zeros(num, int), command, np.array(poses), None, starts)


def table() -> tuple[dict[str, float], np.ndarray]:
    """Numbers of the style, and speed (m/s) and direction (rad) of kicks [2, n]."""
    from envs.soccer import identify, tables

    (one,) = identify.fit(log(), tables.load_body("wheels").styles)
    return one.values, kicks()


def kicks(num: int = 40, seed: int = 0) -> np.ndarray:
    """Kicks of a ball that lies up to 2 cm to the side, up to 2 cm before the kicker."""
    from envs.wheeled import mjcf
    from envs.wheeled.native import Robot

    rng, robot, found = np.random.default_rng(seed), Robot(), []
    for _ in range(num):
        x, y = mjcf.CAPTURE_X + rng.uniform(0, 0.02), rng.uniform(-0.02, 0.02)
        robot.put((0, 0, 0), (x, y))
        robot.step(0, 0, kick=True)
        for _ in range(2):
            robot.step(0, 0)
        _, _, vx, vy = robot.ball_state
        found.append((np.hypot(vx, vy), np.arctan2(vy, vx)))
    return np.array(found).T


def document(fitted: dict[str, float], kicked: np.ndarray) -> str:
    """The match's table of the body, as JSON."""
    from envs.soccer import tables
    from envs.wheeled import mjcf

    shipped = json.loads((tables.DATA / "wheels.json").read_text())
    style = shipped["styles"][0] | {k: round(v, 4) for k, v in fitted.items()}
    style["lateral"] = 0.0
    speed, direction = (float(np.mean(x)) for x in kicked)
    kick = shipped["kicks"][0] | {
        "speed": round(speed, 3),
        "speed_spread": round(float(np.std(kicked[0])) / speed, 3),
        "direction": round(direction, 3),
        "direction_spread": round(float(np.std(kicked[1])), 3),
    }
    new = shipped | {
        "placeholder": False,
        "source": "styles and kick: python -m experiments.wheeled (the MuJoCo robot of"
        " envs.wheeled); odometry, grip, restitution, miss: assumed",
        "length": mjcf.LENGTH,
        "width": mjcf.WIDTH,
        "chest": mjcf.LENGTH / 2,
        "styles": [style],
        "kicks": [kick],
    }
    return json.dumps(new, indent=2, allow_nan=False) + "\n"


if __name__ == "__main__":
    main()
