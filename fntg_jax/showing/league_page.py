"""What a league came to: CSV, cross table as a picture, and a page with links to replays."""

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fntg_jax.files import csv_table
from fntg_jax.running.league import Played, Row, cross
from fntg_jax.showing import plots

_HEAD = ("team", "matches", "wins", "draws", "losses", "goals", "against", "points", "rating", "sd")


def table_csv(rows: Sequence[Row]) -> bytes:
    """The table, a line for each team."""
    numbers = ([*row[:-2], f"{row.rating:.4f}", f"{row.uncertainty:.4f}"] for row in rows)
    return csv_table(_HEAD, numbers)


def matches_csv(played: Played) -> bytes:
    """Every match, a line for each."""
    names = [f"{name}_{side}" for name in played.statistics for side in ("home", "away")]
    columns = np.concatenate(list(played.statistics.values()), axis=1).tolist()
    pairs = zip(played.seeds, played.home, played.away, columns)
    rows = (
        [n, seed, played.teams[home], played.teams[away], *values]
        for n, (seed, home, away, values) in enumerate(pairs)
    )
    return csv_table(["match", "seed", "home", "away", *names], rows)


def as_text(rows: Sequence[Row]) -> str:
    """The table for a terminal."""
    wide = max(len(row.team) for row in rows)
    wide = max(wide, 4)
    lines = [
        f"{'':>3s}  {'team':{wide}s}{'matches':>8s}{'wins':>7s}{'draws':>7s}{'losses':>7s}"
        f"{'goals':>12s}{'points':>8s}{'rating':>16s}"
    ]
    for rank, row in enumerate(rows, start=1):
        lines.append(
            f"{rank:3d}  {row.team:{wide}s}{row.played:8d}{row.wins:7d}{row.draws:7d}"
            f"{row.losses:7d}{f'{row.goals}:{row.against}':>12s}{row.points:8d}"
            f"{f'{row.rating:.2f} +- {row.uncertainty:.2f}':>16s}"
        )
    return "\n".join(lines) + "\n"


def figure(played: Played, rows: Sequence[Row], path: Path) -> Path:
    """The cross table: share of points of the row's team, with the mean goal difference, in the
    order of the ratings.  Raises OSError."""
    order = [played.teams.index(row.team) for row in rows]
    points, difference = (x[np.ix_(order, order)] for x in cross(played))
    size = 2.2 + 0.75 * len(order)
    panels, axes = plots.new_grid(1, 1, size + 1.2, size)
    axes = axes[0, 0]
    axes.grid(False)
    shown = axes.imshow(100 * points, vmin=0, vmax=100, cmap="PuOr")
    names = [played.teams[k] for k in order]
    axes.set_xticks(range(len(names)), names, rotation=35, ha="right")
    axes.set_yticks(range(len(names)), names)
    for a, b in np.ndindex(points.shape):
        if a != b:
            dark = abs(points[a, b] - 0.5) > 0.3
            words = f"{100 * points[a, b]:.0f} %\n{difference[a, b]:+.2f}"
            colour = "white" if dark else "black"
            axes.text(b, a, words, ha="center", va="center", color=colour, fontsize=8)
    panels.colorbar(shown, ax=axes, shrink=0.8, label="points of the row's team (%)")
    axes.set_title("wins + draws / 2, and mean goal difference", fontsize=9, loc="left")
    return plots.save(panels, path)


def page(rows: Sequence[Row], about: str, replays: Sequence[tuple[str, str, str]]) -> str:
    """The page.  about: a sentence; replays: file, title, words of each."""
    cells = lambda values, tag: "".join(f"<{tag}>{html.escape(str(v))}" for v in values)  # noqa: E731
    lines = "".join(
        f"<tr>{cells([n, *row[:-2], f'{row.rating:.2f} ± {row.uncertainty:.2f}'], 'td')}"
        for n, row in enumerate(rows, start=1)
    )
    links = "".join(
        f'<li><a href="{html.escape(file)}">{html.escape(title)}</a>: {html.escape(words)}'
        for file, title, words in replays
    )
    head = cells(("", *_HEAD[:-2], "rating ± sd"), "th")
    return f"""<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>League</title>
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}}
table{{border-collapse:collapse}}td,th{{padding:.25rem .7rem;text-align:right}}
td{{border-top:1px solid #ccc}}td:nth-child(2),th:nth-child(2){{text-align:left}}
img{{max-width:100%}}div{{overflow-x:auto}}
</style><h1>League</h1><p>{html.escape(about)}</p><div><table><tr>{head}{lines}</table></div>
<p>Rating: openskill's Plackett-Luce model, mean ± standard deviation.</p>
<h2>Cross table</h2><img src="cross.png" alt="Share of points of each team against each other">
<h2>To watch</h2><ul>{links}</ul>
<p><a href="league.csv">league.csv</a>, <a href="matches.csv">matches.csv</a></p></html>
"""
