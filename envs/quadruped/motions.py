"""Kicks and postures: key frames of 17 set-points as JSON, and what they do in the full model.

A frame says where the joints are at a time; between frames set-points move in straight lines.
Joints that no frame names stay as the standing dog has them.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from envs.quadruped import constants as c
from envs.quadruped import mjcf, native, physics
from envs.quadruped.environment import Quadruped

JOINTS = (
    *(f"{leg}_j{j}" for leg in c.LEGS for j in (1, 2, 3)),
    *("head_tilt", "head_pan", "head_roll", "tail_tilt", "tail_pan"),
)
LOW = np.array(
    [*c.LEG_LOW * 4]
    + [math.radians(c.HEAD_LIMITS[k][0]) for k in ("tilt", "pan", "roll")]
    + [-math.radians(c.TAIL_LIMIT)] * 2
)
HIGH = np.array(
    [*c.LEG_HIGH * 4]
    + [math.radians(c.HEAD_LIMITS[k][1]) for k in ("tilt", "pan", "roll")]
    + [math.radians(c.TAIL_LIMIT)] * 2
)
SPEED = np.array([*c.LEG_SPEED * 4, *c.HEAD_SPEED, c.TAIL_SPEED, c.TAIL_SPEED])
FOLDER = Path(__file__).parent / "data" / "motions"
_BALL_Q, _BALL_V = physics.NUM_Q + 5, physics.NUM_V + 5


class Motion(NamedTuple):
    """times: s, [frames], rising; points: rad, [frames, 17], in the order of `JOINTS`; strike: s,
    when a kick is meant to meet the ball."""

    name: str
    times: np.ndarray
    points: np.ndarray
    strike: float


def load(name_or_path: str | Path, standing: np.ndarray) -> Motion:
    """A motion from its file, or by its name from those shipped.  standing: [17], rad: where it
    begins and what joints do that frames don't name.

    Raises ValueError (file, field, value, what is allowed) on anything that the joints or their
    servos cannot do.
    """
    path = Path(name_or_path)
    if not path.suffix:
        path = FOLDER / f"{name_or_path}.json"
        if not path.exists():
            known = ", ".join(sorted(p.stem for p in FOLDER.glob("*.json")))
            raise ValueError(f"motion = {name_or_path!r}: known are {known}")
    try:
        file = json.loads(path.read_text(encoding="utf-8"))
        frames = [(float(f["time"]), dict(f["joints"])) for f in file["frames"]]
        strike = float(file.get("strike", 0.0))
    except OSError as error:
        raise ValueError(f"motion {path}: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError, AttributeError):
        raise ValueError(
            f"motion {path}: allowed is JSON with 'frames', each with a 'time' and 'joints'"
        ) from None
    times, points = [0.0], [np.array(standing, float)]
    for time, joints in frames:
        point = points[0].copy()
        for joint, angle in joints.items():
            if joint not in JOINTS:
                raise ValueError(f"motion {path}: joint {joint!r}: allowed are {', '.join(JOINTS)}")
            n = JOINTS.index(joint)
            if not (isinstance(angle, (int, float)) and LOW[n] - 1e-6 <= angle <= HIGH[n] + 1e-6):
                raise ValueError(
                    f"motion {path}: {joint} = {angle} at {time} s: allowed are"
                    f" {LOW[n]:.3f} to {HIGH[n]:.3f} rad"
                )
            point[n] = angle
        if not times[-1] < time <= 60:
            raise ValueError(f"motion {path}: time = {time}: allowed are rising ones, up to 60 s")
        speed = np.abs(point - points[-1]) / (time - times[-1])
        if np.any(speed > 1.001 * SPEED):
            n = int(np.argmax(speed / SPEED))
            raise ValueError(
                f"motion {path}: {JOINTS[n]} moves at {speed[n]:.2f} rad/s before {time} s:"
                f" allowed are up to {SPEED[n]:.2f}"
            )
        times.append(time)
        points.append(point)
    return Motion(path.stem, np.array(times), np.array(points), strike)


def set_points(motion: Motion, timestep: float) -> np.ndarray:
    """Set-points [steps, 17] of a motion, a timestep (s) apart."""
    ticks = np.arange(1, math.ceil(motion.times[-1] / timestep) + 1) * timestep
    return np.stack([np.interp(ticks, motion.times, p) for p in motion.points.T], axis=1)


@cache
def _model(timestep: float) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        mjcf.mjcf("full", timestep=timestep, iterations=20, ls_iterations=20, num_obstacles=0)
    )


def standing(env: Quadruped) -> np.ndarray:
    """Set-points [17] of the standing dog, its head and tail at zero."""
    assert env.rest is not None
    return np.concatenate([np.asarray(env.rest)[7:], np.zeros(5)])


class Kicked(NamedTuple):
    """ball: velocity 0.3 s after the motion's strike, m/s, [2] in the frame of the dog's start.
    upright, height: of the trunk at the end, cosine of its tilt and m.  speed: 99th percentile of
    joint speeds over their limits, worst joint."""

    ball: np.ndarray
    upright: float
    height: float
    speed: float


def kick(env: Quadruped, points: np.ndarray, strike: float, ball: np.ndarray) -> Kicked:
    """Play set-points [steps, 17] with a resting ball at [2] (m, dog's frame); full model, C."""
    model = _model(env.solver.timestep)
    data = mujoco.MjData(model)
    data.qpos[: physics.NUM_Q] = env.rest
    data.qpos[_BALL_Q : _BALL_Q + 2] = ball
    every = round(env.dt / env.solver.timestep)
    after = min(round((strike + 0.3) / env.solver.timestep), len(points) + every) - 1
    padded = np.concatenate([points, np.tile(points[-1], (every, 1))])
    speeds, seen = [], np.zeros(2)
    for n, ctrl in enumerate(padded):
        if n % every == 0:
            v = data.qvel[_BALL_V : _BALL_V + 2][None]
            resistance = native.rolling_resistance(v, float(env.ball_deceleration), env.dt)
            data.qfrc_applied[_BALL_V : _BALL_V + 2] = resistance[0]
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data)
        speeds.append(np.abs(data.qvel[physics.NUM_V - 12 : _BALL_V]))
        if n == after:
            seen = data.qvel[_BALL_V : _BALL_V + 2].copy()
    upright = 1 - 2 * float(data.qpos[4] ** 2 + data.qpos[5] ** 2)
    ratio = np.quantile(np.array(speeds), 0.99, axis=0) / SPEED
    return Kicked(seen, upright, float(data.qpos[2]), float(ratio.max()))


def displaced(rng: np.random.Generator, at: np.ndarray, num: int) -> np.ndarray:
    """Where a ball [num, 2] that should lie at `at` may lie when the dog stands up to 2 cm and
    0.2 rad off, uniformly."""
    turn = rng.uniform(-0.2, 0.2, num)
    off = rng.uniform(-1, 1, (4 * num, 2))
    off = 0.02 * off[np.sum(off**2, axis=1) <= 1][:num]
    cos, sin = np.cos(turn), np.sin(turn)
    turned = np.stack([cos * at[0] - sin * at[1], sin * at[0] + cos * at[1]], axis=1)
    return turned + off
