"""How well Vision sees: judged on pictures of MuJoCo's renderer that calibration never saw.

    python -m experiments.vision

Random scenes (ball, five other robots, any place), light 0.6 to 1.4, blur and noise on.  A quarter
of the robots look towards the ball, the others towards a landmark.  Truth and visibility come from
MuJoCo, too.  --hard: light 0.3 to 2, three times the noise, more than the colour table knows.
Prints one table, with Wilson 95 % intervals, and how often those of a confidence were right; --json
for machines.  --speed times drawing and seeing of our own pictures instead, on the cores it has.
"""

import dataclasses
import json
import os
import sys
import time
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Camera
from envs.field import FIELD
from envs.soccer import image, image_mjcf
from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.robot import colours, sight, vision
from fntg_jax.running import statistics, xla

ROBOTS = 5
BATCH = 32
BLUR, NOISE = 0.12, 4.0
WRONG = 10.0  # degrees: what is farther off is another thing
CONFIDENCES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0001)


@dataclasses.dataclass(frozen=True)
class Options:
    """Vision judged on MuJoCo's pictures."""

    frames: int = 2000
    """pictures."""
    seed: int = 1
    """of the scenes."""
    hard: bool = False
    """light and noise beyond what the colour table was calibrated for."""
    speed: bool = False
    """pictures a second instead: the fastest of seven repetitions."""
    json: bool = False
    """print JSON."""


def scenes(rng: np.random.Generator, count: int) -> tuple[image.Scene, np.ndarray, np.ndarray]:
    """Random scenes, and pose and neck joints of a sixth robot that stands clear of all."""
    place = lambda *n: rng.uniform((-1.3, -0.8), (1.3, 0.8), (*n, 2))  # noqa: E731
    ball = np.concatenate([place(count), np.full((count, 1), FIELD.ball_radius)], 1)
    turn = rng.uniform(-np.pi, np.pi, (count, ROBOTS, 1))
    others = np.concatenate([place(count, ROBOTS), turn], -1)
    pose = np.empty((count, 3))
    pose[:, 2] = rng.uniform(-np.pi, np.pi, count)
    for n in range(count):
        while True:
            pose[n, :2] = rng.uniform((-1.2, -0.7), (1.2, 0.7))
            gaps = np.hypot(*(others[n, :, :2] - pose[n, :2]).T)
            if gaps.min() > 0.3 and np.hypot(*(ball[n, :2] - pose[n, :2])) > 0.25:
                break
    # Half of the heads look towards the ball, half anywhere.
    away = np.arctan2(ball[:, 1] - pose[:, 1], ball[:, 0] - pose[:, 0])
    pose[::2, 2] = away[::2] + rng.uniform(-0.4, 0.4, len(away[::2]))
    head = rng.uniform((-0.7, -1.0, -0.2), (0.1, 1.0, 0.2), (count, 3))
    head[::2, 1] *= 0.2
    scene = image.Scene(
        jnp.asarray(ball, jnp.float32),
        jnp.asarray(others, jnp.float32),
        jnp.asarray(np.tile((0, 0, 1, 1, 1), (count, 1))),
        jnp.asarray(rng.random((count, ROBOTS)) < 0.7),
    )
    return scene, pose, head


def towards_landmarks(rng: np.random.Generator, pose: np.ndarray, head: np.ndarray) -> None:
    """Turn three of four of some `scenes` towards a landmark, level or somewhat up or down."""
    for n in range(len(pose)):
        if n % 4:
            mark = FIELD.landmarks[rng.integers(len(FIELD.landmarks))]
            away = np.arctan2(mark.y - pose[n, 1], mark.x - pose[n, 0])
            pose[n, 2] = away + rng.uniform(-0.4, 0.4)
            head[n] = rng.uniform((-0.3, -0.2, -0.2), (0.3, 0.2, 0.2))


class Stage:
    """MuJoCo's model of the field, and its renderer."""

    def __init__(self, num_robots: int = ROBOTS):
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(image_mjcf.mjcf(num_robots))
        self.data = mujoco.MjData(self.model)
        self.model.vis.quality.shadowsize = 512  # half of a picture's time at 2048
        self.renderer = mujoco.Renderer(self.model, Camera().height, Camera().width)
        names = [self.model.geom(g).name.split(":")[0] for g in range(self.model.ngeom)]
        self.geoms = np.array(names)

    def put(self, scene: image.Scene, eye: image.Eye, n: int, light: float = 1.0) -> None:
        """Put everything of scene n in its place."""
        num = scene.robots.shape[1]
        data, model = self.data, self.model
        data.mocap_pos[0] = scene.ball[n]
        for k in range(num):
            x, y, heading = np.asarray(scene.robots[n, k], float)
            data.mocap_pos[1 + k] = (x, y, 0.0 if scene.present[n, k] else -5.0)
            data.mocap_quat[1 + k] = (np.cos(heading / 2), 0, 0, np.sin(heading / 2))
        ahead, left, up = np.asarray(eye.axes[n], float)
        data.mocap_pos[1 + num] = np.asarray(eye.place[n])
        # MuJoCo's cameras look along -z, with x to the right and y up.
        axes = np.stack([-left, up, -ahead], 1).ravel()
        self.mujoco.mju_mat2Quat(data.mocap_quat[1 + num], axes)
        model.vis.headlight.ambient[:] = light * image.AMBIENT
        model.light_diffuse[:] = light * (1 - image.AMBIENT)
        self.mujoco.mj_forward(model, data)

    def segmented(self) -> np.ndarray:
        """The geom that every pixel shows, -1 for none."""
        self.renderer.enable_segmentation_rendering()
        self.renderer.update_scene(self.data, camera="eye")
        geoms = self.renderer.render()[:, :, 0].copy()
        self.renderer.disable_segmentation_rendering()
        return geoms

    def picture(self) -> np.ndarray:
        self.renderer.update_scene(self.data, camera="eye")
        return self.renderer.render().copy()


def spoilt(picture: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> np.ndarray:
    """Blur and noise (standard deviation, levels of 255)."""
    picture = picture.astype(np.float32)
    for axis in (0, 1):
        padded = np.pad(picture, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        n = picture.shape[axis]
        sides = padded.take(range(n), axis) + padded.take(range(2, n + 2), axis)
        picture = picture + BLUR * (sides - 2 * picture)
    picture += noise * rng.standard_normal(picture.shape, np.float32)
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)


def truths(stage: Stage, scene, eye, pose, n: int) -> dict[str, tuple]:
    """By object: share of it that is in view, distance from the robot's centre (m), bearing and
    elevation from the camera's axis (rad)."""
    geoms = stage.segmented()
    pixels = np.bincount(geoms[geoms >= 0], minlength=len(stage.geoms))
    middle = FIELD.landmark_foot + FIELD.landmark_band
    focal = Camera().width / 2 / np.tan(Camera().horizontal / 2)
    focal2 = focal * Camera().height / 2 / np.tan(Camera().vertical / 2)
    found: dict[str, tuple] = {}
    places = {"ball": tuple(np.asarray(scene.ball[n], float))}
    places |= {f"landmark{k}": (m.x, m.y, middle) for k, m in enumerate(FIELD.landmarks)}
    for name, place in places.items():
        ahead, left, up = np.asarray(eye.axes[n], float) @ (place - np.asarray(eye.place[n], float))
        slant = np.sqrt(ahead**2 + left**2 + up**2)
        if name == "ball":
            full = np.pi * FIELD.ball_radius**2
            parts = pixels[stage.geoms == name]
        else:
            full = 2 * FIELD.landmark_radius * FIELD.landmark_band
            parts = pixels[stage.geoms == name][1:]  # white, lower, upper
        # Pixels of the undistorted picture grow towards its edges.
        stretch = (slant / max(ahead, 1e-3)) ** 3
        share = min(1.0, parts.min() / (full * focal2 / slant**2 * stretch)) if ahead > 0.05 else 0
        distance = np.hypot(place[0] - pose[n, 0], place[1] - pose[n, 1])
        bearing, elevation = np.arctan2(left, ahead), np.arctan2(up, np.hypot(ahead, left))
        found[name] = (share, distance, bearing, elevation)
    return found


def judge(options: Options) -> dict[str, Any]:
    rng = np.random.default_rng(options.seed)
    stage, table = Stage(), colours.load("ers210")
    sizes = sight.sizes_of(
        FIELD.ball_radius, FIELD.landmark_foot, FIELD.landmark_band, FIELD.goal_height
    )

    @jax.jit
    def see(pictures, heads):
        def one(picture, head):
            s = vision.see(picture, table, vision.Team(), vision.bands(FIELD))
            seen = sight.locate(s.frame, head, sizes)
            return s.frame.visible, s.frame.bearing, s.confidence, seen.distance

        return jax.vmap(one)(pictures, heads)

    place = jax.jit(jax.vmap(image.eye))
    # Rows: share, distance, seen, bearing error, distance error, confidence.
    ball: list[tuple] = []
    marks: list[tuple] = []
    lightness, noise = ((0.3, 2.0), 3 * NOISE) if options.hard else ((0.6, 1.4), NOISE)
    for _ in range(-(-options.frames // BATCH)):
        scene, pose, head = scenes(rng, BATCH)
        towards_landmarks(rng, pose, head)
        eye = place(jnp.asarray(pose, jnp.float32), jnp.asarray(head, jnp.float32))
        eye = jax.tree.map(np.asarray, eye)
        scene = jax.tree.map(np.asarray, scene)
        lights = rng.uniform(*lightness, BATCH)
        pictures, truth = [], []
        for n in range(BATCH):
            stage.put(scene, eye, n, lights[n])
            truth.append(truths(stage, scene, eye, pose, n))
            pictures.append(spoilt(stage.picture(), rng, noise))
        visible, bearing, sure, distance = (
            np.asarray(leaf) for leaf in see(np.stack(pictures), jnp.asarray(head, jnp.float32))
        )
        for n in range(BATCH):
            for k in range(7):
                share, far, angle, _ = truth[n]["ball" if k == 0 else f"landmark{k - 1}"]
                off = np.degrees(abs(bearing[n, k] - angle))
                row = (share, far, visible[n, k], off, distance[n, k] / far - 1, sure[n, k])
                (ball if k == 0 else marks).append(row)
        if len(ball) % (64 * BATCH) == 0:
            so_far = wrong(np.array(ball)).sum(), np.sum(marks, 0)[2], wrong(np.array(marks)).sum()
            print(f"{len(ball)}: false balls, named, wrong", *so_far, file=sys.stderr, flush=True)
    return summary(np.array(ball, float), np.array(marks, float))


def speed() -> dict[str, Any]:
    """Pictures a second, drawn with every option of the light and seen."""
    rng, table = np.random.default_rng(0), colours.load("ers210")
    scene, pose, head = scenes(rng, BATCH)
    eye = jax.vmap(image.eye)(jnp.asarray(pose, jnp.float32), jnp.asarray(head, jnp.float32))
    of_all = lambda value: jnp.full(BATCH, value)  # noqa: E731
    light = image.Light(
        light=jnp.asarray(rng.uniform(0.6, 1.4, BATCH), jnp.float32),
        shading=of_all(1.0),
        shadows=of_all(0.35),
        balance=jnp.ones((BATCH, 3)),
        blur=of_all(BLUR),
        noise=of_all(NOISE),
        seed=jnp.arange(BATCH),
    )
    draw = jax.jit(jax.vmap(image.render))
    see = lambda p: vision.see(p, table, vision.Team(), vision.bands(FIELD))  # noqa: E731
    one, all_of = jax.jit(see), jax.jit(jax.vmap(see))
    pictures = draw(scene, eye, light)

    def fastest(call) -> float:
        jax.block_until_ready(call())
        seconds = []
        for _ in range(7):
            begin = time.perf_counter()
            jax.block_until_ready(call())
            seconds.append(time.perf_counter() - begin)
        return BATCH / min(seconds)

    return {
        "pictures/s drawn": fastest(lambda: draw(scene, eye, light)),
        "pictures/s seen, vmap": fastest(lambda: all_of(pictures)),
        "pictures/s seen, one by one": fastest(lambda: [one(p) for p in pictures]),
    }


def wrong(rows: np.ndarray) -> np.ndarray:
    """Which of the rows name something that is not there, or elsewhere."""
    return (rows[:, 2] > 0) & ((rows[:, 0] == 0) | (rows[:, 3] > WRONG))


def summary(ball: np.ndarray, marks: np.ndarray) -> dict[str, Any]:
    frames = len(ball)
    rows: dict[str, Any] = {"frames": frames}

    def share(name, hits, of):
        rate = statistics.wilson(int(hits), max(int(of), 1))
        rows[name] = {"share": rate.share, "low": rate.low, "high": rate.high, "of": int(of)}

    near = ball[(ball[:, 0] >= 0.5) & (ball[:, 1] < 2.0)]
    share("ball found, half visible, within 2 m", near[:, 2].sum(), len(near))
    share("false balls per frame", wrong(ball).sum(), frames)
    clear = marks[(marks[:, 0] >= 0.5) & (marks[:, 1] < 2.5)]
    share("landmarks found, half visible, within 2.5 m", clear[:, 2].sum(), len(clear))
    share("landmarks named that are not there", wrong(marks).sum(), marks[:, 2].sum())
    for name, rows_ in (("ball", ball), ("landmark", marks)):
        good = rows_[(rows_[:, 2] > 0) & (rows_[:, 0] > 0.5) & ~wrong(rows_)]
        rows[f"{name}: direction error, degrees, median"] = float(np.median(good[:, 3]))
        for middle in (0.5, 1.0, 1.5, 2.0):
            here = good[np.abs(good[:, 1] - middle) < 0.1 * middle]
            if len(here):
                key = f"{name}: distance error at {middle} m, median"
                rows[key] = float(np.median(np.abs(here[:, 4])))
        for low, high in pairwise(CONFIDENCES):
            named = rows_[(rows_[:, 2] > 0) & (rows_[:, 5] >= low) & (rows_[:, 5] < high)]
            if len(named):
                right = len(named) - wrong(named).sum()
                share(
                    f"{name}: right of those of confidence {low:g} to {min(high, 1):g}",
                    right,
                    len(named),
                )
    return rows


def main() -> None:
    options = script.options(Options, __doc__, "experiments/vision.py")
    os.environ.setdefault("MUJOCO_GL", "egl")
    xla.configure()
    try:
        script.check_least(options, frames=1)
        rows = speed() if options.speed else judge(options)
    except ValueError as error:
        refuse(str(error))
    if options.json:
        json.dump(rows, sys.stdout, allow_nan=False)
        print()
        return
    for name, value in rows.items():
        if isinstance(value, dict):
            words = f"{value['share']:.4f} [{value['low']:.4f}, {value['high']:.4f}]"
            print(f"{name:50s} {words} of {value['of']}")
        else:
            print(f"{name:50s} {value:.4g}")


if __name__ == "__main__":
    main()
