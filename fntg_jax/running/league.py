"""A round robin of teams: every pair, both as home, in one program; table and ratings."""

from collections.abc import Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from fntg_jax.learning import play
from fntg_jax.learning.mixture import mixture
from fntg_jax.running import matches

_CHUNK = 4096  # matches of a call


class Played(NamedTuple):
    """All matches [M]: home, away: indices of teams; seeds; statistics by name, [M, 2]."""

    teams: tuple[str, ...]
    home: np.ndarray
    away: np.ndarray
    seeds: np.ndarray
    statistics: dict[str, np.ndarray]


class Row(NamedTuple):
    """A team's line: matches, wins, draws, losses, goals, points (3 a win, 1 a draw); rating: mean
    and standard deviation of openskill's Plackett-Luce model (begins at 25 and 8.33)."""

    team: str
    played: int
    wins: int
    draws: int
    losses: int
    goals: int
    against: int
    points: int
    rating: float
    uncertainty: float


def names_of(teams: Sequence[str]) -> list[str]:
    """Teams as `fntg match` takes them; a folder stands for the team files in it.  Raises
    ValueError where there are fewer than two, or one twice."""
    found: list[str] = []
    for team in teams:
        path = Path(team)
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix in (".json", ".py"))
            if not inside:
                raise ValueError(f"teams = {team}: no .json and no .py in this folder")
            found += map(str, inside)
        else:
            found.append(team)
    if len(found) < 2:
        raise ValueError(f"teams = {' '.join(found)}: allowed are two and more")
    if twice := {name for name in found if found.count(name) > 1}:
        raise ValueError(f"teams: {min(twice)} is there twice")
    return found


def label(team: str) -> str:
    """A team's name in tables: of a file without folder and suffix."""
    return Path(team).stem if Path(team).suffix in (".json", ".py") else team


def schedule(num_teams: int, num: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """home, away, seeds [M]: `num` matches of every pair, half of them with either at home; the two
    legs of a pair have the same seed.  Raises ValueError where num is odd."""
    if num < 2 or num % 2:
        raise ValueError(f"matches = {num}: allowed are even numbers from 2, of each pair")
    pairs = np.array(list(combinations(range(num_teams), 2)))
    first = matches.match_seeds(len(pairs) * num // 2, seed).reshape(len(pairs), -1)
    seeds = np.repeat(first, 2, axis=1).ravel()
    home, away = (
        np.repeat(pairs[:, [k, 1 - k]][:, None], num // 2, axis=1).ravel() for k in (0, 1)
    )
    return home, away, seeds


def play_league(
    match: Any, teams: Sequence[str], num: int, seed: int, say: Any = lambda done, total: None
) -> Played:
    """The round robin.  The same whatever the number of devices.  say: called with the matches
    played and to be played."""
    sides = [[matches.get_team(name, match, side) for name in teams] for side in (0, 1)]
    (home_side, home_teams), (away_side, away_teams) = map(mixture, sides)
    home, away, seeds = schedule(len(teams), num, seed)
    if len(seeds) > matches.MOST:
        raise ValueError(f"matches = {num}: allowed are at most {matches.MOST} in all")
    # In the order of the seeds' draw: blocks of matches then take as long.
    devices = jax.devices()[: -(-len(seeds) // 128)]
    program = _program(match, home_side, away_side, len(devices))
    parts = []
    for start in range(0, len(seeds), _CHUNK):
        rows = slice(start, start + _CHUNK)
        columns = home[rows], away[rows], seeds[rows]
        surplus = -len(columns[0]) % len(devices)
        padded = (np.pad(c, (0, surplus), mode="edge") for c in columns)
        played = program((home_teams, away_teams), *padded)
        size = len(seeds[rows])
        parts.append({k: np.asarray(v)[:size] for k, v in played._asdict().items()})
        say(min(start + _CHUNK, len(seeds)), len(seeds))
    statistics = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
    return Played(tuple(map(label, teams)), home, away, seeds, statistics)


@cache
def _program(match: Any, home: play.Side, away: play.Side, num_devices: int) -> Any:
    mesh = Mesh(np.asarray(jax.devices()[:num_devices]), ("match",))

    def some(teams, rows_home, rows_away, seeds):
        pick = lambda stacked, rows: jax.tree.map(lambda a: a[rows], stacked)  # noqa: E731
        return play.play(
            match,
            home._replace(team=pick(teams[0], rows_home)),
            away._replace(team=pick(teams[1], rows_away)),
            seeds,
            each=(True, True),
        )

    specs = (P(), P("match"), P("match"), P("match"))
    return jax.jit(
        jax.shard_map(some, mesh=mesh, in_specs=specs, out_specs=P("match"), check_vma=False)
    )


def table(played: Played, seed: int) -> list[Row]:
    """Rows from the highest rating down.  Matches are rated in an order drawn from the seed."""
    from openskill.models import PlackettLuce  # here: only leagues need it

    goals = played.statistics["goals"]
    model = PlackettLuce()
    ratings = [model.rating(name=name) for name in played.teams]
    for n in np.random.default_rng(seed).permutation(len(goals)):
        pair = played.home[n], played.away[n]
        rated = model.rate([[ratings[k]] for k in pair], scores=[float(g) for g in goals[n]])
        for k, (new,) in zip(pair, rated):
            ratings[k] = new
    rows = []
    for k, name in enumerate(played.teams):
        as_home, as_away = played.home == k, played.away == k
        own = np.concatenate([goals[as_home, 0], goals[as_away, 1]])
        other = np.concatenate([goals[as_home, 1], goals[as_away, 0]])
        won, drawn = int((own > other).sum()), int((own == other).sum())
        rows.append(
            Row(
                name,
                len(own),
                won,
                drawn,
                len(own) - won - drawn,
                int(own.sum()),
                int(other.sum()),
                3 * won + drawn,
                float(ratings[k].mu),
                float(ratings[k].sigma),
            )
        )
    return sorted(rows, key=lambda row: -row.rating)


def cross(played: Played) -> tuple[np.ndarray, np.ndarray]:
    """Share of points (wins and half of the draws) and mean goal difference of the row's team
    against the column's, [teams, teams]; NaN on the diagonal."""
    num, goals = len(played.teams), played.statistics["goals"]
    points, difference = np.full((2, num, num), np.nan)
    for a in range(num):
        for b in range(num):
            if a == b:
                continue
            home = (played.home == a) & (played.away == b)
            away = (played.home == b) & (played.away == a)
            gap = np.concatenate([goals[home] @ [1, -1], goals[away] @ [-1, 1]])
            points[a, b] = np.mean(0.5 + 0.5 * np.sign(gap))
            difference[a, b] = gap.mean()
    return points, difference


def closest(played: Played) -> int:
    """The match with the least difference, of those with the most goals."""
    goals = played.statistics["goals"].astype(int)
    return int(np.lexsort((-goals.sum(1), np.abs(goals[:, 0] - goals[:, 1])))[0])


def wildest(played: Played) -> int:
    """The match with the most goals, shots and saves: 10 a goal, 1 a shot, 2 a save."""
    s = played.statistics
    return int(np.argmax((10 * s["goals"] + s["shots"] + 2 * s["saves"]).sum(1)))
