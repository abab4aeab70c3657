"""Evolve the walk with our own genetic algorithm, and look at what a gait does.

python -m experiments.tune_gait evolve --out gait.json     some minutes on two cores
python -m experiments.tune_gait speed [--gait gait.json]   forward speed against command
python -m experiments.tune_gait falls [--gait gait.json] [--variant full]

The table of commands is `python -m experiments.locomotion table`.
"""

import dataclasses
import json
import sys
from functools import partial
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro

from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.controller import genome
from fntg_jax.learning import ga
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class Config:
    """Gait tuning.

    Attributes:
        what: evolve, speed or falls.
        gait: gait to look at, and where an evolved one has what does not evolve from (v_rate,
            omega_rate); default the shipped one.
        out: where the evolved gait goes.
        variant: model of the falls.
        num: sequences of falls.
        population, generations, seed: of the genetic algorithm.
    """

    what: tyro.conf.Positional[Literal["evolve", "speed", "falls"]] = "speed"
    gait: Path | None = None
    out: Path = Path("gait.json")
    variant: Literal["lean", "full"] = "lean"
    num: int = 100
    population: int = 60
    generations: int = 95
    seed: int = 0


def evolve(config: Config, env) -> ga.State:
    """Evolve a gait; rank selection, since fitness differences get small."""
    from envs.quadruped import gait_task

    settings = ga.GAConfig(
        population=config.population, selection="rank", mutation_rate=0.01, num_elites=2
    )

    def fitness_fn(key, theta):
        return gait_task.fitness(env, key, theta)[0]

    advance = jax.jit(partial(ga.generation, fitness_fn=fitness_fn, config=settings))
    state = ga.init(jax.random.key(config.seed), len(gait_task.GENES), settings)
    for n in range(config.generations):
        state, record = advance(state)
        print(f"generation {n + 1}: best {record.best:.3f} mean {record.mean:.3f}", file=sys.stderr)
    return state


def document(gait, origin: str) -> str:
    """A gait as the text of its JSON file."""
    from envs.quadruped.locomotion import as_number

    values = {
        f.name: as_number(np.round(getattr(gait, f.name), 5)) for f in dataclasses.fields(gait)
    }
    file = {"format": "fntg-gait", "version": 2, "origin": origin, "gait": values}
    return json.dumps(file, indent=2, allow_nan=False) + "\n"


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(Config, args=argv)
    try:
        _main(config)
    except ValueError as error:
        refuse(str(error))


def _main(config: Config) -> None:
    script.check_least(config, population=4, generations=1, seed=0, num=1)
    if config.what != "falls" and config.variant == "full":
        raise ValueError(f"variant = 'full': allowed with {config.what} is lean")
    script.check_files(config, "out")
    xla.configure()
    from envs.quadruped import gait_task, measure
    from envs.quadruped.environment import Quadruped
    from envs.quadruped.locomotion import DEFAULT_GAIT, load_gait

    gait = load_gait(config.gait or DEFAULT_GAIT)
    env = Quadruped(gait=gait)
    if config.what == "evolve":
        plain = dataclasses.replace(gait, calibration=type(gait)().calibration)
        state = evolve(config, dataclasses.replace(env, gait=plain))
        found = gait_task.gait_of(plain, genome.decode(state.best_bits, 15, False))
        found = gait_task.calibrate(Quadruped(gait=found), jax.random.key(config.seed))
        origin = f"experiments.tune_gait evolve --population {config.population}"
        origin += f" --generations {config.generations} --seed {config.seed}"
        config.out.write_text(document(found, origin), encoding="utf-8")
        print(f"fitness {float(state.best_fitness):.3f}, written to {config.out}")
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
