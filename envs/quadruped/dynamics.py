"""One physics step of the lean model, written out for its structure.

The equations are MuJoCo's (rigid-body dynamics, soft pyramidal contacts, one Newton iteration
with an exact line search, explicit Euler), so that its result is that of MJX up to rounding
(tests/test_truth.py).  What is used here and cannot be known by a general engine: a trunk with
four legs of three hinges whose parts are bodies of revolution, and two possible contacts a leg.
Dry friction and limits of joints are rows of one entry: they only add to diagonals.
Then mass matrix and Hessian are arrows, and everything is arithmetic on scalars, with the four
legs side by side, which XLA turns into straight vector code under `vmap`.

Vectors are tuples of three components in the trunk's axes; a component has shape [], or [4]
where there is one a leg, or [8] where there is one a contact (feet, then elbows).  Unknowns:
acceleration of the trunk's origin, angular acceleration, joint accelerations.
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
    """The eight possible contacts, everything [8]: point, Jacobian columns of the joints there,
    whether it touches, row stiffness D and wanted row accelerations."""

    point: tuple
    columns: tuple
    touching: jax.Array
    stiffness: jax.Array
    wanted: tuple


class Joints(NamedTuple):
    """Rows of the joints themselves, lists of three of [4].  Dry friction: stiffness D and wanted
    acceleration; limits: direction that leads back inside, D (0 inside) and wanted acceleration."""

    friction: list
    stop: list
    inward: list
    limit: list
    back: list


def _twice(x):
    """[4] of the legs to [8] of the contacts."""
    return x if isinstance(x, float) else jnp.concatenate([x, x])


def _by_leg(x):
    """The sum of a leg's two contacts: [8] to [4]."""
    return x[:4] + x[4:]


def _sum(x):
    return over_legs(_by_leg(x))


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
        *(scale(_twice(u), g) for u, g in zip(joints, contact.columns)),
    )


def _impedance(k: Constants, gap):
    """MuJoCo's impedance d of a row that is violated by |gap|."""
    d_min, d_max, width = k.impedance
    x = jnp.minimum(jnp.abs(gap) / width, 1.0)
    ramp = jnp.where(x < 0.5, 2 * x * x, 1 - 2 * (1 - x) * (1 - x))
    return d_min + ramp * (d_max - d_min)


def _reference(k: Constants):
    """Spring and damper of the wanted accelerations: a = -damper v - spring d gap."""
    d_max = k.impedance[1]
    return 1 / (d_max * k.time_constant * k.damp_ratio) ** 2, 2 / (d_max * k.time_constant)


def _contact(k: Constants, body: Body, height, world, base_speed, joint_speed, lane) -> Contact:
    """Feet and elbows against the floor.  Source: MuJoCo's documentation, Computation."""
    centre = tuple(jnp.concatenate([a, b]) for a, b in zip(body.foot, body.knee))
    radius = lane([c.FOOT_RADIUS] * 4 + [c.ELBOW_RADIUS] * 4)
    gap = height + dot(world[2], centre) - radius
    # MuJoCo puts the contact half way between the two surfaces.
    point = sub(centre, scale(radius + 0.5 * gap, world[2]))
    origins = (body.shoulder, body.shoulder, body.knee)
    columns = tuple(
        cross(tuple(map(_twice, a)), sub(point, tuple(map(_twice, o))))
        for a, o in zip(body.axes, origins)
    )
    impedance = _impedance(k, gap)
    # MuJoCo's approximation of a pyramid edge's inverse inertia.
    weight = lane(np.tile(k.weight, 2)) * (2 * k.friction**2 * (1 + k.friction**2))
    stiffness = impedance / ((1 - impedance) * weight)
    spring, damper = _reference(k)
    contact = Contact(point, columns, gap < 0, stiffness, ())
    speeds = _edges(world, k.friction, _at(contact, base_speed, joint_speed))
    return contact._replace(wanted=tuple(-damper * u - spring * impedance * gap for u in speeds))


def _joint_rows(k: Constants, q, speed, lane) -> Joints:
    """Dry friction and limits.  Source: MuJoCo's documentation, Computation."""
    spring, damper = _reference(k)
    d_min = k.impedance[0]
    rows = Joints([], [], [], [], [])
    for n in range(3):
        weight = lane(k.joint_weight[n])
        rows.friction.append(lane(d_min / (1 - d_min) / k.joint_weight[n]))
        rows.stop.append(-damper * speed[n])
        below, above = q[n] - k.low[n], k.high[n] - q[n]
        gap = jnp.minimum(below, above)
        inward = jnp.where(below < above, 1.0, -1.0).astype(gap.dtype)
        impedance = _impedance(k, gap)
        stiffness = impedance / ((1 - impedance) * weight)
        rows.inward.append(inward)
        rows.limit.append(jnp.where(gap < 0, stiffness, 0.0))
        rows.back.append(-damper * inward * speed[n] - spring * impedance * gap)
    return rows


def _hessian(mass: Arrow, contact: Contact, world, friction, active, joint_rows) -> Arrow:
    """Mass matrix plus J^T D J of the active rows: still an arrow.  joint_rows: D of each joint's
    own active rows."""
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

    legs = [[mass.leg[i][j] + _by_leg(block(6 + i, 6 + j)) for j in range(i + 1)] for i in range(3)]
    for n in range(3):
        legs[n][n] = legs[n][n] + joint_rows[n]
    return Arrow(
        [[mass.base[i][j] + _sum(block(i, j)) for j in range(i + 1)] for i in range(6)],
        [[mass.cross[i][j] + _by_leg(block(i, 6 + j)) for j in range(3)] for i in range(6)],
        legs,
    )


def _line_search(curve_0, rows, speeds, contact, joints, friction_loss, iterations):
    """Minimiser over alpha of curve_0 alpha^2 / 2 + the rows' costs: contacts and limits
    D/2 min(x + alpha u, 0)^2, dry friction Huber's.  joints: (x, u, D) of limits, of friction.

    The derivative rises monotonically, piecewise linearly: Newton from 0, kept in a bracket.
    """
    limits, frictions = joints

    def derivative(alpha):
        curve, slope = curve_0, alpha * curve_0
        pulls, curves = 0.0, 0.0
        for x, u in zip(rows, speeds):
            at = x + alpha * u
            pull = jnp.where(contact.touching & (at < 0), contact.stiffness * u, 0.0)
            pulls, curves = pulls + pull * at, curves + pull * u
        slope, curve = slope + _sum(pulls), curve + _sum(curves)
        pulls, curves = 0.0, 0.0
        for x, u, d in limits:
            at = x + alpha * u
            pull = jnp.where(at < 0, d * u, 0.0)
            pulls, curves = pulls + pull * at, curves + pull * u
        for x, u, d in frictions:
            force = d * (x + alpha * u)
            pulls = pulls + u * jnp.clip(force, -friction_loss, friction_loss)
            curves = curves + jnp.where(jnp.abs(force) < friction_loss, d * u * u, 0.0)
        return slope + over_legs(pulls), curve + over_legs(curves)

    zero = jnp.zeros_like(curve_0)
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
    servo = [
        jnp.clip(p * (t - x) - d * v, -k.torque, k.torque)
        for p, d, t, x, v in zip(k.gain, k.damping, wanted, q, joint_speed)
    ]
    force = [a - b for a, b in zip(servo, bias_leg)]
    base, joints = solve_arrow(mass, [-b for b in bias_base], force)

    contact = _contact(k, body, qpos[2], world, base_speed, joint_speed, lane)
    rows = [
        a - b for a, b in zip(_edges(world, k.friction, _at(contact, base, joints)), contact.wanted)
    ]
    active = [contact.touching & (x < 0) for x in rows]
    push = [jnp.where(a, -contact.stiffness * x, 0.0) for a, x in zip(active, rows)]
    at_point = _from_edges(world, k.friction, push)
    pull_base = [_sum(f) for f in (*at_point, *cross(contact.point, at_point))]
    pull_leg = [_by_leg(dot(g, at_point)) for g in contact.columns]

    own = _joint_rows(k, q, joint_speed, lane)
    stiff = []
    limits, frictions = [], []
    for n in range(3):
        dry = joints[n] - own.stop[n]
        wall = own.inward[n] * joints[n] - own.back[n]
        drag = own.friction[n] * dry
        hold = jnp.where(wall < 0, own.limit[n], 0.0)
        stiff.append(hold + jnp.where(jnp.abs(drag) < k.friction_loss, own.friction[n], 0.0))
        pull_leg[n] = pull_leg[n] - own.inward[n] * hold * wall
        pull_leg[n] = pull_leg[n] - jnp.clip(drag, -k.friction_loss, k.friction_loss)
        limits.append((wall, own.inward[n], own.limit[n]))
        frictions.append((dry, own.friction[n]))
    active = [a.astype(dtype) for a in active]
    hessian = _hessian(mass, contact, world, k.friction, active, stiff)
    search, search_leg = solve_arrow(hessian, pull_base, pull_leg)

    # Where nothing acts the gradient and the direction are zero and so is the step.
    speeds = _edges(world, k.friction, _at(contact, search, search_leg))
    curve = _quadratic(mass, search, search_leg)
    of_joints = (
        [(x, s * u, d) for (x, s, d), u in zip(limits, search_leg)],
        [(x, u, d) for (x, d), u in zip(frictions, search_leg)],
    )
    alpha = _line_search(
        curve, rows, speeds, contact, of_joints, k.friction_loss, search_iterations
    )
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


def step(k: Constants, qpos, qvel, ctrl, search_iterations: int = 8):
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
