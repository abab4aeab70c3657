"""Two teams x a match under one scan.

A match is anything with the batch methods of `envs.soccer.Match`; nothing here knows one by name.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

# Matches of a block on a CPU, so that its state stays in the cache; a multiple of a vector
# register's 16.  Elsewhere all at once.
_BLOCK = 128
_BLOCK_ELSEWHERE = 1 << 16


class Words(NamedTuple):
    """Names of what `Belief` numbers: roles, behaviours, rules."""

    roles: tuple[str, ...] = ()
    behaviors: tuple[str, ...] = ()
    rules: tuple[str, ...] = ()


class Side(NamedTuple):
    """A team as a match needs it: a pure control program for one robot.

    name: for tables.  team: parameters, a pytree.  begin: (team, shirt, pose [3]) -> memory of one
    robot, put on its kick-off place (x, y, heading in its team's frame).  control: (team, memory,
    senses) -> (memory, action), one robot, one control step.  truth: `control` takes
    `envs.base.Truth` instead of `envs.base.Senses`.  believe: (team, memory) -> `Belief`, for
    viewers, or None.  words: names of what it numbers.
    """

    name: str
    team: Any
    begin: Callable[[Any, Any, Any], Any]
    control: Callable[[Any, Any, Any], tuple[Any, Any]]
    truth: bool = False
    believe: Callable[[Any, Any], Any] | None = None
    words: Words = Words()


class Belief(NamedTuple):
    """What one robot thinks, for viewers: pose (x, y, heading) and ball (x, y) in its team's frame
    (m, rad); ball_age: s since it was seen; role, behavior, rule: indices into the team's own
    names, -1 where it has none."""

    pose: Float[Array, "3"]
    ball: Float[Array, "2"]
    ball_age: Float[Array, ""]
    role: Int[Array, ""]
    behavior: Int[Array, ""]
    rule: Int[Array, ""]


class History(NamedTuple):
    """One match step by step, leaves [steps + 1, ...]: the match's snapshots; what each robot of
    both teams believed when it was asked (`Belief`, leaves [steps + 1, N, ...]) or None; actions
    [steps, R, ...]; statistics: at the end."""

    picture: Any
    home: Any
    away: Any
    action: Any
    statistics: Any


def kickoffs(seeds: Int[Array, " M"]) -> Int[Array, " M"]:
    """Who kicks off: home in matches of even seed, away in the others."""
    return (seeds % 2).astype(jnp.int32)


def play(
    match: Any,
    home: Side,
    away: Side,
    seeds: Int[Array, " M"],
    num_steps: int | None = None,
    each: bool = False,
) -> Any:
    """Every seed's match from kick-off to the end: the match's statistics, leaves [M, 2].

    num_steps: control steps, default until all is over.  each: `home.team` has a leading axis [M],
    a team for each match.  M matches go block by block; blocks are filled up with repetitions.
    """
    num = seeds.shape[0]
    most = _BLOCK if jax.default_backend() == "cpu" else _BLOCK_ELSEWHERE
    blocks = -(-num // most)
    # Whole registers.
    size = -(-num // (16 * blocks)) * 16 if num > 1 else 1
    steps = match.steps if num_steps is None else num_steps

    def block(first):
        rows = jnp.minimum(first + jnp.arange(size), num - 1)
        mine = home
        if each:
            mine = home._replace(
                team=jax.tree.map(lambda a: jnp.moveaxis(a[rows], 0, -1), home.team)
            )
        state = _last_state(match, mine, away, seeds[rows], steps, each)
        # One array leaves the loop; see `rollout._in_blocks`.
        leaves = jax.tree.leaves(state.statistics)
        return jnp.concatenate([leaf.reshape(-1, size) for leaf in leaves])

    rows = jax.lax.map(block, size * jnp.arange(-(-num // size)))
    flat = jnp.moveaxis(rows, 1, -1).reshape(-1, rows.shape[1])[:num]
    like = jax.eval_shape(lambda: match.reset(0, 0)).statistics
    sizes = [leaf.shape[0] for leaf in jax.tree.leaves(like)]
    ends = [sum(sizes[: k + 1]) for k in range(len(sizes))]
    parts = [flat[:, end - n : end] for n, end in zip(sizes, ends)]
    return jax.tree.unflatten(jax.tree.structure(like), parts)


def _last_state(match, home, away, seeds, steps, each):
    state = match.reset(kickoffs(seeds), seeds)
    memory = begin(match, home, away, state, each)

    def step(carry, _):
        return control_step(match, home, away, carry, each)[0], None

    (state, _), _ = jax.lax.scan(step, (state, memory), None, length=steps)
    return state


def begin(match: Any, home: Side, away: Side, state: Any, each: bool = False) -> tuple[Any, Any]:
    """Memories of both teams' robots at a kick-off, leaves [..., N B]."""
    poses = match.truth_batch(state).pose
    shirts = jnp.arange(match.players, dtype=jnp.int32)
    return tuple(
        jax.vmap(side.begin, in_axes=(-1 if own else None, -1, -1), out_axes=-1)(
            _spread(side.team, match, poses) if own else side.team,
            jnp.repeat(shirts, poses.shape[-1]),
            _of_team(poses, match, k),
        )
        for k, (side, own) in enumerate(((home, each), (away, False)))
    )  # type: ignore[return-value]


def control_step(match: Any, home: Side, away: Side, carry: Any, each: bool = False):
    """One control step of a batch: ((state, memories), action) after both teams have acted.

    Robots and matches are one flat axis, the last, for the teams: their inner loops then run over
    contiguous numbers."""
    state, memories = carry
    needed = {side.truth for side in (home, away)}
    truth = match.truth_batch(state) if True in needed else None
    senses = match.sense_batch(state) if False in needed else None
    after, actions = [], []
    for k, (side, own) in enumerate(((home, each), (away, False))):
        given = jax.tree.map(lambda a, k=k: _of_team(a, match, k), truth if side.truth else senses)
        team = _spread(side.team, match, state.robots.x) if own else side.team
        memory, action = jax.vmap(side.control, in_axes=(-1 if own else None, -1, -1), out_axes=-1)(
            team, memories[k], given
        )
        after.append(memory)
        actions.append(action)
    shape = state.robots.x.shape[1:]
    both = jax.tree.map(lambda a, b: _joined(a, b, match, shape), *actions)
    return (match.step_batch(state, both), tuple(after)), both


def _of_team(a, match, team):
    """[..., R, B] to one team's [..., N B]."""
    n = match.players
    a = a[..., team * n : (team + 1) * n, :]
    return a.reshape(*a.shape[:-2], -1)


def _joined(home, away, match, shape):
    """Two [..., N B] to [..., R, B]."""
    parts = [a.reshape(*a.shape[:-1], match.players, *shape) for a in (home, away)]
    return jnp.concatenate(parts, axis=-2)


def _spread(team, match, like):
    """A team for each match, [..., B], for every robot: [..., N B]."""
    n, b = match.players, like.shape[-1]
    return jax.tree.map(
        lambda a: jnp.broadcast_to(a[..., None, :], (*a.shape[:-1], n, b)).reshape(
            *a.shape[:-1], n * b
        ),
        team,
    )


def record(
    match: Any, home: Side, away: Side, seed: Int[Array, ""], num_steps: int | None = None
) -> History:
    """One match with everything that a viewer wants; the same match as `play` of that seed."""
    steps = match.steps if num_steps is None else num_steps
    seeds = jnp.reshape(seed, (1,))
    state = match.reset(kickoffs(seeds), seeds)

    def look(state, memories):
        one = jax.tree.map(lambda a: a[..., 0], state)
        beliefs = tuple(
            None
            if side.believe is None
            else jax.vmap(partial(side.believe, side.team), in_axes=-1)(memory)
            for side, memory in zip((home, away), memories)
        )
        return match.snapshot(one), *beliefs

    def step(carry, _):
        seen = look(*carry)
        carry, action = control_step(match, home, away, carry)
        return carry, (seen, jax.tree.map(lambda a: jnp.moveaxis(a[..., 0], -1, 0), action))

    carry = (state, begin(match, home, away, state))
    (state, memories), (seen, actions) = jax.lax.scan(step, carry, None, length=steps)
    seen = jax.tree.map(lambda xs, x: jnp.concatenate([xs, x[None]]), seen, look(state, memories))
    statistics = jax.tree.map(lambda a: a[..., 0], state.statistics)
    picture, believed, theirs = seen
    return History(picture, believed, theirs, actions, statistics)
