"""Genomes, observations and documents to try things on."""

import json

import numpy as np

from envs.base import Limits
from fntg_jax import export
from fntg_jax.controller.layout import LAYOUTS

FIELD_DIAGONAL = float(np.hypot(2.8, 1.8))
NEAR_ZERO = 5 / 32767  # the 15-bit gene nearest 0

layouts = tuple(LAYOUTS.values())


def random_thetas(layout, num: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-5, 5, (num, layout.num_genes))


def extreme_thetas(layout, num: int, seed: int = 0) -> np.ndarray:
    """Genes at the bounds, around zero and exactly zero, in any mixture."""
    rng = np.random.default_rng(seed)
    values = [-5.0, 5.0, -NEAR_ZERO, NEAR_ZERO, 0.0]
    thetas = rng.choice(values, (num, layout.num_genes))
    thetas[: len(values)] = np.asarray(values)[:, None]
    return thetas


def random_observations(num: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    low, high = [0, -0.1, -np.pi, -np.pi], [FIELD_DIAGONAL, 0.9, np.pi, np.pi]
    return rng.uniform(low, high, (num, 4))


def extreme_observations() -> np.ndarray:
    """All combinations of the ends of what a field can show, and around theta = 0."""
    angles = [-np.pi, -NEAR_ZERO, -1e-30, 0.0, 1e-30, NEAR_ZERO, 1.0, np.pi]
    axes = [0.0, FIELD_DIAGONAL], [-0.2, 0.0, 0.9], [-np.pi, 0.0, np.pi], angles
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 4)


def document(layout, theta, output="scale", limits=None) -> dict:
    """The exported JSON document of a controller, as another program would read it."""
    theta = np.asarray(theta, np.float64)
    controller = export.Controller(layout, theta, output, limits or Limits())
    return json.loads(export.dumps(controller))
