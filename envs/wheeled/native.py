"""The wheeled robot in MuJoCo's C code: episodes of a controller, logs of commands, kicks."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from envs.base import Observation, Scene
from envs.field import FIELD, Ball, Disc
from envs.quadruped.native import rolling_resistance
from envs.wheeled import mjcf
from envs.wheeled.environment import SUBSTEP, measured, wheel_speeds


class Robot:
    """One robot, perhaps with a ball and obstacles, in one model."""

    def __init__(self, num_obstacles: int = 0, ball: bool = True):
        text = mjcf.mjcf(SUBSTEP, num_obstacles, ball)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.ball = ball

    def put(self, pose: Any, ball: Any = (), obstacles: Any = ()) -> None:
        """Stand at x, y, heading with the ball at x, y and obstacles [K, 3] x, y, radius."""
        mujoco.mj_resetData(self.model, self.data)
        x, y, heading = map(float, pose)
        half = 0.5 * heading
        self.data.qpos[:7] = [x, y, mjcf.WHEEL_RADIUS, np.cos(half), 0, 0, np.sin(half)]
        if self.ball and len(ball):
            at = self.model.joint("ball").qposadr[0]
            self.data.qpos[at : at + 2] = ball
        for k, (x, y, radius) in enumerate(np.asarray(obstacles).reshape(-1, 3)):
            self.model.geom(f"obstacle{k}").size[0] = radius
            self.data.mocap_pos[k] = x, y, 0.1
        mujoco.mj_forward(self.model, self.data)

    def step(self, v: float, omega: float, dt: float = 0.1, kick: bool = False) -> None:
        """A control step.  A kick pushes for its first 40 ms."""
        left, right = (float(x) for x in wheel_speeds(v, omega))
        data = self.data
        if self.ball:
            speed = self.model.joint("ball").dofadr[0]
            rolling = data.qvel[speed : speed + 2][None]
            data.qfrc_applied[speed : speed + 2] = rolling_resistance(rolling, 0.05, dt)[0]
        for n in range(round(dt / SUBSTEP)):
            data.ctrl[:] = left, right, mjcf.KICK_FORCE if kick and n < 10 else 0.0
            mujoco.mj_step(self.model, data)

    @property
    def pose(self) -> np.ndarray:
        """x, y, heading."""
        w, i, j, k = self.data.qpos[3:7]
        heading = np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
        return np.array([*self.data.qpos[:2], heading])

    @property
    def ball_state(self) -> np.ndarray:
        """x, y, vx, vy."""
        joint = self.model.joint("ball")
        q, v = joint.qposadr[0], joint.dofadr[0]
        return np.array([*self.data.qpos[q : q + 2], *self.data.qvel[v : v + 2]])


def episodes(
    scenes: Scene, control: Callable[[Observation], Any], num_steps: int = 220
) -> tuple[Observation, np.ndarray, np.ndarray]:
    """Scenes with resting obstacles, the ball a body: true observations, leaves [steps + 1,
    scenes], and v, omega [steps, scenes]."""
    num, obstacles = scenes.start.shape[0], np.asarray(scenes.obstacles)
    robots = [Robot(obstacles.shape[1]) for _ in range(num)]
    for n, robot in enumerate(robots):
        robot.put(scenes.start[n], np.asarray(scenes.ball[n]), obstacles[n])

    @jax.jit
    def look(pose, ball):
        def one(pose, ball, discs):
            x, y, heading = pose
            own = tuple(Disc(d[0], d[1], d[2], None, None) for d in discs)
            seen = Ball(ball[0], ball[1], None, None)
            return measured(x, y, jnp.cos(heading), jnp.sin(heading), seen, own, FIELD)

        seen = jax.vmap(one)(pose, ball, jnp.asarray(obstacles))
        return seen, jax.vmap(control)(seen)

    rows, commands = [], []
    for step in range(num_steps + 1):
        pose = np.stack([robot.pose for robot in robots]).astype(np.float32)
        ball = np.stack([robot.ball_state[:2] for robot in robots]).astype(np.float32)
        seen, (v, omega) = jax.device_get(look(pose, ball))
        rows.append(seen)
        if step < num_steps:
            commands.append((v, omega))
            for n, robot in enumerate(robots):
                robot.step(v[n], omega[n])
    v, omega = np.moveaxis(np.asarray(commands), 1, 0)
    return jax.tree.map(lambda *x: np.stack(x), *rows), v, omega
