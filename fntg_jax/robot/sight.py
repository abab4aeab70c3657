"""Vision at the objects level: camera frame and head joints -> objects in the robot's frame.

What `vision` finds in a picture arrives here, too: bearings, elevations and sizes of objects.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import SEEN, Camera, Frame, Head
from fntg_jax.robot.geometry import length, unit
from fntg_jax.robot.messages import Scalar, Seen

_PIXEL = Camera().horizontal / Camera().width  # rad
_SIZE_NOISE = 1.0  # pixels, of an object's edges together (facts: beyond 2 m a pixel is 0.3-0.6 m)
_LEVEL_NOISE = 0.02  # rad, of elevation: the trunk sways (assumed)
_AGREE = 2.0  # ratio of the distances by size and by elevation beyond which a sighting is false
_BIAS = 0.05  # of the distance, what is left at any range


class Sizes(NamedTuple):
    """What Vision knows of the objects, [K] in the order of `envs.base.SEEN`: m.

    size: the extent that `Frame.size` is the angle of; height: of the centre above the floor.
    """

    size: Float[Array, " K"]
    height: Float[Array, " K"]


def rotation(head: Float[Array, "3"]) -> tuple[tuple[Scalar, ...], ...]:
    """Rows of the matrix that turns camera coordinates (x ahead, y left, z up) into the body's.

    head: tilt (up positive), pan (left positive), roll, rad: tilt carries pan, pan carries roll.
    """
    (ct, st), (cp, sp), (cr, sr) = unit(head[0]), unit(head[1]), unit(head[2])
    # R = R_y(-tilt) R_z(pan) R_x(roll)
    z = ((cp, -sp * cr, sp * sr), (sp, cp * cr, -cp * sr), (0 * sr, sr, cr))
    return (
        tuple(ct * a - st * b for a, b in zip(z[0], z[2])),
        z[1],
        tuple(st * a + ct * b for a, b in zip(z[0], z[2])),
    )


def camera_place(head: Float[Array, "3"], neck: Head = Head()) -> tuple[Scalar, Scalar, Scalar]:
    """The camera in the body's frame (z above the floor), m."""
    (ct, st), (cp, sp) = unit(head[0]), unit(head[1])
    # From the tilt axis up the neck, then ahead along the nose, both carried by tilt.
    x, z = neck.nose * cp, jnp.full_like(cp, neck.neck)
    return (
        neck.base[0] + ct * x - st * z,
        neck.base[1] + neck.nose * sp,
        neck.base[2] + st * x + ct * z,
    )


def locate(frame: Frame, head: Float[Array, "3"], sizes: Sizes, neck: Head = Head()) -> Seen:
    """Distances along the floor and directions of what was found.

    The distance follows from the size and, where the ray meets the object's height steeply enough,
    from the elevation; the two are weighted by their variances.
    """
    (cb, sb), (ce, se) = unit(frame.bearing), unit(frame.elevation)
    ray = (ce * cb, ce * sb, se)
    rows = rotation(head)
    dx, dy, dz = (r[0] * ray[0] + r[1] * ray[1] + r[2] * ray[2] for r in rows)
    cx, cy, cz = camera_place(head, neck)
    shape = (-1, *(1,) * (frame.size.ndim - 1))
    size, height = sizes.size.reshape(shape), sizes.height.reshape(shape)
    flat = length(dx, dy)
    # By size: the chord of the angle.  half / sin(size / 2), along the ray.
    _, half = unit(0.5 * jnp.maximum(frame.size, 1e-3))
    by_size = 0.5 * size / half * flat
    noise_size = by_size * (_SIZE_NOISE * _PIXEL / jnp.maximum(frame.size, _PIXEL) + _BIAS)
    # By elevation: where the ray reaches the height of the object's centre.
    drop = height - cz
    slope = dz / flat
    steep = jnp.where(drop * slope > 0, jnp.abs(slope), 0.0)
    by_floor = jnp.clip(jnp.abs(drop) / jnp.maximum(steep, 0.02), 0.05, 5.0)
    noise_floor = by_floor**2 / jnp.maximum(jnp.abs(drop), 0.02) * _LEVEL_NOISE + _BIAS * by_floor
    weight_size, weight_floor = 1 / noise_size**2, jnp.where(steep > 0.02, 1 / noise_floor**2, 0.0)
    total = weight_size + weight_floor
    distance = (weight_size * by_size + weight_floor * by_floor) / total
    # From the camera to the robot's centre.
    x, y = cx + distance * dx / flat, cy + distance * dy / flat
    far = length(x, y)
    spread = 1 / jnp.sqrt(total) / jnp.maximum(far, 0.05)
    # What is not about as large as its place on the floor says is not what it seems to be.
    agrees = (by_size < _AGREE * by_floor) & (by_floor < _AGREE * by_size)
    return Seen(far, x / far, y / far, frame.visible & (agrees | (steep < 0.04)), spread)


def sizes_of(ball_radius: float, landmark_foot: float, band: float, goal_height: float) -> Sizes:
    """`Sizes` from the field's map (m) and the ERS-210's body."""
    ball = (2 * ball_radius, ball_radius)
    landmark = (2 * band, landmark_foot + band)
    goal = (goal_height, 0.5 * goal_height)
    robot = (0.22, 0.1)  # between its length and its width
    rows = [
        ball
        if name == "ball"
        else landmark
        if name.startswith("landmark")
        else goal
        if name.startswith("goal")
        else robot
        for name in SEEN
    ]
    size, height = jnp.asarray(rows, jnp.float32).T
    return Sizes(size, height)
