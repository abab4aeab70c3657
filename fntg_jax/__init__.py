"""FNTG-JAX: train small, readable robot controllers with a genetic algorithm in JAX.

    import fntg_jax as fntg

    controller = fntg.train(seeds=3)
    fntg.evaluate(controller, suite="open").rates["success"]
    fntg.save(controller, "mine.json")
    v, omega = fntg.load("mine.json")(1.0, 0.4, 0.2, -1.5)

Each function imports what it needs when it is called: importing the package costs nothing.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fntg_jax.export import Controller
    from fntg_jax.running.evaluation import Evaluation

__version__ = "0.1.0"
__all__ = ["evaluate", "load", "save", "train"]


def train(preset: str = "paper", out: str | Path | None = None, **options: Any) -> "Controller":
    """Learn controllers and return the best of all seeds.

    options: fields of `settings.TrainConfig` over the preset's, e.g. seeds=10, generations=50,
    layout="full-63", ga={"population": 120}.  out: also write this run folder, as `fntg train`
    does.  Raises ValueError naming the field, its value and what is allowed.
    """
    import dataclasses

    from fntg_jax.running import run_folder, runner, settings

    if preset not in settings.PRESETS:
        raise ValueError(f"preset = {preset!r}: known are {', '.join(settings.PRESETS)}")
    values = dataclasses.asdict(settings.PRESETS[preset])
    for name, value in options.items():
        nested = isinstance(value, dict) and isinstance(values.get(name), dict)
        values[name] = {**values[name], **value} if nested else value
    run = runner.start(run_folder.config_from_dict(values))
    if out is not None:
        run_folder.create(Path(out), run.config)
    runner.complete(run)
    result = None
    if out is not None:
        run_folder.save_checkpoint(Path(out), run)
        _, result = run_folder.finish(Path(out), run)
    return run_folder.controller(run, result=result)


def evaluate(
    controller: "Controller",
    suite: str = "blocked",
    scenes: int = 2000,
    seed: int = 0,
    env: str = "kinematic",
) -> "Evaluation":
    """Success on unseen scenes: `rates` has reach, safe, stop and success, each with `share`,
    `low` and `high` (Wilson 95 %).  Raises ValueError on an unknown suite or world."""
    from fntg_jax.running import evaluation, settings

    return evaluation.evaluate(controller, settings.get_world(env), suite, scenes, seed)


def shipped(name: str) -> Path:
    """Path of a controller that comes with the package: "bioa", trained by
    `fntg train --preset robust --seeds 10`."""
    return Path(__file__).parent / "data" / f"{name}.json"


def load(path: str | Path) -> "Controller":
    """A controller from params.json, an exported .fll, or a run folder.

    Calling it maps d_ball, d_obstacle (m), theta_ball, theta_obstacle (rad, > 0 is left),
    numbers or arrays, to v (m/s) and omega (rad/s), in NumPy.  Raises ValueError (one line) when
    it cannot be read or is not valid.
    """
    import os

    from fntg_jax import export

    # os.path, because Path.is_dir raises on names that no file can have.
    return export.load(Path(path, "params.json") if os.path.isdir(path) else path)


def save(controller: "Controller", path: str | Path) -> None:
    """Write params.json, whole or not at all.  Raises OSError when it cannot be written."""
    from fntg_jax import export

    export.save(controller, path)
