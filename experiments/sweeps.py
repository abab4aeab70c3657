"""What the sweep scripts share: options, the run, and its table, leaderboard and figure."""

import dataclasses
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tyro

from experiments import script
from fntg_jax.commands.cli import say
from fntg_jax.running import xla


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


def main(doc: str, name: str, run: Callable, plot: Callable) -> None:
    """Parse options, run, plot; the leaderboard on stdout; bad input is one line and status 2."""
    options = tyro.cli(Options, description=doc, prog=f"experiments/{name}.py")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    from fntg_jax.showing import sweep_report

    with script.folder(options.out):
        table = run(options)
        print(sweep_report.leaderboard(table), end="")
        print(plot(table, options.out / f"{name}.png"))


def swept(
    config: Options, settings: Sequence[dict[str, Any]], suites: Sequence[str] = (), **base: Any
) -> Any:
    """`sweep.Table` of the paper preset with those settings; base: other fields of it."""
    from fntg_jax.running import settings as presets
    from fntg_jax.running import sweep

    paper = presets.PRESETS["paper"]
    paper = dataclasses.replace(
        paper,
        seeds=config.seeds,
        generations=config.generations,
        ga=dataclasses.replace(paper.ga, population=config.population),
        **base,
    )
    return sweep.run(paper, settings, suites, say=say)


def plot(table: Any, path: Path) -> Path:
    """PNG, PDF and CSV."""
    from fntg_jax.showing import sweep_report

    sweep_report.write_csv(table, 0, path.with_suffix(".csv"))
    figure = sweep_report.plot(table, path)
    assert figure is not None  # all scripts sweep one or two axes
    return figure
