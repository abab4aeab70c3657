"""How much of a real dog's perception and actuation a controller stands: success against level.

    python -m experiments.noise

Seven disturbances, one at a time: noise of angles and of ranges, latency, lost frames, a camera
that sees ahead only, a body slower than commanded, slip.  Controllers: the shipped one, and two
sets of the same budget (options generations and refine_steps), one trained without any
disturbance and one with all of `TRAINED_WITH` at once.  Lines are medians over seeds, bands go from
the worst seed to the best.  Success is the mean over unseen scenes of the suites open and blocked.
Writes noise.csv (one row a controller, disturbance, level and suite), noise.png and .pdf.
"""

import dataclasses
import os
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import fntg_jax
from experiments import script
from fntg_jax.controller.layout import get_layout
from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import rollout_pairs
from fntg_jax.running import evaluation, registry, runner, settings, xla
from fntg_jax.showing import plots

SUITES = ("open", "blocked")


class Disturbance(NamedTuple):
    """An option of the kinematic world, its levels, and what else must be given to have nothing
    but it.  The first level is none."""

    option: str
    label: str
    levels: tuple[float, ...]
    base: dict[str, float]


_SENSING = {"angle_noise": 0.0, "range_noise": 0.0}
_ACTUATION = {"v_rate": 100.0, "omega_rate": 1000.0, "lag": 0.0}
DISTURBANCES = (
    Disturbance("angle_noise", "angle noise, rad", (0, 0.035, 0.07, 0.14, 0.28), _SENSING),
    Disturbance("range_noise", "range noise, share", (0, 0.07, 0.15, 0.3, 0.6), _SENSING),
    Disturbance("latency", "latency, 0.1 s", (0, 1, 2, 4, 8), {}),
    Disturbance("dropout", "lost frames, share", (0, 0.2, 0.4, 0.6, 0.8), _SENSING),
    Disturbance("view", "camera's opening, rad", (6.3, 4.0, 2.0, 1.0, 0.5), _SENSING),
    Disturbance("v_top", "top speed, m/s", (0.2, 0.175, 0.15, 0.125, 0.1), _ACTUATION),
    Disturbance("slip", "slip, share", (0, 0.1, 0.2, 0.4, 0.8), _ACTUATION),
)
# About what was published for the AIBO (angles 2 degrees, ranges 5-10 %, odometry 10-20 %), twice
# that for angles, and a camera frame of 0.1 s; the camera opens by 57.6 degrees.
TRAINED_WITH = {
    "angle_noise": 0.07,
    "range_noise": 0.1,
    "latency": 1.0,
    "dropout": 0.1,
    "view": 1.0,
    "slip": 0.15,
}


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute and where the results go."""

    out: Path = Path("runs/noise")
    """folder of the CSV and the figure."""
    seeds: int = 4
    """controllers trained in each set; 0: the shipped controller alone."""
    generations: int = 100
    """of the preset robust (which has 200)."""
    refine_steps: int = 500
    """of its refinement (which has 1000)."""
    population: int = 512
    """genomes."""
    scenes: int = 1000
    """unseen scenes a suite."""


class Results(NamedTuple):
    """sets: name -> row indices into success [disturbance, level, controller, suite]."""

    sets: dict[str, list[int]]
    success: np.ndarray


def train(options: Options, env_options: dict[str, float]) -> Any:
    """theta [seeds, genes]: the preset robust at the given budget."""
    robust = settings.PRESETS["robust"]
    config = dataclasses.replace(
        robust,
        seeds=options.seeds,
        generations=options.generations,
        refine_steps=options.refine_steps,
        env_options=env_options,
        ga=dataclasses.replace(robust.ga, population=options.population),
    )
    return jnp.asarray(runner.train(config).conclude().theta)


def run(options: Options) -> Results:
    """Train, then judge every controller under every disturbance.  Raises ValueError."""
    script.check_least(options, seeds=0, generations=1, refine_steps=0, scenes=1)
    shipped = fntg_jax.load(fntg_jax.shipped("bioa"))
    thetas = [jnp.asarray(shipped.theta, jnp.float32)[None]]
    sets = {"shipped (bioa)": [0]}
    if options.seeds:
        for name, env_options in (("trained without", {}), ("trained with", TRAINED_WITH)):
            print(f"{name}: {options.seeds} seeds, {options.generations} generations", flush=True)
            first = sum(len(t) for t in thetas)
            thetas.append(train(options, env_options))
            sets[name] = list(range(first, first + options.seeds))
    # All controllers are read like the shipped one: one batch.
    robust = settings.PRESETS["robust"]
    assert (shipped.layout, shipped.output) == (get_layout(robust.layout), robust.output)
    theta = jnp.concatenate(thetas)
    world = registry.get_world("kinematic")
    scenes = [evaluation.held_out_scenes(world, suite, options.scenes) for suite in SUITES]

    @jax.jit
    def judge(theta, scenes, env):
        outcome = rollout_pairs(shipped.layout, theta, scenes, env, output=shipped.output)
        return jnp.mean(fitness.success(outcome).success, axis=1)

    make = partial(evaluation.environment_for, shipped, world)
    success = np.zeros((len(DISTURBANCES), 5, len(theta), len(SUITES)))
    for row, d in enumerate(DISTURBANCES):
        for column, level in enumerate(d.levels):
            # Floats as arrays: the levels of a disturbance share one compilation.
            env = jax.tree.map(jnp.asarray, make(**{**d.base, d.option: float(level)}))
            for n, batch in enumerate(scenes):
                success[row, column, :, n] = judge(theta, batch, env)
            print(_line(d, level, sets, success[row, column]), flush=True)
    return Results(sets, success)


def _line(d: Disturbance, level: float, sets: dict[str, list[int]], success: np.ndarray) -> str:
    mean = 100 * success.mean(axis=1)
    parts = [
        f"{name} {np.median(mean[rows]):5.1f} % [{mean[rows].min():.1f}, {mean[rows].max():.1f}]"
        for name, rows in sets.items()
    ]
    return f"{d.label:22s} {level:<6g} " + "   ".join(parts)


def plot(results: Results, path: Path) -> Path:
    """PNG, PDF and CSV."""
    figure, axes = plots.new_grid(2, 4, 11, 5.2)
    for axis, d, success in zip(axes.flat, DISTURBANCES, results.success):
        for (name, rows), colour in zip(results.sets.items(), plots.COLOURS):
            mean = 100 * success.mean(axis=-1)[:, rows]
            axis.plot(d.levels, np.median(mean, axis=1), "o-", color=colour, ms=3, label=name)
            if len(rows) > 1:
                band = mean.min(axis=1), mean.max(axis=1)
                axis.fill_between(d.levels, *band, color=colour, alpha=0.2, lw=0)
        axis.set_xlabel(d.label)
        axis.set_ylim(0, 100)
        if d.levels[0] > d.levels[-1]:
            axis.invert_xaxis()  # worse to the right, everywhere
    for axis in axes[:, 0]:
        axis.set_ylabel("success, %")
    axes[1, 3].axis("off")
    axes[1, 3].legend(*axes[0, 0].get_legend_handles_labels(), loc="center")
    path = plots.save(figure, path)
    table = [
        (name, seed, d.option, f"{level:g}", suite, f"{value:.6g}")
        for d, of_levels in zip(DISTURBANCES, results.success)
        for level, of_rows in zip(d.levels, of_levels)
        for name, of_set in results.sets.items()
        for seed, row in enumerate(of_set)
        for suite, value in zip(SUITES, of_rows[row])
    ]
    header = ("controllers", "seed", "disturbance", "level", "suite", "success")
    script.write_csv(path.with_suffix(".csv"), header, table)
    return path


def main() -> None:
    options = script.options(Options, __doc__, "experiments/noise.py")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    with script.folder(options.out):
        print(plot(run(options), options.out / "noise.png"))


if __name__ == "__main__":
    main()
