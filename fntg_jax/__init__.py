"""FNTG-JAX: train small, readable robot controllers with a genetic algorithm in JAX.

    import fntg_jax

    controller = fntg_jax.load("bioa")
    v, omega = controller(1.0, 0.4, 0.2, -1.5)
    print(fntg_jax.evaluate(controller, suite="open").rates["success"])
    mine = fntg_jax.train(seeds=3)
    fntg_jax.save(mine, "mine.json")

What is public is named here and in the `__init__` files of the packages below.  Everything is
imported when it is first used: importing the package costs nothing.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from envs.base import Gene, Task, World
    from fntg_jax.controller import Controller
    from fntg_jax.learning.fitness import PaperWeights, SmoothWeights
    from fntg_jax.learning.ga import GAConfig
    from fntg_jax.running.evaluation import Evaluation
    from fntg_jax.running.learnt import Learnt
    from fntg_jax.running.runner import History, Progress
    from fntg_jax.running.settings import TrainConfig

__version__ = "0.1.0"
__all__ = [
    "Controller",
    "Evaluation",
    "GAConfig",
    "Gene",
    "History",
    "Learnt",
    "PaperWeights",
    "Progress",
    "SmoothWeights",
    "Task",
    "TrainConfig",
    "World",
    "evaluate",
    "gym",
    "learn",
    "load",
    "register_task",
    "register_world",
    "save",
    "shipped",
    "train",
]

_HOMES = {
    "Controller": "fntg_jax.controller",
    "Evaluation": "fntg_jax.running.evaluation",
    "GAConfig": "fntg_jax.learning.ga",
    "Gene": "envs.base",
    "History": "fntg_jax.running.runner",
    "Learnt": "fntg_jax.running.learnt",
    "PaperWeights": "fntg_jax.learning.fitness",
    "Progress": "fntg_jax.running.runner",
    "SmoothWeights": "fntg_jax.learning.fitness",
    "Task": "envs.base",
    "TrainConfig": "fntg_jax.running.settings",
    "World": "envs.base",
}


def __getattr__(name: str) -> Any:
    import importlib

    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if name == "gym":
        return importlib.import_module("fntg_jax.gym")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


def learn(
    preset: str = "paper",
    out: str | Path | None = None,
    on_progress: "Callable[[Progress], None] | None" = None,
    task: "Task | str" = "bioa",
    **options: Any,
) -> "Learnt":
    """Learn controllers and return the whole run: the best of all seeds and of each, and the
    history of their fitness.

    Args:
        preset: "paper" (faithful to the paper) or "robust" (for scenes never seen in training).
        out: also write this run folder, as `fntg train` does.
        on_progress: called with a `Progress` after each chunk of generations, about once a second.
        task: what to learn, by name, or a `Task` of your own.
        options: fields of `TrainConfig` over the preset's: seeds=10, layout="full-63",
            ga=GAConfig(population=120) for all of it, or ga={"population": 120} for a part.

    Raises ValueError naming the field, its value and what is allowed.
    """
    from fntg_jax.running import learnt

    folder = None if out is None else Path(out)
    mine = None if isinstance(task, str) else task
    config = learnt.configure(preset, {**options, "task": task if mine is None else mine.name})
    done = learnt.learn(config, folder, on_progress, mine)
    if folder is not None:
        from fntg_jax.showing import plots

        plots.fitness_curves(done.history, folder / "fig5.png", done.refined, done.strength)
    return done


def train(
    preset: str = "paper",
    out: str | Path | None = None,
    on_progress: "Callable[[Progress], None] | None" = None,
    task: "Task | str" = "bioa",
    **options: Any,
) -> "Controller | dict[str, float]":
    """Learn, and return the best of all seeds: a controller (`learn(...).controller`), or in tasks
    other than bioa gene by name to value (`learn(...).genes`).

    Args:
        preset: as of `learn`.
        out: as of `learn`.
        on_progress: as of `learn`.
        task: as of `learn`.
        options: as of `learn`.

    Raises ValueError naming the field, its value and what is allowed.
    """
    done = learn(preset, out, on_progress, task, **options)
    return done.genes if done.controller is None else done.controller


def register_world(name: str, world: "World") -> None:
    """Make a world of your own known in this process, wherever a world is named.

    Args:
        name: of the world; it goes over an installed one of that name.
        world: model and scenes (`envs.base.World`).
    """
    from fntg_jax.running import registry

    registry.register(registry.WORLDS, name, world)


def register_task(name: str, make: "Callable[..., Task]") -> None:
    """Make a task of your own known in this process, wherever a task is named.

    Args:
        name: of the task; it goes over an installed one of that name.
        make: options by name (floats) -> `envs.base.Task`.
    """
    from fntg_jax.running import registry

    registry.register(registry.TASKS, name, make)


def evaluate(
    controller: "Controller | str | Path",
    suite: str = "blocked",
    scenes: int = 2000,
    seed: int = 0,
    env: str | None = None,
    env_options: dict[str, float] | None = None,
) -> "Evaluation":
    """Success on scenes that training never saw.

    Args:
        controller: a controller, or what `load` takes.
        suite: kind of scenes: "open", "blocked", "crowded", "moving-ball", "moving-obstacles", or
            the learning set-up, "paper".
        scenes: how many.
        seed: of the scenes; asking for more scenes leaves the first ones as they are.
        env: world, by its entry point name; None for the one that the controller was trained in.
        env_options: options of that world by name, over the controller's own limits and control
            step: {"latency": 2, "angle_noise": 0.1}.

    Returns:
        Rates `reach`, `safe`, `stop` and `success`, each with `share`, `low` and `high` (Wilson
        95 %), scenes, outcomes, and whether each trial succeeded.

    Raises ValueError on an unknown suite, world or option, or an unreadable file.
    """
    from fntg_jax.running import evaluation, registry

    if isinstance(controller, (str, Path)):
        controller = load(controller)
    world = registry.get_world(controller.env if env is None else env)
    environment = evaluation.environment_for(controller, world, **(env_options or {}))
    return evaluation.evaluate(controller, world, suite, scenes, seed, environment)


def shipped(name: str) -> Path:
    """Path of a controller that comes with the package.

    Args:
        name: "bioa", trained by `fntg train --preset robust --seeds 10`.
    """
    from fntg_jax import export

    return export.shipped(name)


def load(path: str | Path) -> "Controller":
    """A controller from params.json, an exported .fll or a run folder, or a shipped one by name.

    Args:
        path: a file or folder; where there is none of that name, "bioa" is the controller that
            comes with the package.

    Raises ValueError (one line) when it cannot be read or is not valid.
    """
    from fntg_jax import export

    return export.load(path)


def save(controller: "Controller", path: str | Path) -> None:
    """Write params.json, whole or not at all.

    Args:
        controller: what to write.
        path: file.

    Raises OSError when it cannot be written.
    """
    from fntg_jax import export

    export.save(controller, path)
