"""What a sweep found, for people and programs: CSV, leaderboard, figure."""

from pathlib import Path
from typing import Any

import numpy as np

from fntg_jax.files import csv_table, write_atomically
from fntg_jax.running.statistics import bootstrap_median
from fntg_jax.running.sweep import Table
from fntg_jax.showing import plots
from fntg_jax.showing.plots import BLUE, ORANGE, RC


def measure(table: Table) -> tuple[str, np.ndarray]:
    """What settings are compared by: the mean success over the suites, in per cent, where scenes
    were asked for; else the fitness.

    Args:
        table: of `sweep.run`.

    Returns:
        Its name, and values [setting, seed].
    """
    if table.success:
        return "success (%)", 100 * np.mean(list(table.success.values()), axis=0)
    return "fitness F", table.best


def write_csv(table: Table, first_seed: int, path: Path) -> None:
    """One row for each setting and seed: its values, seed, best, mean, success by suite.

    Args:
        table: of `sweep.run`.
        first_seed: of the seeds.
        path: file to write.

    Raises OSError.
    """
    names = list(table.settings[0])
    header = [*names, "seed", "best", "mean", *(f"success_{s}" for s in table.success)]
    rows = []
    for n, seed in np.ndindex(table.best.shape):
        numbers = [table.best[n, seed], table.mean[n, seed]]
        numbers += [share[n, seed] for share in table.success.values()]
        values = [str(table.settings[n][name]) for name in names]
        rows.append([*values, first_seed + seed, *(f"{x:.9g}" for x in numbers)])
    write_atomically(path, csv_table(header, rows))


def leaderboard(table: Table) -> str:
    """Settings by their median over seeds, with quartiles and the median's 95 % bootstrap
    interval.

    Args:
        table: of `sweep.run`.
    """
    label, values = measure(table)
    low, median, high = bootstrap_median(values.T)
    quartiles = np.percentile(values, [25, 75], axis=1)
    names = list(table.settings[0])
    head = ["", *names, f"median {label}", "95 % interval", "quartiles"]
    rows = [head]
    for rank, n in enumerate(np.argsort(-median, kind="stable")):
        rows.append(
            [
                str(rank + 1),
                *(str(table.settings[n][name]) for name in names),
                f"{median[n]:.4g}",
                f"{low[n]:.4g} to {high[n]:.4g}",
                f"{quartiles[0, n]:.4g} to {quartiles[1, n]:.4g}",
            ]
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(head))]
    lines = ["  ".join(x.rjust(w) for x, w in zip(row, widths)).rstrip() for row in rows]
    if not table.success and any(redefines(name) for name in names):
        lines.append("note: fitness means another thing in each setting; compare with --suites")
    return "\n".join(lines) + "\n"


def redefines(axis: str) -> bool:
    """Whether the fitness of one value cannot be compared with that of another.

    Args:
        axis: of a sweep.
    """
    scenes = ("env", "objective", "suite", "num_scenes", "scene_pool")
    return axis in scenes or axis.partition(".")[0] in ("env", "fitness", "smooth")


def plot(table: Table, path: Path) -> Path | None:
    """PNG and PDF: a heat map of medians for two axes, a line for one; None for more.

    Args:
        table: of `sweep.run`.
        path: file to write.

    Raises OSError.
    """
    names = [n for n in table.settings[0] if len({s[n] for s in table.settings}) > 1]
    if not names or len(names) > 2:
        return None
    grid = [list(dict.fromkeys(s[n] for s in table.settings)) for n in names]
    if len(names) == 2 and len(grid[0]) * len(grid[1]) == len(table.settings):
        return heat_map(table, names, path)
    return line(table, names[0] if len(names) == 1 else "", path)


def heat_map(table: Table, names: list[str], path: Path) -> Path:
    """Medians over seeds by two axes, the first upwards, each cell with its number.

    Args:
        table: of `sweep.run`.
        names: of the two axes.
        path: file to write, and a PDF beside it.

    Raises OSError.
    """
    label, values = measure(table)
    columns, rows = names[1], names[0]
    xs = list(dict.fromkeys(s[columns] for s in table.settings))
    ys = list(dict.fromkeys(s[rows] for s in table.settings))
    cells = np.full((len(ys), len(xs)), np.nan)
    for setting, value in zip(table.settings, np.median(values, axis=1)):
        cells[ys.index(setting[rows]), xs.index(setting[columns])] = value
    figure, panels = plots.new_grid(1, 1, 1.6 + 0.85 * len(xs) + 1.2, 1.6 + 0.55 * len(ys))
    axes = panels[0, 0]
    image = axes.imshow(cells, origin="lower", aspect="auto", cmap="cividis")
    middle = (np.min(cells) + np.max(cells)) / 2
    for (y, x), value in np.ndenumerate(cells):
        colour = "white" if value < middle else "black"
        axes.text(x, y, f"{value:.3g}", ha="center", va="center", color=colour)
    axes.set_xticks(range(len(xs)), [str(x) for x in xs])
    axes.set_yticks(range(len(ys)), [str(y) for y in ys])
    axes.set_xlabel(columns)
    axes.set_ylabel(rows)
    axes.grid(False)
    bar = figure.colorbar(image, ax=axes, label=f"{label}, median of {values.shape[1]} seeds")
    bar.outline.set_visible(False)
    return plots.save(figure, path)


def line(table: Table, name: str, path: Path) -> Path:
    """Seeds as dots, their median with its 95 % bootstrap interval, setting beside setting.

    Args:
        table: of `sweep.run`.
        name: the axis; "" where settings differ in several, which are then all written out.
        path: file to write, and a PDF beside it.

    Raises OSError.
    """
    label, values = measure(table)
    low, median, high = bootstrap_median(values.T)
    words = [
        str(s[name]) if name else "\n".join(f"{k.rpartition('.')[2]} {v}" for k, v in s.items())
        for s in table.settings
    ]
    wide = max(len(line) for word in words for line in word.split("\n"))
    position = np.arange(len(words))
    figure, panels = plots.new_grid(1, 1, max(4.0, 1.2 + (0.5 + 0.075 * wide) * len(words)), 3.4)
    axes = panels[0, 0]
    # Spread sideways by seed, the same way in every setting, so that dots do not hide dots.
    side = np.linspace(-0.16, 0.16, values.shape[1]) if values.shape[1] > 1 else np.zeros(1)
    axes.plot(position[:, None] + side, values, ".", color=BLUE, alpha=0.4, markersize=4)
    if name and not isinstance(table.settings[0][name], str | bool):
        axes.plot(position, median, color=ORANGE, linewidth=1)
    error: Any = np.maximum([median - low, high - median], 0)
    axes.errorbar(position, median, error, fmt="o", color=ORANGE, markersize=5, capsize=3)
    axes.set_xticks(position, words)
    axes.set_xlim(-0.5, len(words) - 0.5)
    axes.set_xlabel(name)
    axes.set_ylabel(label)
    axes.grid(False, axis="x")
    note = f"{values.shape[1]} seeds; median, 95 % bootstrap interval"
    axes.set_title(note, fontsize=RC["font.size"] - 1, loc="left")
    return plots.save(figure, path)
