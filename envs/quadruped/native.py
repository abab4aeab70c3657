"""The same episodes in MuJoCo's C code: the truth to compare with, and the full model.

A controller is closed around native physics one control step at a time, for a batch of scenes:
observation, gait and set-points come from the environment's own functions, only the physics is
MuJoCo's.  In the full variant ball, walls, obstacles and the dog's body are part of it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout as mujoco_rollout

from envs.base import Head, Observation, Scene
from envs.field import FIELD, Ball
from envs.quadruped import constants as c
from envs.quadruped import head as neck
from envs.quadruped import mjcf, physics
from envs.quadruped.environment import Quadruped, State, heading, three

PHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS
_INPUT = (
    mujoco.mjtState.mjSTATE_CTRL
    | mujoco.mjtState.mjSTATE_QFRC_APPLIED
    | mujoco.mjtState.mjSTATE_MOCAP_POS
)
_BALL_V = physics.NUM_V + 5  # of the full model's speeds: the ball's, after head and tail
_ROLLING = 1.4  # a rolling solid sphere is as inert as so many of its masses


class Episode(NamedTuple):
    """What happened, NumPy, leading axes [steps + 1, scenes] (command: [steps, scenes]).

    observation: true distances and angles; command: the controller's; qpos: coordinates of the
    model's variant; ball: x, y (m); obstacles: x, y, radius (m); fallen.  path: coordinates
    between control steps, [steps, poses a step, scenes, coordinates].
    """

    observation: Observation
    command: Any
    qpos: np.ndarray
    ball: np.ndarray
    obstacles: np.ndarray
    fallen: np.ndarray
    path: np.ndarray


def rolling_resistance(velocity: np.ndarray, deceleration: float, dt: float) -> np.ndarray:
    """The force [n, 2] (N) that slows a rolling ball by `deceleration` (m/s^2) for dt (s), or to a
    standstill: the law of `envs.field.roll_ball`.  velocity: [n, 2], m/s."""
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    lost = np.minimum(deceleration, speed / dt)
    return -_ROLLING * c.BALL_MASS * lost * velocity / np.maximum(speed, 1e-9)


def run(
    env: Quadruped,
    scenes: Scene,
    control: Callable[[Any, Any], Any],
    variant: str = mjcf.LEAN,
    num_steps: int = 220,
    num_threads: int = 2,
    poses: int = 1,
    look: bool = True,
) -> Episode:
    """Drive a batch of scenes.  control: (observation, leaves [scenes]; index of the control
    step) -> command, jitted here.

    poses: how many a control step are kept in `path`, evenly, to the nearest timestep.  look: in
    the full variant the head follows the ball, within its joints' limits and speeds; else it looks
    ahead.
    The full variant takes each obstacle's radius into the model, so that it is compiled once a
    scene.  A dog that has fallen goes on being simulated, but what is judged is the state from
    before the fall, as in the environment; numbers that blow up are caught.
    """
    num = scenes.start.shape[0]
    num_obstacles = scenes.obstacles.shape[1]
    full = variant == mjcf.FULL
    models = [_model(variant, env, scenes, n, num_obstacles) for n in range(num if full else 1)]
    model = models[0]
    datas = [mujoco.MjData(model) for _ in range(num_threads)]
    state = jax.jit(jax.vmap(env.reset))(scenes)
    qpos, qvel = np.zeros((num, model.nq)), np.zeros((num, model.nv))
    qpos[:] = model.qpos0
    qpos[:, : physics.NUM_Q] = state.qpos
    if full:
        ball = physics.NUM_Q + 5
        qpos[:, ball : ball + 2] = scenes.ball
        if scenes.ball_velocity is not None:
            v = np.asarray(scenes.ball_velocity)
            qvel[:, _BALL_V : _BALL_V + 2] = v
            # It rolls: its lowest point is at rest.
            spin = np.stack([-v[:, 1], v[:, 0]], axis=1) / FIELD.ball_radius
            qvel[:, _BALL_V + 3 : _BALL_V + 5] = spin

    measure = jax.jit(jax.vmap(env.measure))

    @jax.jit
    def before(state, n):
        seen = measure(state)
        command = control(seen, n)
        wanted = jnp.stack(three(command), axis=1)
        stride, targets = jax.vmap(env.targets)(state, wanted)
        return seen, command, stride, targets

    @jax.jit
    def after(state, qpos, qvel, stride, set_points):
        turns = state.phase + env.dt / env.gait.period
        new = jax.vmap(env.accept)(state, qpos, qvel, turns - jnp.floor(turns), stride, set_points)
        return new, measure(new)

    @jax.jit
    def turned(state, head):
        return jax.vmap(lambda s, h: neck.follow(h, _look(s), env.dt))(state, head)

    head = jnp.zeros((num, 3))
    size = mujoco.mj_stateSize(model, PHYSICS)
    seen, record = measure(state), []
    commands, paths = [], []
    kept = np.round(np.arange(1, poses + 1) * env.solver.substeps / poses).astype(int) - 1
    with mujoco_rollout.Rollout(nthread=num_threads) as pool:
        for n in range(num_steps):
            record.append(_row(seen, qpos, state))
            _, command, stride, targets = before(state, n)
            commands.append(jax.tree.map(np.asarray, command))
            initial = np.zeros((num, size))
            # Layout of the state vector: time, qpos, qvel.
            initial[:, 1 : 1 + model.nq] = qpos
            initial[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
            force, mocap = model.nu, model.nu + model.nv
            inputs = np.zeros((num, env.solver.substeps, mocap + 3 * model.nmocap))
            inputs[:, :, :12] = targets
            if full and look:
                last, head = head, turned(state, head)
                share = np.arange(1, env.solver.substeps + 1)[:, None] / env.solver.substeps
                way = np.asarray(head - last)[:, None]
                inputs[:, :, 12:15] = np.asarray(last)[:, None] + share * way
            if full:
                rolling = qvel[:, _BALL_V : _BALL_V + 2]
                resistance = rolling_resistance(rolling, float(env.ball_deceleration), env.dt)
                inputs[:, :, force + _BALL_V : force + _BALL_V + 2] = resistance[:, None]
            for k in range(model.nmocap):
                disc = state.discs[k]
                inputs[:, :, mocap + 3 * k] = np.asarray(disc.x)[:, None]
                inputs[:, :, mocap + 3 * k + 1] = np.asarray(disc.y)[:, None]
                inputs[:, :, mocap + 3 * k + 2] = 0.12
            path, _ = pool.rollout(
                models if full else model, datas, initial, inputs, control_spec=int(_INPUT)
            )
            paths.append(path[:, kept, 1 : 1 + model.nq].swapaxes(0, 1))
            end = path[:, -1]
            qpos = end[:, 1 : 1 + model.nq].copy()
            qvel = end[:, 1 + model.nq : 1 + model.nq + model.nv].copy()
            lost = ~np.isfinite(qpos).all(1) | ~np.isfinite(qvel).all(1)
            qpos[lost], qvel[lost] = model.qpos0, 0
            legs_q = np.where(lost[:, None], np.nan, qpos[:, : physics.NUM_Q])
            legs_q = jnp.asarray(legs_q, jnp.float32)  # type: ignore[assignment]
            legs_v = jnp.asarray(qvel[:, : physics.NUM_V], jnp.float32)
            state, seen = after(state, legs_q, legs_v, stride, targets[:, -1])
            if full:
                x, y = jnp.asarray(qpos[:, ball : ball + 2].T, jnp.float32)
                state = state._replace(ball=Ball(x, y))
                seen = measure(state)
    record.append(_row(seen, qpos, state))
    columns = [jax.tree.map(lambda *x: np.stack(x), *column) for column in zip(*record)]
    commands = jax.tree.map(lambda *x: np.stack(x), *commands)
    seen, qpos, balls, obstacles, fallen = columns
    return Episode(seen, commands, qpos, balls, obstacles, fallen, np.stack(paths))


def _look(state: State):
    """Tilt, pan and roll that look at the ball's centre."""
    cos, sin = heading(state.qpos)
    x, y = state.ball.x - state.qpos[0], state.ball.y - state.qpos[1]
    point = jnp.stack([cos * x + sin * y, cos * y - sin * x, jnp.full_like(x, FIELD.ball_radius)])
    return neck.look_to(point, Head(base=(*c.NECK_BASE[:2], c.NECK_BASE[2] + state.qpos[2])))


def _model(variant: str, env: Quadruped, scenes: Scene, n: int, num_obstacles: int):
    if variant == mjcf.LEAN:
        return physics.compile_model(variant, env.solver)
    model = mujoco.MjModel.from_xml_string(
        mjcf.mjcf(
            variant,
            timestep=env.solver.timestep,
            # Many contacts at once: one iteration is enough for four feet, not for a collision.
            iterations=20,
            ls_iterations=20,
            num_obstacles=num_obstacles,
        )
    )
    for k in range(num_obstacles):
        model.geom(f"obstacle{k}").size[0] = float(scenes.obstacles[n, k, 2])
    return model


def _row(seen, qpos, state: State):
    now = (seen, qpos.copy(), _ball(state), _discs(state), state.fallen)
    return jax.tree.map(np.asarray, now)


def _ball(state: State):
    return np.stack([np.asarray(state.ball.x), np.asarray(state.ball.y)], axis=-1)


def _discs(state: State):
    if not state.discs:
        return np.zeros((state.qpos.shape[0], 0, 3))
    return np.stack([np.stack([np.asarray(x) for x in d[:3]], -1) for d in state.discs], axis=1)
