"""The wheeled robot as a world: motors with limits, wheels that roll without slipping.

The equations are those of `mjcf` for wheels that hold; `native` runs the same in MuJoCo's C code.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from envs.base import Field, Limits, Observation, Scalar, Scene, Snapshot
from envs.field import FIELD, Ball, Disc, bearing, distance, move_disc, nearest_obstacle, roll_ball
from envs.scenes import BALL_DECELERATION
from envs.wheeled import mjcf as m

SUBSTEP = 0.004  # s


class State(NamedTuple):
    """x, y: m; cos, sin: of the heading; left, right: wheel speeds, rad/s; ball; discs."""

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    left: Scalar
    right: Scalar
    ball: Ball
    discs: tuple[Disc, ...]


def wheel_speeds(v: Scalar, omega: Scalar) -> tuple[Scalar, Scalar]:
    """What the left and the right wheel are asked for, rad/s, within what their motors turn: of a
    command that asks for more, v and omega are scaled down together."""
    left = (v - 0.5 * m.TRACK * omega) / m.WHEEL_RADIUS
    right = (v + 0.5 * m.TRACK * omega) / m.WHEEL_RADIUS
    over = jnp.maximum(jnp.maximum(jnp.abs(left), jnp.abs(right)) / m.NO_LOAD, 1.0)
    return left / over, right / over


def drive(left: Scalar, right: Scalar, asked: tuple[Scalar, Scalar], dt: Scalar):
    """Wheel speeds dt (s) later: two speed servos that push a mass and turn it.

    (m + 2 I / r^2) dv/dt = (t_l + t_r) / r and (J + I b^2 / (2 r^2)) domega/dt = (t_r - t_l) b /
    (2 r), with torques t = clip(k (asked - speed)) - damping."""
    r, b = m.WHEEL_RADIUS, m.TRACK
    torque = [
        jnp.clip(m.GAIN * (want - now), -m.TORQUE, m.TORQUE) - m.DAMPING * now
        for want, now in zip(asked, (left, right))
    ]
    v = dt * (torque[0] + torque[1]) / r / (m.MASS + 2 * m.WHEEL_INERTIA / r**2)
    turning = m.INERTIA + m.WHEEL_INERTIA * b**2 / (2 * r**2)
    omega = dt * (torque[1] - torque[0]) * b / (2 * r) / turning
    return left + (v - 0.5 * b * omega) / r, right + (v + 0.5 * b * omega) / r


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Wheeled:
    """Differential drive (contract: `envs.base.Environment`).  d_ball is measured from the point
    before the front where the ball lies, as the dog's is.

    dt: control step, s, a multiple of 4 ms (static).  limits: informative only.
    ball_deceleration: m/s^2.
    """

    limits: Limits = Limits(0.0, 0.2, 1.5)
    ball_deceleration: Scalar = BALL_DECELERATION
    dt: float = dataclasses.field(default=0.1, metadata={"static": True})
    field: Field = dataclasses.field(default=FIELD, metadata={"static": True})

    def reset(self, scene: Scene) -> State:
        """Standing at the scene's start.  Raises nothing."""
        x, y, heading = scene.start[0], scene.start[1], scene.start[2]
        vb, vo = scene.ball_velocity, scene.obstacle_velocity
        zero = jnp.zeros_like(x)
        return State(
            x,
            y,
            jnp.cos(heading),
            jnp.sin(heading),
            zero,
            zero,
            Ball(scene.ball[0], scene.ball[1], *((None,) * 2 if vb is None else vb)),
            tuple(
                Disc(o[0], o[1], o[2], *((None,) * 2 if vo is None else vo[n]))
                for n, o in enumerate(scene.obstacles)
            ),
        )

    def step(self, state: State, command: Any) -> State:
        """One control step under v (m/s) and omega (rad/s)."""
        asked = wheel_speeds(command.v, command.omega)
        num = round(self.dt / SUBSTEP)

        def substep(_, carry):
            x, y, cos, sin, left, right = carry
            left, right = drive(left, right, asked, SUBSTEP)
            v = 0.5 * m.WHEEL_RADIUS * (left + right)
            half = 0.5 * SUBSTEP * m.WHEEL_RADIUS * (right - left) / m.TRACK
            # Small turns: the midpoint rule, with the heading kept a unit vector.
            c, s = 1 - 0.5 * half * half, half
            mid_cos, mid_sin = cos * c - sin * s, sin * c + cos * s
            x, y = x + SUBSTEP * v * mid_cos, y + SUBSTEP * v * mid_sin
            cos, sin = mid_cos * c - mid_sin * s, mid_sin * c + mid_cos * s
            norm = jax.lax.rsqrt(cos * cos + sin * sin)
            return x, y, cos * norm, sin * norm, left, right

        moved = jax.lax.fori_loop(0, num, substep, tuple(state[:6]))
        ball = roll_ball(state.ball, self.dt, self.ball_deceleration, self.field)
        discs = tuple(move_disc(d, self.dt, self.field) for d in state.discs)
        x, y, cos, sin, left, right = moved
        return State(x, y, cos, sin, left, right, ball, discs)

    def measure(self, state: State) -> Observation:
        """True distances and angles."""
        return measured(state.x, state.y, state.cos, state.sin, state.ball, state.discs, self.field)

    def observe(self, state: State) -> Observation:
        """What the controller sees: `measure`."""
        return self.measure(state)

    def failed(self, state: State) -> Bool[Array, ""]:
        """It cannot fall."""
        return jnp.zeros_like(state.x, bool)

    def snapshot(self, state: State) -> Snapshot:
        """Positions in the field's frame, for pictures."""
        discs: Float[Array, "K 3"] = (
            jnp.stack([jnp.stack([d.x, d.y, d.radius]) for d in state.discs])
            if state.discs
            else jnp.zeros((0, 3))
        )
        return Snapshot(
            jnp.stack([state.x, state.y, jnp.arctan2(state.sin, state.cos)]),
            jnp.stack([state.ball.x, state.ball.y]),
            discs,
        )


def measured(x, y, cos, sin, ball, discs, field) -> Observation:
    """The observation of a robot at a pose, m and rad."""
    bx, by = ball.x - x, ball.y - y
    ahead, left = cos * bx + sin * by, cos * by - sin * bx
    d_obstacle, ox, oy = nearest_obstacle(x, y, discs, field)
    return Observation(
        d_ball=distance(ahead - m.CAPTURE_X, left),
        d_obstacle=d_obstacle,
        theta_ball=bearing(ahead, left),
        theta_obstacle=bearing(cos * ox + sin * oy, cos * oy - sin * ox),
    )
