"""Where the head looks: the part of the Vision box that moves it, as in the paper.

It scans until something is known of the ball, then looks to it, with glances at landmarks.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from envs.base import Head
from fntg_jax.robot.geometry import angle, length, unit
from fntg_jax.robot.messages import Pose, Scalar

_SCAN_PERIOD = 3.0  # s: the head's speed allows a full pan in 1.0 s
_GLANCE = 0.7  # s, how long a glance at the landmarks lasts
_UNSURE = 0.10  # rad, of the heading: from here on a glance goes before a ball that is near
_FAR, _NEAR = -0.2, -1.05  # rad, tilts of a scan: floor from 0.4 m on and landmarks; the chest


class Gaze(NamedTuple):
    """time: s since the last glance began; side: +1 or -1, where the next one goes."""

    time: Scalar
    side: Scalar


def begin(shape: tuple[int, ...] = ()) -> Gaze:
    return Gaze(jnp.zeros(shape, jnp.float32), jnp.ones(shape, jnp.float32))


def look_to(x: Scalar, y: Scalar, z: Scalar, neck: Head = Head()) -> tuple[Scalar, Scalar]:
    """Tilt and pan (rad) that bring a point of the body's frame (z above the floor, m) into the
    middle of the picture; the nose's own offset is left out."""
    pan = angle(x - neck.base[0], y)
    flat = jnp.sqrt((x - neck.base[0]) ** 2 + y**2 + 1e-9)
    # The tilt carries the pan: at a pan p the axis tilts by p only in its cosine's part.
    cos, _ = unit(pan)
    tilt = angle(jnp.maximum(flat * jnp.abs(cos), 0.05), z - neck.base[2] - neck.neck)
    return tilt, pan


def look(
    gaze: Gaze,
    fresh: Bool[Array, ""],
    ball: tuple[Scalar, Scalar],
    pose: Pose,
    marks: Float[Array, "L 2"],
    every: Scalar,
    dt: float,
    neck: Head = Head(),
) -> tuple[Gaze, Float[Array, "3"]]:
    """The head's set-points (tilt, pan, roll), and the memory of it.

    fresh: the ball was seen a moment ago; ball: x, y in the robot's frame, m; pose: the robot's;
    marks: x, y of the landmarks in the pose's frame, m; every: s between glances; dt: s.
    """
    time = gaze.time + dt
    begins = time >= every
    time = jnp.where(begins, 0.0, time)
    side = jnp.where(begins, -gaze.side, gaze.side)
    near = ball[0] ** 2 + ball[1] ** 2 < 0.3**2
    glance = fresh & (time < _GLANCE) & ~(near & (pose.sd_heading < _UNSURE))
    # A triangle wave from side to side.
    phase = time / _SCAN_PERIOD
    wave = 4 * jnp.abs(phase - jnp.floor(phase + 0.5)) - 1
    scan = wave * neck.high[1]
    # Far one way, near the way back: a ball before the chest is seen by looking down only.
    sweep = jnp.where(phase - jnp.floor(phase) < 0.5, _FAR, _NEAR)
    tilt, pan = look_to(ball[0], ball[1], jnp.full_like(ball[0], 0.042), neck)
    away = jnp.clip(_landmark(pan, side, pose, marks), neck.low[1], neck.high[1])
    tilt = jnp.where(fresh & ~glance, tilt, jnp.where(glance, -0.05, sweep))
    pan = jnp.where(fresh & ~glance, pan, jnp.where(glance, away, scan))
    head = jnp.stack([tilt, pan, jnp.zeros_like(pan)])
    return Gaze(time, side), head


def _landmark(pan, side, pose, marks):
    """The pan (rad) of a glance: at the landmark nearest to where the head looks, on one side of
    that (+1: left) if there is one within its reach, 0.3 m away at least."""
    c, s = unit(pan)
    best, found = jnp.full_like(pan, -9.0), pan + side
    for mark in marks:
        dx, dy = mark[0] - pose.x, mark[1] - pose.y
        x, y = pose.cos * dx + pose.sin * dy, pose.cos * dy - pose.sin * dx
        far = length(x, y)
        straight = (x * c + y * s) / far  # cosine of the way from here
        other = side * (y * c - x * s) < 0
        worth = straight - jnp.where(other, 0.5, 0.0)
        worth = jnp.where((x < -0.5 * far) | (far < 0.3), -8.0, worth)  # behind, or too near
        found = jnp.where(worth > best, angle(x, y), found)
        best = jnp.maximum(worth, best)
    return found
