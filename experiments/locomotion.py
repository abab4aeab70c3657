"""What Locomotion can do, measured: tracking, joint speeds, time step, styles.

    python -m experiments.locomotion table [--gait g.json] [--variant full] [--json] [--csv t.csv]
    python -m experiments.locomotion kicks [--num 100] [--out kicks.json]

table: every command of `gait_task.TABLE` is held for 8 s, the last 6 are measured.
joint_speed_ratio_p99: 99th percentile of a joint's measured speed over Sony's, worst joint and
all commands together.
step_ratio: speed at the training step over that at 0.5 ms, both in MuJoCo's C code, the value
farthest from 1 (speeds in units of the ellipsoid's half axes 0.15 m/s, 0.08 m/s, 1 rad/s).

kicks: what each kick does to a resting ball when the dog stands up to 2 cm and 0.2 rad off, in the
full model.
"""

import dataclasses
import json
import math
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
import tyro

from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.running import xla

FINE = 0.0005  # s, the time step that the training step is compared with


@dataclasses.dataclass(frozen=True)
class Config:
    """What to measure.

    Attributes:
        what: table, or kicks.
        gait: a gait's JSON; default the shipped one.
        variant: lean, or the full model in MuJoCo's C code (no joint speeds).
        json: print JSON for machines instead of text.
        csv: where the rows go, too.
        num: trials of a kick.
        seed: of their places.
        out: where the kicks' table goes, too.
    """

    what: tyro.conf.Positional[Literal["table", "kicks"]] = "table"
    gait: Path | None = None
    variant: Literal["lean", "full"] = "lean"
    json: bool = False
    csv: Path | None = None
    num: int = 100
    seed: int = 1
    out: Path | None = None


def rows_of(walks, fine, coarse, commands) -> list[dict[str, float]]:
    """One row a command: asked, got, errors, and speeds at both time steps."""
    from envs.quadruped import measure

    v, omega = measure.errors(walks, commands)
    axes = np.asarray(measure.RANGE)
    speed = {
        n: np.linalg.norm(np.asarray(w.velocity) / axes, axis=1)
        for n, w in (("fine", fine), ("coarse", coarse))
    }
    joints = (
        measure.speed_ratio(walks) if np.ndim(walks.speed) > 1 else np.full(len(commands), np.nan)
    )
    rows = []
    for n, (v_x, v_y, w) in enumerate(commands.tolist()):
        got = np.asarray(walks.velocity[n]).tolist()
        row = {"v_x": v_x, "v_y": v_y, "omega": w, "got_v_x": got[0], "got_v_y": got[1]}
        row |= {"got_omega": got[2], "error_v": float(v[n]), "error_omega": float(omega[n])}
        row |= {"step_ratio": float(speed["coarse"][n] / speed["fine"][n])}
        row |= {"joint_speed_ratio_p99": float(joints[n]), "fell": int(walks.fallen[n])}
        rows.append({k: round(x, 4) for k, x in row.items()})
    return rows


def table(env, variant: str = "lean") -> tuple[list[dict[str, float]], dict[str, Any]]:
    """The rows, and what they come to."""
    from envs.quadruped import gait_task, measure, physics

    commands = gait_task.TABLE
    if variant == "full":
        walks = measure.steady_native(env, commands, "full")
    else:
        walks = jax.jit(partial(measure.steady, commands=commands))(env)
    coarse = measure.steady_native(env, commands, "lean")
    solver = physics.Solver(timestep=FINE, substeps=round(env.dt / FINE))
    fine = measure.steady_native(dataclasses.replace(env, solver=solver), commands, "lean")
    rows = rows_of(walks, fine, coarse, commands)

    def column(name):
        return np.array([row[name] for row in rows])

    ratio = column("step_ratio")
    whole: dict[str, Any] = {
        "variant": variant,
        "timestep": env.solver.timestep,
        "error_v": float(column("error_v").max()),
        "error_v_mean": round(float(column("error_v").mean()), 5),
        "error_omega": float(column("error_omega").max()),
        "error_omega_mean": round(float(column("error_omega").mean()), 5),
        "step_ratio": float(ratio[np.argmax(np.abs(ratio - 1))]),
        "falls": int(column("fell").sum()),
    }
    if variant == "lean":
        flat = walks.speed.reshape(-1, 12)
        share = float(np.max(np.mean(np.asarray(flat) > 1.2, axis=0)))
        whole |= {
            "joint_speed_ratio_p99": round(
                float(measure.speed_ratio(walks._replace(speed=flat[None]))), 4
            ),
            "share_above_1.2": round(share, 5),
            "torque_max": round(float(walks.torque.max()), 3),
            "power_mean": round(float(walks.power.mean()), 3),
            "clipped_worst_joint": round(float(walks.clipped.max()), 4),
        }
    return rows, whole


def kicks(env, num: int, seed: int) -> list[dict[str, Any]]:
    """What the kicks do, one row each: speed (m/s) and direction (rad) with their standard
    deviations over the trials that moved the ball, the share that missed (below 0.05 m/s), that
    gave 0.5 m/s, and that fell; the zone (m, dog's frame) of the ball's places; the run-out (m)."""
    from envs.quadruped import motions

    rows = []
    for path in sorted(motions.FOLDER.glob("*.json")):
        file = json.loads(path.read_text(encoding="utf-8"))
        if file["kind"] != "kick":
            continue
        motion = motions.load(path, motions.standing(env))
        points = motions.set_points(motion, env.solver.timestep)
        balls = motions.displaced(np.random.default_rng(seed), np.array(file["ball"]), num)
        found = motions.kick(env, points, motion.strike, balls)
        velocity = found.ball
        speed = np.hypot(*velocity.T)
        hit = speed >= 0.05
        angle = np.arctan2(velocity[hit, 1], velocity[hit, 0])
        low, high = balls.min(0), balls.max(0)
        row: dict[str, Any] = {"name": motion.name, "trials": num}
        row |= {"zone": [low[0], high[0], low[1], high[1]], "delay": motion.strike}
        row |= {"duration": motion.times[-1], "speed": speed[hit].mean()}
        row |= {"speed_spread": speed[hit].std(), "direction": angle.mean()}
        row |= {"direction_spread": angle.std(), "miss": 1 - hit.mean()}
        row |= {"half_metre_a_second": np.mean(speed >= 0.5)}
        row |= {"within_0.35_rad": np.mean(np.abs(angle - np.median(angle)) <= 0.35)}
        row |= {"run_out": float(np.mean(speed**2) / (2 * float(env.ball_deceleration)))}
        row |= {"falls": np.mean((found.upright < 0.7) | (found.height < 0.05))}
        row |= {"joint_speed_ratio_p99": found.speed.max()}
        rows.append({k: np.round(x, 3).tolist() if k != "name" else x for k, x in row.items()})
    return rows


def main(argv: list[str] | None = None) -> None:
    config = script.options(Config, Config.__doc__, "experiments/locomotion.py", argv)
    try:
        _main(config)
    except ValueError as error:
        refuse(str(error))


def _main(config: Config) -> None:
    script.check_files(config, "csv", "out")
    script.check_least(config, num=1, seed=0)
    xla.configure()
    from envs.quadruped.environment import standing
    from envs.quadruped.locomotion import DEFAULT_GAIT, load_gait

    env = standing(load_gait(config.gait or DEFAULT_GAIT))
    if config.what == "kicks":
        document = {
            "format": "fntg-kicks",
            "version": 1,
            "kicks": kicks(env, config.num, config.seed),
        }
        text = json.dumps(document, indent=1, allow_nan=False)
        print(text)
        if config.out is not None:
            config.out.write_text(text + "\n", encoding="utf-8")
        return
    rows, whole = table(env, config.variant)
    if config.csv is not None:
        script.write_csv(config.csv, rows[0], [row.values() for row in rows])
    if config.json:
        plain = [{k: None if math.isnan(x) else x for k, x in row.items()} for row in rows]
        print(json.dumps({**whole, "rows": plain}, allow_nan=False))
        return
    print(" ".join(f"{k:>11.11s}" for k in rows[0]))
    for row in rows:
        print(" ".join(f"{x:11.4g}" for x in row.values()))
    for name, value in whole.items():
        print(f"{name} {value}")


if __name__ == "__main__":
    main()
