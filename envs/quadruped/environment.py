"""The ERS-210 on the field, in physics (contract: `envs.base.Environment`)."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from envs.base import Limits, Observation, Scalar, Scene, Snapshot
from envs.field import (
    FIELD,
    Ball,
    Disc,
    Field,
    bearing,
    distance,
    move_disc,
    nearest_obstacle,
    roll_ball,
)
from envs.quadruped import constants as c
from envs.quadruped import nature as fates
from envs.quadruped import physics
from envs.quadruped.locomotion import SPEED, Gait, follow, limit, load_gait, set_points
from envs.quadruped.rigid_body import Variation
from envs.scenes import BALL_DECELERATION


class State(NamedTuple):
    """Everything that changes during an episode, plus the scene's constants.

    qpos: x, y, z (m), quaternion w, x, y, z, twelve joints (rad).  qvel: linear (m/s, world
    frame), angular (rad/s, body frame), joints.  phase: of the gait, turns.  stride: v_x, v_y,
    omega the gait is walking at.  set_points: the servos' last ones, rad.  fallen: it fell, for
    good.  fate: what the trial drew of the world's `Nature`; None without.
    """

    qpos: Float[Array, "19"]
    qvel: Float[Array, "18"]
    phase: Float[Array, ""]
    stride: Float[Array, "3"]
    set_points: Float[Array, "12"]
    fallen: Bool[Array, ""]
    ball: Ball
    discs: tuple[Disc, ...]
    fate: fates.Fate | None = None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Quadruped:
    """ERS-210 that walks by open-loop gait; ball and obstacles move as in the kinematic world.

    The robot's centre is the middle between its four shoulders.  d_obstacle is measured from
    it, and both angles are taken there; d_ball is measured from the capture point, 0.145 m
    ahead of the centre: below the nose, where the ball lies free of chest and feet.
    Angles are those of the trunk at that instant, with the few hundredths of a radian by which
    a trot swings it: what a camera on the body would see, so nothing is filtered.

    servo_speed: how fast set-points may move, in units of Sony's speeds (`constants.LEG_SPEED`).
    variation: how this dog and its carpet differ from the model.  nature: how every trial's differ
    instead, with noise, latency and pushes; None: not at all.
    solver: timestep, substeps and back end (static).  fall_tilt: cosine of the trunk's tilt, and
    fall_height: shoulders above the floor (m), below which the dog has fallen; it then stays as
    it is.  ball_deceleration: m/s^2 of a rolling ball.  rest: the pose at the start; `standing`
    finds that of a gait.
    """

    gait: Gait
    rest: Float[np.ndarray, "19"]
    limits: Limits = Limits(**c.OWN)
    servo_speed: Scalar = 1.0
    fall_tilt: Scalar = 0.7
    fall_height: Scalar = 0.045
    ball_deceleration: Scalar = BALL_DECELERATION
    variation: Variation = Variation()
    nature: fates.Nature | None = None
    solver: physics.Solver = dataclasses.field(default=physics.Solver(), metadata={"static": True})
    field: Field = dataclasses.field(default=FIELD, metadata={"static": True})

    @property
    def dt(self) -> float:
        """Control step, s."""
        return self.solver.timestep * self.solver.substeps

    def reset(self, scene: Scene) -> State:
        """Standing at rest at the scene's start.  Raises nothing; shapes are the contract's."""
        x, y, heading = scene.start[0], scene.start[1], scene.start[2]
        rest = jnp.asarray(self.rest, jnp.result_type(x))
        # Turn the settled pose about the vertical through the trunk and put it in its place.
        cos, sin = jnp.cos(0.5 * heading), jnp.sin(0.5 * heading)
        w, i, j, k = rest[3], rest[4], rest[5], rest[6]
        turned = [cos * w - sin * k, cos * i - sin * j, cos * j + sin * i, cos * k + sin * w]
        qpos = jnp.concatenate([jnp.stack([x, y, rest[2], *turned]), rest[7:]])
        vb, vo = scene.ball_velocity, scene.obstacle_velocity
        state = State(
            qpos=qpos,
            qvel=jnp.zeros(physics.NUM_V, qpos.dtype),
            phase=jnp.zeros_like(x),
            stride=jnp.zeros(3, qpos.dtype),
            set_points=rest[7:],
            fallen=jnp.zeros_like(x, bool),
            ball=Ball(scene.ball[0], scene.ball[1], *((None,) * 2 if vb is None else vb)),
            discs=tuple(
                Disc(o[0], o[1], o[2], *((None,) * 2 if vo is None else vo[n]))
                for n, o in enumerate(scene.obstacles)
            ),
        )
        if self.nature is None:
            return state
        fate = fates.draw(self.nature, scene.seed, self.measure(state))
        return state._replace(qpos=fates.first_pose(self.nature, fate, qpos), fate=fate)

    def step(self, state: State, command: Any) -> State:
        """Advance one control step: gait, physics, then ball and obstacles.

        command: v (m/s) and omega (rad/s), and v_y (m/s, to the left) where it has one.
        """
        wanted = jnp.stack([jnp.asarray(u, state.qpos.dtype) for u in three(command)])
        stride, targets = self.targets(state, wanted)
        physics_step = physics.step_fn(self.solver)
        variation, qvel = self.variation, state.qvel
        if self.nature is not None and state.fate is not None:
            variation = state.fate.variation
            qvel = fates.push(self.nature, state.fate, qvel)

        def substep(carry, ctrl):
            return physics_step(*carry, ctrl, variation), None

        # Reverse mode keeps one state a physics step and computes the rest again.
        substep = jax.checkpoint(substep, prevent_cse=False)
        (qpos, qvel), _ = jax.lax.scan(substep, (state.qpos, qvel), targets)
        turns = state.phase + self.dt / self.gait.period
        return self.accept(state, qpos, qvel, turns - jnp.floor(turns), stride, targets[-1])

    def targets(self, state: State, wanted: Float[Array, "3"]):
        """Stride of this control step, and set-points [substeps, 12] for its physics steps."""
        stride = follow(self.gait, state.stride, wanted, self.dt)
        ticks = jnp.arange(self.solver.substeps, dtype=state.phase.dtype) * self.solver.timestep
        targets = set_points(self.gait, state.phase + ticks / self.gait.period, stride)
        most = self.servo_speed * self.solver.timestep * jnp.asarray(SPEED, targets.dtype)
        return stride, limit(targets, state.set_points, most)

    def accept(self, state: State, qpos, qvel, phase, stride, set_points) -> State:
        """The state after a control step's physics; a dog that has fallen stays as it was."""
        upright = 1 - 2 * (qpos[4] * qpos[4] + qpos[5] * qpos[5])
        # Written so that a NaN anywhere counts as a fall.
        well = (upright > self.fall_tilt) & (qpos[2] > self.fall_height)
        well &= jnp.all(jnp.abs(qvel) < 1e3)
        fallen = state.fallen | ~well
        new = State(
            qpos=jnp.where(fallen, state.qpos, qpos),
            qvel=jnp.where(fallen, jnp.zeros_like(qvel), qvel),
            phase=phase,
            stride=stride,
            set_points=set_points,
            fallen=fallen,
            ball=roll_ball(state.ball, self.dt, self.ball_deceleration, self.field),
            discs=tuple(move_disc(d, self.dt, self.field) for d in state.discs),
        )
        if state.fate is None:
            return new
        return new._replace(fate=fates.remember(state.fate, self.measure(new)))

    def measure(self, state: State) -> Observation:
        """True distances and angles at this instant."""
        x, y = state.qpos[0], state.qpos[1]
        cos, sin = heading(state.qpos)
        bx, by = state.ball.x - x, state.ball.y - y
        ahead, left = cos * bx + sin * by, cos * by - sin * bx
        d_obstacle, ox, oy = nearest_obstacle(x, y, state.discs, self.field)
        return Observation(
            d_ball=distance(ahead - c.CAPTURE_X, left),
            d_obstacle=d_obstacle,
            theta_ball=bearing(ahead, left),
            theta_obstacle=bearing(cos * ox + sin * oy, cos * oy - sin * ox),
        )

    def observe(self, state: State) -> Observation:
        """What the controller sees: `measure`, late and with noise where the world's nature has
        them."""
        if self.nature is None or state.fate is None:
            return self.measure(state)
        return fates.sense(self.nature, state.fate, self.dt)

    def failed(self, state: State) -> Bool[Array, ""]:
        """True once the dog has fallen."""
        return state.fallen

    def snapshot(self, state: State) -> Snapshot:
        """Positions in the field's frame, for pictures."""
        cos, sin = heading(state.qpos)
        return Snapshot(
            robot=jnp.stack([state.qpos[0], state.qpos[1], jnp.arctan2(sin, cos)]),
            ball=jnp.stack([state.ball.x, state.ball.y]),
            obstacles=jnp.stack([jnp.stack([d.x, d.y, d.radius]) for d in state.discs])
            if state.discs
            else jnp.zeros((0, 3), state.qpos.dtype),
        )


def three(command: Any) -> tuple[Any, Any, Any]:
    """v, v_y, omega of a command, which need not have a v_y."""
    v_y = getattr(command, "v_y", None)
    return command.v, jnp.zeros_like(command.v) if v_y is None else v_y, command.omega


def standing(
    gait: Gait | None = None, solver: physics.Solver = physics.Solver(), **fields: Any
) -> Quadruped:
    """A dog that starts as it comes to rest with this gait, after standing still for two seconds.

    Args:
        gait: how it walks; None for the default one.
        solver: timestep, substeps and back end.
        fields: further fields of `Quadruped`.
    """
    gait = load_gait() if gait is None else gait
    return Quadruped(gait=gait, rest=physics.settled(gait, solver), solver=solver, **fields)


def heading(qpos: Float[Array, "19"]) -> tuple[Scalar, Scalar]:
    """Direction of the trunk's x axis seen from above, as a unit vector (cos, sin)."""
    w, i, j, k = qpos[3], qpos[4], qpos[5], qpos[6]
    cos, sin = 1 - 2 * (j * j + k * k), 2 * (w * k + i * j)
    norm = jnp.maximum(distance(cos, sin), 1e-6)
    return cos / norm, sin / norm
