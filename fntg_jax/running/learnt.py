"""A learning run as a value: what `fntg_jax.learn` returns."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from envs.base import Task
from fntg_jax.controller.controller import Controller
from fntg_jax.running import controllers, run_folder, runner, settings
from fntg_jax.running.problem import resolve
from fntg_jax.running.runner import History, Progress
from fntg_jax.running.settings import TrainConfig


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Learnt:
    """A completed learning run.

    Attributes:
        controller: the best of all seeds; None in tasks other than bioa.
        controllers: the best of each seed, in the order of the seeds; () in other tasks.
        genes: gene by name to value, of the best of all seeds.
        judgement: the task's held-out judgement of it, by name; empty where the task has none.
        fitness: [seeds], of the best of each seed.
        history: what evolution recorded, leading axes (seed, generation).
        refined: [seeds, steps] fitness in the course of the refinement, None without one.
        strength: where fitness is relative, generations [n] and their champions' scores
            [seeds, n]; None elsewhere.
        config: all options of the run.
    """

    controller: Controller | None
    controllers: tuple[Controller, ...]
    genes: dict[str, float]
    judgement: dict[str, float]
    fitness: np.ndarray
    history: History
    refined: np.ndarray | None
    strength: tuple[np.ndarray, np.ndarray] | None
    config: TrainConfig

    def __repr__(self) -> str:
        c = self.config
        return (
            f"Learnt({c.seeds} seed{'s' if c.seeds > 1 else ''}, {c.generations} generations, "
            f"fitness {np.min(self.fitness):.4g} to {np.max(self.fitness):.4g})"
        )


def configure(preset: str, options: dict[str, Any]) -> TrainConfig:
    """The preset with options over it.

    Args:
        preset: name in `settings.PRESETS`.
        options: fields of `TrainConfig`; those that are configurations themselves (ga, fitness,
            smooth) whole, or as a dict of the fields to change.

    Raises ValueError naming the field, its value and what is allowed.
    """
    if preset not in settings.PRESETS:
        raise ValueError(f"preset = {preset!r}: known are {', '.join(settings.PRESETS)}")
    values = dataclasses.asdict(settings.PRESETS[preset])
    for name, value in options.items():
        default = getattr(settings.PRESETS[preset], name, None)
        if dataclasses.is_dataclass(default) and not isinstance(default, type):
            wanted = type(default).__name__
            if type(value) is type(default):
                value = dataclasses.asdict(value)  # type: ignore[call-overload]
            elif isinstance(value, dict):
                value = {**values[name], **value}
            else:
                raise ValueError(f"{name} = {value!r}: allowed is a {wanted} or a dict of fields")
        values[name] = str(value) if isinstance(value, Path) else value
    return settings.from_dict(values)


def learn(
    config: TrainConfig,
    out: Path | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    task: Task | None = None,
) -> Learnt:
    """Learn to the end.

    Args:
        config: of the run.
        out: folder to be made, for a run folder; None for none.
        on_progress: called after each chunk of generations.
        task: what is learnt, where it is not a registered one.

    Raises ValueError where `out` exists already, the configuration does not do, or nothing was
    learnt (`runner.check_finite`).
    """
    run = runner.start(resolve(config, task))
    if out is not None:
        run_folder.create(out, config)
    runner.complete(run, on_progress)
    if out is None:
        runner.check_finite(run)
        result = run.conclude()
    else:
        run_folder.save_checkpoint(out, run)
        result = run_folder.finish(out, run)
    best, own = int(np.argmax(result.fitness)), None
    each: tuple[Controller, ...] = ()
    if run.problem.task is None:
        seeds = range(config.first_seed, config.first_seed + config.seeds)
        own = controllers.of_run(run, result=result)
        each = tuple(controllers.of_run(run, seed, result) for seed in seeds)
    return Learnt(
        controller=own,
        controllers=each,
        genes={g.name: float(x) for g, x in zip(run.problem.genes, result.theta[best])},
        judgement={name: float(x[best]) for name, x in (result.judgement or {}).items()},
        fitness=np.asarray(result.fitness),
        history=run.history(),
        refined=result.refined,
        strength=result.strength,
        config=config,
    )
