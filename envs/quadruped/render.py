"""Pictures of the dog: frames of an episode, as an animation and as key frames."""

import os
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from envs.quadruped import mjcf, physics

_NO_BACKEND = (
    "MuJoCo cannot draw here: set MUJOCO_GL=egl (Debian: libegl1 libgl1-mesa-dri) or"
    " MUJOCO_GL=osmesa (libosmesa6), before Python starts"
)


def scene_model(obstacles: np.ndarray) -> mujoco.MjModel:
    """The full model with obstacle robots of the given radii.  obstacles: [K, 3], x, y, radius."""
    num = len(obstacles)
    model = mujoco.MjModel.from_xml_string(mjcf.mjcf(mjcf.FULL, num_obstacles=num))
    for k in range(num):
        model.geom(f"obstacle{k}").size[0] = obstacles[k, 2]
    return model


def place(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    qpos: np.ndarray,
    ball: np.ndarray,
    obstacles: np.ndarray,
) -> None:
    """Put dog (lean's 19 or full's coordinates), ball (x, y) and obstacles where they are."""
    data.qpos[:] = model.qpos0
    data.qpos[: len(qpos)] = qpos
    if len(qpos) == physics.NUM_Q:
        address = model.jnt_qposadr[model.joint("ball").id]
        data.qpos[address : address + 2] = ball
    for k in range(len(obstacles)):
        data.mocap_pos[k, :2] = obstacles[k, :2]
    mujoco.mj_forward(model, data)


def frames(
    qpos: np.ndarray,
    ball: np.ndarray,
    obstacles: np.ndarray,
    width: int = 480,
    height: int = 360,
    follow: bool = True,
) -> list[np.ndarray]:
    """Pictures [height, width, 3] of an episode's instants.

    qpos: [N, 19 or more]; ball: [N, 2]; obstacles: [N, K, 3].  follow: the camera stays with the
    dog; otherwise it shows the field.  Raises ValueError where no OpenGL back end works.
    """
    model = scene_model(obstacles[0])
    data = mujoco.MjData(model)
    renderer = _renderer(model, height, width)
    camera = mujoco.MjvCamera()
    view_from = (0.9, -20, 120) if follow else (3.4, -45, 90)
    camera.distance, camera.elevation, camera.azimuth = view_from
    pictures = []
    try:
        for n in range(len(qpos)):
            place(model, data, qpos[n], ball[n], obstacles[n])
            camera.lookat[:] = (*qpos[n, :2], 0.06) if follow else (0, -0.1, 0)
            renderer.update_scene(data, camera)
            pictures.append(renderer.render().copy())
    finally:
        renderer.close()
    return pictures


def _renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    if os.environ.get("MUJOCO_GL", "") == "" and not os.environ.get("DISPLAY"):
        raise ValueError(_NO_BACKEND)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return mujoco.Renderer(model, height, width)
    # Each back end fails with errors of its own library.
    except Exception as error:
        raise ValueError(f"{_NO_BACKEND} ({type(error).__name__}: {error})") from error


def save(
    pictures: list[np.ndarray], path: Path, dt: float = 0.1, num_key_frames: int = 6
) -> list[Path]:
    """Write an animation (GIF or WebP by the path's ending) and key frames PATH-key-N.png.

    dt: seconds a frame.  Returns the files.  Raises ValueError for another ending.
    """
    from PIL import Image

    if path.suffix not in (".gif", ".webp"):
        raise ValueError(f"{path.name}: an animation is .gif or .webp")
    images = [Image.fromarray(p) for p in pictures]
    options: dict[str, Any] = {"save_all": True, "append_images": images[1:], "loop": 0}
    images[0].save(path, duration=round(1000 * dt), **options)
    written = [path]
    for n, i in enumerate(np.linspace(0, len(images) - 1, num_key_frames).round().astype(int)):
        key = path.with_name(f"{path.stem}-key-{n}.png")
        images[i].save(key)
        written.append(key)
    return written


def view(qpos: np.ndarray, ball: np.ndarray, obstacles: np.ndarray, dt: float = 0.1) -> None:
    """Play an episode in MuJoCo's own viewer, over and over, until its window is closed.

    Raises ValueError where there is no display.
    """
    import time

    if not os.environ.get("DISPLAY") and os.name == "posix":
        raise ValueError("MuJoCo's viewer needs a display (DISPLAY is not set)")
    import mujoco.viewer

    model = scene_model(obstacles[0])
    data = mujoco.MjData(model)
    with mujoco.viewer.launch_passive(model, data) as window:
        n = 0
        while window.is_running():
            place(model, data, qpos[n], ball[n], obstacles[n])
            window.sync()
            time.sleep(dt)
            n = (n + 1) % len(qpos)


def episode(env: Any, scene: Any, control: Any, num_steps: int = 220, substeps: bool = False):
    """Record one trial for `frames`: (qpos [N, 19], ball [N, 2], obstacles [N, K, 3], seconds a
    frame).

    control: observation -> command, jittable.  substeps: every physics step instead of every
    control step, for slow motion (ball and obstacles stay within a control step).
    """
    import jax
    import jax.numpy as jnp

    physics_step = physics.step_fn(env.solver)

    def control_step(state, _):
        command = control(env.observe(state))
        seen = env.snapshot(state)
        path = state.qpos[None]
        if substeps:
            wanted = jnp.stack([command.v, jnp.zeros_like(command.v), command.omega])
            _, targets = env.targets(state, wanted)

            def substep(carry, ctrl):
                return physics_step(*carry, ctrl), carry[0]

            _, path = jax.lax.scan(substep, (state.qpos, state.qvel), targets)
        return env.step(state, command), (path, seen.ball, seen.obstacles)

    @jax.jit
    def record(env, scene):
        return jax.lax.scan(control_step, env.reset(scene), None, length=num_steps)[1]

    path, ball, obstacles = jax.tree.map(np.asarray, record(env, scene))
    times = path.shape[1]
    qpos = path.reshape(-1, path.shape[-1])
    return qpos, np.repeat(ball, times, 0), np.repeat(obstacles, times, 0), env.dt / times
