"""The lean model as rigid bodies: its numbers, the legs' pose, mass matrix and bias force.

A trunk with four legs of three hinges; a leg's parts are bodies of revolution, so that their
inertia needs an axis and two numbers and no rotation matrix.  Vectors are tuples of components in
the trunk's axes; a component has shape [], or [4] where there is one a leg.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
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
    sub,
    total,
    turn_inertia,
)
from envs.quadruped.locomotion import FORE, SHIN, SHOULDERS, SIDE


class Part(NamedTuple):
    """A body of revolution: mass (kg), inertia across and along its axis (kg m^2), [4] each."""

    mass: np.ndarray
    across: np.ndarray
    along: np.ndarray


class Variation(NamedTuple):
    """A dog and a carpet that differ from the model.  friction: coefficient of the carpet; gain,
    torque, mass: factors on the servos' P, on their torque and on all masses.  None: as modelled.
    Values may be traced.
    """

    friction: Any = None
    gain: Any = None
    torque: Any = None
    mass: Any = None


class Constants(NamedTuple):
    """What the step takes from the compiled model.  Numbers that a world varies (`gain`,
    `friction`, `mass`, `torque`) may be traced.  Lists of three: of J1, J2, J3.

    mass: factor on all masses and inertias.
    """

    timestep: float
    gravity: float
    gain: list
    damping: list
    torque: Any
    armature: float
    friction_loss: float
    low: list
    high: list
    friction: Any
    mass: Any
    trunk_mass: float
    trunk_centre: np.ndarray  # [3], m
    trunk_inertia: np.ndarray  # [3, 3] about its centre, kg m^2
    shoulder: Part
    upper: Part
    lower: Part
    upper_centre: np.ndarray  # share of the way from shoulder to knee
    lower_centre: np.ndarray  # [4], m below the knee
    weight: np.ndarray  # [4], inverse mass of a lower leg
    joint_weight: np.ndarray  # [3, 4], inverse inertia of a joint
    time_constant: float
    damp_ratio: float
    impedance: tuple[float, float, float]  # d_min, d_max, width


def constants_of(model: mujoco.MjModel) -> Constants:
    """Read the numbers from a compiled lean model.

    Raises ValueError where the model is not what this module is written for.
    """

    def need(ok, what):
        if not ok:
            raise ValueError(f"impl='structured' needs {what}; take impl='jax' for this model")

    def inertia(b):
        rot = np.zeros(9)
        mujoco.mju_quat2Mat(rot, model.body_iquat[b])
        rot = rot.reshape(3, 3)
        return rot @ np.diag(model.body_inertia[b]) @ rot.T

    def part(name, axis):
        bodies = [model.body(f"{leg}_{name}").id for leg in c.LEGS]
        along = np.array([u @ inertia(b) @ u for u, b in zip(axis, bodies)])
        across = np.array([0.5 * (np.trace(inertia(b)) - a) for b, a in zip(bodies, along)])
        for u, b, lon, lat in zip(axis, bodies, along, across):
            round_ = np.allclose(inertia(b), lat * np.eye(3) + (lon - lat) * np.outer(u, u), 1e-6)
            need(round_, f"a body of revolution, {model.body(b).name} is none")
        return Part(model.body_mass[bodies], across, along), model.body_ipos[bodies]

    knee = np.stack([-FORE * c.KNEE_OFFSET, 0 * FORE, -c.UPPER_LEG + 0 * FORE], 1)
    down = np.tile([0.0, 0.0, -1.0], (4, 1))
    shoulder, at = part("shoulder", np.tile([0.0, 1.0, 0.0], (4, 1)))
    need(np.allclose(at, 0), "shoulders centred on their axes")
    upper, upper_at = part("upper", knee / np.linalg.norm(knee, axis=1)[:, None])
    lower, lower_at = part("lower", down)
    share = np.linalg.norm(upper_at, axis=1) / np.linalg.norm(knee, axis=1)
    need(np.allclose(upper_at, share[:, None] * knee, atol=1e-7), "centres on the legs' axes")
    need(np.allclose(lower_at[:, :2], 0, atol=1e-7), "centres on the legs' axes")
    need(model.nv == 18 and model.npair == 8, "18 degrees of freedom and 8 contact pairs")
    mu, solref, solimp = model.pair_friction[0, 0], model.pair_solref[0], model.pair_solimp[0]
    need(np.all(model.pair_friction[:, :2] == mu), "one friction coefficient")
    need(tuple(solimp[3:]) == (0.5, 2.0) and np.all(solref > 0), "default solref and solimp")
    feet = [model.body(f"{leg}_lower").id for leg in c.LEGS]
    joints = slice(6, 18)

    def each(values, what):
        """One number a kind of joint, the same for all legs."""
        rows = np.asarray(values).reshape(4, 3)
        need(np.ptp(rows, axis=0).max() == 0, f"the same {what} in every leg")
        return [float(x) for x in rows[0]]

    def one(values, what):
        need(np.ptp(values) == 0, f"one {what}")
        return float(np.ravel(values)[0])

    need(np.all(model.jnt_limited[1:]) and np.all(model.actuator_forcelimited), "limits")
    need(np.all(model.dof_damping == 0), "damping in the actuators")
    solvers = (model.dof_solref[joints], model.jnt_solref[1:], model.pair_solref)
    need(all(np.all(x == solref) for x in solvers), "one solref")
    solvers = (model.dof_solimp[joints], model.jnt_solimp[1:], model.pair_solimp)
    need(all(np.all(x == solimp) for x in solvers), "one solimp")
    return Constants(
        timestep=float(model.opt.timestep),
        gravity=float(-model.opt.gravity[2]),
        gain=each(model.actuator_gainprm[:, 0], "gain"),
        damping=each(-model.actuator_biasprm[:, 2], "damping"),
        torque=one(model.actuator_forcerange[:, 1], "torque"),
        armature=one(model.dof_armature[joints], "armature"),
        friction_loss=one(model.dof_frictionloss[joints], "friction loss"),
        low=each(model.jnt_range[1:, 0], "range"),
        high=each(model.jnt_range[1:, 1], "range"),
        friction=float(mu),
        mass=1.0,
        trunk_mass=float(model.body("trunk").mass[0]),
        trunk_centre=model.body("trunk").ipos,
        trunk_inertia=inertia(model.body("trunk").id),
        shoulder=shoulder,
        upper=upper,
        lower=lower,
        upper_centre=share,
        lower_centre=-lower_at[:, 2],
        weight=model.body_invweight0[feet, 0] / model.opt.impratio,
        joint_weight=model.dof_invweight0[joints].reshape(4, 3).T,
        time_constant=float(max(solref[0], 2 * model.opt.timestep)),
        damp_ratio=float(solref[1]),
        impedance=(float(solimp[0]), float(solimp[1]), float(solimp[2])),
    )


def vary(k: Constants, variation: Variation) -> Constants:
    """The numbers of a dog that differs from the model."""
    if variation.friction is not None:
        k = k._replace(friction=variation.friction)
    if variation.gain is not None:
        k = k._replace(gain=[variation.gain * p for p in k.gain])
    if variation.torque is not None:
        k = k._replace(torque=variation.torque * k.torque)
    if variation.mass is not None:
        k = k._replace(mass=variation.mass)
    return k


class Body(NamedTuple):
    """Geometry of the legs at an instant: joint axes, shoulder, knee and foot (trunk's axes)."""

    axes: tuple
    shoulder: tuple
    knee: tuple
    foot: tuple
    thigh: tuple  # unit vector from shoulder to knee
    shank: tuple  # unit vector from foot to knee


def pose(q, lane) -> Body:
    """Where the legs are at joint angles q [3][4].  lane: constants [4] in the angles' type."""
    fore, side = lane(FORE), lane(SIDE)
    sa, ca = -fore * jnp.sin(q[0]), jnp.cos(q[0])
    sb, cb = side * jnp.sin(q[1]), jnp.cos(q[1])
    sg, cg = -fore * jnp.sin(q[2]), jnp.cos(q[2])
    ex = (ca, 0.0, -sa)
    ey = (sa * sb, cb, ca * sb)
    ez = (sa * cb, -sb, ca * cb)
    shank = add(scale(sg, ex), scale(cg, ez))
    shoulder = (lane(SHOULDERS[:, 0]), lane(SHOULDERS[:, 1]), 0.0)
    to_knee = add(scale(-c.KNEE_OFFSET * fore, ex), scale(-c.UPPER_LEG, ez))
    knee = add(shoulder, to_knee)
    foot = add(knee, scale(-lane(SHIN), shank))
    length = float(np.hypot(c.KNEE_OFFSET, c.UPPER_LEG))
    axes = ((0.0, -fore, 0.0), scale(side, ex), scale(-fore, ey))
    return Body(axes, shoulder, knee, foot, scale(1 / length, to_knee), shank)


def inertia_and_bias(k: Constants, body: Body, spin, joint_speed, up, lane):
    """Mass matrix, and the generalised force that gravity and velocities ask for."""
    a1, a2, a3 = body.axes
    v1, v2, v3 = joint_speed
    upper_arm = scale(lane(k.upper_centre), sub(body.knee, body.shoulder))
    lower_arm = scale(-lane(k.lower_centre), body.shank)
    knee_arm = sub(body.knee, body.shoulder)
    upper_at, lower_at = add(body.shoulder, upper_arm), add(body.knee, lower_arm)
    iu, il = (tuple(lane(x) for x in p[1:]) for p in (k.upper, k.lower))
    mu, ml, ms = lane(k.upper.mass), lane(k.lower.mass), lane(k.shoulder.mass)
    y_axis = (0.0, 1.0, 0.0)
    ishoulder = tuple(lane(x) for x in k.shoulder[1:])

    # Velocities and accelerations outward, with the trunk's own acceleration -gravity.
    spin1 = add(spin, scale(v1, a1))
    spin2 = add(spin1, scale(v2, a2))
    spin3 = add(spin2, scale(v3, a3))
    twist1 = cross(spin, scale(v1, a1))
    twist2 = add(twist1, cross(spin1, scale(v2, a2)))
    twist3 = add(twist2, cross(spin2, scale(v3, a3)))
    weightless = scale(k.gravity, up)

    def swing(twist, spin, arm):
        return add(cross(twist, arm), cross(spin, cross(spin, arm)))

    at_shoulder = add(weightless, cross(spin, cross(spin, body.shoulder)))
    force_s = scale(ms, at_shoulder)
    force_u = scale(mu, add(at_shoulder, swing(twist2, spin2, upper_arm)))
    at_knee = add(at_shoulder, swing(twist2, spin2, knee_arm))
    force_l = scale(ml, add(at_knee, swing(twist3, spin3, lower_arm)))

    def torque(inertia, axis, twist, spin):
        return add(
            turn_inertia(inertia, axis, twist), cross(spin, turn_inertia(inertia, axis, spin))
        )

    torque_s = torque(ishoulder, y_axis, twist1, spin1)
    torque_u = torque(iu, body.thigh, twist2, spin2)
    torque_l = torque(il, body.shank, twist3, spin3)
    about_knee = add(torque_l, cross(lower_arm, force_l))
    about_shoulder = add(
        torque_l,
        cross(add(knee_arm, lower_arm), force_l),
        torque_u,
        cross(upper_arm, force_u),
    )
    leg_force = add(force_s, force_u, force_l)
    leg_torque = add(torque_s, about_shoulder, cross(body.shoulder, leg_force))
    bias_leg = [
        dot(a1, add(about_shoulder, torque_s)),
        dot(a2, about_shoulder),
        dot(a3, about_knee),
    ]
    centre, mt = tuple(float(x) for x in k.trunk_centre), k.trunk_mass
    it = [[float(x) for x in row] for row in k.trunk_inertia]
    trunk_force = scale(mt, add(weightless, cross(spin, cross(spin, centre))))
    momentum = tuple(dot(row, spin) for row in it)
    trunk_torque = add(cross(spin, momentum), cross(centre, trunk_force))
    bias_base = [t + over_legs(x) for t, x in zip(trunk_force, leg_force)]
    bias_base += [t + over_legs(x) for t, x in zip(trunk_torque, leg_torque)]

    # Mass matrix: the force and the torque about the origin that a unit joint acceleration needs.
    def column(axis, outer):
        force_l = scale(ml, cross(axis, add(knee_arm, lower_arm) if outer else lower_arm))
        torque = add(turn_inertia(il, body.shank, axis), cross(lower_at, force_l))
        if not outer:
            return force_l, torque
        force_u = scale(mu, cross(axis, upper_arm))
        torque = add(torque, turn_inertia(iu, body.thigh, axis), cross(upper_at, force_u))
        return add(force_l, force_u), torque

    f1, n1 = column(a1, True)
    f2, n2 = column(a2, True)
    f3, n3 = column(a3, False)
    n1 = add(n1, scale(ishoulder[1], a1))

    def entry(axis, at, force, torque):
        return dot(axis, sub(torque, cross(at, force)))

    leg = [
        [entry(a1, body.shoulder, f1, n1)],
        [entry(a1, body.shoulder, f2, n2), entry(a2, body.shoulder, f2, n2)],
        [entry(a, at, f3, n3) for a, at in ((a1, body.shoulder), (a2, body.shoulder))],
    ]
    leg[2].append(entry(a3, body.knee, f3, n3))
    coupling = [[f[i] for f in (f1, f2, f3)] for i in range(3)]
    coupling += [[n[i] for n in (n1, n2, n3)] for i in range(3)]

    mass = mt + float(np.sum(k.upper.mass + k.lower.mass + k.shoulder.mass))
    moment = add(scale(mu, upper_at), scale(ml, lower_at), scale(ms, body.shoulder))
    moment = [mt * x + over_legs(y) for x, y in zip(centre, moment)]

    def steiner(i, j):
        """Inertia about the origin, legs."""
        out = []
        for m, at, inertia, axis in (
            (mu, upper_at, iu, body.thigh),
            (ml, lower_at, il, body.shank),
            (ms, body.shoulder, ishoulder, y_axis),
        ):
            out.append(mul(inertia[1] - inertia[0], mul(axis[i], axis[j])))
            out.append(mul(-1.0, mul(m, mul(at[i], at[j]))))
            if i == j:
                out += [inertia[0], mul(m, dot(at, at))]
        return over_legs(total(*out))

    own = np.asarray(it) + mt * (np.dot(centre, centre) * np.eye(3) - np.outer(centre, centre))
    rot = [[float(own[i, j]) + steiner(i, j) for j in range(i + 1)] for i in range(3)]
    hx, hy, hz = moment
    # Torque of the trunk's acceleration: moment x acceleration.
    base = [[mass], [0.0, mass], [0.0, 0.0, mass]]
    base += [[0.0, -hz, hy, rot[0][0]], [hz, 0.0, -hx, *rot[1]], [-hy, hx, 0.0, *rot[2]]]

    def heavier(rows):
        return [[mul(k.mass, x) for x in row] for row in rows]

    if not isinstance(k.mass, float) or k.mass != 1.0:
        base, coupling, leg = heavier(base), heavier(coupling), heavier(leg)
        bias_base, bias_leg = heavier([bias_base, bias_leg])
    for n in range(3):
        leg[n][n] = leg[n][n] + k.armature
    return Arrow(base, coupling, leg), bias_base, bias_leg
