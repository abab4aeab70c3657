"""Pictures of the dog, drawn by MuJoCo: trials in the full model, as frames or in a window."""

import importlib
import os
import platform
import time
import warnings
from collections.abc import Callable
from typing import Any

import jax
import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context

from envs.base import Scene
from envs.quadruped import mjcf, native

_FRAME_SECONDS = 0.05  # at most; a trot has three steps a second


class FullFilm:
    """Trials of a batch of scenes in the full model (contract: `envs.base.Film`).

    control: observation -> command, jittable.  window: whether `view` will be called, or
    `pictures`.  Raises ValueError where there is no display or no OpenGL back end.
    """

    def __init__(
        self, env: Any, scenes: Scene, control: Callable[[Any], Any], window: bool = False
    ):
        if window:
            _need_display()
        else:
            _renderer(scene_model(np.asarray(scenes.obstacles[0])), 16, 16).close()
        poses = max(1, round(env.dt / _FRAME_SECONDS))
        run = native.run(
            env, scenes, lambda seen, _: jax.vmap(control)(seen), mjcf.FULL, poses=poses
        )
        self.measured, self.command, self.failed = run.observation, run.command, run.fallen[-1]
        self.dt = env.dt / poses
        start = run.qpos[0]
        self._qpos = np.concatenate([start[None], run.path.reshape(-1, *start.shape)])
        # They move from control step to control step.
        moved = np.repeat(run.obstacles[:-1], poses, axis=0)
        self._obstacles = np.concatenate([run.obstacles[:1], moved])

    def pictures(self, trial: int, width: int, height: int) -> list[np.ndarray]:
        """Pictures of a trial, `dt` apart, uint8 [height, width, 3]; the camera stays with the
        dog."""
        return frames(self._qpos[:, trial], self._obstacles[:, trial], width, height)

    def view(self, trial: int) -> None:
        """Play a trial in MuJoCo's own viewer, over and over, until its window is closed."""
        view(self._qpos[:, trial], self._obstacles[:, trial], self.dt)


def scene_model(obstacles: np.ndarray) -> mujoco.MjModel:
    """The full model with obstacle robots of the given radii.  obstacles: [K, 3], x, y, radius."""
    num = len(obstacles)
    model = mujoco.MjModel.from_xml_string(mjcf.mjcf(mjcf.FULL, num_obstacles=num))
    for k in range(num):
        model.geom(f"obstacle{k}").size[0] = obstacles[k, 2]
    return model


def place(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray, obstacles: np.ndarray
) -> None:
    """Put dog and ball (full's coordinates) and obstacles where they are."""
    data.qpos[:] = qpos
    for k in range(len(obstacles)):
        data.mocap_pos[k, :2] = obstacles[k, :2]
    mujoco.mj_forward(model, data)


def frames(
    qpos: np.ndarray, obstacles: np.ndarray, width: int = 400, height: int = 300
) -> list[np.ndarray]:
    """Pictures uint8 [height, width, 3] of a trial's instants, by a camera beside the dog.

    qpos: [N, full's coordinates]; obstacles: [N, K, 3].  Raises ValueError where no OpenGL back
    end works.
    """
    model = scene_model(obstacles[0])
    data = mujoco.MjData(model)
    renderer = _renderer(model, height, width)
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation, camera.azimuth = _camera(qpos)
    pictures = []
    try:
        for n in range(len(qpos)):
            place(model, data, qpos[n], obstacles[n])
            camera.lookat[:] = (*qpos[n, :2], 0.06)
            renderer.update_scene(data, camera)
            pictures.append(renderer.render().copy())
    finally:
        renderer.close()
    return pictures


def _renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    try:
        if not os.environ.get("MUJOCO_GL") and _headless():
            # MuJoCo chooses when it is imported, and without a display chooses wrongly.
            os.environ["MUJOCO_GL"] = "egl"
            importlib.reload(gl_context)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return mujoco.Renderer(model, height, width)
    # Each back end fails with errors of its own library.
    except Exception as error:
        backend = os.environ.get("MUJOCO_GL", "its default for this display")
        raise ValueError(
            f"MuJoCo cannot draw here with {backend} ({type(error).__name__}: {error}): set"
            " MUJOCO_GL=egl (Debian: libegl1 libgl1-mesa-dri) or MUJOCO_GL=osmesa (libosmesa6);"
            " an .html replay needs neither"
        ) from error


def _headless() -> bool:
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    return platform.system() == "Linux" and not any(os.environ.get(s) for s in screens)


def _need_display() -> None:
    if _headless():
        raise ValueError(
            "MuJoCo's viewer needs a display (neither DISPLAY nor WAYLAND_DISPLAY is set)"
        )


def _camera(qpos: np.ndarray) -> tuple[float, float, float]:
    """Distance in m, elevation and azimuth in degrees, from the dog: from above obstacles, and
    outwards from the field's middle, so that little hides the dog."""
    return 1.1, -42.0, 120.0 if qpos[:, 1].mean() > 0 else -60.0


def view(qpos: np.ndarray, obstacles: np.ndarray, dt: float) -> None:
    """Play a trial in MuJoCo's own viewer, over and over, until its window is closed.

    dt: s a frame.  Raises ValueError where there is no display.
    """
    _need_display()
    import mujoco.viewer

    model = scene_model(obstacles[0])
    data = mujoco.MjData(model)
    panels = {"show_left_ui": False, "show_right_ui": False}
    with mujoco.viewer.launch_passive(model, data, **panels) as window:
        # It follows the dog, and the mouse turns it.
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = model.body("trunk").id
        window.cam.distance, window.cam.elevation, window.cam.azimuth = _camera(qpos)
        n = 0
        while window.is_running():
            place(model, data, qpos[n], obstacles[n])
            window.sync()
            time.sleep(dt)
            n = (n + 1) % len(qpos)
