"""Calibrate a walk, and look at what a gait does.

fntg train --task gait --out runs/gait                                   evolves one
python -m experiments.tune_gait calibrate --gait runs/gait/gait.json --out gait.json
python -m experiments.tune_gait speed [--gait gait.json]   forward speed against command
python -m experiments.tune_gait falls [--gait gait.json] [--variant full]

The table of commands is `python -m experiments.locomotion table`.
"""

import dataclasses
import json
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro

from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class Config:
    """Gait tuning.

    Attributes:
        what: calibrate, speed or falls.
        gait: gait to look at; default the shipped one.
        out: where the calibrated gait goes.
        variant: model of the falls.
        num: sequences of falls.
        seed: of the commands.
    """

    what: tyro.conf.Positional[Literal["calibrate", "speed", "falls"]] = "speed"
    gait: Path | None = None
    out: Path = Path("gait.json")
    variant: Literal["lean", "full"] = "lean"
    num: int = 100
    seed: int = 0


def main(argv: list[str] | None = None) -> None:
    config = script.options(Config, Config.__doc__, "experiments/tune_gait.py", argv)
    try:
        _main(config)
    except ValueError as error:
        refuse(str(error))


def _main(config: Config) -> None:
    script.check_least(config, seed=0, num=1)
    if config.what != "falls" and config.variant == "full":
        raise ValueError(f"variant = 'full': allowed with {config.what} is lean")
    script.check_files(config, "out")
    xla.configure()
    from envs.quadruped import measure, styles
    from envs.quadruped.environment import standing
    from envs.quadruped.locomotion import DEFAULT_GAIT, load_gait

    path = config.gait or DEFAULT_GAIT
    gait = load_gait(path)
    env = standing(gait)
    if config.what == "calibrate":
        table = styles.calibrate(env, measure.RANGE)
        origin = json.loads(path.read_text(encoding="utf-8"))["origin"]
        text = styles.document(dataclasses.replace(gait, calibration=table), origin)
        config.out.write_text(text, encoding="utf-8")
        print(config.out)
    elif config.what == "speed":
        commands = np.array([[v, 0, 0] for v in np.arange(0.04, 0.33, 0.04)], np.float32)
        walks = jax.jit(partial(measure.steady, commands=commands))(env)
        speed = measure.speed_ratio(walks)
        for command, got, fell, joint in zip(commands, walks.velocity, walks.fallen, speed):
            print(
                f"{command[0]:.2f} m/s: v_x {got[0]:.3f} v_y {got[1]:.3f} m/s, omega {got[2]:.3f}"
                f" rad/s, joints {joint:.2f} x Sony's speed{', fell' if fell else ''}"
            )
    else:
        key = jax.random.key(config.seed)
        fell = measure.falls_full if config.variant == "full" else _falls_lean
        fallen = np.asarray(fell(env, key, config.num))
        print(f"{int(fallen.sum())} falls in {len(fallen)} sequences of 22 s, {config.variant}")


def _falls_lean(env, key, num):
    from envs.quadruped import measure

    return jax.jit(partial(measure.falls, num=num))(env, key).fallen


if __name__ == "__main__":
    main()
