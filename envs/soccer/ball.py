"""The ball: it rolls, bounces off walls, posts and bodies, and is kicked by a table.

A control step is cut into sub-steps short enough that the fastest ball moves less than half of
the thinnest body in one of them, so that it can't pass through.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from envs.base import Field, Scalar
from envs.field import distance
from envs.soccer.state import RollingBall, total
from envs.soccer.tables import Rolling
from envs.soccer.trig import turn, unturn

CORNER = 0.02  # m, of a body's box, rounded (assumed)
CHEST = 0.06  # m, half of the width in which the chest takes a ball along (assumed)


class Boxes(NamedTuple):
    """Bodies as the ball meets them, leaves [R]: pose (m; cosine and sine), velocity (m/s, rad/s;
    field's frame), chest, rear and half_width (m), grip (1/s), restitution, on (on the field)."""

    x: Array
    y: Array
    cos: Array
    sin: Array
    vx: Array
    vy: Array
    omega: Array
    chest: Array | float
    rear: Array | float
    half_width: Array
    grip: Array | float
    restitution: Array | float
    on: Bool[Array, " R"]


def keep_in(x: Scalar, y: Scalar, radius: float, field: Field) -> tuple[Scalar, Scalar]:
    """By how much (m) a disc must move so as to be on the field or in a goal.

    The field is a rectangle with two smaller ones, the goals; their posts are corners.
    """
    half_x, half_y = 0.5 * field.length, 0.5 * field.width
    mouth, depth = 0.5 * field.goal_width, field.goal_depth
    ax, ay = jnp.abs(x), jnp.abs(y)
    # Beside the field: walls at y = +-half_y and at the goals' backs.
    py = jnp.minimum(half_y - radius - ay, 0)
    ay = ay + py
    px = jnp.minimum(half_x + depth - radius - ax, 0)
    ax = ax + px
    # The walls beside the mouth: the solid quarter ax > half_x, ay > mouth, with a corner (post).
    gap_x, gap_y = half_x - ax, mouth - ay
    inside = (gap_x <= 0) & (gap_y <= 0)
    out_x, out_y = jnp.maximum(gap_x, 0), jnp.maximum(gap_y, 0)
    gap = distance(out_x, out_y)
    scale = jnp.maximum(radius - gap, 0) / gap
    x_first = gap_x > gap_y  # inside the wall: the nearer way out
    px = px + jnp.where(inside, jnp.where(x_first, gap_x - radius, 0.0), -out_x * scale)
    py = py + jnp.where(inside, jnp.where(x_first, 0.0, gap_y - radius), -out_y * scale)
    return jnp.where(x < 0, -px, px), jnp.where(y < 0, -py, py)


def bounce(ball: RollingBall, px: Scalar, py: Scalar, restitution: float) -> RollingBall:
    """Move a ball out of a wall by (px, py) and turn its velocity there."""
    depth2 = px * px + py * py
    hit = depth2 > 0
    inwards = jnp.minimum(ball.vx * px + ball.vy * py, 0)
    loss = jnp.where(hit, (1 + restitution) * inwards / jnp.where(hit, depth2, 1.0), 0.0)
    return RollingBall(ball.x + px, ball.y + py, ball.vx - loss * px, ball.vy - loss * py)


def roll(ball: RollingBall, dt: float, deceleration: float) -> RollingBall:
    """Constant deceleration until it lies still; exact."""
    speed = distance(ball.vx, ball.vy)
    lost = jnp.minimum(deceleration * dt, speed)
    time = jnp.minimum(dt, speed * (1 / max(deceleration, 1e-9)))
    share = lost / speed
    mean = (1 - 0.5 * share) * time
    keep = 1 - share
    return RollingBall(
        ball.x + ball.vx * mean, ball.y + ball.vy * mean, ball.vx * keep, ball.vy * keep
    )


def contact(ball: RollingBall, boxes: Boxes, radius: float) -> tuple[Any, Any, Any, Any]:
    """How deep (m) the ball is in each body (negative: apart), the outward normal there (body's
    frame) and the ball's y in that frame; each [R]."""
    lx, ly = unturn(ball.x - boxes.x, ball.y - boxes.y, boxes.cos, boxes.sin)
    middle, half = 0.5 * (boxes.chest - boxes.rear), 0.5 * (boxes.chest + boxes.rear)
    cx = lx - middle
    qx, qy = jnp.abs(cx) - (half - CORNER), jnp.abs(ly) - (boxes.half_width - CORNER)
    ox, oy = jnp.maximum(qx, 0), jnp.maximum(qy, 0)
    gap2 = jnp.maximum(ox * ox + oy * oy, 1e-20)
    one = jax.lax.rsqrt(gap2)
    within = (qx <= 0) & (qy <= 0)
    along = qx > qy
    depth = CORNER + radius - jnp.where(within, jnp.maximum(qx, qy), gap2 * one)
    nx = jnp.where(within, jnp.where(along, 1.0, 0.0), ox * one)
    ny = jnp.where(within, jnp.where(along, 0.0, 1.0), oy * one)
    nx, ny = jnp.where(cx < 0, -nx, nx), jnp.where(ly < 0, -ny, ny)
    return jnp.where(boxes.on, depth, -1.0), nx, ny, ly


def sub_step(
    ball: RollingBall, boxes: Boxes, dt: float, rolling: Rolling, field: Field
) -> tuple[RollingBall, Bool[Array, " R"]]:
    """The ball after dt (s) among moving bodies, and which of them it touches, [R]."""
    ball = roll(ball, dt, rolling.deceleration)
    depth, lnx, lny, ly = contact(ball, boxes, field.ball_radius)
    hit = depth > 0
    nx, ny = turn(lnx, lny, boxes.cos, boxes.sin)
    # Velocity of the body's point under the ball; the body is taken as infinitely heavy.
    rx, ry = ball.x - boxes.x, ball.y - boxes.y
    ux = ball.vx - (boxes.vx - boxes.omega * ry)
    uy = ball.vy - (boxes.vy + boxes.omega * rx)
    inwards = jnp.minimum(ux * nx + uy * ny, 0)
    normal = -(1 + boxes.restitution) * inwards
    # The chest takes the ball's sideways motion along.
    held = hit & (lnx > 0.7) & (jnp.abs(ly) < CHEST)
    sideways = ny * ux - nx * uy  # along (ny, -nx)
    side_loss = jnp.where(held, jnp.minimum(boxes.grip * dt, 1.0) * sideways, 0.0)
    change_x = jnp.where(hit, normal * nx, 0.0) - side_loss * ny
    change_y = jnp.where(hit, normal * ny, 0.0) + side_loss * nx
    # The mean over the bodies in contact: no sum of bounces can then add energy.
    one = 1 / jnp.maximum(total(hit.astype(jnp.float32)), 1.0)
    out = jnp.maximum(depth, 0)
    ball = RollingBall(
        ball.x + one * total(out * nx),
        ball.y + one * total(out * ny),
        ball.vx + one * total(change_x),
        ball.vy + one * total(change_y),
    )
    ball = bounce(
        ball, *keep_in(ball.x, ball.y, field.ball_radius, field), rolling.wall_restitution
    )
    return ball, hit
