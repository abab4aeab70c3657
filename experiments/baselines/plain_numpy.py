"""The paper preset's fitness in NumPy, written plainly from the paper.

Trials are the last axis of every array; a loop over the 220 control steps is all that Python
does.  In float64 it is what every contestant's fitness is compared with.
"""

from typing import Any

import numpy as np


def fitness(theta: np.ndarray, scenes: Any, dtype: Any = np.float32, dt: float = 0.1) -> np.ndarray:
    """F [P] of theta [P, 31] (layout paper-31) on T scenes with one obstacle."""
    num, trials = len(theta), len(scenes.start)
    genes = np.repeat(theta.astype(dtype), trials, axis=0).T  # [31, P * T]

    def of_trials(x):
        return np.tile(np.asarray(x, dtype), (num, 1)).T

    x, y, heading = of_trials(scenes.start)
    ball_x, ball_y = of_trials(scenes.ball)
    disc_x, disc_y, radius = of_trials(scenes.obstacles[:, 0])
    V, Omega = rule_tables(genes)
    half_length, half_width = dtype(1.4), dtype(0.9)
    clearance, v_peak = np.full_like(x, np.inf), np.full_like(x, -np.inf)
    distances, vs, omegas = [], [], []

    def nearest(x, y):
        """d_O, and the vector to the nearest point of a wall or to the obstacle's centre."""
        to_x, to_y = half_length - np.abs(x), half_width - np.abs(y)
        dx, dy = disc_x - x, disc_y - y
        to_disc = np.hypot(dx, dy) - radius
        d = np.minimum(to_x, to_y)
        one, zero = dtype(1), dtype(0)
        wall_x = np.where(to_x < to_y, np.where(x < 0, -one, one), zero)
        wall_y = np.where(to_x < to_y, zero, np.where(y < 0, -one, one))
        disc = to_disc < d
        d = np.where(disc, to_disc, d)
        return d, np.where(disc, dx, wall_x), np.where(disc, dy, wall_y)

    def seen(dx, dy):
        """The direction of a vector relative to the heading."""
        angle = np.arctan2(dy, dx) - heading
        return dtype(np.pi) - (dtype(np.pi) - angle) % dtype(2 * np.pi)  # in (-pi, pi]

    for step in range(1, 221):
        d_obstacle, ox, oy = nearest(x, y)
        clearance = np.minimum(clearance, d_obstacle)
        A = labels(np.hypot(ball_x - x, ball_y - y), genes[0:4])
        B = labels(d_obstacle, genes[4:8])
        C = labels(seen(ball_x - x, ball_y - y), genes[8:12])
        theta_obstacle = seen(ox, oy)
        bell = np.exp(-(theta_obstacle**2) / (2 * np.maximum(genes[12] ** 2, dtype(1e-10))))
        left = theta_obstacle > 0
        D = np.stack([np.where(left, bell, 0), np.where(left, 0, bell), 1 - bell])
        # The 24 firing strengths, normalised: [i, j, k, l, trial].
        mu = A[:, None, None, None] * B[:, None, None] * C[:, None] * D
        v = (mu * V).sum((0, 1, 2, 3)) + genes[29]
        omega = (mu * Omega).sum((0, 1, 2, 3)) + genes[30]
        v = np.clip(dtype(0.04) * v, dtype(0), dtype(0.2))
        omega = np.clip(dtype(0.3) * omega, dtype(-1.5), dtype(1.5))
        v_peak = np.maximum(v_peak, v)
        # Along the chord of the exact arc.
        half_turn = omega * dtype(dt / 2)
        length = v * dtype(dt) * np.sinc(half_turn / dtype(np.pi))
        x = x + length * np.cos(heading + half_turn)
        y = y + length * np.sin(heading + half_turn)
        heading = heading + 2 * half_turn
        if step in (170, 200, 220):
            distances.append(np.hypot(ball_x - x, ball_y - y).reshape(num, trials).mean(1))
            vs.append(np.abs(v).reshape(num, trials).mean(1))
            omegas.append(np.abs(omega).reshape(num, trials).mean(1))
    clearance = np.minimum(clearance, nearest(x, y)[0]).reshape(num, trials)
    d1, d, d2 = distances
    delta = ((20 * np.maximum(dtype(0.145) - clearance, 0)) ** 2).mean(1)
    still = (v_peak.reshape(num, trials) <= 0.05).mean(1, dtype=dtype)
    cost = (6 * d) ** 2 + d1 + d2 + 2 * np.mean(vs, 0) + np.mean(omegas, 0) / 2 + delta
    return 10 / (dtype(0.001) + cost + 60 * still)


def labels(x: np.ndarray, genes: np.ndarray) -> np.ndarray:
    """Shares [2, N] of a family of two sigmoids; genes: a_1, c_1, a_2, c_2, each [N]."""
    e = np.exp(np.clip(genes[0::2] * (genes[1::2] - x), -60, 60))
    mu = 1 / (1 + e)
    return mu / mu.sum(0)


def rule_tables(genes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V and Omega of the rules, [2, 2, 2, 3, N], from the 31 genes [31, N]: far rules ignore the
    obstacle's side, and mirrored rules share V and have opposite Omega."""
    V = np.empty((2, 2, 2, 3, genes.shape[1]), genes.dtype)
    Omega = np.empty_like(V)
    for i in range(2):
        for table, first, sign in ((V, 13 + 4 * i, 1), (Omega, 21 + 4 * i, -1)):
            near, far = genes[first : first + 3], genes[first + 3]
            table[i, 0, 0], table[i, 0, 1] = near, sign * near[[1, 0, 2]]
            table[i, 1, 0], table[i, 1, 1] = far, sign * far
    return V, Omega
