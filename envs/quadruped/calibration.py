"""Calibration of a walk: what to ask for so that the dog, which slips, walks as wanted.

As real robots do it: a table of walks that were measured (wanted velocity, what had to be asked
for), and the smoothest surface through it, a cubic spline in three dimensions.
"""

import itertools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Calibration(NamedTuple):
    """The table and its spline.  scale: half axes of the ellipsoid of velocities that it covers
    (m/s, m/s, rad/s), the unit of everything else.  rows: [R, 6], wanted and asked.  sites:
    [K, 3]; weights: [K, 3] of |x - site|^3; linear: [4, 3] of 1, x."""

    scale: Any
    rows: Any
    sites: Any
    weights: Any
    linear: Any


_MIRROR = np.array([1.0, -1.0, -1.0])
_SMOOTHING = 1e-3


def fit(rows: np.ndarray, scale: np.ndarray) -> Calibration:
    """The spline through a table.  rows: [R, 6], wanted and asked v (m/s), v_y, omega (rad/s);
    every row counts for its mirror image, too, and standing still asks for nothing.

    Source: thin-plate smoothing spline, sum of |x - site|^3 and a linear part.
    """
    scale, rows = np.asarray(scale, float), np.asarray(rows, float)
    both = np.concatenate([rows, rows * np.tile(_MIRROR, 2), np.zeros((1, 6))])
    sites, index = np.unique(np.round(both[:, :3] / scale, 5), axis=0, return_inverse=True)
    asked = np.zeros_like(sites)
    np.add.at(asked, index, both[:, 3:] / scale)  # a row that is its own mirror image: the mean
    asked /= np.bincount(index)[:, None]
    num = len(sites)
    kernel = np.linalg.norm(sites[:, None] - sites, axis=-1) ** 3
    linear = np.concatenate([np.ones((num, 1)), sites], axis=1)
    system = np.block([[kernel + _SMOOTHING * np.eye(num), linear], [linear.T, np.zeros((4, 4))]])
    solved = np.linalg.solve(system, np.concatenate([asked, np.zeros((4, 3))]))
    weights, linear = solved[:num], solved[num:]
    linear[0] = -(np.linalg.norm(sites, axis=1) ** 3 @ weights)
    return Calibration(*(np.asarray(x, np.float32) for x in (scale, rows, sites, weights, linear)))


def ask(calibration: Calibration, wanted: Float[Array, "3"]) -> Float[Array, "3"]:
    """What to ask for (m/s, m/s, rad/s) so that the dog walks as wanted.

    Outside the ellipsoid: what its surface asks for in that direction, in proportion.
    """
    dtype = wanted.dtype
    scale, _, sites, weights, linear = (jnp.asarray(x, dtype) for x in calibration)
    x = wanted / scale
    far = jnp.sqrt(jnp.maximum(jnp.sum(x * x), 1.0))
    x = x / far
    off = sites - x
    squared = jnp.sum(off * off, axis=1)
    bump = squared * jnp.sqrt(squared + 1e-12)
    return far * scale * (bump @ weights + linear[0] + x @ linear[1:])


def sites(scale: Any) -> np.ndarray:
    """Velocities [56, 3] for a table: 14 directions (others are mirror images), four speeds."""
    directions = [
        d for d in itertools.product((-1, 0, 1), repeat=3) if any(d) and (d[2], d[1]) >= (0, 0)
    ]
    units = np.array(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    radii = np.array([0.2, 0.45, 0.72, 1.0])
    return (radii[:, None, None] * units).reshape(-1, 3) * np.asarray(scale)
