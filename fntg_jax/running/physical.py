"""Matches whose bodies are physics: one after the other, steered by the same `control`."""

import time
from collections.abc import Callable
from importlib import metadata
from typing import Any, NamedTuple

import jax
import numpy as np

from fntg_jax.learning import play
from fntg_jax.running import matches
from fntg_jax.running.matches import Results

GROUP = "fntg_jax.bodies"


class Played(NamedTuple):
    """results: as of `matches.play_matches`; seconds: that the first match took, without compiling;
    poses: of the first match, where they were kept."""

    results: Results
    seconds: float
    poses: list[np.ndarray]


def get_bodies(name: str, match: Any) -> Any:
    """What moves the bodies of a match, by its entry point's name.  Raises ValueError."""
    found = {entry.name: entry for entry in metadata.entry_points(group=GROUP)}
    if name not in found:
        raise ValueError(f"body = {name!r}: known are tables, {', '.join(sorted(found))}")
    return found[name].load()(match)


def play_matches(
    match: Any,
    bodies: Any,
    sides: tuple[play.Side, play.Side],
    num: int,
    seed: int = 0,
    keep: tuple[int, float] = (0, 0.0),
    show: Callable[[int, int], None] = lambda *_: None,
) -> Played:
    """`num` matches of the seeds of `matches.match_seeds`.

    keep: poses a control step, and for how many seconds of the first match.  show: called with
    matches done and to be played.
    """
    home, away = sides
    begin = jax.jit(lambda state: play.begin(match, home, away, state))
    decide = jax.jit(lambda carry: play.decide(match, home, away, carry))
    seeds, rows, first, poses = matches.match_seeds(num, seed), [], 0.0, []
    for n, own in enumerate(seeds):
        bodies.keep = keep[0] if n == 0 else 0
        state = bodies.reset(int(own) % 2, int(own))
        memories = begin(state)
        start = time.perf_counter()
        for step in range(match.steps):
            memories, action = decide((state, memories))
            state = bodies.step(state, action)
            if step == 0:
                start = time.perf_counter()  # now everything is compiled
            if bodies.keep and step * match.dt >= keep[1]:
                poses, bodies.keep = bodies.poses, 0
        if n == 0:
            first, poses = time.perf_counter() - start, poses or bodies.poses
        rows.append(jax.tree.map(lambda a: np.asarray(a)[..., 0], state.statistics))
        show(n + 1, num)
    statistics = {name: np.stack([getattr(row, name) for row in rows]) for name in rows[0]._fields}
    return Played(Results(seeds, statistics, match.steps), first, poses)
