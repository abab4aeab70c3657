"""Many matches between two teams, and what they come to.

Matches are found by entry point (group "fntg_jax.matches"), teams likewise ("fntg_jax.teams"), or
in a Python file that defines `make(match, side)`.
"""

import importlib.util
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from fntg_jax.learning import play
from fntg_jax.running.statistics import Rate, bootstrap_mean_of_counts, wilson

MATCHES, TEAMS = "fntg_jax.matches", "fntg_jax.teams"
MOST = 1_000_000
_CHUNK = 4096  # matches of a call: Ctrl-C is heard between calls


class Results(NamedTuple):
    """Matches one by one: seeds [M]; statistics by name, [M, 2] (home, away); steps of a match."""

    seeds: np.ndarray
    statistics: dict[str, np.ndarray]
    steps: int


def get_match(name: str, **options: Any) -> Any:
    """A match by its entry point's name, with options by name.  Raises ValueError."""
    found = {entry.name: entry for entry in metadata.entry_points(group=MATCHES)}
    if name not in found:
        raise ValueError(f"match = {name!r}: known are {', '.join(sorted(found))}")
    return found[name].load()(**options)


def team_names() -> list[str]:
    return sorted(entry.name for entry in metadata.entry_points(group=TEAMS))


def get_team(name: str, match: Any, side: int) -> play.Side:
    """A team for a match on a side, 0 home or 1 away: by entry point, or from a file: .py that
    defines `make(match, side)`, .json a team file.  Raises ValueError in one line."""
    found = {entry.name: entry for entry in metadata.entry_points(group=TEAMS)}
    path = Path(name)
    if name in found:
        return found[name].load()(match, side)
    if path.suffix == ".json" and "cerberus" in found:
        return found["cerberus"].load()(match, side, path)
    if path.suffix == ".py":
        return _checked(_from_python(path), match, side, path)
    known = ", ".join(sorted(found))
    raise ValueError(f"team = {name!r}: known are {known}, or a file (.py, .json)")


def _from_python(path: Path) -> Callable[..., Any]:
    spec = importlib.util.spec_from_file_location(f"team_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"team = {str(path)!r}: no such file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from error
    if not callable(getattr(module, "make", None)):
        raise ValueError(f"{path}: make is missing: a function of (match, side)")
    return module.make


def _checked(make: Callable[..., Any], match: Any, side: int, path: Path) -> play.Side:
    try:
        team = make(match, side)
        if not isinstance(team, play.Side):
            raise TypeError(f"make returned {type(team).__name__}, not fntg_jax.learning.play.Side")
        seeds = jnp.zeros(1, jnp.int32)
        jax.eval_shape(lambda s: play.play(match, team, team, s, num_steps=1), seeds)
    except Exception as error:
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from error
    return team


def play_matches(match: Any, home: play.Side, away: play.Side, num: int, seed: int = 0) -> Results:
    """`num` matches, shared by all devices; the results depend on neither their number nor `num`.

    Match k has seed `seed` x 1 000 003 + k (32 bits); home kicks off where that is even.
    """
    if not 1 <= num <= MOST:
        raise ValueError(f"matches = {num}: allowed are 1 to {MOST}")
    seeds = match_seeds(num, seed)
    # A device gets whole blocks.
    devices = jax.devices()[: num if getattr(match, "vivid", False) else -(-num // 128)]
    chunk = _CHUNK if jax.default_backend() == "cpu" else 1 << 18
    parts = []
    for first in range(0, num, chunk):
        rows = seeds[first : first + chunk]
        # As many for each device; the surplus repeats the last match.
        share = -(-len(rows) // len(devices))
        rows = np.pad(rows, (0, share * len(devices) - len(rows)), mode="edge")
        played = _shared(match, _static(home), _static(away), len(devices))(
            (home.team, away.team), rows
        )
        parts.append({k: np.asarray(v) for k, v in played._asdict().items()})
    statistics = {k: np.concatenate([part[k] for part in parts])[:num] for k in parts[0]}
    return Results(seeds, statistics, match.steps)


def match_seeds(num: int, seed: int) -> np.ndarray:
    """Seeds of `num` matches, int32."""
    return ((seed * 1_000_003 + np.arange(num)) % 2**31).astype(np.int32)


def _static(side: play.Side) -> play.Side:
    """All but the parameters: what a compiled program is chosen by."""
    return side._replace(team=None)


@cache
def _shared(match: Any, home: play.Side, away: play.Side, num_devices: int) -> Callable[..., Any]:
    mesh = Mesh(np.asarray(jax.devices()[:num_devices]), ("match",))

    def all_matches(teams, seeds):
        return play.play(match, home._replace(team=teams[0]), away._replace(team=teams[1]), seeds)

    return jax.jit(
        jax.shard_map(
            all_matches,
            mesh=mesh,
            in_specs=(P(), P("match")),
            out_specs=P("match"),
            check_vma=False,
        )
    )


class Summary(NamedTuple):
    """One team over many matches: means a match; goals with a bootstrap 95 % interval, wins a
    Wilson one; points: wins plus half of the draws, as a share, with a bootstrap interval."""

    team: str
    goals: float
    goals_interval: tuple[float, float]
    wins: Rate
    points: float
    points_interval: tuple[float, float]
    means: dict[str, float]


def summarize(results: Results, names: tuple[str, str]) -> tuple[Summary, Summary, Rate]:
    """Both teams' summaries and the share of draws."""
    goals = results.statistics["goals"]
    num = len(goals)
    draws = wilson(int((goals[:, 0] == goals[:, 1]).sum()), num)
    made = []
    for k, name in enumerate(names):
        wins = wilson(int((goals[:, k] > goals[:, 1 - k]).sum()), num)
        means = {
            key: float(value[:, k].mean())
            for key, value in results.statistics.items()
            if key not in ("goals", "possession")
        }
        steps = max(float(results.statistics["possession"].sum()), 1.0)
        means["possession"] = float(results.statistics["possession"][:, k].sum()) / steps
        made.append(
            Summary(
                name,
                float(goals[:, k].mean()),
                bootstrap_mean_of_counts(goals[:, k]),
                wins,
                wins.share + 0.5 * draws.share,
                bootstrap_mean_of_counts(0.5 + 0.5 * np.sign(goals[:, k] - goals[:, 1 - k])),
                means,
            )
        )
    return made[0], made[1], draws
