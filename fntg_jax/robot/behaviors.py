"""Table 1: the nine reactive behaviours, each a small pure function of the data that it needs.

All of them take `Need` (distances in m, angles in rad, left positive) and the body's `Speeds`, work
elementwise on any shape, and return a `Motion`.  They choose the walking style (index into
`STYLES`) and say why.  Row 7 is handed in: any callable from the four inputs to (v, omega).

Paper: rows 3, 5 and 9 list no direction of the ball, without which a robot that is not exactly
behind it cannot correct; ours get it.  Rows 2, 4 and 5 are given the distance that remains, which
the Planner keeps up by Locomotion's displacement.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from fntg_jax.robot.messages import Motion, Need, Scalar

# Sony's names of the nine walking styles, in the order of every table of styles.
STYLES = ("DEFAULT", "STABLE", "SLOW", "FAST", "OFFLOAD", "BABY", "LIZARD", "CREEP", "TROT")
DEFAULT, STABLE, SLOW, FAST, OFFLOAD, BABY, LIZARD, CREEP, TROT = range(9)

NAMES = (
    "standing",
    "lateral movement",
    "align with the ball and the goal",
    "go straight",
    "dribble",
    "kick",
    "BIOA",
    "goalkeeper standing",
    "goalkeeper rotates around the ball",
)

Bioa = Callable[[Scalar, Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]

_TURN = 2.0  # 1/s, turning rate for an error of direction
_GAIN = 1.5  # 1/s, speed for an error of distance
BALL_AHEAD = 0.20  # m, distance to the ball at which it is circled: the chest is at 0.10 m, the
# ball's radius 0.042 m, and who stays within 2 cm of a ball that lies holds it, says the referee
_TOUCH = 0.15  # m, distance to a ball at the chest
_STILL = 0.006  # m, an error of distance below which nothing is done about it


class Speeds(NamedTuple):
    """The body's limits by walking style, leaves [9]: v, v_y in m/s, omega in rad/s."""

    v: Float[Array, " styles"]
    v_y: Float[Array, " styles"]
    omega: Float[Array, " styles"]


def _motion(like: Scalar, style: int, v=0.0, v_y=0.0, omega=0.0, kick=0, posture=0) -> Motion:
    """A motion whose fields all have the shape of `like`."""
    shape = jnp.shape(like)
    of = lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), shape)  # noqa: E731
    index = lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.int32), shape)  # noqa: E731
    return Motion(of(v), of(v_y), of(omega), index(style), index(kick), index(posture))


def _towards(error: Scalar, most: Scalar) -> Scalar:
    """Speed that brings an error of distance (m) to 0: proportional, at most `most`, 0 when near.

    A body that follows with a lag stops short of overshooting as the speed falls with the error.
    """
    speed = jnp.clip(_GAIN * error, -most, most)
    return jnp.where(jnp.abs(error) < _STILL, 0.0, speed)


def standing(need: Need, speeds: Speeds) -> Motion:
    """Row 1: stand still.  STABLE: the widest stance."""
    return _motion(need.distance, STABLE)


def lateral(need: Need, speeds: Speeds) -> Motion:
    """Row 2: move sideways by D = `need.distance` (m): D > 0 to the right, D < 0 to the left.

    DEFAULT: the style with the best tracking sideways.
    """
    v_y = -_towards(need.distance, speeds.v_y[DEFAULT])
    return _motion(need.distance, DEFAULT, v_y=v_y)


def align(need: Need, speeds: Speeds) -> Motion:
    """Row 3: circle around the ball until ball and goal lie ahead, one behind the other.

    Needs d_ball, goal (theta_g) and, beyond the table, ball.  The ball is kept ahead by turning;
    the robot steps to the right while the goal lies to the left, and the other way about.
    DEFAULT: sideways and turning at once.
    """
    return _circle(need, speeds, BALL_AHEAD)


def _circle(need, speeds, radius):
    most = speeds.v_y[DEFAULT]
    far = jnp.maximum(need.d_ball, 0.1)
    v_y = jnp.clip(-_GAIN * far * need.goal, -most, most)
    # No stepping around a ball that is not in front yet.
    facing = jnp.maximum(0.0, 1 - jnp.abs(need.ball))
    # Nor around one at the chest, which that would push away.
    v_y = v_y * facing * jnp.clip((need.d_ball - _TOUCH) / 0.03, 0.0, 1.0)
    limit = speeds.omega[DEFAULT]
    omega = jnp.clip(_TURN * need.ball - v_y / far, -limit, limit)
    v = jnp.clip(_GAIN * (need.d_ball - radius), -0.5 * speeds.v[DEFAULT], speeds.v[DEFAULT])
    return _motion(need.d_ball, DEFAULT, v * facing, v_y, omega)


def straight(need: Need, speeds: Speeds) -> Motion:
    """Row 4: go straight on by D = `need.distance` (m), backwards where D < 0.  DEFAULT."""
    return _motion(need.distance, DEFAULT, v=_towards(need.distance, speeds.v[DEFAULT]))


def dribble(need: Need, speeds: Speeds) -> Motion:
    """Row 5: push the ball on by D = `need.distance` (m) with the chest, towards the goal.

    Needs, beyond the table, ball and goal: the robot steps sideways behind the ball and turns to
    the goal.  DEFAULT and not the fastest style: the ball must not roll ahead.
    """
    style = DEFAULT
    limit = speeds.omega[style]
    # The ball to the left of the heading needs a step to the left; its offset is d sin(angle).
    offset = need.d_ball * jnp.clip(need.ball, -1.0, 1.0)
    v_y = jnp.clip(3 * _GAIN * offset, -speeds.v_y[style], speeds.v_y[style])
    omega = jnp.clip(_TURN * (0.75 * need.goal + 0.25 * need.ball), -limit, limit)
    ahead = jnp.maximum(0.2, 1 - 3.0 * jnp.abs(need.ball))
    v = jnp.clip(_GAIN * need.distance, 0.0, speeds.v[style]) * ahead
    return _motion(need.d_ball, style, v, v_y, omega)


def kick(need: Need, speeds: Speeds) -> Motion:
    """Row 6: kick with `need.kick`, an index into the body's table of kicks.  STABLE."""
    return _motion(need.d_ball, STABLE, kick=1 + need.kick)


def bioa(need: Need, speeds: Speeds, trajectory: Bioa) -> Motion:
    """Row 7: intercept the ball and avoid the obstacle; `trajectory` is the trained controller.

    DEFAULT and not FAST, which a push fells.
    """
    v, omega = trajectory(need.d_ball, need.d_obstacle, need.ball, need.obstacle)
    # Where the body cannot follow it goes the same way slower, instead of another one.
    over = jnp.maximum(jnp.abs(v) / speeds.v[DEFAULT], jnp.abs(omega) / speeds.omega[DEFAULT])
    slower = 1 / jnp.maximum(over, 1.0)
    return _motion(need.d_ball, DEFAULT, v * slower, omega=omega * slower)


def goalkeeper(need: Need, speeds: Speeds) -> Motion:
    """Row 8: stand in the goal, step to the side where the ball will come in, face the ball.

    `need.distance`: how far to the right the ball will cross the robot's line, m.  Paper: the row
    lists no data; without any a keeper saves only what is shot at it.
    """
    v_y = jnp.clip(-2 * _GAIN * need.distance, -speeds.v_y[DEFAULT], speeds.v_y[DEFAULT])
    limit = 0.5 * speeds.omega[DEFAULT]
    omega = jnp.clip(_TURN * need.ball, -limit, limit)
    omega = jnp.where(jnp.abs(need.ball) < 0.25, 0.0, omega)
    return _motion(need.distance, DEFAULT, v_y=v_y, omega=omega)


def rotate(need: Need, speeds: Speeds) -> Motion:
    """Row 9: the goalkeeper rotates around the ball to face the opposite goal (theta_g).

    As row 3, from a little further off: the own goal is behind.
    """
    return _circle(need, speeds, BALL_AHEAD + 0.03)


def act(behavior: Array, need: Need, speeds: Speeds, trajectory: Bioa) -> Motion:
    """The motion of behaviour 1 to 9 (an index of any shape): all are computed, one is taken."""
    motions = [
        standing(need, speeds),
        lateral(need, speeds),
        align(need, speeds),
        straight(need, speeds),
        dribble(need, speeds),
        kick(need, speeds),
        bioa(need, speeds, trajectory),
        goalkeeper(need, speeds),
        rotate(need, speeds),
    ]
    found = motions[0]
    for number, motion in enumerate(motions[1:], start=2):
        found = Motion(*(jnp.where(behavior == number, b, a) for a, b in zip(found, motion)))
    return found
