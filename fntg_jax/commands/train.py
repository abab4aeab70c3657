"""`fntg train`: a learning run with progress, checkpoints and a run folder."""

import contextlib
import dataclasses
import os
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from fntg_jax.commands import stopping
from fntg_jax.commands.cli import parse, say
from fntg_jax.files import sweep
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """Learn controllers: a population of genomes, batched roll-outs, a genetic algorithm.

    Attributes:
        preset: starting point of all other options (given first or anywhere).
        out: run folder; default runs/PRESET-DATE-TIME.
        resume: continue this interrupted run folder; takes no other option of training.
        distributed: run on several hosts, this being one of the processes; give all the same
            options.
        coordinator: HOST:PORT of process 0; default: as the cluster says.
        num_processes: how many there are; default: as the cluster says.
        process_id: which of them this is, from 0; default: as the cluster says.
    """

    config: Annotated[Any, tyro.conf.arg(name="")]
    preset: str = "paper"
    out: Path | None = None
    resume: Path | None = None
    distributed: bool = False
    coordinator: str | None = None
    num_processes: int | None = None
    process_id: int | None = None


def main(argv: list[str]) -> None:
    options = parse_over_preset(TrainOptions, argv, "train")
    meeting = (options.coordinator, options.num_processes, options.process_id)
    if not options.distributed and any(x is not None for x in meeting):
        raise ValueError("coordinator, num_processes, process_id: only with --distributed")
    folder = options.resume
    if folder is not None:
        names = {word.partition("=")[0] for word in argv if word.startswith("--")}
        if names - {f"--{x}" for x in _WITH_RESUME}:
            raise ValueError("--resume takes the run folder and no other option of training")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    from fntg_jax.running import hosts, problem, run_folder, runner

    if options.distributed:
        hosts.join(*meeting)
    if folder is None:
        resolved = problem.resolve(options.config)
        task = options.config.task
        kind = options.preset if task == "bioa" else task
        stamp = time.strftime("%Y%m%d-%H%M%S")
        folder = options.out or Path("runs") / f"{kind}-{stamp}"

        made = None

        def create() -> bytes:
            nonlocal made
            made = run_folder.create(folder, options.config)
            return b""

        hosts.from_first(create)
    advice = f"continue with: fntg train --resume {folder}"
    with hosts.together(advice), stopping.listen(lambda: f"stopped; {advice}") as stop:
        if options.resume is not None:
            run = run_folder.restore(folder)
            if hosts.is_first():
                sweep(folder, run_folder.FILES)
            _train(folder, run, stop, resumed=True)
            return
        most = max(options.config.scene_pool, options.config.num_scenes)
        if most > 50_000:
            say(f"drawing {most} scenes ...")
        try:
            _train(folder, runner.start(resolved), stop, resumed=False)
        except BaseException:  # also where memory ran out
            run_folder.discard(folder, made)
            raise


_WITH_RESUME = ("resume", "distributed", "coordinator", "num-processes", "process-id")


def _train(folder: Path, run: Any, stop: stopping.Stop, resumed: bool) -> None:
    import jax

    from fntg_jax.files import writing
    from fntg_jax.running import hosts, run_folder
    from fntg_jax.showing import plots

    if run.origin:
        # What it starts from may be gone when the run is resumed.
        run_folder.save_checkpoint(folder, run)
        say(f"starting from {run.origin}")
    config = run.config
    where = f"folder {folder}"
    if jax.process_count() > 1:
        where = f"process {jax.process_index()} of {jax.process_count()}"
        where += f", folder {folder}" if hosts.is_first() else ""
    what = f"task {config.task}"
    if run.problem.task is None:
        what = f"{config.num_scenes} scenes, world {config.env}, layout {config.layout}"
    say(
        f"{config.seeds} run{'s' if config.seeds > 1 else ''} of {config.generations} generations, "
        f"{config.ga.population} genomes x {what}; {where}"
    )
    if config.seeds > 1:
        say("numbers of the progress are medians over them")
    if run.problem.task is None and config.suite == "paper" and config.num_scenes > 4:
        say(f"suite paper has 4 starts: {config.num_scenes} trials repeat them")
    if run.done:
        say("this run is complete: writing its results again")
    else:
        if resumed:
            say(f"continuing after generation {run.generation}")
        _learn(run, folder, stop)
    began = time.perf_counter()
    with writing(folder):
        if config.scene_pool or config.refine_steps or run.problem.blocks > 1:
            what = ", then refining them" if config.refine_steps else ""
            chosen = "controllers on validation scenes" if run.problem.task is None else "genes"
            say(f"choosing the {chosen}{what} ...")
        with progress_bar("refinement step") as show:
            result = run_folder.finish(
                folder, run, lambda done, total, best: show(done, total, f"best {best:.4g}")
            )
        if hosts.is_first():
            figure = plots.fitness_curves(
                run.history(), folder / "fig5.png", result.refined, result.strength
            )
    spread = f", median over seeds {np.median(result.fitness):.4g}" if config.seeds > 1 else ""
    if result.judgement:
        judged = {name: x[np.argmax(result.fitness)] for name, x in result.judgement.items()}
        say("judged: " + ", ".join(f"{name} {x:.4g}" for name, x in judged.items()))
    say(
        f"best fitness {result.fitness.max():.4g}{spread}; "
        f"{run.now.run_seconds:.2f} s of evolution, "
        f"{time.perf_counter() - began:.2f} s of choosing and writing"
    )
    history = run.history()
    if lost := int(history.num_nonfinite.sum()):
        total = history.best.size * config.ga.population
        say(f"{lost} of {total} genomes had NaN or infinite fitness, which counts as 0")
    found = "controller" if run.problem.task is None else "genes"
    if hosts.is_first():
        say(f"figure {figure}, {found} {folder / 'params.json'}")
        print(folder)
    history = run.history()
    bad = history.num_nonfinite[:, -1] == config.ga.population
    if run.problem.task is None:
        bad |= ~(history.best[:, -1] > 0)  # it is 10 over a number that overflowed
    if bad.any():
        say(
            f"fntg: error: no genome of the last generation has a fitness in {bad.sum()} of "
            f"{len(bad)} runs: numbers overflow; what was written is arbitrary"
        )
        raise SystemExit(3)


def parse_over_preset(cls: type, argv: list[str], command: str) -> Any:
    """Options of `cls`, and as its field `config` those of `settings.TrainConfig` over the
    preset's."""
    from fntg_jax.running import settings

    preset = _preset(argv, list(settings.PRESETS))
    # Here and not at the top, because `settings` loads jax.
    options_type = dataclasses.make_dataclass(
        cls.__name__,
        [("config", Annotated[settings.TrainConfig, tyro.conf.arg(name="")])]
        + [
            (f.name, f.type, dataclasses.field(default=f.default))
            for f in dataclasses.fields(cls)[1:]
        ],
        frozen=True,
    )
    options_type.__doc__ = cls.__doc__
    return parse(options_type, argv, command, options_type(settings.PRESETS[preset], preset=preset))


def _preset(argv: list[str], known: list[str]) -> str:
    """The value of --preset, before tyro needs it for the other options' defaults."""
    for n, word in enumerate(argv):
        if word == "--preset" or word.startswith("--preset="):
            value = word.partition("=")[2] or (argv[n + 1] if n + 1 < len(argv) else "")
            if value not in known:
                raise ValueError(f"preset = {value!r}: known are {', '.join(known)}")
            return value
    return known[0]


_CHECKPOINT_SECONDS = 2.0


def _learn(run: Any, folder: Path, stop: stopping.Stop) -> None:
    """Advance a run to its end, with progress on stderr, leaving a checkpoint when stopped."""
    from fntg_jax.files import writing
    from fntg_jax.running import hosts, memory, run_folder

    number = 0
    say("tracing and compiling ...")
    say(f"tracing and compiling took {run.compile():.1f} s")
    memory.announce(run.memory_bytes, say)
    with generation_bar(run) as show, writing(folder):
        saved = time.monotonic()
        stop.at_once = False
        while not run.done and not number:
            progress = run.advance()
            due = int(time.monotonic() - saved > _CHECKPOINT_SECONDS)
            # Of several processes all save, and stop, when one wants to.
            due, number = hosts.largest(due, stop.wanted)
            if due or run.done or number:
                run_folder.save_checkpoint(folder, run)
                saved = time.monotonic()
            show(progress)
    if number:
        say(
            f"stopped after generation {run.generation} of {run.config.generations}; "
            f"continue with: fntg train --resume {folder}"
        )
        raise SystemExit(128 + number)
    stop.at_once = True  # all that follows can be done again from the checkpoint


@contextlib.contextmanager
def progress_bar(what: str, start: int = 0, total: int | None = None):
    """A callable (done, total, words) that shows how far something is: a bar on a terminal;
    otherwise the first step and ten lines."""
    if not sys.stderr.isatty():
        shown = -1

        def line(done, total, words):
            nonlocal shown
            if done * 10 // total > shown:
                shown = done * 10 // total
                say(f"{what} {done}/{total}  {words}")

        yield line
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn(what + " {task.completed}/{task.total}"),
        BarColumn(),
        TextColumn("{task.fields[words]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=total, completed=start, words="", visible=bool(total))

        def move(done, total, words):
            progress.update(task, completed=done, total=total, words=words, visible=True)

        yield move


@contextlib.contextmanager
def generation_bar(run: Any):
    """A callable that shows a `runner.Progress`."""
    with progress_bar("generation", run.generation, run.config.generations) as show:
        yield lambda p: show(p.generation, p.generations, _words(p))


def _words(p: Any) -> str:
    words = f"best {p.best:.3g}  average {p.mean:.3g}"
    if p.control_steps:
        words += f"  {p.control_steps / max(p.seconds, 1e-9) / 1e6:.3g} M control steps/s"
    if p.num_nonfinite:
        words += f"  {p.num_nonfinite} genomes with NaN or infinite fitness"
    return words
