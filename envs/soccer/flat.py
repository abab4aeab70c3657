"""Observations and actions of a match as flat vectors, for learners of other libraries."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import Action, Walk
from envs.field import distance
from envs.soccer.match import Match
from envs.soccer.state import KICKOFF, PLAY, State

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


def rewards(
    before: State, after: State, goal: float, progress: float, approach: float = 0.0
) -> Float[Array, " R"]:
    """Of one step, for each robot: `goal` for a goal of its team (minus that of the others);
    `progress` for each metre that the ball comes nearer to the opponents' goal line; `approach` for
    each metre that the robot comes nearer to the ball.  The last two only in open play, not where
    the referee puts something."""
    scored = (after.statistics.goals - before.statistics.goals).astype(jnp.float32)
    n = before.robots.x.shape[0] // 2
    playing = (after.game.phase == PLAY) & (scored.sum() == 0) & (after.game.stuck > 0)
    way = before.game.attack * (after.ball.x - before.ball.x)
    home = goal * (scored[0] - scored[1]) + progress * jnp.where(playing, way, 0.0)
    far, near = (distance(s.ball.x - s.robots.x, s.ball.y - s.robots.y) for s in (before, after))
    walks = (after.robots.out <= 0) & (before.robots.out <= 0)
    nearer = jnp.where((after.game.phase <= KICKOFF) & (scored.sum() == 0) & walks, far - near, 0.0)
    # A robot and a ball that is kicked part by up to 0.3 m in a step; farther ones were placed.
    nearer = jnp.where(jnp.abs(nearer) < 0.3, nearer, 0.0)
    return jnp.concatenate([jnp.full(n, 1.0) * home, jnp.full(n, -1.0) * home]) + approach * nearer
