"""How well Vision sees: judged on pictures of MuJoCo's renderer that calibration never saw.

    python -m experiments.vision

Random scenes (ball, five other robots, any place, head level to 40 degrees down), light 0.6 to
1.4, blur and noise on.  Truth and visibility come from MuJoCo, too.  Prints one table, with Wilson
95 % intervals; --json for machines.
"""

import dataclasses
import json
import os
import sys
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from envs.base import Camera
from envs.field import FIELD
from envs.soccer import image, image_mjcf
from experiments import script
from fntg_jax.robot import colours, sight, vision
from fntg_jax.running import statistics, xla

ROBOTS = 5
BATCH = 32
BLUR, NOISE = 0.12, 4.0


@dataclasses.dataclass(frozen=True)
class Options:
    """Vision judged on MuJoCo's pictures."""

    frames: int = 2000
    """pictures."""
    seed: int = 1
    """of the scenes."""
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


class Stage:
    """MuJoCo's model of the field, and its renderer."""

    def __init__(self, num_robots: int = ROBOTS):
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(image_mjcf.mjcf(num_robots))
        self.data = mujoco.MjData(self.model)
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


def spoilt(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Blur and noise."""
    picture = picture.astype(np.float32)
    for axis in (0, 1):
        padded = np.pad(picture, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        n = picture.shape[axis]
        sides = padded.take(range(n), axis) + padded.take(range(2, n + 2), axis)
        picture = picture + BLUR * (sides - 2 * picture)
    picture += NOISE * rng.standard_normal(picture.shape, np.float32)
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
            s = vision.see(picture, table, vision.Team(), FIELD)
            seen = sight.locate(s.frame, head, sizes)
            return s.frame.visible, s.frame.bearing, s.confidence, seen.distance

        return jax.vmap(one)(pictures, heads)

    ball: list[tuple] = []
    marks: list[tuple] = []  # rows: share, distance, seen, bearing error, distance error
    false_balls = named = wrong = 0
    for _ in range(-(-options.frames // BATCH)):
        scene, pose, head = scenes(rng, BATCH)
        eye = jax.vmap(image.eye)(jnp.asarray(pose, jnp.float32), jnp.asarray(head, jnp.float32))
        eye = jax.tree.map(np.asarray, eye)
        scene = jax.tree.map(np.asarray, scene)
        lights = rng.uniform(0.6, 1.4, BATCH)
        pictures, truth = [], []
        for n in range(BATCH):
            stage.put(scene, eye, n, lights[n])
            truth.append(truths(stage, scene, eye, pose, n))
            pictures.append(spoilt(stage.picture(), rng))
        visible, bearing, _, distance = (
            np.asarray(leaf) for leaf in see(np.stack(pictures), jnp.asarray(head, jnp.float32))
        )
        for n in range(BATCH):
            for k in range(7):
                share, far, angle, _ = truth[n]["ball" if k == 0 else f"landmark{k - 1}"]
                off = np.degrees(abs(bearing[n, k] - angle))
                row = (share, far, visible[n, k], off, distance[n, k] / far - 1)
                (ball if k == 0 else marks).append(row)
                if visible[n, k] and k == 0:
                    false_balls += share == 0 or off > 10
                elif visible[n, k]:
                    named += 1
                    wrong += share == 0 or off > 10
    return summary(np.array(ball, float), np.array(marks, float), false_balls, named, wrong)


def summary(ball: np.ndarray, marks: np.ndarray, false_balls: int, named: int, wrong: int):
    frames = len(ball)
    rows: dict[str, Any] = {"frames": frames}

    def share(name, hits, of):
        rate = statistics.wilson(int(hits), max(int(of), 1))
        rows[name] = {"share": rate.share, "low": rate.low, "high": rate.high, "of": int(of)}

    near = ball[(ball[:, 0] >= 0.5) & (ball[:, 1] < 2.0)]
    share("ball found, half visible, within 2 m", near[:, 2].sum(), len(near))
    share("false balls per frame", false_balls, frames)
    clear = marks[(marks[:, 0] >= 0.5) & (marks[:, 1] < 2.5)]
    share("landmarks found, half visible, within 2.5 m", clear[:, 2].sum(), len(clear))
    share("landmarks named that are not there", wrong, named)
    for name, rows_ in (("ball", ball), ("landmark", marks)):
        good = rows_[(rows_[:, 2] > 0) & (rows_[:, 0] > 0.5) & (rows_[:, 3] < 10)]
        rows[f"{name}: direction error, degrees, median"] = float(np.median(good[:, 3]))
        for middle in (0.5, 1.0, 1.5, 2.0):
            here = good[np.abs(good[:, 1] - middle) < 0.1 * middle]
            if len(here):
                key = f"{name}: distance error at {middle} m, median"
                rows[key] = float(np.median(np.abs(here[:, 4])))
    return rows


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    xla.configure()
    script.check_least(options, frames=1)
    rows = judge(options)
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
