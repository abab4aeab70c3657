"""Do controllers hold on scenes they have never seen?  Paper, gradient only, and robust.

    python -m experiments.generalization

The preset paper, the preset robust, and gradient descent alone from random starts on robust's
scenes, seed by seed, each judged on every suite of unseen scenes.  Then the preset robust with one
ingredient at a time put back to the trainer's default, on the same seeds.  Prints medians over
seeds with their 95 % bootstrap intervals, and the worst seed.  Writes generalization.csv and
ablations.csv (one row a seed, as each method ends), generalization.png and .pdf.
"""

import dataclasses
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments import script
from fntg_jax import export
from fntg_jax.controller.layout import HIGH, LOW, get_layout
from fntg_jax.learning import gradient, objective
from fntg_jax.running import controllers, evaluation, registry, runner, settings, statistics, xla
from fntg_jax.running.settings import TrainConfig
from fntg_jax.showing import plots


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute and where the results go."""

    out: Path = Path("runs/generalization")
    """folder of the results."""
    seeds: int = 10
    """learning runs of each method."""
    ablation_seeds: int = 5
    """learning runs of each ablation, beside the first ones of robust."""
    generations: int = 0
    """generations of both presets; 0 for each preset's own."""
    gradient_steps: int = 600
    """steps of gradient descent alone."""
    gradient_starts: int = 16
    """random starts of a seed; the best validated one counts."""
    scenes: int = 2000
    """unseen scenes a suite."""
    ablations: tuple[str, ...] = ("all",)
    """which to run, by name; all, or none."""


class Row(NamedTuple):
    """One seed; success: share on each suite of unseen scenes; seconds with the method's
    compilation (shared among seeds; gradient: in the first), without judging."""

    method: str
    seed: int
    seconds: float
    success: tuple[float, ...]


# What the comparison holds fixed: the budget, and what is named by hand below.
_FIXED = {"seeds", "first_seed", "generations", "num_scenes", "suite", "population"}


def ablations(preset: TrainConfig) -> dict[str, TrainConfig]:
    """name -> the preset without one ingredient.  Every setting of it that is not the trainer's
    default is one; those of the objective and of the scenes are named here."""
    found, default = {}, TrainConfig()

    def without(name: str, group: str, value: Any) -> None:
        part = getattr(preset, group) if group else preset
        now = getattr(part, name)
        if now == value:
            return
        changed: Any = dataclasses.replace(part, **{name: value})
        config = dataclasses.replace(preset, **{group: changed}) if group else changed
        label = f"{group}.{name}" if group else name
        try:
            settings.validate(config)
        except ValueError:  # a setting that makes sense only beside another
            return
        found[f"{label}={value:g}" if isinstance(value, float) else f"{label}={value}"] = config

    for group in ("", "ga"):
        plain = getattr(default, group) if group else default
        for field in dataclasses.fields(plain):
            value = getattr(plain, field.name)
            if field.name not in _FIXED and not dataclasses.is_dataclass(value):
                without(field.name, group, value)
    without("suite", "", "open")  # no obstacle in the way, no ball that rolls
    if "moving-ball" in preset.suite:
        without("suite", "", "open:2,blocked:3")  # no ball that rolls
    if "/" in preset.suite:
        without("suite", "", "open:1,blocked:2,moving-ball:2")  # no ball at a wall
    without("gate", "smooth", 1000.0)  # stopping always counts
    without("margin", "smooth", 0.145)  # no more clearance than what counts
    return found


# A method yields its seeds as they end: seed, seconds, controller.
Method = Callable[[], Iterator[tuple[int, float, export.Controller]]]


def evolved(config: TrainConfig, seeds: int) -> Iterator[tuple[int, float, export.Controller]]:
    """The preset's learning runs: one program, seed after seed on each device, so that memory
    does not grow with their number."""
    begin = time.perf_counter()
    run = runner.train(dataclasses.replace(config, seeds=seeds))
    result = run.conclude()
    seconds = (time.perf_counter() - begin) / seeds
    for seed in range(config.first_seed, config.first_seed + seeds):
        yield seed, seconds, controllers.of_run(run, seed, result)


def descended(options: Options) -> Iterator[tuple[int, float, export.Controller]]:
    """Gradient descent from random starts, on the scenes of the preset robust."""
    config = settings.PRESETS["robust"]
    world, layout = registry.get_world(config.env), get_layout(config.layout)
    env, suite = world.make(**config.env_options), registry.get_suite(world, config.suite)
    problem = objective.smooth_descent(
        layout, env, suite, config.num_scenes, config.output, checkpoint=True
    )
    optimiser = gradient.optimiser("adam", options.gradient_steps, 0.03)

    @partial(jax.jit, compiler_options=xla.GRADIENT_OPTIONS)
    def descend(key):
        k_start, k_steps = jax.random.split(key)
        shape = (options.gradient_starts, layout.num_genes)
        theta = jax.random.uniform(k_start, shape, minval=LOW, maxval=HIGH)
        found = gradient.refine(k_steps, theta, *problem, optimiser, options.gradient_steps)
        return found.theta[jnp.argmin(found.cost)]

    for seed in range(options.seeds):
        begin = time.perf_counter()
        theta = np.asarray(descend(jax.random.key(seed)), np.float64)
        yield seed, time.perf_counter() - begin, export.Controller(layout, theta, config.output)


def judge(name: str, method: Method, options: Options, done: Callable[[Row], None]) -> list[Row]:
    """Run a method and judge every seed as it ends."""
    rows = []
    for seed, seconds, controller in method():
        world = registry.get_world("kinematic")
        success = tuple(
            evaluation.evaluate(controller, world, suite, options.scenes).rates["success"].share
            for suite in evaluation.held_out_suites(world)
        )
        rows.append(Row(name, seed, seconds, success))
        done(rows[-1])
        shares = " ".join(f"{100 * share:.1f}" for share in success)
        print(f"{name}, seed {seed}: {shares} %, {seconds:.0f} s", file=sys.stderr, flush=True)
    return rows


def run(options: Options) -> tuple[list[Row], list[Row]]:
    """Rows of the comparison and of the ablations; writes the CSVs.  Raises ValueError: option,
    value, what is allowed."""
    script.check_least(
        options, seeds=1, ablation_seeds=1, generations=0, gradient_steps=1, gradient_starts=1,
        scenes=1,
    )  # fmt: skip
    paper, robust = (
        dataclasses.replace(p, generations=options.generations or p.generations)
        for p in (settings.PRESETS["paper"], settings.PRESETS["robust"])
    )
    known = ablations(robust)
    wanted = {"all": tuple(known), "none": ()}.get(" ".join(options.ablations), options.ablations)
    for name in wanted:
        if name not in known:
            raise ValueError(f"ablations = {name!r}: known are all, none, {', '.join(known)}")

    def collect(methods: dict[str, Method], name: str, rows: list[Row]) -> list[Row]:
        found = list(rows)

        def done(row):
            found.append(row)
            write_csv(options.out / name, found)

        for method, start in methods.items():
            judge(method, start, options, done)
        return found

    compared = collect(
        {
            "paper": partial(evolved, paper, options.seeds),
            "gradient": partial(descended, options),
            "robust": partial(evolved, robust, options.seeds),
        },
        "generalization.csv",
        [],
    )
    num = min(options.ablation_seeds, options.seeds)
    whole = [row for row in compared if row.method == "robust"][:num]
    methods: dict[str, Method] = {n: partial(evolved, known[n], num) for n in wanted}
    return compared, collect(methods, "ablations.csv", whole) if wanted else []


def suites() -> list[str]:
    return evaluation.held_out_suites(registry.get_world("kinematic"))


def write_csv(path: Path, rows: list[Row]) -> None:
    header = ("method", "seed", "seconds", *suites())
    cells = [
        (row.method, row.seed, f"{row.seconds:.3f}", *(f"{share:.6g}" for share in row.success))
        for row in rows
    ]
    script.write_csv(path, header, cells)


def by_method(rows: list[Row]) -> dict[str, np.ndarray]:
    """method -> success in percent [seed, suite]."""
    names = dict.fromkeys(row.method for row in rows)
    return {n: 100 * np.asarray([r.success for r in rows if r.method == n]) for n in names}


def table(rows: list[Row]) -> str:
    """Markdown: median over seeds [95 % bootstrap interval], worst seed."""
    seeds = max(row.seed for row in rows) + 1
    lines = [
        f"Success on unseen scenes, %: median of {seeds} seeds [95 % interval], worst seed",
        "",
        f"| | {' | '.join(suites())} | seconds a seed |",
        "|---" * (len(suites()) + 2) + "|",
    ]
    for name, success in by_method(rows).items():
        cells = [
            f"{median:.1f} [{low:.1f}, {high:.1f}], {worst:.1f}"
            for low, median, high, worst in zip(
                *statistics.bootstrap_median(success), success.min(0)
            )
        ]
        seconds = np.median([r.seconds for r in rows if r.method == name])
        lines.append(f"| {name} | {' | '.join(cells)} | {seconds:.0f} |")
    return "\n".join(lines)


def differences(rows: list[Row]) -> str:
    """Markdown: what taking each ingredient away does to success on the mean of all suites, seed
    by seed."""
    found = {name: success.mean(axis=1) for name, success in by_method(rows).items()}
    whole = found.pop("robust")
    lines = [
        "Percentage points lost (-) or won without an ingredient, mean of all suites, the same "
        "seeds: median [95 % interval], worst seed before -> after",
        "",
        "| instead | difference | worst seed |",
        "|---|---|---|",
    ]
    for name, success in found.items():
        low, median, high = statistics.bootstrap_median(success - whole)
        worst = f"{whole.min():.1f} -> {success.min():.1f}"
        lines.append(f"| {name} | {median:+.1f} [{low:+.1f}, {high:+.1f}] | {worst} |")
    return "\n".join(lines)


def plot(rows: list[Row], path: Path) -> Path:
    """PNG and PDF: every seed as a dot, by suite and method, with medians and intervals."""
    figure, axes = plots.new_grid(1, 1, 7.2, 3.8)
    panel, found = axes[0, 0], by_method(rows)
    colours = dict(zip(found, (plots.ORANGE, plots.GREEN, plots.BLUE)))
    for n, (name, success) in enumerate(found.items()):
        low, median, high = statistics.bootstrap_median(success)
        x = np.arange(len(suites())) + 0.26 * (n - (len(found) - 1) / 2)
        spread = np.linspace(-0.07, 0.07, len(success))[:, None]
        panel.plot(x + spread, success, "o", color=colours[name], alpha=0.4, ms=3.5, mew=0)
        panel.errorbar(
            x, median, [median - low, high - median], fmt="_", ms=16, mew=2, capsize=3,
            color=colours[name], label=name,
        )  # fmt: skip
        for at, value in zip(x, median):
            panel.annotate(
                f"{value:.1f}", (at, value), (5, 3), textcoords="offset points", ha="left",
                fontsize=6, color=colours[name],
            )  # fmt: skip
    panel.set_xticks(np.arange(len(suites())), [s.replace("-", "-\n") for s in suites()])
    panel.set_ylim(-2, 109)
    panel.set_ylabel("success on unseen scenes, %")
    panel.set_title("dots: seeds; bars: medians with 95 % intervals", fontsize=9, loc="left")
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return plots.save(figure, path)


def main() -> None:
    options = script.options(Options, __doc__, "experiments/generalization.py")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    with script.folder(options.out):
        compared, ablated = run(options)
        print(table(compared))
        print(plot(compared, options.out / "generalization.png"))
        if ablated:
            print(f"\n{table(ablated)}\n\n{differences(ablated)}")


if __name__ == "__main__":
    main()
