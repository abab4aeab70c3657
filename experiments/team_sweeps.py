"""What makes a team learn: sweeps over one thing at a time, in the paper's spirit.

    python -m experiments.team_noise [--seeds 3] [--generations 40] [--population 60] [--seconds 20]

Each setting is evolved from as many seeds; the result is judged on held-out matches against the
shipped teams under the same conditions: points (wins and half of the draws) by setting and seed as
CSV, and a figure with the medians and their 95 % bootstrap intervals.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments import script
from fntg_jax.running import xla

RESULTS = Path(__file__).parent / "results"


class Sweep(NamedTuple):
    """label: of the axis; settings: name -> changes of (task options, configuration)."""

    label: str
    settings: dict[str, tuple[dict[str, float], dict[str, Any]]]


def _option(name: str, label: str, values: tuple[float, ...]) -> Sweep:
    return Sweep(label, {f"{value:g}": ({name: value}, {}) for value in values})


SWEEPS = {
    "noise": _option(
        "noise", "factor on the camera's errors and misses", (0.0, 0.5, 1.0, 2.0, 4.0)
    ),
    "sound": _option("hearing", "distance where half of the words are lost (m)", (0.3, 1.0, 3.8)),
    "players": _option("players", "robots a side", (1, 2, 3, 4)),
    "length": _option("seconds", "length of a training match (s)", (5, 10, 20, 40)),
    # As many matches each.
    "budget": Sweep(
        "population x generations",
        {
            f"{p} x {g}": ({}, {"population": p, "generations": g})
            for p, g in ((20, 285), (60, 95), (120, 47), (240, 24))
        },
    ),
    # What evolution consists of.
    "ablation": Sweep(
        "what is left out, or added",
        {
            "all": ({}, {}),
            "no hall of fame": ({"hall": 0, "rivals": 4}, {}),
            "no side swap": ({"swap": 0}, {}),
            "no dense term": ({"dense": 0.0}, {}),
            "with BIOA's genes": ({"bioa": 1}, {}),
        },
    ),
}


def evolve(sweep: Sweep, options: Any) -> list[tuple[str, int, dict[str, float]]]:
    """(setting, seed, judgement) of every run."""
    import dataclasses

    from fntg_jax.running import runner, settings

    rows = []
    preset = settings.PRESETS["team"]
    for name, (task, changes) in sweep.settings.items():
        seconds = {} if "seconds" in task else {"seconds": options.seconds}
        population = changes.get("population", options.population)
        # A budget given by hand keeps the shares of a setting's own.
        generations = round(changes.get("generations", 95) / 95 * options.generations)
        config = dataclasses.replace(
            preset,
            task_options=seconds | task,
            seeds=options.seeds,
            first_seed=options.first_seed,
            generations=max(generations, 1),
            ga=dataclasses.replace(preset.ga, population=population),
        )
        result = runner.train(config).conclude()
        assert result.judgement is not None
        for seed in range(options.seeds):
            judged = {key: float(x[seed]) for key, x in result.judgement.items()}
            rows.append((name, options.first_seed + seed, judged))
            print(
                f"{name:20s} seed {seed}: " + ", ".join(f"{k} {v:.3f}" for k, v in judged.items())
            )
    return rows


def plot(sweep: Sweep, rows: list, path: Path) -> Path:
    """Points by setting: seeds, median, interval."""
    from fntg_jax.running.statistics import bootstrap_median
    from fntg_jax.showing import plots

    figure, axes = plots.new_grid(1, 1, 5.6, 3.6)
    axes = axes[0, 0]
    names = list(sweep.settings)
    for n, name in enumerate(names):
        values = np.array([100 * judged["score"] for setting, _, judged in rows if setting == name])
        axes.plot(np.full(len(values), n), values, ".", color=plots.BLUE, alpha=0.4)
        low, median, high = bootstrap_median(values[:, None])[:, 0]
        axes.errorbar(n, median, [[median - low], [high - median]], fmt="o", color=plots.ORANGE)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlabel(sweep.label)
    axes.set_ylabel("points against the shipped teams (%)")
    return plots.save(figure, path)


def main(name: str, argv: list[str] | None = None) -> Path:
    parser = argparse.ArgumentParser(description=__doc__)
    for option, value in (
        ("seeds", 3),
        ("first-seed", 100),
        ("generations", 40),
        ("population", 60),
    ):
        parser.add_argument(f"--{option}", type=int, default=value)
    parser.add_argument("--seconds", type=float, default=20.0, help="of a match in training")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(argv)
    xla.configure()
    with script.folder(options.out):
        script.check_least(options, seeds=1, generations=1, population=2)
        sweep = SWEEPS[name]
        rows = evolve(sweep, options)
        path = plot(sweep, rows, options.out / f"team_{name}.png")
        keys = list(rows[0][2])
        script.write_csv(
            path.with_suffix(".csv"),
            ["setting", "seed", *keys],
            [
                [setting, seed, *(f"{judged[k]:.6g}" for k in keys)]
                for setting, seed, judged in rows
            ],
        )
        print(path)
    return path
