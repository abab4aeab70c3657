"""A picture of trials that failed, with the reason of each: people learn from those."""

import textwrap
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from envs.base import Environment, World
from fntg_jax.controller.controller import Controller
from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import trajectory
from fntg_jax.running.evaluation import Evaluation
from fntg_jax.showing import plots

MOST = 12  # trials shown of a suite


def reasons(outcome: Any) -> list[str]:
    """Why one trial failed, in words with the numbers; empty where it succeeded.

    Args:
        outcome: `rollout.Outcome` of one trial, NumPy.
    """
    parts, found = fitness.success(outcome), []
    if outcome.failed:
        found.append("fell")
    if not parts.reach:
        found.append(f"not reached ({outcome.distance[1]:.2f} m)")
    if not outcome.clearance >= fitness.CLEARANCE:
        found.append(f"too near ({outcome.clearance:.3f} m)")
    if not parts.stop:
        found.append(f"not stopped ({np.mean(np.abs(outcome.v)):.3f} m/s)")
    return found


def picture(
    controller: Controller,
    world: World,
    env: Environment,
    results: list[Evaluation],
    path: str | Path,
    most: int = MOST,
) -> Path:
    """The first failed trials of every suite from above, PNG and PDF; returns the PNG's path.

    Trials come in the order of their scenes and carry the number that `fntg replay --scene` takes.

    Args:
        controller: who drove.
        world: `envs.base.World`.
        env: that the trials ran in.
        results: of `evaluation.evaluate` in `env`.
        path: file to write, and a PDF beside it.
        most: trials of a suite.

    Raises OSError.
    """
    chosen = [(r, np.flatnonzero(~r.success)[:most]) for r in results]
    num = sum(len(failed) for _, failed in chosen)
    # As many beside each other as leave the fewest places empty.
    columns = min((4, 5, 3), key=lambda n: -num % n) if num > 5 else max(num, 1)
    num_rows = -(-num // columns)
    words = "\n".join(textwrap.fill(_summary(r, most), 37 * columns) for r in results)
    height = 0.3 + 0.17 * len(words.splitlines())
    figure = plots.new_figure(max(2.9 * columns, 5.8), 1.85 * num_rows + height + 0.4)
    figure.suptitle(words, fontsize=9, x=0.01, ha="left")
    if num_rows == 0:
        return plots.save(figure, path)
    panels = iter(figure.subplots(num_rows, columns, squeeze=False).ravel())
    for result, failed in chosen:
        if len(failed) == 0:
            continue
        trials = _trajectories(controller, env, result.scenes, failed)
        for n, index in enumerate(failed):
            axes = next(panels)
            outcome = jax.tree.map(lambda x, i=index: x[i], result.outcome)
            _draw(axes, world.field, jax.tree.map(lambda x, n=n: x[n], trials))
            why = f"{result.suite} {index}: {', '.join(reasons(outcome))}"
            axes.set_title(textwrap.fill(why, 46), fontsize=7, loc="left", pad=2)
    for axes in panels:
        axes.set_axis_off()
    figure.supxlabel(
        textwrap.fill(
            "over each: suite, scene, why it failed. Arrow: start; line: path of the robot, "
            "square: its end; star: ball (dotted: its way); grey: obstacles when the robot was "
            "nearest to one (dotted: 0.145 m around); cross: too near there",
            45 * columns,
        ),
        fontsize=7,
    )
    return plots.save(figure, path)


def _summary(result: Evaluation, most: int = MOST) -> str:
    """How many failed in all, and by which part; a trial can fail by several."""
    failed = int(np.sum(~result.success))
    words = {"reach": "not reached", "safe": "too near or fallen", "stop": "not stopped"}
    counts = [
        f"{round((1 - result.rates[part].share) * result.num_scenes)} {word}"
        for part, word in words.items()
    ]
    shown = f"; the first {most}" if failed > most else ""
    return f"{result.suite}: {failed} of {result.num_scenes} failed ({', '.join(counts)}){shown}"


def _trajectories(controller: Controller, env: Environment, scenes: Any, rows: np.ndarray) -> Any:
    params = controller.params32
    # Always as many, so that all suites of a kind share a compilation.
    rows = np.resize(rows, MOST)
    chosen = jax.tree.map(lambda x: x[rows], scenes)
    return jax.tree.map(np.asarray, _record(params, chosen, env, controller.output))


@partial(jax.jit, static_argnames="output")
def _record(params, scenes, env, output):
    return jax.vmap(lambda scene: trajectory(params, scene, env, output))(scenes)


def _draw(axes: Any, field: Any, trial: Any) -> None:
    """One trial; the obstacles stand where they were when the robot was nearest to one."""
    plots.draw_field(axes, field)
    reach = field.length / 2 + field.goal_depth + 0.02
    axes.set(xlabel="", ylabel="", xlim=(-reach, reach))
    axes.set_axis_off()
    distance = np.asarray(trial.measured.d_obstacle)
    worst = int(np.argmin(distance))
    obstacles = trial.snapshot.obstacles
    plots.draw_discs(axes, obstacles[worst])
    for n in range(obstacles.shape[1]):
        if np.ptp(obstacles[:, n, :2]) > 0:
            axes.plot(*obstacles[:, n, :2].T, color="0.6", linestyle=":", linewidth=0.8)
    plots.draw_path(axes, trial.snapshot.robot, plots.BLUE)
    plots.draw_ball(axes, trial.snapshot.ball)
    if distance[worst] < fitness.CLEARANCE:
        axes.plot(*trial.snapshot.robot[worst, :2], "x", color=plots.RED, markersize=7, zorder=6)
