"""Exports against a float64 reference that is written from the paper's equations alone.

The reference sums over rules, shares no code with `controller.network` and reads only the
expanded parameters.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import HIGH

NUM_OBSERVATIONS = 20_000
FLOAT64, FLOAT32 = 1e-12, 1e-4  # largest error of v and omega as a share of their limits


class MaxError(NamedTuple):
    """Largest absolute error over the observations: m/s, rad/s."""

    v: float
    omega: float


def observations(num: int = NUM_OBSERVATIONS, seed: int = 0) -> np.ndarray:
    """[num, 4] d_B, d_O (m), theta_B, theta_O (rad), float64 holding float32 values.

    Most are drawn over the field (3.4 m, -0.1 to 0.9 m, both angles all round); the first are
    the corners, with zeros, both ends of the circle and distances that no field holds.  The
    values are those of float32 so that no rounding moves an obstacle from one side to the other.
    """
    rng = np.random.default_rng(seed)
    low, high = (0.0, -0.1, -np.pi, -np.pi), (3.4, 0.9, np.pi, np.pi)
    drawn = rng.uniform(low, high, (num, 4))
    far, angles = (0.0, 0.145, 100.0), (-np.pi, -1e-4, 0.0, 1e-4, np.pi)
    corners = np.array(np.meshgrid(far, far, angles, angles)).reshape(4, -1).T[:num]
    drawn[: len(corners)] = corners
    return drawn.astype(np.float32).astype(np.float64)


def reference(controller: Controller, inputs: np.ndarray) -> np.ndarray:
    """[n, 4] observations to [n, 2] commands (m/s, rad/s), float64, rule by rule."""
    p = controller.params
    d_ball, d_obstacle, theta_ball, theta_obstacle = np.asarray(inputs, np.float64).T

    def sigmoids(x, a, c):
        # Exponents beyond 60 do not occur on the field; they are cut as in the trainer.
        return [1 / (1 + np.exp(np.clip(-a[n] * (x - c[n]), -60, 60))) for n in range(2)]

    variance = np.maximum(p.sigma**2, 1e-10)
    bells = [np.exp(-(theta_obstacle**2) / (2 * s)) for s in variance]
    left = theta_obstacle > 0
    # With three sigmas all labels can vanish; 1e-16 makes that "not influencing", not 0/0.
    sides = [np.where(left, bells[0], 0), np.where(left, 0, bells[1]), 1 - bells[2] + 1e-16]
    sides = [s / sum(sides) for s in sides]
    families = (
        sigmoids(d_ball, p.a_A, p.c_A),
        sigmoids(d_obstacle, p.a_B, p.c_B),
        sigmoids(theta_ball, p.a_C, p.c_C),
        sides,
    )
    total = np.zeros(len(d_ball))
    sums = np.zeros((2, len(d_ball)))
    for i, j, k, l in np.ndindex(2, 2, 2, 3):
        mu = families[0][i] * families[1][j] * families[2][k] * families[3][l]
        total += mu
        sums += mu * np.array([[p.V[i, j, k, l]], [p.Omega[i, j, k, l]]])
    limits = controller.limits
    scale = controller.output == "scale"
    gains = [limits.v_max / HIGH, limits.omega_max / HIGH] if scale else [1.0, 1.0]
    v, omega = np.array(gains)[:, None] * (sums / total + p.bias[:, None])
    return np.stack(
        [
            np.clip(v, limits.v_min, limits.v_max),
            np.clip(omega, -limits.omega_max, limits.omega_max),
        ],
        axis=-1,
    )


def max_error(controller: Controller, commands: Callable[[np.ndarray], np.ndarray]) -> MaxError:
    """Error of a function [n, 4] -> [n, 2] over `observations`; a NaN counts as infinite."""
    inputs = observations()
    error = np.abs(np.asarray(commands(inputs), np.float64) - reference(controller, inputs))
    return MaxError(*(float(x) for x in np.nan_to_num(error, nan=np.inf).max(axis=0)))


def within(controller: Controller, error: MaxError, share: float) -> bool:
    """Whether the error is below that share of the speed limits."""
    limits = controller.limits
    return bool(error.v <= share * limits.v_max and error.omega <= share * limits.omega_max)
