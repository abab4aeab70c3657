"""The soccer field: walls, disc obstacles, a rolling ball, and bearings to them.

Everything here is elementwise arithmetic on scalars, so that under `vmap` XLA turns it into
straight vector code; nothing indexes, sorts or branches.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from envs.base import Field, Landmark, Scalar, arctan

# The Sony legged league's field of 2001.  Size, goals and landmarks: paper, Introduction;
# Gutmann and Fox 2002.  Pink is above where y > 0; the other colour is the near goal's, green in
# the middle.
FIELD = Field(
    length=2.8,
    width=1.8,
    goal_width=0.6,
    goal_depth=0.3,
    ball_radius=0.042,
    landmarks=(
        Landmark("yellow/pink", 1.5, 1.0, "yellow", "pink"),
        Landmark("green/pink", 0.0, 1.0, "green", "pink"),
        Landmark("skyblue/pink", -1.5, 1.0, "skyblue", "pink"),
        Landmark("pink/yellow", 1.5, -1.0, "pink", "yellow"),
        Landmark("pink/green", 0.0, -1.0, "pink", "green"),
        Landmark("pink/skyblue", -1.5, -1.0, "pink", "skyblue"),
    ),
)


class Disc(NamedTuple):
    """An obstacle: centre and radius (m), velocity (m/s) or None where it stands still."""

    x: Scalar
    y: Scalar
    radius: Scalar
    vx: Scalar | None = None
    vy: Scalar | None = None


class Ball(NamedTuple):
    """Ball centre (m) and velocity (m/s), None where it lies still."""

    x: Scalar
    y: Scalar
    vx: Scalar | None = None
    vy: Scalar | None = None


@jax.custom_jvp
def bearing(x: Scalar, y: Scalar) -> Scalar:
    """Direction of the vector (x, y) in radians, counter-clockwise from x, in [-pi, pi].

    atan2 with its arguments in reading order.  XLA does not vectorise atan2 on CPU, so in
    float32 a polynomial stands in for it (error below 4e-7 rad, less than one rounding of pi
    more than the library's); float64 uses the library's.  bearing(0, 0) = 0, with gradient 0.

    Args:
        x: m, or any unit that y has; of any shape.
        y: the same.
    """
    if jnp.result_type(x, y) == jnp.float64:
        return jnp.arctan2(y, x)
    ax, ay = jnp.abs(x), jnp.abs(y)
    big = jnp.maximum(jnp.maximum(ax, ay), jnp.float32(1e-30))
    angle = arctan(jnp.minimum(ax, ay) / big)
    angle = jnp.where(ay > ax, jnp.float32(math.pi / 2) - angle, angle)
    angle = jnp.where(x < 0, jnp.float32(math.pi) - angle, angle)
    return jnp.where(y < 0, -angle, angle)


@bearing.defjvp
def _bearing_jvp(primals, tangents):
    (x, y), (dx, dy) = primals, tangents
    return bearing(x, y), (x * dy - y * dx) / jnp.maximum(x * x + y * y, 1e-12)


def distance(x: Scalar, y: Scalar) -> Scalar:
    """Length of (x, y); the gradient at the origin is 0, not NaN.

    Args:
        x: m, of any shape.
        y: m.
    """
    return jnp.sqrt(jnp.maximum(x * x + y * y, 1e-20))


def nearest_obstacle(
    x: Scalar, y: Scalar, discs: Sequence[Disc], field: Field = FIELD
) -> tuple[Scalar, Scalar, Scalar]:
    """Distance from a point to the nearest disc or wall surface, and a vector towards it.

    The distance is negative inside a disc or outside the field.  The vector has no particular
    length; it points along a wall's outward normal or at a disc's centre, so that its
    direction does not jump when a surface is crossed.  The nearest of two equally near
    surfaces is the wall, then the first disc.

    Args:
        x: m, field's frame.
        y: m.
        discs: obstacles.
        field: whose walls.

    Returns:
        The distance, m, and the vector's x and y.
    """
    to_x = 0.5 * field.length - jnp.abs(x)
    to_y = 0.5 * field.width - jnp.abs(y)
    x_wall = to_x < to_y
    d = jnp.minimum(to_x, to_y)
    zero = jnp.zeros_like(d)
    ux = jnp.where(x_wall, jnp.where(x < 0, -1.0, 1.0).astype(d.dtype), zero)
    uy = jnp.where(x_wall, zero, jnp.where(y < 0, -1.0, 1.0).astype(d.dtype))
    for disc in discs:
        dx, dy = disc.x - x, disc.y - y
        to_disc = distance(dx, dy) - disc.radius
        nearer = to_disc < d
        d = jnp.where(nearer, to_disc, d)
        ux, uy = jnp.where(nearer, dx, ux), jnp.where(nearer, dy, uy)
    return d, ux, uy


def _reflect(p: Scalar, v: Scalar, half: Scalar) -> tuple[Scalar, Scalar]:
    """Fold a coordinate back into [-half, half] and turn its velocity where it was beyond."""
    beyond = jnp.abs(p) > half
    p = jnp.where(beyond, jnp.sign(p) * 2 * half - p, p)
    # Only an outward velocity turns: a ball that starts in the wall must not oscillate there.
    return p, jnp.where(beyond & (v * p > 0), -v, v)


def roll_ball(ball: Ball, dt: Scalar, deceleration: Scalar, field: Field = FIELD) -> Ball:
    """The ball after a time: constant deceleration until it stops, elastic walls.

    Exact between bounces; a ball without velocity is returned as it is.

    Args:
        ball: before.
        dt: s.
        deceleration: m/s^2, > 0.
        field: whose walls.
    """
    if ball.vx is None or ball.vy is None:
        return ball
    speed = distance(ball.vx, ball.vy)
    lost = jnp.minimum(deceleration * dt, speed)
    keep = 1 - lost / speed
    # Mean speed over the step; the last, partial step stops where v^2 / 2a says.
    time = jnp.minimum(dt, speed / jnp.maximum(deceleration, 1e-9))
    mean = (1 - 0.5 * lost / speed) * time
    half_x, half_y = 0.5 * field.length - field.ball_radius, 0.5 * field.width - field.ball_radius
    x, vx = _reflect(ball.x + ball.vx * mean, ball.vx * keep, half_x)
    y, vy = _reflect(ball.y + ball.vy * mean, ball.vy * keep, half_y)
    return Ball(x, y, vx, vy)


def move_disc(disc: Disc, dt: Scalar, field: Field = FIELD) -> Disc:
    """The obstacle after a time at constant velocity, turning at the walls.

    Args:
        disc: before; without velocity it is returned as it is.
        dt: s.
        field: whose walls.
    """
    if disc.vx is None or disc.vy is None:
        return disc
    x, vx = _reflect(disc.x + disc.vx * dt, disc.vx, 0.5 * field.length - disc.radius)
    y, vy = _reflect(disc.y + disc.vy * dt, disc.vy, 0.5 * field.width - disc.radius)
    return Disc(x, y, disc.radius, vx, vy)
