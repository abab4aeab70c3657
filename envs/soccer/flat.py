"""Observations and actions of a match as flat vectors, for learners of other libraries."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import Action, Walk
from envs.soccer.match import Match
from envs.soccer.state import State

SPEEDS = (0.3, 0.1, 1.5)  # m/s, m/s, rad/s of a full v, v_y, omega


def width(match: Match) -> int:
    """Numbers of one observation."""
    return 9 + 2 * match.robots


def observe(match: Match, state: State) -> Float[Array, "R width"]:
    """The truth in each robot's team's frame; see `envs.soccer.pettingzoo`."""
    truth = match.truth(state)
    x, y, heading = truth.pose[:, 0], truth.pose[:, 1], truth.pose[:, 2]
    own = jnp.stack([x, y, jnp.cos(heading), jnp.sin(heading)], -1)
    plays = (truth.signal <= 2).astype(jnp.float32)[:, None]
    return jnp.concatenate([own, truth.ball, truth.robots.reshape(match.robots, -1), plays], -1)


def act(match: Match, actions: Float[Array, "R 6"]) -> Action:
    """Six numbers in [-1, 1] a robot as an action; see `envs.soccer.pettingzoo`."""
    a = jnp.clip(actions, -1, 1)
    none = jnp.zeros(match.robots, jnp.int32)
    postures = match.bodies.home.postures.name
    get_up = postures.index("get-up") + 1 if "get-up" in postures else 0
    pan = 1.5 * a[:, 3]
    return Action(
        Walk(none, *(speed * a[:, k] for k, speed in enumerate(SPEEDS))),
        jnp.stack([-0.3 + 0 * pan, pan, 0 * pan], -1),
        (a[:, 4] > 0).astype(jnp.int32),
        jnp.where(a[:, 5] > 0, get_up, 0).astype(jnp.int32),
        jnp.zeros((match.robots, 2), jnp.uint32),
    )


def rewards(before: State, after: State, goal: float, progress: float) -> Float[Array, " R"]:
    """Goals, and the ball's way (m) to the opponents' goal where no goal fell."""
    scored = (after.statistics.goals - before.statistics.goals).astype(jnp.float32)
    n = before.robots.x.shape[0] // 2
    way = before.game.attack * (after.ball.x - before.ball.x)
    way = jnp.where((after.game.phase == 0) & (scored.sum() == 0), way, 0.0)
    home = goal * (scored[0] - scored[1]) + progress * way
    return jnp.concatenate([jnp.full(n, 1.0) * home, jnp.full(n, -1.0) * home])
