"""`chaser`: sees the truth, takes BIOA to the ball and kicks it ahead.

Of the field players the one nearest to the ball chases, the other keeps its place behind; shirt 0
stands in the goal's mouth, between ball and goal, and chases what comes near.  All numbers: chosen
by hand.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from envs.base import Observation, Truth, Walk
from fntg_jax import export
from fntg_jax.controller import network
from fntg_jax.learning.play import Belief, Side, Words
from fntg_jax.robot.geometry import angle, length, unit, wrap
from fntg_jax.teams.still import stand

BODY = 0.12  # m, radius of the disc that stands for another robot
BEHIND = 0.28  # m, from the ball, where a way round it leads
ALIGNED = 0.6  # rad, how far off the line to the goal it may take the ball
AIM = 0.35  # rad, how far off the mouth's edges it may kick
GUARD = 0.9  # m, the goalkeeper chases a ball that is nearer to its goal


class Chaser(NamedTuple):
    """bioa: behaviour 7, a pytree that maps an observation to (v, omega).  capture: m, from the
    robot's centre to where it has the ball; zone: m, how far that may be off when it kicks;
    goal, wall: m, half of the field's length, width and of the mouth; kick, get_up: 1 + index into
    the body's tables, 0 for none."""

    bioa: Callable[[Observation], Any]
    capture: Float[Array, ""]
    zone: Float[Array, "4"]
    half: Float[Array, "3"]
    kick: Int[Array, ""]
    get_up: Int[Array, ""]


BEHAVIORS = ("hold place", "to the ball", "round the ball", "kick")


class Memory(NamedTuple):
    """shirt: 0, 1, ...; behavior: index into BEHAVIORS."""

    shirt: Int[Array, ""]
    behavior: Int[Array, ""]


def make(match: Any, side: int) -> Side:
    """The team for a match (its bodies' tables and field) on a side, 0 home or 1 away."""
    body, field = match.bodies[side], match.field
    controller = export.load(export.shipped("bioa"))
    params = jax.tree.map(lambda a: np.asarray(a, np.float32), controller.params)
    team = Chaser(
        bioa=jax.tree_util.Partial(_BIOA[controller.output], params, controller.limits),
        capture=jnp.float32(body.chest + field.ball_radius + 0.003),
        zone=jnp.asarray(body.kicks.zone[0] if body.kicks.name else (9, 9, 9, 9), jnp.float32),
        half=jnp.asarray([field.length / 2, field.width / 2, field.goal_width / 2], jnp.float32),
        kick=jnp.int32(1 if body.kicks.name else 0),
        get_up=jnp.int32(
            body.postures.name.index("get-up") + 1 if "get-up" in body.postures.name else 0
        ),
    )
    return Side(
        "chaser", team, _begin, _control, truth=True, believe=_believe, words=Words((), BEHAVIORS)
    )


# Named once: a function made anew at every call would be compiled anew.
_BIOA: dict[str, Callable[..., Any]] = {
    "scale": lambda params, limits, seen: network.command(params, seen, limits, "scale"),
    "clip": lambda params, limits, seen: network.command(params, seen, limits, "clip"),
}


def _begin(team, shirt, pose):
    return Memory(shirt, jnp.zeros((), jnp.int32))


def _control(team: Chaser, memory: Memory, truth: Truth):
    x, y, heading = truth.pose[0], truth.pose[1], truth.pose[2]
    ball_x, ball_y = truth.ball[0], truth.ball[1]
    half_x, half_y, mouth = team.half[0], team.half[1], team.half[2]
    num = truth.robots.shape[0]
    shirt = memory.shirt

    # Who chases: the field player nearest to the ball, or the goalkeeper when the ball is near it.
    mine = length(ball_x - x, ball_y - y)
    nearest = jnp.ones((), bool)
    for mate in range(1, num // 2):
        d = length(ball_x - truth.robots[mate, 0], ball_y - truth.robots[mate, 1])
        d = jnp.where(truth.on[mate], d, jnp.inf)
        nearest &= (mate == shirt) | (mine < d) | ((mine == d) & (shirt < mate))
    keeper = shirt == 0
    danger = length(ball_x + half_x, ball_y) < GUARD
    chases = jnp.where(keeper, danger if num > 2 else True, nearest)

    # Round the ball, until it lies between robot and goal; then to it.
    goal_x, goal_y = half_x + 0.1, jnp.clip(ball_y, -0.5 * mouth, 0.5 * mouth)
    to_goal = length(goal_x - ball_x, goal_y - ball_y)
    gx, gy = (goal_x - ball_x) / to_goal, (goal_y - ball_y) / to_goal
    along = (ball_x - x) * gx + (ball_y - y) * gy
    aside = (ball_x - x) * gy - (ball_y - y) * gx
    aligned = (along > 0.0) & (jnp.abs(aside) < ALIGNED * along + 0.03)
    # Beside the ball first where it is in the way.
    detour = jnp.where(along < 0.05, jnp.where(aside > 0, -BEHIND, BEHIND), 0.0)
    around_x = ball_x - BEHIND * gx + detour * gy
    around_y = ball_y - BEHIND * gy - detour * gx
    around_x = jnp.clip(around_x, 0.1 - half_x, half_x - 0.1)
    around_y = jnp.clip(around_y, 0.1 - half_y, half_y - 0.1)
    post_x = jnp.where(keeper, 0.15 - half_x, jnp.minimum(ball_x - 0.7, 0.6))
    post_y = jnp.where(keeper, jnp.clip(0.4 * ball_y, -mouth + 0.05, mouth - 0.05), -0.6 * ball_y)
    target_x = jnp.where(chases, jnp.where(aligned, ball_x, around_x), post_x)
    target_y = jnp.where(chases, jnp.where(aligned, ball_y, around_y), post_y)

    c, s = unit(heading)
    # d_B: from the point ahead that has the ball; other targets are reached with the centre.
    dx, dy = target_x - x, target_y - y
    ahead, left = c * dx + s * dy, c * dy - s * dx
    reach = jnp.where(chases & aligned, team.capture, 0.0)
    theta_o, d_o = _nearest_obstacle(team, truth, x, y, c, s)
    observation = Observation(
        d_ball=length(ahead - reach, left),
        d_obstacle=d_o,
        theta_ball=angle(ahead, left),
        theta_obstacle=theta_o,
    )
    v, omega = team.bioa(observation)[:2]

    # Kick what lies before the chest when the heading hits the mouth.
    bx, by = ball_x - x, ball_y - y
    lx, ly = c * bx + s * by, c * by - s * bx
    zone = team.zone
    has = (lx > zone[0] + 0.005) & (lx < zone[1] - 0.005)
    has &= (ly > zone[2] + 0.005) & (ly < zone[3] - 0.005)
    aim = wrap(angle(half_x - ball_x, jnp.clip(goal_y, -mouth, mouth) - ball_y) - heading)
    kicks = has & (jnp.abs(aim) < AIM)
    # It has the ball but not the aim: turn towards the goal with it.
    turns = has & ~kicks & chases & aligned
    omega = jnp.where(turns, jnp.clip(2 * aim, -0.8, 0.8), omega)
    v = jnp.where(turns, 0.05, v)
    there = ~chases & (length(dx, dy) < 0.08)
    turn_to_ball = jnp.clip(1.5 * angle(lx, ly), -0.8, 0.8)
    v = jnp.where(there, 0.0, v)
    omega = jnp.where(there, turn_to_ball, omega)
    action = stand()._replace(
        walk=Walk(jnp.zeros((), jnp.int32), v, jnp.zeros((), jnp.float32), omega),
        head=jnp.stack([jnp.float32(-0.3) + 0 * lx, jnp.clip(angle(lx, ly), -1.5, 1.5), 0 * lx]),
        kick=jnp.where(kicks, team.kick, 0),
        posture=jnp.where(truth.upright, 0, team.get_up),
    )
    behavior = jnp.where(kicks, 3, jnp.where(chases, jnp.where(aligned, 1, 2), 0))
    return Memory(shirt, behavior.astype(jnp.int32)), action


def _nearest_obstacle(team, truth, x, y, c, s):
    """theta_O (rad) and d_O (m) of the nearest wall or robot."""
    half_x, half_y = team.half[0], team.half[1]
    to_x, to_y = half_x - jnp.abs(x), half_y - jnp.abs(y)
    d = jnp.minimum(to_x, to_y)
    ux = jnp.where(to_x < to_y, jnp.sign(x), 0.0)
    uy = jnp.where(to_x < to_y, 0.0, jnp.sign(y))
    for k in range(truth.robots.shape[0]):
        dx, dy = truth.robots[k, 0] - x, truth.robots[k, 1] - y
        gap = length(dx, dy)
        # Oneself is among them, at no distance.
        near = truth.on[k] & (gap > 1e-3) & (gap - BODY < d)
        d = jnp.where(near, gap - BODY, d)
        ux, uy = jnp.where(near, dx, ux), jnp.where(near, dy, uy)
    return angle(c * ux + s * uy, c * uy - s * ux), d


def _believe(team, memory):
    nothing = jnp.full((), jnp.nan, jnp.float32)
    none = jnp.full((), -1, jnp.int32)
    return Belief(jnp.full(3, jnp.nan), jnp.full(2, jnp.nan), nothing, none, memory.behavior, none)
