"""The sweeps of the paper's recipe, and what `experiments/sweep_NAME.py` does: the run, its table,
leaderboard and figure."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from experiments import script
from fntg_jax.commands.cli import say
from fntg_jax.controller.layout import LAYOUTS
from fntg_jax.learning.ga import SELECTIONS
from fntg_jax.running import xla
from fntg_jax.running.sweep import grid


@dataclasses.dataclass(frozen=True)
class Options:
    """Budget of every setting, and where the results go."""

    seeds: int = 30
    """seeds of every setting."""
    generations: int = 95
    """generations of the paper's population of 60; other settings as they say."""
    population: int = 60
    """genomes, where they are not what is swept."""
    out: Path = Path("runs/figures")
    """folder for PNG, PDF and CSV."""


class Sweep(NamedTuple):
    """about: what is asked.  settings: options -> the settings that are compared.  suites: of
    unseen scenes that are judged on, where fitness means another thing in each setting."""

    about: str
    settings: Callable[[Options], list[dict[str, Any]]]
    suites: tuple[str, ...] = ()


def _budget(options: Options) -> list[dict[str, Any]]:
    evaluations = 60 * options.generations
    sizes = [20, 30, 60, 100, 190, 300]
    return [{"ga.population": n, "generations": max(1, evaluations // n)} for n in sizes]


SWEEPS = {
    "bits": Sweep(
        "Bits a gene x plain binary or Gray code.  A bit flips with the same probability "
        "everywhere: genes of more bits mutate more often.",
        lambda _: grid({"ga.num_bits": [6, 8, 10, 15, 20], "ga.gray": [False, True]}),
    ),
    "budget": Sweep(
        "Few generations of many genomes, or many of few: population x generations is the same.",
        _budget,
    ),
    "dt": Sweep(
        "The control step, which the paper does not give: 220 steps take 11 s at 0.05 s, 44 s at "
        "0.2 s.  Judged by success on unseen scenes, at the same control step, because F of a "
        "longer trial is another quantity.",
        lambda _: grid({"env.dt": [0.05, 0.075, 0.1, 0.15, 0.2]}),
        ("open",),
    ),
    "layout": Sweep(
        "Gene tables (readings of the paper) x reading of the outputs.",
        lambda _: grid({"layout": list(LAYOUTS), "output": ["scale", "clip"]}),
    ),
    "mutation_crossover": Sweep(
        "Mutation rate a bit x share of pairs that are crossed: one compiled program.",
        lambda _: grid(
            {
                "ga.mutation_rate": [0.0, 0.0003, 0.001, 0.003, 0.01],
                "ga.crossover_rate": [0.0, 0.6, 0.8, 1.0],
            }
        ),
    ),
    "selection": Sweep(
        "Selection schemes: roulette wheel (the paper, as we read it) and four others.",
        lambda _: grid({"ga.selection": list(SELECTIONS)}),
    ),
}


def main(name: str) -> None:
    """Parse options, run, plot; the leaderboard on stdout; bad input is one line and status 2."""
    script_name = f"sweep_{name}"
    about = SWEEPS[name].about
    options = script.options(Options, about, f"experiments/{script_name}.py")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    from fntg_jax.showing import sweep_report

    with script.folder(options.out):
        table = run(name, options)
        print(sweep_report.leaderboard(table), end="")
        print(plot(table, options.out / f"{script_name}.png"))


def run(name: str, options: Options) -> Any:
    """`sweep.Table` of the paper preset with the settings of that sweep."""
    from fntg_jax.running import settings, sweep

    paper = settings.PRESETS["paper"]
    paper = dataclasses.replace(
        paper,
        seeds=options.seeds,
        generations=options.generations,
        ga=dataclasses.replace(paper.ga, population=options.population),
    )
    return sweep.run(paper, SWEEPS[name].settings(options), SWEEPS[name].suites, say=say)


def plot(table: Any, path: Path) -> Path:
    """PNG, PDF and CSV."""
    from fntg_jax.showing import sweep_report

    sweep_report.write_csv(table, 0, path.with_suffix(".csv"))
    figure = sweep_report.plot(table, path)
    assert figure is not None  # all scripts sweep one or two axes
    return figure
