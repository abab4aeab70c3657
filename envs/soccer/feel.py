"""Senses of the body: odometry, the head's infrared sensor, gyroscope, accelerometer."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from envs.base import Field, Head
from envs.soccer import noise
from envs.soccer.bodies import BIAS
from envs.soccer.camera import eye, neck
from envs.soccer.state import State, upright
from envs.soccer.tables import Feelings

FIRST_CHANNEL = 130  # of a robot's noise in a step
GRAVITY = 9.81
REACH = 0.11  # m, radius of the disc that stands for a robot before the infrared beam (assumed)


def displacement(state: State) -> Array:
    """dx, dy (m), turn (rad) of the last step as odometry has it, [3, R]."""
    r = state.robots
    return jnp.stack([r.odometry_x, r.odometry_y, r.odometry_turn])


def proximity(
    state: State,
    field: Field,
    head: Head,
    height: Any,
    feelings: Feelings,
    key: Array,
    perfect: bool,
) -> Array:
    """Distance along the camera's axis to the floor, a wall, the ball or a robot, m, [R], within
    the sensor's range."""
    r = state.robots
    (ct, st), (cp, sp), _ = neck(state)
    x, y, z = eye(state, head)
    # The axis in the body's frame, then in the field's: undoes `camera.to_camera`.
    ahead, left, up = ct * cp, sp, st * cp
    ux, uy = r.cos * ahead - r.sin * left, r.sin * ahead + r.cos * left
    far = feelings.proximity_high
    most = jnp.full_like(x, far)
    falls = jnp.minimum(up, -1e-3)
    nearest = jnp.where(up < -1e-3, z / -falls, most)  # floor
    # Walls: planes as high as the field says.
    for u, p, half in ((ux, x, 0.5 * field.length), (uy, y, 0.5 * field.width)):
        t = (half - jnp.abs(p) * jnp.where(u * p < 0, -1.0, 1.0)) / jnp.maximum(jnp.abs(u), 1e-3)
        hit = (z + up * t < field.wall_height) & (t > 0)
        nearest = jnp.minimum(nearest, jnp.where(hit, t, most))
    # The ball, a sphere.
    gx, gy, gz = state.ball.x - x, state.ball.y - y, field.ball_radius - z
    along = gx * ux + gy * uy + gz * up
    off = gx * gx + gy * gy + gz * gz - along * along
    inside = field.ball_radius**2 - off
    t = along - jnp.sqrt(jnp.maximum(inside, 0))
    nearest = jnp.minimum(nearest, jnp.where((inside > 0) & (along > 0), t, most))
    # Other robots, upright discs as high as they are.
    n = r.x.shape[0]
    flat2 = jnp.maximum(ux * ux + uy * uy, 1e-3)
    for j in range(n):
        gx, gy = r.x[j] - x, r.y[j] - y
        middle = (gx * ux + gy * uy) / flat2
        inside = REACH**2 - (gx * gx + gy * gy - middle * middle * flat2)
        t = middle - jnp.sqrt(jnp.maximum(inside, 0) / flat2)
        hit = (inside > 0) & (t > 0) & (z + up * t < height) & (r.out[j] <= 0)
        hit &= ~upright([k == j for k in range(n)], r.x)
        nearest = jnp.minimum(nearest, jnp.where(hit, t, most))
    if not perfect:
        nearest = nearest + feelings.proximity * noise.normal(key, FIRST_CHANNEL)
    nearest = jnp.where(r.fallen | (r.out > 0), most, nearest)
    return jnp.clip(nearest, feelings.proximity_low, far)


def gyro(
    state: State, feelings: Feelings, key: Array, lane_key: Array, dt: float, perfect: bool
) -> Array:
    """Rates of turn about x, y, z of the body, rad/s, [3, R]."""
    r, hand = state.robots, state.game.hand
    yaw = r.turned * (1 / dt)
    if perfect:
        return jnp.stack([jnp.zeros_like(yaw), jnp.zeros_like(yaw), yaw])
    a, b, c = (feelings.gyro * noise.normal(key, FIRST_CHANNEL + k) for k in (1, 2, 3))
    bias = feelings.gyro_bias * noise.normal(lane_key, BIAS)
    return jnp.stack([hand * a, b, yaw + hand * (c + bias)])


def acceleration(state: State, feelings: Feelings, key: Array, dt: float, perfect: bool) -> Array:
    """What an accelerometer in the body feels, m/s^2, [3, R]: gravity along z when it stands, along
    y when it lies on its side, and its own speeding up."""
    r, hand = state.robots, state.game.hand
    ax, ay = r.gained_x * (1 / dt), r.gained_y * (1 / dt)
    lies = r.fallen
    ax, ay = jnp.where(lies, 0.0, ax), jnp.where(lies, hand * GRAVITY, ay)
    az = jnp.where(lies, 0.0, GRAVITY)
    if perfect:
        return jnp.stack([ax, ay, az])
    a, b, c = (feelings.acceleration * noise.normal(key, FIRST_CHANNEL + k) for k in (4, 5, 6))
    return jnp.stack([ax + a, ay + hand * b, az + c])
