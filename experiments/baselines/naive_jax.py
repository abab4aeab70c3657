"""The paper preset's fitness as one would first write it in JAX.

The library's controller; one trial is a scan over the control steps with everything that is
needed later as its outputs, the heading is an angle, and two `vmap`s make a population of it.  No
flag, no polynomial, no thought of how the batch lies in memory.
"""

from typing import Any

import jax
import jax.numpy as jnp

from envs.base import Observation
from fntg_jax.controller import network
from fntg_jax.controller.layout import LAYOUTS, expand


def fitness(theta: Any, scenes: Any) -> Any:
    """F [P] of theta [P, 31] (layout paper-31) on T scenes with one obstacle."""
    return jax.vmap(lambda t: _one_genome(t, scenes))(theta)


def _one_genome(genes, scenes):
    run = jax.vmap(_trial, in_axes=(None, 0, 0, 0))
    d, v, omega, clearance = run(genes, scenes.start, scenes.ball, scenes.obstacles)
    d1, d0, d2 = jnp.mean(d[:, jnp.array([170, 200, 220])], axis=0)
    samples = jnp.array([169, 199, 219])
    v_fit = jnp.mean(jnp.abs(v[:, samples]))
    omega_fit = jnp.mean(jnp.abs(omega[:, samples]))
    delta = jnp.mean((20 * (0.145 - jnp.minimum(clearance.min(1), 0.145))) ** 2)
    phi = jnp.mean(v.max(1) <= 0.05)
    cost = (6 * d0) ** 2 + d1 + d2 + 2 * v_fit + 0.5 * omega_fit + delta + 60 * phi
    return 10 / (0.001 + cost)


def _trial(genes, start, ball, obstacles, dt=0.1):
    params = expand(LAYOUTS["paper-31"], genes)

    def look(pose):
        x, y, heading = pose

        def angle(dx, dy):
            a = jnp.arctan2(dy, dx) - heading
            return jnp.pi - (jnp.pi - a) % (2 * jnp.pi)  # in (-pi, pi]

        bx, by = ball[0] - x, ball[1] - y
        # The nearer wall first, then the obstacles.
        to_x, to_y = 1.4 - jnp.abs(x), 0.9 - jnp.abs(y)
        d = jnp.minimum(to_x, to_y)
        ox = jnp.where(to_x < to_y, jnp.where(x < 0, -1.0, 1.0), 0.0)
        oy = jnp.where(to_x < to_y, 0.0, jnp.where(y < 0, -1.0, 1.0))
        for k in range(len(obstacles)):
            dx, dy = obstacles[k, 0] - x, obstacles[k, 1] - y
            to_disc = jnp.sqrt(dx**2 + dy**2) - obstacles[k, 2]
            ox, oy = jnp.where(to_disc < d, dx, ox), jnp.where(to_disc < d, dy, oy)
            d = jnp.minimum(d, to_disc)
        return Observation(jnp.sqrt(bx**2 + by**2), d, angle(bx, by), angle(ox, oy))

    def control_step(pose, _):
        seen = look(pose)
        v, omega, _ = network.command(params, seen)
        x, y, heading = pose
        half_turn = omega * dt / 2
        length = v * dt * jnp.sinc(half_turn / jnp.pi)
        way = heading + half_turn
        pose = (x + length * jnp.cos(way), y + length * jnp.sin(way), heading + 2 * half_turn)
        return pose, (seen.d_ball, v, omega, seen.d_obstacle)

    pose = (start[0], start[1], start[2])
    pose, (d, v, omega, clearance) = jax.lax.scan(control_step, pose, None, length=220)
    last = look(pose)
    return jnp.append(d, last.d_ball), v, omega, jnp.append(clearance, last.d_obstacle)
