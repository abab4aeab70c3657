"""Kicks and postures: key frames of 17 set-points as JSON, and what they do in the full model.

A frame says where the joints are at a time; between frames set-points move in straight lines.
Joints that no frame names stay as the standing dog has them.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

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
BALL_Q, BALL_V = physics.NUM_Q + 5, physics.NUM_V + 5


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


class Played(NamedTuple):
    """What motions did to N dogs and balls, full model in C.  qpos, qvel: [T, N, coordinates], a
    control step apart.  speed: of the seventeen joints, [N], 99th percentile over their limits,
    worst joint."""

    qpos: np.ndarray
    qvel: np.ndarray
    speed: np.ndarray


def start(env: Quadruped, num: int, ball=(1.0, 0.7)) -> np.ndarray:
    """Coordinates [num, nq] of standing dogs with a resting ball at [2] or [num, 2] (m)."""
    qpos = np.tile(_model(env.solver.timestep).qpos0, (num, 1))
    qpos[:, : physics.NUM_Q] = env.rest
    qpos[:, BALL_Q : BALL_Q + 2] = ball
    return qpos


def play(env: Quadruped, points: np.ndarray, qpos: np.ndarray, qvel: Any = None) -> Played:
    """Play set-points [N, steps, 17] (rad, a timestep apart) from coordinates [N, nq]; the last
    control step is filled up with the last set-points."""
    model = _model(env.solver.timestep)
    num, substeps = len(points), env.solver.substeps
    rest = -points.shape[1] % substeps
    points = np.concatenate([points, np.repeat(points[:, -1:], rest, axis=1)], axis=1)
    qvel = np.zeros((num, model.nv)) if qvel is None else qvel
    at, speeds, path = np.concatenate([qpos, qvel], axis=1), [], []
    size = mujoco.mj_stateSize(model, native.PHYSICS)
    spec = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED
    force = model.nu + BALL_V
    data = mujoco.MjData(model)
    with rollout.Rollout(nthread=1) as pool:
        for n in range(0, points.shape[1], substeps):
            initial = np.zeros((num, size))
            initial[:, 1 : 1 + at.shape[1]] = at
            inputs = np.zeros((num, substeps, model.nu + model.nv))
            inputs[:, :, : model.nu] = points[:, n : n + substeps]
            rolling = at[:, model.nq + BALL_V : model.nq + BALL_V + 2]
            lost = native.rolling_resistance(rolling, float(env.ball_deceleration), env.dt)
            inputs[:, :, force : force + 2] = lost[:, None]
            states, _ = pool.rollout(model, data, initial, inputs, control_spec=int(spec))
            at = states[:, -1, 1 : 1 + model.nq + model.nv]
            joints = 1 + model.nq + physics.NUM_V - 12
            speeds.append(np.abs(states[:, :, joints : joints + 17]))
            path.append(at)
    ratio = np.quantile(np.concatenate(speeds, axis=1), 0.99, axis=1) / SPEED
    whole = np.array(path)
    return Played(whole[..., : model.nq], whole[..., model.nq :], ratio.max(axis=1))


class Kicked(NamedTuple):
    """ball: velocity about 0.3 s after the motion's strike, m/s, [N, 2] in the frame of the dog's
    start.  upright, height: of the trunk at the end, cosine of its tilt and m.  speed: 99th
    percentile of joint speeds over their limits, worst joint."""

    ball: np.ndarray
    upright: np.ndarray
    height: np.ndarray
    speed: np.ndarray


def kick(env: Quadruped, points: np.ndarray, strike: float, balls: np.ndarray) -> Kicked:
    """Play set-points [steps, 17], or [N, steps, 17], with resting balls at [N, 2] (m, dog's
    frame)."""
    points = np.broadcast_to(points, (len(balls), *points.shape[-2:]))
    last = np.repeat(points[:, -1:], 3 * env.solver.substeps, axis=1)
    found = play(env, np.concatenate([points, last], axis=1), start(env, len(balls), balls))
    after = min(round((strike + 0.3) / env.dt), len(found.qvel)) - 1
    end = found.qpos[-1]
    upright = 1 - 2 * (end[:, 4] ** 2 + end[:, 5] ** 2)
    return Kicked(found.qvel[after, :, BALL_V : BALL_V + 2], upright, end[:, 2], found.speed)


def mirrored(points: np.ndarray) -> np.ndarray:
    """Set-points [..., 17] of the mirror image: left and right change places, pan, roll and tail
    their sign."""
    legs = points[..., :12].reshape(*points.shape[:-1], 4, 3)[..., [1, 0, 3, 2], :]
    sign = np.array([1.0, -1.0, -1.0, 1.0, -1.0])
    return np.concatenate([legs.reshape(*points.shape[:-1], 12), points[..., 12:] * sign], axis=-1)


def accelerometer(qpos: np.ndarray) -> np.ndarray:
    """What a resting dog's accelerometer shows [N, 3], in units of gravity: the way up, in the
    trunk's axes."""
    w, i, j, k = qpos[:, 3:7].T
    return np.stack([2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)], axis=1)


class GetUp(NamedTuple):
    """points: [steps, 17].  up: [3], what the accelerometer shows where this motion helps."""

    points: np.ndarray
    up: np.ndarray


@cache
def ways_up(timestep: float, standing: tuple[float, ...]) -> tuple[GetUp, ...]:
    """The motions of the kind get-up and their mirror images."""
    ways = []
    for path in sorted(FOLDER.glob("get-up-*.json")):
        up = np.array(json.loads(path.read_text(encoding="utf-8"))["up"])
        points = set_points(load(path, np.array(standing)), timestep)
        ways += [GetUp(points, up), GetUp(mirrored(points), up * [1, -1, 1])]
    return tuple(ways)


def get_up(env: Quadruped, qpos: np.ndarray, attempts: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Fallen dogs [N, nq] at rest get up: each plays the motion whose `up` is nearest to what its
    accelerometer shows; who stands keeps still.  Returns who stands [N], and coordinates."""
    ways = ways_up(env.solver.timestep, tuple(standing(env).tolist()))
    length = max(len(way.points) for way in ways) + 5 * env.solver.substeps
    qvel = None
    for _ in range(attempts):
        shown = accelerometer(qpos)
        chosen = np.argmax(shown @ np.stack([way.up for way in ways]).T, axis=1)
        points = np.stack(
            [
                np.pad(ways[n].points, ((0, length - len(ways[n].points)), (0, 0)), "edge")
                for n in chosen
            ]
        )
        points[shown[:, 2] > 0.9] = standing(env)
        found = play(env, points, qpos, qvel)
        qpos, qvel = found.qpos[-1], found.qvel[-1]
    return (accelerometer(qpos)[:, 2] > 0.9) & (qpos[:, 2] > 0.07), qpos


def dropped(env: Quadruped, rng: np.random.Generator, num: int) -> np.ndarray:
    """Dogs [num, nq] that were dropped from 0.25 m, turned uniformly at random, two seconds on."""
    qpos = start(env, num)
    turn = rng.normal(size=(num, 4))
    qpos[:, 3:7] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    qpos[:, 2] = 0.25
    still = np.tile(standing(env), (num, round(2 / env.solver.timestep), 1))
    return play(env, still, qpos).qpos[-1]


def displaced(rng: np.random.Generator, at: np.ndarray, num: int) -> np.ndarray:
    """Where a ball [num, 2] that should lie at `at` may lie when the dog stands up to 2 cm and
    0.2 rad off, uniformly."""
    turn = rng.uniform(-0.2, 0.2, num)
    off = rng.uniform(-1, 1, (4 * num, 2))
    off = 0.02 * off[np.sum(off**2, axis=1) <= 1][:num]
    cos, sin = np.cos(turn), np.sin(turn)
    turned = np.stack([cos * at[0] - sin * at[1], sin * at[0] + cos * at[1]], axis=1)
    return turned + off
