"""What the figure scripts share: options, and a run from a folder or trained anew."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from experiments import script
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class Options:
    """Where the data comes from and where the figure goes."""

    run: Path | None = None
    """a finished run folder; without it, train anew with the options below."""
    out: Path = Path("runs/figures")
    """folder for PNG, PDF and CSV."""
    seeds: int = 30
    """seeds, when training anew."""
    generations: int = 95
    """generations, when training anew."""
    env: str = "kinematic"
    """world, when training anew."""


def main(doc: str, name: str, run: Callable, plot: Callable) -> None:
    """Parse options, run, plot; bad input is one line and exit status 2."""
    options = script.options(Options, doc, f"experiments/{name}.py")
    xla.configure(num_cpu_devices=os.cpu_count() or 1)
    with script.folder(options.out):
        print(plot(run(options), options.out / f"{name}.png"))


def finished_run(options: Options) -> Any:
    """The `runner.Run` of a folder, or a new one of the paper preset."""
    from fntg_jax.running import run_folder, runner, settings

    if options.run is not None:
        run = run_folder.restore(options.run)
        if not run.done:
            raise ValueError(f"{options.run}: not finished; continue it with --resume")
        return run
    config = dataclasses.replace(
        settings.PRESETS["paper"],
        seeds=options.seeds,
        generations=options.generations,
        env=options.env,
    )
    return runner.train(config)


class Trials(NamedTuple):
    """Recorded trials of one controller: batched `rollout.Trajectory` and how to draw them."""

    trajectory: Any
    field: Any
    limits: Any
    dt: float
    title: str


def paper_trials(options: Options, starts: slice) -> Trials:
    """The paper's trial motions, by the best genome of the last generation.

    Of several seeds, the one whose final best fitness is the median is shown: seeds are not
    chosen for looks.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from fntg_jax.controller.layout import expand_scalars
    from fntg_jax.learning.rollout import trajectory
    from fntg_jax.running import runner

    run = finished_run(options)
    history = run.history()
    final = history.best[:, -1]
    index = int(np.argsort(final)[(len(final) - 1) // 2])
    theta = jnp.asarray(runner.decode_history(history, run.config)[index, -1])
    world, layout, env = run.problem.world, run.problem.layout, run.problem.env
    scenes = world.suites["paper"](jax.random.key(0), 4)
    scenes = jax.tree.map(lambda x: x[starts], scenes)
    params = expand_scalars(layout, theta)
    record = jax.jit(jax.vmap(lambda s: trajectory(params, s, env, output=run.config.output)))
    seed = run.config.first_seed + index
    which = f"seed {seed}" + (f", the median of {len(final)}" if len(final) > 1 else "")
    title = f"best genome of generation {history.best.shape[1]}, F = {final[index]:.3g}\n({which})"
    return Trials(
        record(scenes),
        world.field,
        env.limits,
        float(env.dt),
        title,
    )


def write_csv(path: Path, header: str, columns: list[Any]) -> None:
    """The numbers of a figure, beside it."""
    rows = ([f"{x:.9g}" for x in row] for row in zip(*columns, strict=True))
    script.write_csv(path, header.split(","), rows)


def write_trials_csv(path: Path, trials: Trials) -> None:
    """Positions, distances and commands by trial and step; the last state has no command."""
    import numpy as np

    t = trials.trajectory
    robot = np.asarray(t.snapshot.robot)[:, :-1]
    num_trials, num_steps = robot.shape[:2]
    trial, step = np.indices((num_trials, num_steps))
    columns = [trial + 1, step * trials.dt, *np.moveaxis(robot, -1, 0)]
    columns += [np.asarray(x)[:, :-1] for x in t.measured]
    columns += [np.asarray(x) for x in (t.command.v, t.command.omega)]
    header = "trial,time,x,y,heading,d_ball,d_obstacle,theta_ball,theta_obstacle,v,omega"
    write_csv(path, header, [c.ravel() for c in columns])
