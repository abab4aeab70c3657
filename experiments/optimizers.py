"""Which optimiser for such a controller?  Equal control steps, equal seconds, many seeds.

    python -m experiments.optimizers

Our genetic algorithm (settings of the paper and of the preset robust, and with that preset's
refinement or with gradients after it), gradients alone, evosax's CMA-ES, OpenES and SimpleGA, and
brax's trainers, all on the smooth objective of the preset robust and on open and blocked scenes.
Genes are read as in that preset (clip) or scaled to the range of speeds, which suits gradients.
Success is on unseen scenes, the mean of the suites open and blocked.  A gradient step counts three
control steps for one (forward, forward again, backward).  Seconds are those of training alone,
without compilation and judging.

Results are added to optimizers.csv as each run ends; runs that are in it are not repeated.  brax's
networks go faster without our XLA flags: run those methods first, with FNTG_XLA_FLAGS=off and
--methods; PPO and APG need an older jax than ours (`make brax-baseline`).  Writes optimizers.csv
(one row a checkpoint), optimizers.md, optimizers.png and .pdf.
"""

import contextlib
import csv
import dataclasses
import io
import sys
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from experiments import optimizers_brax, optimizers_fntg, script
from experiments.optimizers_fntg import Task
from fntg_jax.files import write_atomically
from fntg_jax.running import statistics, xla
from fntg_jax.showing import plots

METHODS = (
    "ga-paper", "ga-robust", "ga-refined", "ga-gradient", "gradient", "cma-es", "open-es",
    "simple-ga", *optimizers_brax.NAMES,
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute and where the results go."""

    out: Path = Path("runs/optimizers")
    """folder of the results."""
    budget: int = 100_000_000
    """control steps of a run."""
    seeds: int = 10
    """runs of each method."""
    checkpoints: int = 10
    """how often success is measured on the way."""
    eval_scenes: int = 1000
    """unseen scenes a suite."""
    output: Literal["clip", "scale"] = "clip"
    """how the FNTG's genes are read; does not concern networks."""
    methods: tuple[str, ...] = METHODS
    """which methods to run; the figure and the table show all that the CSV has."""


class Row(NamedTuple):
    """One checkpoint."""

    method: str
    seed: int
    budget: int
    eval_scenes: int
    output: str
    parameters: int
    control_steps: int
    seconds: float
    open: float
    blocked: float

    @property
    def success(self) -> float:
        return (self.open + self.blocked) / 2


def run(options: Options) -> tuple[list[Row], list[str]]:
    """All runs that the CSV lacks; all rows at this budget, and what was left out and why.
    Raises ValueError: option, value, what is allowed."""
    script.check_least(options, budget=1, seeds=1, checkpoints=1, eval_scenes=1)
    for name in options.methods:
        if name not in METHODS:
            raise ValueError(f"methods = {name!r}: known are {', '.join(METHODS)}")
    path = options.out / "optimizers.csv"
    rows = read(path) if path.exists() else []
    task = Task(options.output, eval_scenes=options.eval_scenes)
    try:
        ours = [name for name in options.methods if name not in optimizers_brax.NAMES]
        phases = optimizers_fntg.searches() if ours else {}
        with contextlib.redirect_stdout(io.StringIO()):  # "Failed to import warp"
            import brax.envs  # noqa: F401
    except ModuleNotFoundError as error:
        raise ValueError(f"needs {error.name}: pip install 'fntg-jax[compare]'") from None
    left_out = []
    kind = (options.budget, options.eval_scenes, options.output)
    for name in options.methods:
        for seed in range(options.seeds):
            what = (name, seed, *kind)
            if any(row[:5] == what for row in rows):
                continue
            print(f"{name}, seed {seed} of {options.seeds}", file=sys.stderr, flush=True)
            try:
                found = _train(name, phases, task, seed, options)
            except optimizers_brax.LeftOut as error:
                left_out.append(str(error))
                break
            rows += [Row(*what, *more) for more in found]
            write(path, rows)
    return [row for row in rows if row[2:5] == kind], left_out


def _train(name: str, phases: Any, task: Task, seed: int, options: Options) -> list[tuple]:
    if name in phases:
        course = list(
            optimizers_fntg.train(
                name, phases[name], task, seed, options.budget, options.checkpoints
            )
        )
        parameters = task.static.layout.num_genes
    else:
        *course, parameters = optimizers_brax.train(
            name, task, seed, options.budget, options.checkpoints
        )
    return [(parameters, c.control_steps, c.seconds, *map(float, c.success)) for c in course]


def read(path: Path) -> list[Row]:
    """Rows of the CSV.  Raises ValueError when it is not one of ours."""
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file)
        if next(reader, None) != list(Row._fields):
            raise ValueError(f"{path}: not written by this script")
        kinds = Row.__annotations__.values()
        try:
            return [Row(*(kind(x) for kind, x in zip(kinds, line, strict=True))) for line in reader]
        except ValueError:
            raise ValueError(f"{path}: line {reader.line_num} is not a row") from None


def write(path: Path, rows: list[Row]) -> None:
    script.write_csv(path, Row._fields, rows)


def courses(rows: list[Row]) -> dict[str, list[list[Row]]]:
    """method -> runs, each a list of its checkpoints."""
    runs: dict[str, dict[int, list[Row]]] = {}
    for row in rows:
        runs.setdefault(row.method, {}).setdefault(row.seed, []).append(row)
    known = [name for name in METHODS if name in runs]
    return {name: list(runs[name].values()) for name in known}


def at_seconds(course: list[Row], seconds: float) -> float:
    """Success at the last checkpoint within so many seconds; 0 before the first."""
    within = [row.success for row in course if row.seconds <= seconds]
    return within[-1] if within else 0.0


def table(rows: list[Row], left_out: list[str]) -> str:
    """Markdown: medians over seeds with 95 % bootstrap intervals, and who wins."""
    found = courses(rows)
    ends = {name: np.asarray([c[-1].success for c in runs]) for name, runs in found.items()}
    wall = {name: np.median([c[-1].seconds for c in runs]) for name, runs in found.items()}
    # Everyone gets the time that the fastest needs for the whole budget.
    common = min(wall.values())
    timely = {
        name: np.asarray([at_seconds(c, 1.001 * common) for c in runs])
        for name, runs in found.items()
    }
    lines = [
        "| method | readable | parameters | seeds | seconds | success after all steps, % |"
        f" success after {common:.3g} s, % |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, runs in found.items():
        readable = "no, a network" if name.endswith("mlp") else "yes, 16 rules"
        lines.append(
            f"| {name} | {readable} | {runs[0][0].parameters} | {len(runs)} | {wall[name]:.3g}"
            f" | {_interval(ends[name])} | {_interval(timely[name])} |"
        )
    steps = max(c[-1].control_steps for runs in found.values() for c in runs) / 1e6
    lines += ["", _winner(f"{steps:.3g} M control steps", ends)]
    lines += [_winner(f"{common:.3g} s", timely)]
    lines += [f"Left out: {reason}" for reason in left_out]
    return "\n".join(lines)


def _interval(values: np.ndarray) -> str:
    low, middle, high = 100 * statistics.bootstrap_median(values)
    return f"{middle:.1f} [{low:.1f}, {high:.1f}]"


def _winner(budget: str, values: dict[str, np.ndarray]) -> str:
    bounds = {name: statistics.bootstrap_median(v) for name, v in values.items()}
    best = max(bounds, key=lambda name: bounds[name][1])
    equal = [n for n in bounds if n != best and bounds[n][2] >= bounds[best][0]]
    rest = f"; its interval overlaps with that of {', '.join(equal)}" if equal else ", alone"
    return f"After {budget} {best} has the highest median success{rest}."


def plot(rows: list[Row], path: Path) -> Path:
    """PNG and PDF: success against control steps and against seconds."""
    figure, axes = plots.new_grid(1, 2, 10, 4.2)
    styles = ("-", "--")
    for n, (name, runs) in enumerate(courses(rows).items()):
        colour, style = plots.COLOURS[n % 6], styles[n // 6]
        # Runs of a method share their checkpoints' steps, within rounding.
        length = min(len(c) for c in runs)
        success = 100 * np.asarray([[r.success for r in c[:length]] for c in runs])
        steps = np.median([[r.control_steps for r in c[:length]] for c in runs], axis=0)
        seconds = np.median([[r.seconds for r in c[:length]] for c in runs], axis=0)
        low, middle, high = np.percentile(success, [25, 50, 75], axis=0)
        for axis, x in zip(axes[0], (steps / 1e6, seconds)):
            axis.plot(x, middle, style, marker="o", ms=3, color=colour, label=name)
            # Quartiles of the end alone: bands of eight methods over each other say nothing.
            end = [middle[-1:] - low[-1:], high[-1:] - middle[-1:]]
            axis.errorbar(x[-1:], middle[-1:], end, color=colour, capsize=3, lw=1.2)
    axes[0, 0].set_xlabel("control steps, millions")
    axes[0, 1].set_xlabel("seconds of training")
    axes[0, 1].set_xscale("log")
    for axis in axes[0]:
        axis.set_ylim(-3, 101)  # so that a method at 0 is seen
        axis.set_ylabel("success on unseen scenes, %\n(median; at the end quartiles)")
    axes[0, 1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return plots.save(figure, path)


def main() -> None:
    options = script.options(Options, __doc__, "experiments/optimizers.py")
    xla.configure()
    with script.folder(options.out):
        rows, left_out = run(options)
        text = table(rows, left_out) if rows else "\n".join(f"Left out: {x}" for x in left_out)
        print(text)
        write_atomically(options.out / "optimizers.md", (text + "\n").encode())
        if rows:
            print(plot(rows, options.out / "optimizers.png"))


if __name__ == "__main__":
    main()
