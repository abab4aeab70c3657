"""`fntg sweep`: a grid of settings x seeds; table, leaderboard, figure."""

import dataclasses
import os
import time
from pathlib import Path
from typing import Annotated, Any

import tyro

from fntg_jax.commands.cli import say
from fntg_jax.commands.train import generation_bar, parse_over_preset
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """Learn with every combination of values and compare: sweep.csv, a leaderboard, a figure.

    Attributes:
        preset: starting point of all other options (given first or anywhere).
        axis: NAME=VALUE,VALUE,...; may be given several times.  NAME is an option of training
            (generations, layout, ga.mutation_rate, fitness.v) or env.OPTION of the world.
        suites: also judge on unseen scenes of these suites.
        scenes: scenes a suite.
        out: folder; default runs/sweep-DATE-TIME.
    """

    config: Annotated[Any, tyro.conf.arg(name="")]
    preset: str = "paper"
    axis: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    suites: tuple[str, ...] = ()
    scenes: int = 2000
    out: Path | None = None


def main(argv: list[str]) -> None:
    options = parse_over_preset(SweepOptions, argv, "sweep")
    if not options.axis:
        raise ValueError("axis: none given; e.g. --axis ga.mutation_rate=0.0003,0.001,0.003")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    from fntg_jax.files import writing
    from fntg_jax.running import sweep
    from fntg_jax.showing import sweep_report

    axes: dict[str, list[Any]] = {}
    for text in options.axis:
        name, values = sweep.parse_axis(text)
        if name in axes:
            raise ValueError(f"axis {name}: given twice")
        axes[name] = values
    settings = sweep.grid(axes)
    if options.scenes < 1:
        raise ValueError(f"scenes = {options.scenes}: allowed are whole numbers from 1")
    folder = options.out or Path("runs") / f"sweep-{time.strftime('%Y%m%d-%H%M%S')}"
    sweep.problems(options.config, settings, options.suites)  # refuses what cannot run
    with writing(folder, "out"):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ValueError(f"out = {folder}: exists already; choose a new folder")
        folder.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    table = sweep.run(options.config, settings, options.suites, options.scenes, say, generation_bar)
    say(f"{time.perf_counter() - start:.1f} s")
    with writing(folder):
        sweep_report.write_csv(table, options.config.first_seed, folder / "sweep.csv")
        figure = sweep_report.plot(table, folder / "sweep.png")
    print(sweep_report.leaderboard(table), end="")
    say(f"table {folder / 'sweep.csv'}" + (f", figure {figure}" if figure else ""))
