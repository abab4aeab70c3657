"""Logs of a robot that drives about the field and sees landmarks, with the truth.

Several ways to drive, to read "15 % at random" and to look about, so that nothing is fitted to one.
"""

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments import script

DRIVES = ("waypoints", "circles", "points", "wander", "sideways", "weave")
# Gutmann and Fox's five points, m.
POINTS = ((0.0, 0.0), (0.5, 0.0), (0.5, -0.5), (-1.0, 0.5), (-1.0, 0.0))


@dataclasses.dataclass(frozen=True)
class Settings:
    """How a log is made: SI units, shares; the defaults are those of the usual log."""

    drive: str = "waypoints"
    """one of DRIVES."""
    seconds: float = 120.0
    """length."""
    dt: float = 0.1
    """time between odometry rows, s."""
    speed: float = 0.15
    """m/s."""
    range_noise: float = 0.07
    """standard deviation of a distance, share of it."""
    bearing_noise: float = math.radians(2.0)
    """standard deviation of a bearing, rad."""
    sightings: float = 0.65
    """landmarks a step."""
    head: str = "pan"
    """"pan": a camera of 57.6 degrees sweeps over +-90; "any": in any direction."""
    misnamed: float = 0.0
    """share of the landmarks with another's name."""
    scale: float = 0.08
    """the odometry's systematic error; negative: too short."""
    random: float = 0.15
    """its random error, a share."""
    random_kind: str = "component"
    """"component": of each number of each row; "length": the same spread ahead and aside;
    "slow": of each number, the same for a second."""
    drift: float = 0.02
    """of the odometry's heading, rad/s."""
    kidnapped: tuple[float, ...] = ()
    """when the robot is put elsewhere, s."""
    started: bool = True
    """the log begins with the true pose."""


class Log(NamedTuple):
    """rows: (time, kind, name, a, b, c); truth [steps + 1, 4]: time, x, y, heading."""

    rows: list[tuple]
    truth: np.ndarray


def _wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


class _Driver:
    """Velocities (ahead, aside, turning) from the pose, one call a step."""

    def __init__(self, rng, s: Settings):
        self.rng, self.s, self.n = rng, s, 0
        self.goal, self.wait = np.zeros(2), 0
        self.v = np.zeros(3)
        self.sign = rng.choice([-1, 1])
        self._next()

    def _next(self):
        if self.s.drive == "points":
            self.goal = np.array(POINTS[self.n % 5])
            self.n += 1
        else:
            self.goal = self.rng.uniform([-1.25, -0.75], [1.25, 0.75])

    def __call__(self, pose, k):
        s, rng = self.s, self.rng
        to = self.goal - pose[:2]
        if np.hypot(*to) < 0.08:
            self.wait = 30 if s.drive == "points" else 0
            self._next()
            to = self.goal - pose[:2]
        if self.wait:
            self.wait -= 1
            return np.zeros(3)
        error = _wrap(math.atan2(to[1], to[0]) - pose[2])
        if s.drive in ("waypoints", "points"):
            omega = np.clip(2 * error, -1, 1)
            return np.array([s.speed * max(0.0, math.cos(error)) * (abs(error) < 1), 0, omega])
        if s.drive == "sideways":
            local = s.speed * np.array([math.cos(error), math.sin(error)])
            return np.array([*local, 0.3 * self.sign * math.sin(k * s.dt / 5)])
        if s.drive == "circles":
            # About the field's centre, from wherever it starts.
            r = math.hypot(pose[0], pose[1])
            tangent = math.atan2(pose[1], pose[0]) + self.sign * (math.pi / 2 + 1.5 * (r - 0.55))
            error = _wrap(tangent - pose[2])
            return np.array([s.speed, 0, np.clip(2 * error + self.sign * s.speed / 0.55, -1, 1)])
        if s.drive == "weave":
            wave = 0.8 * math.sin(k * s.dt * 2.0)
            return np.array([s.speed, 0, np.clip(1.5 * error, -0.7, 0.7) + wave])
        # wander: smooth random velocities, turned back at the walls.
        self.v += 0.1 * (rng.normal(0, [0.1, 0.05, 0.6]) - 0.3 * self.v)
        if max(abs(pose[0]) - 1.1, abs(pose[1]) - 0.6) > 0:
            centre = _wrap(math.atan2(-pose[1], -pose[0]) - pose[2])
            return np.array([s.speed * max(0.0, math.cos(centre)), 0, np.clip(2 * centre, -1, 1)])
        return np.array([s.speed, 0, 0]) + self.v


def make(settings: Settings, landmarks: dict[str, tuple[float, float]], seed: int) -> Log:
    """One log.  landmarks: name -> x, y (m)."""
    rng = np.random.default_rng(seed)
    s = settings
    names = list(landmarks)
    place = np.array(list(landmarks.values()))
    pose = np.array([*rng.uniform([-1.2, -0.7], [1.2, 0.7]), rng.uniform(-np.pi, np.pi)])
    driver = _Driver(rng, s)
    rows: list[tuple] = []
    truth = [[0.0, *pose]]
    if s.started:
        rows.append((0.0, "start", "", *(f"{v:.6f}" for v in pose)))
    lift = {round(t / s.dt) for t in s.kidnapped}
    slow = rng.normal(size=3)
    # Of a panning camera a fraction of the landmarks is in sight; found so often that `sightings`
    # come out on the average (0.96 of six are in view with this sweep).
    view = math.radians(57.6 / 2)
    for k in range(1, round(s.seconds / s.dt) + 1):
        t = k * s.dt
        v = driver(pose, k)
        d = v * s.dt
        turn = d[2]
        c, si = math.cos(pose[2] + turn / 2), math.sin(pose[2] + turn / 2)
        pose = pose + np.array([c * d[0] - si * d[1], si * d[0] + c * d[1], turn])
        pose[:2] = np.clip(pose[:2], [-1.4, -0.9], [1.4, 0.9])
        pose[2] = _wrap(pose[2])
        if k in lift:
            pose = np.array([*rng.uniform([-1.2, -0.7], [1.2, 0.7]), rng.uniform(-np.pi, np.pi)])
            driver._next()
        if s.random_kind == "component":
            noise = s.random * rng.normal(size=3) * d
        elif s.random_kind == "length":
            length = math.hypot(d[0], d[1])
            noise = s.random * rng.normal(size=3) * [length, length, abs(turn)]
        else:
            slow = rng.normal(size=3) if k % 10 == 0 else slow
            noise = s.random * slow * d
        reading = d * (1 + s.scale) + noise + [0, 0, s.drift * s.dt]
        stamp = round(t, 3)
        rows.append((stamp, "odometry", "", *(f"{x:.6f}" for x in reading)))
        truth.append([stamp, *pose])
        off = place - pose[:2]
        bearing = _wrap(np.arctan2(off[:, 1], off[:, 0]) - pose[2])
        if s.head == "pan":
            pan = math.radians(90) * math.sin(2 * math.pi * t / 3.0)
            seen = (np.abs(_wrap(bearing - pan)) < view) & (rng.random(len(names)) < s.sightings)
        else:
            seen = rng.random(len(names)) < s.sightings / len(names)
        for i in np.flatnonzero(seen):
            d_true = math.hypot(*off[i])
            j = i
            if rng.random() < s.misnamed:
                j = rng.choice([n for n in range(len(names)) if n != i])
            dist = d_true * (1 + s.range_noise * rng.normal())
            b = _wrap(bearing[i] + s.bearing_noise * rng.normal())
            rows.append((stamp, "landmark", names[j], f"{max(dist, 0.01):.5f}", f"{b:.5f}", ""))
    return Log(rows, np.array(truth))


def write(log: Log, path: Path, truth: Path) -> None:
    """As `fntg localize` reads them."""
    script.write_csv(path, ("time", "kind", "name", "a", "b", "c"), log.rows)
    poses = [[f"{x:.6g}" for x in row] for row in log.truth]
    script.write_csv(truth, ("time", "x", "y", "heading"), poses)
