"""One physics step of the lean model, written out for its structure.

The equations are MuJoCo's (rigid-body dynamics, soft pyramidal contacts, one Newton iteration
with an exact line search, explicit Euler), so that its result is that of MJX up to rounding
(tests/test_truth.py).  What is used here and cannot be known by a general engine: a trunk with
four legs of three hinges whose parts are bodies of revolution, and one possible contact a leg.
Then mass matrix and Hessian are arrows, and everything is arithmetic on scalars, with the four
legs side by side, which XLA turns into straight vector code under `vmap`.

Vectors are tuples of three components in the trunk's axes; a component has shape [], or [4]
where there is one a leg.  Unknowns: acceleration of the trunk's origin, angular
acceleration, joint accelerations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.quadruped import constants as c
from envs.quadruped.algebra import (
    Arrow,
    add,
    cross,
    dot,
    mul,
    over_legs,
    scale,
    solve_arrow,
    sub,
    total,
)
from envs.quadruped.rigid_body import Body, Constants, inertia_and_bias, pose


class Contact(NamedTuple):
    """The four possible foot contacts, everything [4]: point, Jacobian columns of the
    joints there, whether the foot touches, row stiffness D and wanted row accelerations."""

    point: tuple
    columns: tuple
    touching: jax.Array
    stiffness: jax.Array
    wanted: tuple


def _edges(world, friction, v):
    """A vector along the four pyramid edges: normal +- friction times each tangent."""
    x, y, z = (dot(axis, v) for axis in world)
    return z + friction * y, z - friction * y, z - friction * x, z + friction * x


def _from_edges(world, friction, f):
    """The vector that forces on the four edges add up to."""
    tangent_y, tangent_x = friction * (f[0] - f[1]), friction * (f[3] - f[2])
    normal = (f[0] + f[1]) + (f[2] + f[3])
    return add(scale(tangent_x, world[0]), scale(tangent_y, world[1]), scale(normal, world[2]))


def _at(contact: Contact, base, joints):
    """Motion of the contact points under a motion of trunk and joints."""
    return add(
        tuple(base[:3]),
        cross(tuple(base[3:]), contact.point),
        *(scale(u, g) for u, g in zip(joints, contact.columns)),
    )


def _contact(k: Constants, body: Body, height, world, base_speed, joint_speed, lane) -> Contact:
    """Feet against the floor.  Source: MuJoCo's documentation, Computation."""
    gap = height + dot(world[2], body.foot) - c.FOOT_RADIUS
    # MuJoCo puts the contact half way between the two surfaces.
    point = sub(body.foot, scale(c.FOOT_RADIUS + 0.5 * gap, world[2]))
    origins = (body.shoulder, body.shoulder, body.knee)
    columns = tuple(cross(a, sub(point, o)) for a, o in zip(body.axes, origins))
    d_min, d_max, width = k.impedance
    x = jnp.minimum(jnp.abs(gap) / width, 1.0)
    ramp = jnp.where(x < 0.5, 2 * x * x, 1 - 2 * (1 - x) * (1 - x))
    impedance = d_min + ramp * (d_max - d_min)
    stiffness = impedance / ((1 - impedance) * lane(k.weight))
    spring = 1 / (d_max * k.time_constant * k.damp_ratio) ** 2
    damper = 2 / (d_max * k.time_constant)
    contact = Contact(point, columns, gap < 0, stiffness, ())
    speeds = _edges(world, k.friction, _at(contact, base_speed, joint_speed))
    return contact._replace(wanted=tuple(-damper * u - spring * impedance * gap for u in speeds))


def _hessian(mass: Arrow, contact: Contact, world, friction, active) -> Arrow:
    """Mass matrix plus J^T D J of the active rows: still an arrow."""
    d = contact.stiffness
    s = [d * a for a in active]
    nn = (s[0] + s[1]) + (s[2] + s[3])
    ny, nx = friction * (s[0] - s[1]), friction * (s[3] - s[2])
    yy, xx = friction**2 * (s[0] + s[1]), friction**2 * (s[2] + s[3])

    def push(v):
        x, y, z = (dot(axis, v) for axis in world)
        return add(
            scale(xx * x + nx * z, world[0]),
            scale(yy * y + ny * z, world[1]),
            scale(nx * x + ny * y + nn * z, world[2]),
        )

    px, py, pz = contact.point
    lines = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    columns = [*lines, (0.0, -pz, py), (pz, 0.0, -px), (-py, px, 0.0), *contact.columns]
    pushed = [push(v) for v in columns]

    def block(i, j):
        return dot(columns[i], pushed[j])

    return Arrow(
        [[mass.base[i][j] + over_legs(block(i, j)) for j in range(i + 1)] for i in range(6)],
        [[mass.cross[i][j] + block(i, 6 + j) for j in range(3)] for i in range(6)],
        [[mass.leg[i][j] + block(6 + i, 6 + j) for j in range(i + 1)] for i in range(3)],
    )


def _line_search(slope_0, curve_0, rows, speeds, contact, iterations):
    """Minimiser over alpha of slope_0 alpha + curve_0 alpha^2 / 2 + sum D/2 min(x + alpha u, 0)^2.

    The derivative rises monotonically, piecewise linearly: Newton from 0, kept in a bracket.
    """

    def derivative(alpha):
        slope, curve = slope_0 + alpha * curve_0, curve_0
        for x, u in zip(rows, speeds):
            at = x + alpha * u
            pull = jnp.where(contact.touching & (at < 0), contact.stiffness * u, 0.0)
            slope, curve = slope + over_legs(pull * at), curve + over_legs(pull * u)
        return slope, curve

    zero = jnp.zeros_like(slope_0)
    low, high, alpha = zero, zero + jnp.inf, zero
    for _ in range(iterations):
        slope, curve = derivative(alpha)
        low = jnp.where(slope < 0, alpha, low)
        high = jnp.where(slope > 0, alpha, high)
        step = alpha - slope / jnp.maximum(curve, 1e-20)
        inside = (step >= low) & (step <= high)
        alpha = jnp.where(inside, step, 0.5 * (low + jnp.minimum(high, 1e6)))
    return alpha


def accelerations(k: Constants, qpos, qvel, ctrl, search_iterations: int):
    """Accelerations [18] of MuJoCo's coordinates."""
    dtype = qpos.dtype

    def lane(x):
        return np.asarray(x, dtype)

    w, i, j, z = qpos[3], qpos[4], qpos[5], qpos[6]
    # The world's axes in the trunk's.
    world = (
        (1 - 2 * (j * j + z * z), 2 * (i * j - w * z), 2 * (i * z + w * j)),
        (2 * (i * j + w * z), 1 - 2 * (i * i + z * z), 2 * (j * z - w * i)),
        (2 * (i * z - w * j), 2 * (j * z + w * i), 1 - 2 * (i * i + j * j)),
    )
    q = [qpos[7 + n :: 3] for n in range(3)]
    joint_speed = tuple(qvel[6 + n :: 3] for n in range(3))
    wanted = [ctrl[n::3] for n in range(3)]
    spin = (qvel[3], qvel[4], qvel[5])
    base_speed = (*add(*(scale(qvel[n], world[n]) for n in range(3))), *spin)

    body = pose(q, lane)
    mass, bias_base, bias_leg = inertia_and_bias(k, body, spin, joint_speed, world[2], lane)
    force = [
        k.gain * (t - x) - k.damping * v - b for t, x, v, b in zip(wanted, q, joint_speed, bias_leg)
    ]
    base, joints = solve_arrow(mass, [-b for b in bias_base], force)

    contact = _contact(k, body, qpos[2], world, base_speed, joint_speed, lane)
    rows = [
        a - b for a, b in zip(_edges(world, k.friction, _at(contact, base, joints)), contact.wanted)
    ]
    active = [contact.touching & (x < 0) for x in rows]
    push = [jnp.where(a, -contact.stiffness * x, 0.0) for a, x in zip(active, rows)]
    at_foot = _from_edges(world, k.friction, push)
    pull_base = [over_legs(f) for f in (*at_foot, *cross(contact.point, at_foot))]
    pull_leg = [dot(g, at_foot) for g in contact.columns]
    hessian = _hessian(mass, contact, world, k.friction, [a.astype(dtype) for a in active])
    search, search_leg = solve_arrow(hessian, pull_base, pull_leg)

    # Without contact the gradient and the direction are zero and so is the step.
    speeds = _edges(world, k.friction, _at(contact, search, search_leg))
    curve = _quadratic(mass, search, search_leg)
    alpha = _line_search(jnp.zeros_like(curve), curve, rows, speeds, contact, search_iterations)
    base = [a + alpha * b for a, b in zip(base, search)]
    joints = [a + alpha * b for a, b in zip(joints, search_leg)]
    linear = [dot(axis, tuple(base[:3])) for axis in world]
    legs = jnp.stack(joints, axis=1).reshape(12)
    return jnp.concatenate([jnp.stack([*linear, *base[3:]]), legs])


def _quadratic(m: Arrow, base, leg):
    """x^T M x."""

    def of(a, x):
        n = len(x)
        diagonal = total(*(mul(a[i][i], x[i] * x[i]) for i in range(n)))
        return diagonal + 2 * total(
            *(mul(a[i][j], x[i] * x[j]) for i in range(n) for j in range(i))
        )

    mixed = total(*(base[i] * over_legs(dot(m.cross[i], leg)) for i in range(6)))
    return of(m.base, base) + 2 * mixed + over_legs(of(m.leg, leg))


def step(k: Constants, qpos, qvel, ctrl, search_iterations: int = 6):
    """One timestep of semi-implicit Euler: (qpos [19], qvel [18]) from set-points ctrl [12]."""
    dt = k.timestep
    qvel = qvel + dt * accelerations(k, qpos, qvel, ctrl, search_iterations)
    half = [0.5 * dt * x for x in (qvel[3], qvel[4], qvel[5])]
    angle = half[0] * half[0] + half[1] * half[1] + half[2] * half[2]
    # sin(a)/a and cos(a) as series in a^2: below one rounding for 100 rad/s.
    sinc = 1 - angle / 6 * (1 - angle / 20 * (1 - angle / 42 * (1 - angle / 72)))
    cos = 1 - angle / 2 * (1 - angle / 12 * (1 - angle / 30 * (1 - angle / 56)))
    a, b, d = (sinc * x for x in half)
    w, i, j, z = qpos[3], qpos[4], qpos[5], qpos[6]
    turned = (
        w * cos - i * a - j * b - z * d,
        w * a + i * cos + j * d - z * b,
        w * b - i * d + j * cos + z * a,
        w * d + i * b - j * a + z * cos,
    )
    norm = jax.lax.rsqrt(total(*(x * x for x in turned)))
    place = [qpos[n] + dt * qvel[n] for n in range(3)]
    head = jnp.stack([*place, *(x * norm for x in turned)])
    return jnp.concatenate([head, qpos[7:] + dt * qvel[6:]]), qvel
