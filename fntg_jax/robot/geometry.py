"""Angles and polar coordinates as arithmetic that compilers turn into vector code.

XLA does not vectorise atan2, sin and cos on a CPU.  All functions are elementwise and take any
shape; float32 error below 1e-6 unless said otherwise.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import arctan

Scalar = Float[Array, ""]


def angle(x: Scalar, y: Scalar) -> Scalar:
    """Direction of (x, y) in rad, counter-clockwise from x, in [-pi, pi]; 0 at the origin."""
    ax, ay = jnp.abs(x), jnp.abs(y)
    t = jnp.minimum(ax, ay) / jnp.maximum(jnp.maximum(ax, ay), 1e-30)
    found = arctan(t)
    found = jnp.where(ay > ax, 0.5 * math.pi - found, found)
    found = jnp.where(x < 0, math.pi - found, found)
    return jnp.where(y < 0, -found, found)


def unit(theta: Scalar) -> tuple[Scalar, Scalar]:
    """(cos, sin) of an angle in rad, exact to 1e-6 within [-3 pi, 3 pi]."""
    # The quarter turn is taken off; Taylor series to degree 9 on [-pi/4, pi/4].
    quarter = jnp.round(theta * (2 / math.pi))
    r = theta - quarter * (0.5 * math.pi)
    s = r * r
    sin = r * (1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72))))
    cos = 1 - s / 2 * (1 - s / 12 * (1 - s / 30 * (1 - s / 56)))
    turn = quarter - 4 * jnp.floor(quarter / 4)
    swap = (turn == 1) | (turn == 3)
    c, s = jnp.where(swap, sin, cos), jnp.where(swap, cos, sin)
    return jnp.where((turn == 1) | (turn == 2), -c, c), jnp.where(turn >= 2, -s, s)


def wrap(theta: Scalar) -> Scalar:
    """An angle brought into [-pi, pi]."""
    return theta - 2 * math.pi * jnp.round(theta / (2 * math.pi))


def length(x: Scalar, y: Scalar) -> Scalar:
    """Length of (x, y); the gradient at the origin is 0, not NaN."""
    return jnp.sqrt(jnp.maximum(x * x + y * y, 1e-12))


def polar(x: Scalar, y: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """(distance, cos, sin) of a point."""
    d = length(x, y)
    return d, x / d, y / d
