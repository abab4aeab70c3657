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
    viewers, or None.  words: names of what it numbers.  both: `control` takes the pair (senses,
    truth), for a team that may be any of several (`mixture`).
    """

    name: str
    team: Any
    begin: Callable[[Any, Any, Any], Any]
    control: Callable[[Any, Any, Any], tuple[Any, Any]]
    truth: bool = False
    believe: Callable[[Any, Any], Any] | None = None
    words: Words = Words()
    both: bool = False


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
    """Who kicks off: home in matches of even seed, away in the others.

    Args:
        seeds: [M].

    Returns:
        [M], 0 home, 1 away.
    """
    return (seeds % 2).astype(jnp.int32)


def play(
    match: Any,
    home: Side,
    away: Side,
    seeds: Int[Array, " M"],
    num_steps: int | None = None,
    each: tuple[bool, bool] = (False, False),
    watch: Callable[[Any, Any], Float[Array, "K M"]] | None = None,
    axis: str | None = None,
) -> Any:
    """Every seed's match from kick-off to the end.

    M matches go block by block; blocks are filled up with repetitions.

    Args:
        match: anything with the batch methods of `envs.soccer.Match`.
        home: the team that plays towards +x first.
        away: the other.
        seeds: [M], of all noise.
        num_steps: control steps; None until all is over.
        each: whether home.team, away.team has a leading axis [M], a team for each match.
        watch: (match, state of a batch) -> K numbers [K, M], summed over all steps; None for none.
        axis: inside `jax.shard_map`, the devices along this axis share the blocks, and all get all
            matches.

    Returns:
        The match's statistics, leaves [M, 2]; beside them [M, K] of `watch`.
    """
    num = seeds.shape[0]
    most = _BLOCK if jax.default_backend() == "cpu" else _BLOCK_ELSEWHERE
    # Whole registers; pixels and samples fill them by themselves.
    size = -(-num // (16 * -(-num // most))) * 16 if num > 1 else 1
    size = 1 if _alone(match) else size
    steps = match.steps if num_steps is None else num_steps
    like = jax.eval_shape(lambda: match.reset(0, 0)).statistics

    def block(first):
        rows = jnp.minimum(first + jnp.arange(size), num - 1)
        mine = (
            side._replace(team=jax.tree.map(lambda a: jnp.moveaxis(a[rows], 0, -1), side.team))
            if own
            else side
            for side, own in zip((home, away), each)
        )
        state, watched = _last_state(match, *mine, seeds[rows], steps, each, watch)
        # One array leaves the loop; see `rollout._in_blocks`.
        leaves = [leaf.reshape(-1, size) for leaf in jax.tree.leaves(state.statistics)]
        if watch is not None:
            leaves.append(jax.lax.bitcast_convert_type(watched, leaves[0].dtype))
        return jnp.concatenate(leaves)

    blocks = -(-num // size)
    if axis is None:
        rows = jax.lax.map(block, size * jnp.arange(blocks))
    else:
        # Every device gets as many blocks; the surplus repeats the last match.
        share = -(-blocks // jax.lax.axis_size(axis))
        mine = share * jax.lax.axis_index(axis) + jnp.arange(share)
        rows = jax.lax.all_gather(jax.lax.map(block, size * mine), axis, tiled=True)
    flat = jnp.moveaxis(rows, 1, -1).reshape(-1, rows.shape[1])[:num]
    sizes = [leaf.shape[0] for leaf in jax.tree.leaves(like)]
    ends = [sum(sizes[: k + 1]) for k in range(len(sizes))]
    parts = [flat[:, end - n : end] for n, end in zip(sizes, ends)]
    statistics = jax.tree.unflatten(jax.tree.structure(like), parts)
    if watch is None:
        return statistics
    return statistics, jax.lax.bitcast_convert_type(flat[:, ends[-1] :], jnp.float32)


def num_blocks(num: int) -> int:
    """Into how many blocks `num` matches are cut: as many devices can share them."""
    return -(-num // (_BLOCK if jax.default_backend() == "cpu" else _BLOCK_ELSEWHERE))


def _alone(match: Any) -> bool:
    return getattr(match, "vivid", False) and jax.default_backend() == "cpu"


def _last_state(match, home, away, seeds, steps, each, watch):
    state = match.reset(kickoffs(seeds), seeds)
    memory = begin(match, home, away, state, each)
    look = (lambda state: 0.0) if watch is None else lambda state: watch(match, state)

    def step(carry, _):
        both, watched = carry
        both = control_step(match, home, away, both, each)[0]
        return (both, watched + look(both[0])), None

    first = jax.tree.map(jnp.zeros_like, look(state))
    ((state, _), watched), _ = jax.lax.scan(step, ((state, memory), first), None, length=steps)
    return state, watched


_ONE = (False, False)


def begin(
    match: Any, home: Side, away: Side, state: Any, each: tuple[bool, bool] = _ONE
) -> tuple[Any, Any]:
    """Memories of both teams' robots at a kick-off.

    Args:
        match: the match.
        home: a team.
        away: the other.
        state: of the match, leaves [..., B].
        each: as of `play`.

    Returns:
        Of home and of away, leaves [..., N B].
    """
    poses = match.truth_batch(state).pose
    shirts = jnp.arange(match.players, dtype=jnp.int32)
    return tuple(
        jax.vmap(side.begin, in_axes=(-1 if own else None, -1, -1), out_axes=-1)(
            _spread(side.team, match, poses) if own else side.team,
            jnp.repeat(shirts, poses.shape[-1]),
            _of_team(poses, match, k),
        )
        for k, (side, own) in enumerate(zip((home, away), each))
    )  # type: ignore[return-value]


def control_step(match: Any, home: Side, away: Side, carry: Any, each: tuple[bool, bool] = _ONE):
    """One control step of a batch, in which both teams act.

    Robots and matches are one flat axis, the last, for the teams: their inner loops then run over
    contiguous numbers.

    Args:
        match: the match.
        home: a team.
        away: the other.
        carry: (state, memories of both teams).
        each: as of `play`.

    Returns:
        The new carry, and the actions of all robots, leaves [..., R, B].
    """
    memories, action = decide(match, home, away, carry, each)
    return (match.step_batch(carry[0], action), memories), action


def decide(match: Any, home: Side, away: Side, carry: Any, each: tuple[bool, bool] = _ONE):
    """What both teams make of a batch's states: memories, and the action of all robots.

    Robots and matches are one flat axis, the last, for the teams: their inner loops then run over
    contiguous numbers."""
    state, memories = carry
    sides = (home, away)
    truth = match.truth_batch(state) if any(s.truth or s.both for s in sides) else None
    senses = match.sense_batch(state) if any(s.both or not s.truth for s in sides) else None
    after, actions = [], []
    for k, (side, own) in enumerate(zip(sides, each)):
        given = (senses, truth) if side.both else truth if side.truth else senses
        given = jax.tree.map(lambda a, k=k: _of_team(a, match, k), given)
        team = _spread(side.team, match, state.robots.x) if own else side.team
        memory, action = jax.vmap(side.control, in_axes=(-1 if own else None, -1, -1), out_axes=-1)(
            team, memories[k], given
        )
        after.append(memory)
        actions.append(action)
    # Where robots say sounds, a team that knows words only is silent.
    longest = max((action.say for action in actions), key=len)
    actions = [
        action if len(action.say) == len(longest) else action._replace(say=0 * longest)
        for action in actions
    ]
    shape = state.robots.x.shape[1:]
    return tuple(after), jax.tree.map(lambda a, b: _joined(a, b, match, shape), *actions)


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
    """One match with everything that a viewer wants; the same match as `play` of that seed.

    Args:
        match: the match.
        home: a team.
        away: the other.
        seed: of the match.
        num_steps: control steps; None until it is over.
    """
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


def applied(
    match: Any, home: Side, away: Side, seeds: Int[Array, " M"], num_steps: int | None = None
) -> Int[Array, "roles rules"]:
    """How often each of the home team's rules decided, by the robot's role at that moment.

    Counted in control steps of all its robots on the field in matches of these seeds."""
    steps = match.steps if num_steps is None else num_steps
    state = match.reset(kickoffs(seeds), seeds)
    assert home.believe is not None
    roles, rules = jnp.arange(len(home.words.roles)), jnp.arange(len(home.words.rules))
    believe = jax.vmap(partial(home.believe, home.team), in_axes=-1)

    def step(carry, _):
        (state, memories), counts = carry
        carry, _ = control_step(match, home, away, (state, memories))
        belief = believe(carry[1][0])
        on = state.robots.out[: match.players].reshape(-1) <= 0
        role = (belief.role[:, None] == roles) & on[:, None]
        rule = belief.rule[:, None] == rules
        counts += (role[:, :, None] & rule[:, None, :]).sum(0)
        return (carry, counts), None

    zero = jnp.zeros((len(roles), len(rules)), jnp.int32)
    carry = (state, begin(match, home, away, state))
    return jax.lax.scan(step, (carry, zero), None, length=steps)[0][1]
