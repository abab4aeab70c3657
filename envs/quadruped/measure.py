"""What a walk comes to: speed, course, joint speeds, torque, energy, falls, of commands held."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from envs.base import Scene, Walk
from envs.quadruped import physics
from envs.quadruped.environment import Quadruped, heading
from envs.quadruped.locomotion import SPEED

SETTLE, MEASURE = 20, 60  # control steps of 0.1 s before and while measuring


class Track(NamedTuple):
    """What a walk came to.

    velocity: mean v_x, v_y (m/s), omega (rad/s) in the body's frame.  fallen.  swing: of the
    heading about its mean course, rad, standard deviation.  upright: lowest cosine of the tilt.
    speed: joint speeds [steps, substeps, 12] over Sony's (`constants.LEG_SPEED`), while measuring.
    torque: the largest, N m.  power: mean mechanical power of the servos, W (what they put in, not
    what they brake).  clipped: share of set-points that the speed limit held back, worst joint.
    effort: torque, root of the mean square, N m.  height: of the trunk's centre, m.  shake: of the
    trunk, roll and pitch rate, root of the mean square, rad/s.
    """

    velocity: Any
    fallen: Any
    swing: Any
    upright: Any
    speed: Any = jnp.nan
    torque: Any = jnp.nan
    power: Any = jnp.nan
    clipped: Any = jnp.nan
    effort: Any = jnp.nan
    height: Any = jnp.nan
    shake: Any = jnp.nan


def drive(env: Quadruped, start, command: Float[Array, "3"]):
    """A control step with what its substeps were like: state, (joint speed, torque [substeps, 12],
    whether a set-point was held back)."""
    stride, targets = env.targets(start, command)
    step = physics.step_fn(env.solver)
    numbers = physics.constants(env.solver, env.variation)
    gain, damping = (jnp.tile(jnp.asarray(x), 4) for x in (numbers.gain, numbers.damping))

    def substep(carry, ctrl):
        qpos, qvel = step(*carry, ctrl, env.variation)
        asked = gain * (ctrl - carry[0][7:]) - damping * carry[1][6:]
        torque = jnp.clip(asked, -numbers.torque, numbers.torque)
        return (qpos, qvel), (qvel[6:], torque)

    (qpos, qvel), (speed, torque) = jax.lax.scan(substep, (start.qpos, start.qvel), targets)
    turns = start.phase + env.dt / env.gait.period
    new = env.accept(start, qpos, qvel, turns - jnp.floor(turns), stride, targets[-1])
    moved = jnp.abs(jnp.diff(targets, axis=0, prepend=start.set_points[None]))
    most = env.servo_speed * env.solver.timestep * jnp.asarray(SPEED)
    return new, (speed, torque, moved > 0.999 * most)


PUSH_STEP = 25  # control step before which a push comes


def walk(env: Quadruped, commands: Float[Array, "N 3"], push: Any = None) -> Track:
    """Drive the dog with commands (v_x, v_y, omega) from a stand at the field's centre.

    push: [2], a sudden change of the trunk's velocity (m/s, field's frame).
    """
    zero = jnp.zeros(3)
    start = env.reset(Scene(zero, zero[:2], jnp.zeros((0, 3))))

    def control_step(state, now):
        command, n = now
        if push is not None:
            hit = jnp.where(n == PUSH_STEP, push, 0.0)
            state = state._replace(qvel=state.qvel.at[:2].add(hit))
        new, (speed, torque, clipped) = drive(env, state, command)
        power = jnp.mean(jnp.sum(jnp.maximum(speed * torque, 0), axis=1))
        squares = jnp.mean(torque**2), jnp.sum(new.qvel[3:5] ** 2)
        seen = (new.qpos, speed, jnp.max(jnp.abs(torque)), power, jnp.mean(clipped, axis=0))
        return new, (*seen, squares)

    steps = jnp.arange(len(commands))
    state, seen = jax.lax.scan(control_step, start, (commands, steps))
    path, speed, torque, power, clipped, (effort, shake) = seen
    found = track(jnp.concatenate([start.qpos[None], path]), state.fallen, env.dt)
    return found._replace(
        speed=jnp.abs(speed[SETTLE:]) / jnp.asarray(SPEED),
        torque=jnp.max(torque),
        power=jnp.mean(power[SETTLE:]),
        clipped=jnp.max(jnp.mean(clipped[SETTLE:], axis=0)),
        effort=jnp.sqrt(jnp.mean(effort[SETTLE:])),
        height=jnp.mean(path[SETTLE:, 2]),
        shake=jnp.sqrt(jnp.mean(shake[SETTLE:])),
    )


def track(path, fallen, dt) -> Track:
    """What a walk came to.  path: the dog's coordinates [steps + 1, 19 or more], dt (s) apart."""
    c, s = map(jnp.asarray, jax.vmap(heading)(path))
    turn = jnp.arcsin(jnp.clip(c[:-1] * s[1:] - s[:-1] * c[1:], -1, 1))
    dx, dy = jnp.diff(path[:, 0]), jnp.diff(path[:, 1])
    c, s = c[:-1] + c[1:], s[:-1] + s[1:]  # along the middle of both headings
    norm = jnp.maximum(jnp.hypot(c, s), 1e-6)
    moved = jnp.stack([c * dx + s * dy, c * dy - s * dx]) / norm
    moved, turn = moved[:, SETTLE:], turn[SETTLE:]
    velocity = jnp.append(jnp.mean(moved, 1), jnp.mean(turn)) / dt
    swing = jnp.std(jnp.cumsum(turn - jnp.mean(turn)))
    upright = jnp.min(1 - 2 * jnp.sum(path[1:, 4:6] ** 2, axis=1))
    return Track(velocity, fallen, swing, upright)


def steady(env: Quadruped, commands, num_steps: int = SETTLE + MEASURE) -> Track:
    """One walk for every command, held all the time.  Leaves [commands]."""
    held = jnp.repeat(jnp.asarray(commands)[:, None], num_steps, axis=1)
    return jax.vmap(partial(walk, env))(held)


def errors(walks: Track, commands) -> tuple[Any, Any]:
    """Errors of velocity (m/s, both axes together) and of turning (rad/s), [commands]."""
    off = walks.velocity - commands
    return jnp.hypot(off[..., 0], off[..., 1]), jnp.abs(off[..., 2])


def random_sequences(key, num: int, num_steps: int):
    """Commands [num, num_steps, 3] that jump every 0.4 s, uniform in the ellipsoid
    (v_x/0.15)^2 + (v_y/0.08)^2 + (omega/1.0)^2 <= 1 of what the walk is made for."""
    shape = (num, -(-num_steps // 4), 3)
    k_direction, k_radius = jax.random.split(key)
    direction = jax.random.normal(k_direction, shape)
    direction /= jnp.linalg.norm(direction, axis=-1, keepdims=True)
    radius = jnp.cbrt(jax.random.uniform(k_radius, (*shape[:2], 1)))
    return jnp.repeat(direction * radius * jnp.asarray(RANGE), 4, axis=1)[:, :num_steps]


RANGE = (0.15, 0.08, 1.0)  # m/s, m/s, rad/s: half axes of that ellipsoid


def falls(env: Quadruped, key, num: int = 100, num_steps: int = 220) -> Track:
    """Random command sequences of 22 s.  Leaves [num]."""
    return jax.vmap(partial(walk, env))(random_sequences(key, num, num_steps))


def as_walk(commands) -> Walk:
    """Commands [..., 3] (v_x, v_y, omega) as `Walk`."""
    return Walk(0, commands[..., 0], commands[..., 1], commands[..., 2])


def speed_ratio(walks: Track) -> Float[Array, "..."]:
    """99th percentile of the joints' speeds over Sony's, of the worst joint: [commands]."""
    flat = walks.speed.reshape(*walks.speed.shape[:-3], -1, 12)
    return jnp.max(jnp.quantile(flat, 0.99, axis=-2), axis=-1)


def native_walks(env: Quadruped, commands: np.ndarray, variant: str) -> Track:
    """Walks in MuJoCo's C code, lean or full (ball in a corner).  Joint speeds are not recorded."""
    from envs.quadruped import native

    num, steps = commands.shape[:2]
    # Start so that the walk stays in the middle of the field, clear of walls and ball.
    angle = np.cumsum(commands[..., 2] * env.dt, axis=1)
    v_x, v_y = commands[..., 0], commands[..., 1]
    ideal = np.stack(
        [v_x * np.cos(angle) - v_y * np.sin(angle), v_x * np.sin(angle) + v_y * np.cos(angle)], -1
    )
    ideal = np.cumsum(ideal * env.dt, axis=1)
    start = np.zeros((num, 3), np.float32)
    start[:, :2] = -0.5 * (ideal.min(1) + ideal.max(1))
    ball = np.tile(np.array([1.2, 0.75], np.float32), (num, 1))
    scenes = Scene(start, ball, np.zeros((num, 0, 3), np.float32), seed=np.zeros(num, int))  # type: ignore[arg-type]
    table = jnp.asarray(commands)
    run = native.run(
        env, scenes, lambda _, n: as_walk(table[:, n]), variant, num_steps=steps, look=False
    )
    path = jnp.asarray(run.qpos.swapaxes(0, 1), jnp.float32)
    return jax.vmap(partial(track, dt=env.dt))(path, run.fallen[-1])


def steady_native(env: Quadruped, commands, variant: str) -> Track:
    """`steady` in MuJoCo's C code."""
    steps = round(0.1 / env.dt * (SETTLE + MEASURE))
    return native_walks(env, np.repeat(np.asarray(commands)[:, None], steps, axis=1), variant)


def falls_full(env: Quadruped, key, num: int = 100, num_steps: int = 220) -> np.ndarray:
    """`falls` in the full model: who fell [num]."""
    return np.asarray(
        native_walks(env, np.asarray(random_sequences(key, num, num_steps)), "full").fallen
    )
