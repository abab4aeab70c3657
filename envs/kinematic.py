"""A unicycle on the field: the paper's own simulation, and a fast stand-in for the quadruped.

Within a control step v and omega are constant and the pose moves along the exact arc.  The
heading is kept as a unit vector, because sin and cos do not vectorise on CPU.
"""

import dataclasses
from typing import Any, NamedTuple, dataclass_transform

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from envs import mix, scenes
from envs.base import Limits, Observation, Scalar, Scene, Snapshot, World, check_options
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


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def _traced(cls):
    """Frozen dataclass whose fields are traced leaves (None stays None: an absent part)."""
    cls = dataclasses.dataclass(frozen=True)(cls)
    names = [f.name for f in dataclasses.fields(cls) if not f.metadata.get("static")]
    static = [f.name for f in dataclasses.fields(cls) if f.metadata.get("static")]
    return jax.tree_util.register_dataclass(cls, data_fields=names, meta_fields=static)


@_traced
class Actuation:
    """How the body follows a command: limited speed and acceleration, a first-order lag, slip.

    v_rate: m/s^2; omega_rate: rad/s^2; lag: time constant in s, 0 for none.  v_top: m/s, the
    fastest it goes, whatever is commanded.  slip: v and omega miss by this share (standard
    deviation), drawn anew each control step from the scene's seed.
    """

    v_rate: Scalar = 0.5
    omega_rate: Scalar = 6.0
    lag: Scalar = 0.1
    v_top: Scalar | None = None
    slip: Scalar | None = None


@_traced
class Sensing:
    """Sensor noise, drawn anew each control step from the scene's seed.

    angle_noise: standard deviation in rad; range_noise: standard deviation as a share of the
    distance.  Defaults: about what was published for the AIBO's camera.  dropout: probability
    that a frame is lost; the last one stays.  view: horizontal opening of the camera in rad; of a
    ball outside of it, distance and direction stay as last seen (obstacles are remembered in the
    robot's map).  Both start from the truth.
    """

    angle_noise: Scalar = 0.035
    range_noise: Scalar = 0.07
    dropout: Scalar | None = None
    view: Scalar | None = None


class State(NamedTuple):
    """Everything that changes during an episode, plus the scene's constants."""

    x: Scalar
    y: Scalar
    cos: Scalar  # heading as a unit vector
    sin: Scalar
    ball: Ball
    discs: tuple[Disc, ...]
    velocity: tuple[Scalar, Scalar] | None  # v, omega of the body, with `Actuation` only
    past: tuple[Observation, ...]  # measurements still on their way, oldest first
    seen: Observation | None  # the last frame, where frames can be lost or the ball out of view
    seed: Any  # where something is random
    time: Any  # control steps so far, where something is random


@_traced
class Kinematic:
    """Unicycle environment (contract: `envs.base.Environment`).

    dt: control step, s.  limits: speeds, informative only: the command is taken as it comes.
    actuation, sensing: None switches the part off, as in the paper.  latency: how many control
    steps an observation is old (static).  capture: m ahead of the centre from where d_ball is
    measured (static); the quadruped's is 0.145, and a controller that shall walk it has to learn
    with that: without, an approach at a constant bearing is as good as a straight one.
    ball_deceleration: m/s^2 of a rolling ball.
    """

    dt: Scalar = 0.1
    limits: Limits = Limits()
    actuation: Actuation | None = None
    sensing: Sensing | None = None
    ball_deceleration: Scalar = scenes.BALL_DECELERATION
    latency: int = dataclasses.field(default=0, metadata={"static": True})
    capture: float = dataclasses.field(default=0.0, metadata={"static": True})
    field: Field = dataclasses.field(default=FIELD, metadata={"static": True})

    def reset(self, scene: Scene) -> State:
        """The state at the start of a scene.  Raises nothing; shapes are the contract's."""
        x, y, heading = scene.start[0], scene.start[1], scene.start[2]
        vb, vo = scene.ball_velocity, scene.obstacle_velocity
        ball = Ball(scene.ball[0], scene.ball[1], *((None, None) if vb is None else (vb[0], vb[1])))
        discs = tuple(
            Disc(o[0], o[1], o[2], *((None, None) if vo is None else (vo[k, 0], vo[k, 1])))
            for k, o in ((k, scene.obstacles[k]) for k in range(scene.obstacles.shape[0]))
        )
        state = State(
            x=x,
            y=y,
            cos=jnp.cos(heading),
            sin=jnp.sin(heading),
            ball=ball,
            discs=discs,
            velocity=None if self.actuation is None else (jnp.zeros_like(x), jnp.zeros_like(x)),
            past=(),
            seen=None,
            seed=jnp.asarray(scene.seed, jnp.uint32) if self._random else None,
            time=jnp.zeros_like(scene.seed, jnp.uint32) if self._random else None,
        )
        truth = self.measure(state)
        s = self.sensing
        memory = s is not None and not (s.dropout is None and s.view is None)
        return state._replace(past=(truth,) * self.latency, seen=truth if memory else None)

    @property
    def _random(self) -> bool:
        slips = self.actuation is not None and self.actuation.slip is not None
        return slips or self.sensing is not None

    @property
    def unicycle(self) -> dict[str, float] | None:
        """All there is to know of it where it is the paper's own model: control step (s) and
        deceleration of the ball (m/s^2).  None with actuation, sensing, latency or capture."""
        if self.actuation is not None or self.sensing is not None or self.latency or self.capture:
            return None
        return {"dt": float(self.dt), "deceleration": float(self.ball_deceleration)}

    def step(self, state: State, command: Any) -> State:
        """Advance one control step: body velocity, exact arc, ball and obstacles."""
        v, omega = command.v, command.omega
        velocity = state.velocity
        if self.actuation is not None and velocity is not None:
            if self.actuation.v_top is not None:
                v = jnp.clip(v, -self.actuation.v_top, self.actuation.v_top)
            velocity = (
                self._follow(velocity[0], v, self.actuation.v_rate),
                self._follow(velocity[1], omega, self.actuation.omega_rate),
            )
            v, omega = velocity
            if self.actuation.slip is not None:
                noise = jax.random.normal(
                    jax.random.fold_in(_key(state), 2), (2,), jnp.result_type(v)
                )
                v = v * (1 + self.actuation.slip * noise[0])
                omega = omega * (1 + self.actuation.slip * noise[1])
        turn, v_y = omega * self.dt, getattr(command, "v_y", None)
        x, y, cos, sin = _arc(state.x, state.y, state.cos, state.sin, v * self.dt, turn)
        if v_y is not None:  # the same arc, its chord turned to the left
            x, y, _, _ = _arc(x, y, -state.sin, state.cos, v_y * self.dt, turn)
        new = state._replace(
            x=x,
            y=y,
            cos=cos,
            sin=sin,
            velocity=velocity,
            ball=roll_ball(state.ball, self.dt, self.ball_deceleration, self.field),
            discs=tuple(move_disc(d, self.dt, self.field) for d in state.discs),
            seen=None if state.seen is None else self.observe(state),
            time=None if state.time is None else state.time + 1,
        )
        if state.past:
            # What is measured before this step is the newest thing still on its way.
            new = new._replace(past=(*state.past[1:], self.measure(state)))
        return new

    def _follow(self, now: Scalar, wanted: Scalar, rate: Scalar) -> Scalar:
        assert self.actuation is not None
        lag = jnp.maximum(self.actuation.lag, 1e-6)
        change = (wanted - now) * -jnp.expm1(-self.dt / lag)
        return now + jnp.clip(change, -rate * self.dt, rate * self.dt)

    def measure(self, state: State) -> Observation:
        """True distances and angles at this instant."""
        bx, by = state.ball.x - state.x, state.ball.y - state.y
        d_obstacle, ox, oy = nearest_obstacle(state.x, state.y, state.discs, self.field)
        c, s = state.cos, state.sin
        return Observation(
            d_ball=distance(bx, by) if self.capture == 0 else self._from_capture(state, bx, by),
            d_obstacle=d_obstacle,
            theta_ball=bearing(c * bx + s * by, c * by - s * bx),
            theta_obstacle=bearing(c * ox + s * oy, c * oy - s * ox),
        )

    def _from_capture(self, state: State, bx: Scalar, by: Scalar) -> Scalar:
        c, s = state.cos, state.sin
        return distance(c * bx + s * by - self.capture, c * by - s * bx)

    def observe(self, state: State) -> Observation:
        """What the controller sees: `measure`, delayed by `latency` steps, noisy, and where frames
        are lost or the ball is out of view, what was seen last."""
        seen = state.past[0] if state.past else self.measure(state)
        if self.sensing is None:
            return seen
        key = _key(state)
        noise = jax.random.normal(key, (4,), jnp.result_type(seen.d_ball))
        far, turn = self.sensing.range_noise, self.sensing.angle_noise
        frame = Observation(
            d_ball=seen.d_ball * (1 + far * noise[0]),
            d_obstacle=seen.d_obstacle * (1 + far * noise[1]),
            theta_ball=_wrap(seen.theta_ball + turn * noise[2]),
            theta_obstacle=_wrap(seen.theta_obstacle + turn * noise[3]),
        )
        last = state.seen
        if last is not None and self.sensing.view is not None:
            visible = jnp.abs(seen.theta_ball) <= 0.5 * self.sensing.view
            frame = frame._replace(
                d_ball=jnp.where(visible, frame.d_ball, last.d_ball),
                theta_ball=jnp.where(visible, frame.theta_ball, last.theta_ball),
            )
        if last is not None and self.sensing.dropout is not None:
            lost = jax.random.uniform(jax.random.fold_in(key, 1)) < self.sensing.dropout
            frame = jax.tree.map(lambda old, new: jnp.where(lost, old, new), last, frame)
        return frame

    def failed(self, state: State) -> Bool[Array, ""]:
        """A unicycle never falls."""
        return jnp.zeros_like(state.x, bool)

    def snapshot(self, state: State) -> Snapshot:
        """Positions in the field's frame, for pictures."""
        return Snapshot(
            robot=jnp.stack([state.x, state.y, jnp.arctan2(state.sin, state.cos)]),
            ball=jnp.stack([state.ball.x, state.ball.y]),
            obstacles=jnp.stack([jnp.stack([d.x, d.y, d.radius]) for d in state.discs])
            if state.discs
            else jnp.zeros((0, 3), jnp.result_type(state.x)),
        )


def _key(state: State) -> Any:
    """The key of this control step."""
    return jax.random.fold_in(jax.random.key(state.seed), state.time)


def _arc(x, y, cos, sin, length, turn):
    """Move along a circular arc: length in m, turn in rad (exact for constant v and omega).

    sin(turn)/turn and (1-cos(turn))/turn as series in turn^2, below one float32 rounding for
    |turn| < 0.6 rad and 2e-5 at 1.5 rad (a control step of 1 s): no division and no branch.
    """
    s = turn * turn
    if jnp.result_type(turn) == jnp.float64:
        sinc = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110))))
        cosc = turn / 2 * (1 - s / 12 * (1 - s / 30 * (1 - s / 56 * (1 - s / 90 * (1 - s / 132)))))
    else:
        sinc = 1 - s * (1 / 6 - s * (1 / 120 - s * (1 / 5040)))
        cosc = turn * (1 / 2 - s * (1 / 24 - s * (1 / 720 - s * (1 / 40320))))
    dc, ds = 1 - turn * cosc, turn * sinc
    return (
        x + length * (sinc * cos - cosc * sin),
        y + length * (sinc * sin + cosc * cos),
        dc * cos - ds * sin,
        dc * sin + ds * cos,
    )


def _wrap(angle: Scalar) -> Scalar:
    """Angle into [-pi, pi), for one turn too many at most."""
    turn = 2 * jnp.pi
    return jnp.where(angle >= jnp.pi, angle - turn, jnp.where(angle < -jnp.pi, angle + turn, angle))


# Option -> (least, largest) value.  Parts of the model are switched on by naming one of theirs.
_LIMITS = {"v_min": (-1, 1), "v_max": (0.001, 1), "omega_max": (0.01, 10)}
_ACTUATION = {
    "v_rate": (0.001, 100),
    "omega_rate": (0.01, 1000),
    "lag": (0, 10),
    "v_top": (0.001, 1),
    "slip": (0, 1),
}
_SENSING = {"angle_noise": (0, 3.2), "range_noise": (0, 1), "dropout": (0, 1), "view": (0.01, 6.3)}
_OTHER = {"dt": (0.001, 1), "ball_deceleration": (0, 10), "latency": (0, 100), "capture": (0, 0.5)}


def make(**options: float) -> Kinematic:
    """A `Kinematic` from flat options by name: dt, latency (steps), capture (m),
    ball_deceleration; v_min, v_max, omega_max; v_rate, omega_rate, lag, v_top, slip (any of them
    switches actuation on); angle_noise, range_noise, dropout, view (sensing).  Raises ValueError
    naming the option, its value and the allowed range.
    """
    check_options(options, {**_LIMITS, **_ACTUATION, **_SENSING, **_OTHER})
    if options.get("latency", 0) != int(options.get("latency", 0)):
        raise ValueError(f"env option latency = {options['latency']}: allowed are whole steps")

    def given(names):
        return {name: options[name] for name in names if name in options}

    limits = Limits(**given(_LIMITS))
    if limits.v_min >= limits.v_max:
        raise ValueError(f"env option v_min = {limits.v_min}: must be below v_max = {limits.v_max}")
    other = given(_OTHER)
    return Kinematic(
        limits=limits,
        actuation=Actuation(**given(_ACTUATION)) if given(_ACTUATION) else None,
        sensing=Sensing(**given(_SENSING)) if given(_SENSING) else None,
        **{**other, "latency": int(other.get("latency", 0))},
    )


world = World(make=make, suites=scenes.SUITES, mix=mix.Mix, field=FIELD)
