"""Figures 5 to 8 of the paper, publishable as they are: units, legible, colour-blind safe.

Every function writes a PNG and a PDF beside it and returns the PNG's path.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np

from fntg_jax.files import write_atomically
from fntg_jax.learning.fitness import CLEARANCE
from fntg_jax.running.statistics import bootstrap_median

# Okabe and Ito's palette.
BLUE, ORANGE, GREEN, RED, SKY, PURPLE = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#56B4E9",
    "#CC79A7",
)
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)
RC: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,
}


def _new(width: float, height: float, rows: int = 1):
    with _style():
        figure = new_figure(width, height)
        return figure, figure.subplots(rows, 1, sharex=True)


def new_figure(width: float, height: float) -> Any:
    """An empty figure that pyplot does not know: the caller's back end stays as it is.

    Args:
        width: inches.
        height: inches.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _style() -> Any:
    import matplotlib

    return matplotlib.rc_context(RC)


def new_grid(rows: int, columns: int, width: float, height: float) -> tuple[Any, Any]:
    """A figure and its panels [rows, columns], with no scales shared.

    Args:
        rows: of panels.
        columns: of panels.
        width: inches.
        height: inches.
    """
    with _style():
        figure = new_figure(width, height)
        return figure, figure.subplots(rows, columns, squeeze=False)


def save(figure: Any, path: str | Path) -> Path:
    """Write a figure as PNG and as PDF, atomically; returns the PNG's path.

    Args:
        figure: of matplotlib.
        path: of either; the suffix is replaced.

    Raises OSError.
    """
    path = Path(path)
    for suffix in (".pdf", ".png"):
        drawn = io.BytesIO()
        with _style():
            figure.savefig(drawn, format=suffix[1:], bbox_inches="tight")
        write_atomically(path.with_suffix(suffix), drawn.getvalue())
    return path.with_suffix(".png")


def fitness_curves(
    history: Any,
    path: str | Path,
    refined: np.ndarray | None = None,
    strength: tuple[np.ndarray, np.ndarray] | None = None,
) -> Path:
    """Fig. 5: best ("EC max") and average ("EC av") fitness by generation; returns the PNG's path.

    Single runs as thin lines; with several seeds the median and its 95 % bootstrap band.

    Args:
        history: anything with best and mean, [seed, generation].
        path: file to write, and a PDF beside it.
        refined: [seed, n] fitness on validation scenes in the course of the refinement, in a panel
            of its own: evolution's is on each generation's scenes; None without.
        strength: generations [n] and their champions' scores against fixed opponents [seed, n],
            where fitness is relative; None elsewhere.

    Raises OSError.
    """
    with _style():
        figure = new_figure(5.2 if refined is None else 7.8, 4.0)
        axes, *beside = np.atleast_1d(
            figure.subplots(
                1, 1 if refined is None else 2, width_ratios=None if refined is None else (3, 2)
            )
        )
    seeds, generations = history.best.shape
    x = np.arange(1, generations + 1)
    for values, colour, label in (
        (history.best, BLUE, "best (EC max)"),
        (history.mean, ORANGE, "average (EC av)"),
    ):
        if seeds == 1:
            axes.plot(x, values[0], color=colour, label=label)
            continue
        axes.plot(x, values.T, color=colour, alpha=0.18, linewidth=0.6)
        low, median, high = bootstrap_median(values)
        axes.fill_between(x, low, high, color=colour, alpha=0.3, linewidth=0)
        axes.plot(x, median, color=colour, linewidth=1.8, label=f"{label}, median")
    if seeds > 1:
        note = f"{seeds} seeds (thin lines); band: 95 % bootstrap interval of the median"
        figure.suptitle(note, fontsize=9, x=0.01, ha="left")
    if strength is not None:
        axes.plot(strength[0], strength[1].T, color=GREEN, alpha=0.3, linewidth=0.8)
        label = "champion against fixed opponents, held-out"
        axes.plot(strength[0], np.median(strength[1], axis=0), color=GREEN, label=label)
    if refined is not None:
        (panel,) = beside
        along = np.arange(refined.shape[1])
        panel.plot(along, refined.T, color=GREEN, alpha=0.25 if seeds > 1 else 1, linewidth=0.8)
        label = "refined"
        panel.plot(along, np.median(refined, axis=0), color=GREEN, linewidth=1.8, label=label)
        panel.set_title("refinement", fontsize=9, loc="left")
        panel.set_xlabel("validations")
        panel.set_ylabel("fitness $F$ on validation scenes")
        panel.set_xlim(0, max(refined.shape[1] - 1, 1))
    axes.set_xlabel("generation")
    axes.set_ylabel("fitness $F$")
    axes.set_xlim(0, generations)
    if strength is not None:
        axes.set_ylim(0, 1)
    elif seeds == 1:
        axes.set_ylim(bottom=0)
    else:
        axes.set_yscale("log")  # single runs differ by factors: on a linear axis one hides all
        axes.set_ylim(bottom=max(0.01, np.percentile(history.mean, 1)))
        axes.yaxis.set_major_formatter("{x:g}")
    figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    return save(figure, path)


def draw_field(axes, field: Any) -> None:
    """The field from above, to scale, with its goals.

    Args:
        axes: of matplotlib.
        field: `envs.base.Field`.
    """
    length, width = field.length, field.width
    axes.plot(
        np.array([-1, 1, 1, -1, -1]) * length / 2,
        np.array([-1, -1, 1, 1, -1]) * width / 2,
        color="0.25",
        linewidth=1.2,
    )
    for side in (-1, 1):
        x = side * (length / 2 + np.array([0, field.goal_depth, field.goal_depth, 0]))
        y = np.array([-1, -1, 1, 1]) * field.goal_width / 2
        axes.plot(x, y, color="0.6", linewidth=1)
    axes.plot([0, 0], [-width / 2, width / 2], color="0.85", linewidth=0.8, zorder=0)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid(False)


def draw_discs(axes, discs: np.ndarray) -> None:
    """Obstacles, each with the ring of 0.145 m that the robot's centre must not enter.

    Args:
        axes: of matplotlib.
        discs: [K, 3]: x, y, radius, m.
    """
    from matplotlib.patches import Circle

    for x, y, radius in discs:
        axes.add_patch(Circle((x, y), radius, color="0.45"))
        axes.add_patch(
            Circle((x, y), radius + CLEARANCE, fill=False, color="0.45", linestyle=":", linewidth=1)
        )


def draw_path(axes, robot: np.ndarray, colour: str) -> None:
    """A path with its start pose as an arrow and its end as a square.

    Args:
        axes: of matplotlib.
        robot: [N, 3]: x, y (m), heading (rad).
        colour: of matplotlib.
    """
    axes.plot(robot[:, 0], robot[:, 1], color=colour, linewidth=1.6)
    x, y, heading = robot[0]
    axes.annotate(
        "",
        (x + 0.16 * np.cos(heading), y + 0.16 * np.sin(heading)),
        (x, y),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0},
    )
    axes.plot(x, y, "o", color=colour, markerfacecolor="white", markersize=4, zorder=4)
    axes.plot(robot[-1, 0], robot[-1, 1], "s", color=colour, markersize=4)


def draw_ball(axes, ball: np.ndarray) -> None:
    """The ball where it ends up, an asterisk as in the paper, and its way there.

    Args:
        axes: of matplotlib.
        ball: [N, 2]: x, y, m.
    """
    if len(np.unique(ball, axis=0)) > 1:
        axes.plot(ball[:, 0], ball[:, 1], color="black", linestyle=":", linewidth=0.8)
    axes.plot(
        *ball[-1],
        "*",
        color=RED,
        markeredgecolor="black",
        markeredgewidth=0.5,
        markersize=11,
        zorder=5,
    )


def explain(figure: Any) -> None:
    """What the marks of `draw_path`, `draw_ball` and `draw_discs` mean, below the panels."""
    from matplotlib.lines import Line2D

    styles: dict[str, dict[str, Any]] = {
        "start, arrow: heading": {"marker": "o", "markerfacecolor": "white", "markersize": 4},
        "path, and its end": {"marker": "s", "markersize": 4, "linestyle": "-"},
        "ball": {"marker": "*", "color": RED, "markersize": 10, "markeredgecolor": "black"},
        "obstacle": {"marker": "o", "color": "0.45", "markersize": 10},
        "0.145 m around it": {"color": "0.45", "linestyle": ":"},
    }
    usual: dict[str, Any] = {"color": "0.3", "linestyle": "", "markeredgewidth": 0.5}
    figure.legend(
        [Line2D([], [], **(usual | style)) for style in styles.values()],
        list(styles),
        loc="outside lower center",
        ncols=5,
        frameon=False,
        fontsize=8,
        handletextpad=0.4,
        columnspacing=1.2,
    )


def trajectories(trials: Any, field: Any, path: str | Path, title: str = "") -> Path:
    """Fig. 6 and 7: paths on the drawn field; returns the PNG's path.

    Args:
        trials: batched `rollout.Trajectory`.
        field: `envs.base.Field`.
        path: file to write, and a PDF beside it.
        title: above it.

    Raises OSError.
    """
    figure, axes = _new(5.6, 4.0)
    draw_field(axes, field)
    obstacles = np.asarray(trials.snapshot.obstacles)
    draw_discs(axes, np.unique(obstacles[:, -1].reshape(-1, 3), axis=0))
    for n, robot in enumerate(np.asarray(trials.snapshot.robot)):
        draw_path(axes, robot, COLOURS[n % len(COLOURS)])
        draw_ball(axes, np.asarray(trials.snapshot.ball)[n])
    axes.set_title(title, fontsize=9, loc="left")
    explain(figure)
    return save(figure, path)


def velocities(trial: Any, limits: Any, dt: float, path: str | Path, title: str = "") -> Path:
    """Fig. 8: linear (8a) and angular (8b) velocity of one trial over time; returns the PNG's path.

    Args:
        trial: `rollout.Trajectory`, not batched.
        limits: anything with v_min, v_max (m/s) and omega_max (rad/s).
        dt: control step, s.
        path: file to write, and a PDF beside it.
        title: above it.

    Raises OSError.
    """
    figure, (top, bottom) = _new(5.2, 4.2, rows=2)
    v, omega = np.asarray(trial.command.v), np.asarray(trial.command.omega)
    time = np.arange(len(v)) * dt
    for axes, values, colour, label, bounds in (
        (top, v, BLUE, "$v$ (m/s)", (float(limits.v_min), float(limits.v_max))),
        (
            bottom,
            omega,
            RED,
            r"$\omega$ (rad/s)",
            (-float(limits.omega_max), float(limits.omega_max)),
        ),
    ):
        for bound in bounds:
            axes.axhline(bound, color="0.6", linewidth=0.8, linestyle="--")
        axes.step(time, values, color=colour, where="post")
        axes.set_ylabel(label)
    top.set_title(f"{title}\ndashed: limits".strip(), fontsize=9, loc="left")
    bottom.set_xlabel("time (s)")
    return save(figure, path)
