"""Logs of odometry and landmarks from CSV files, the poses made of them, and their errors."""

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fntg_jax.files import csv_table, number_of, read_text
from fntg_jax.robot import hypotheses

LOG_HEADER = ["time", "kind", "name", "a", "b", "c"]
MAP_HEADER = ["name", "x", "y"]
POSE_HEADER = ["time", "x", "y", "heading"]
SD_HEADER = ["sd_x", "sd_y", "sd_heading"]


class Poses(NamedTuple):
    """One estimate an odometry row: time [N] (s), pose [N, 3], covariance [N, 3, 3] (m, rad), and
    the probability [N] of being lost."""

    time: np.ndarray
    pose: np.ndarray
    covariance: np.ndarray
    lost: np.ndarray


class Row(NamedTuple):
    """A line of a log, values as they stand there (m, rad; a landmark has no c: 0)."""

    time: float
    kind: str
    name: str
    values: tuple[float, float, float]


def _rows(path: Path, header: list[str]) -> Iterator[tuple[str, list[str]]]:
    """("FILE row N", cells) of every line below the header.  Raises ValueError."""
    text = read_text(path, "log", most=500_000_000).removeprefix("\ufeff")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        first = [cell.strip() for cell in next(reader, [])]
        if first != header:
            raise ValueError(f"{path} row 1: {','.join(first)!r}: must be {','.join(header)!r}")
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            where = f"{path} row {reader.line_num}"
            if len(cells) != len(header):
                raise ValueError(f"{where}: {len(cells)} cells: must be {len(header)}")
            yield where, [cell.strip() for cell in cells]
    except csv.Error as error:
        raise ValueError(f"{path} row {reader.line_num}: {error}") from None


def read_map(path: Path) -> dict[str, tuple[float, float]]:
    """name -> x, y (m) of every landmark.  Raises ValueError naming file and row."""
    found: dict[str, tuple[float, float]] = {}
    for where, (name, x, y) in _rows(path, MAP_HEADER):
        if not name or name in found:
            raise ValueError(f"{where}: name = {name!r}: must be one of its own")
        found[name] = number_of(where, "x", x), number_of(where, "y", y)
    if not found:
        raise ValueError(f"{path}: no landmark")
    return found


def read_log(path: Path, landmarks: dict[str, tuple[float, float]]) -> list[Row]:
    """The rows of a log.  Raises ValueError naming file and row."""
    names = {
        "start": ("x", "y", "heading"),
        "odometry": ("dx", "dy", "dtheta"),
        "landmark": ("distance", "bearing"),
    }
    rows: list[Row] = []
    for where, (time, kind, name, *cells) in _rows(path, LOG_HEADER):
        if kind not in names:
            raise ValueError(f"{where}: kind = {kind!r}: known are {', '.join(names)}")
        if kind == "landmark" and name not in landmarks:
            raise ValueError(f"{where}: name = {name!r}: known are {', '.join(landmarks)}")
        if kind != "landmark" and name:
            raise ValueError(f"{where}: name = {name!r}: must be empty for {kind}")
        when = number_of(where, "time", time)
        if rows and when < rows[-1].time:
            raise ValueError(f"{where}: time = {time}: must not be before {rows[-1].time:g}")
        values = [number_of(where, *pair) for pair in zip(names[kind], cells)]
        if kind == "landmark":
            if cells[2]:
                raise ValueError(f"{where}: c = {cells[2]!r}: must be empty for landmark")
            if values[0] <= 0:
                raise ValueError(f"{where}: distance = {cells[0]}: must be above 0")
            if abs(values[1]) > 2 * math.pi:
                raise ValueError(f"{where}: bearing = {cells[1]}: must be within -2 pi to 2 pi")
            values.append(0.0)
        rows.append(Row(when, kind, name, (values[0], values[1], values[2])))
    if not any(row.kind == "odometry" for row in rows):
        raise ValueError(f"{path}: no odometry row")
    return rows


def _events(rows: list[Row], landmarks: dict[str, tuple[float, float]]):
    """(events, index of the last event of each odometry row): what `hypotheses.run` wants.

    A sighting between two odometry rows is dated: the motion is cut there.  Of rows of one time
    the start comes first, then the motion that ends there, then what is seen.
    """
    index = {name: n for n, name in enumerate(landmarks)}
    order = {"start": 0, "odometry": 1, "landmark": 2}
    rows = sorted(rows, key=lambda row: (row.time, order[row.kind]))
    events: list[tuple] = []
    ends: list[int] = []
    here, last = rows[0].time, rows[0].time  # time of the last event, and of the last odometry row
    upcoming = iter([row for row in rows if row.kind == "odometry"])
    ahead = next(upcoming, None)
    for row in rows:
        # The share of the odometry row that we are in which lies between the last event and this.
        whole = ahead.time - last if ahead is not None else 0.0
        share = (row.time - here) / whole if whole > 0 else float(row.kind == "odometry")
        motion = [share * v for v in ahead.values] if ahead is not None else [0.0] * 3
        event = [*motion, row.time - here, share, -1, 1.0, 0.0, False, (0.0, 0.0, 0.0)]
        here = row.time
        if row.kind == "landmark":
            event[5:8] = index[row.name], row.values[0], row.values[1]
        elif row.kind == "start":
            event[8:] = True, row.values
        events.append(tuple(event))
        if row.kind == "odometry":
            last, ahead = row.time, next(upcoming, None)
            ends.append(len(events) - 1)
        elif ends and row.kind == "landmark" and row.time == last:
            # Seen at the very time of the pose: it counts for it.
            ends[-1] = len(events) - 1
    return events, ends


def localize(rows: list[Row], landmarks: dict[str, tuple[float, float]]) -> Poses:
    """The pose after every odometry row, from that row's time and all before."""
    events, ends = _events(rows, landmarks)
    # Lengths in steps of 1024, so that few logs compile anew; the rest is nothing happening.
    padding = -len(events) % 1024
    events += [(0.0, 0.0, 0.0, 0.0, 1.0, -1, 1.0, 0.0, False, (0.0, 0.0, 0.0))] * padding
    columns = [np.array(column) for column in zip(*events)]
    columns = [c if c.dtype.kind in "bi" else c.astype(np.float32) for c in columns]
    event = hypotheses.Event(*(jnp.asarray(c) for c in columns))
    places = np.array(list(landmarks.values()), np.float32)
    estimate = jax.jit(hypotheses.run)(event, hypotheses.Map(*jnp.asarray(places.T)))
    pose, covariance, lost = (np.asarray(x)[ends] for x in estimate)
    time = np.array([row.time for row in rows if row.kind == "odometry"])
    return Poses(time, pose, covariance, lost)


def table(poses: Poses) -> bytes:
    """CSV: time,x,y,heading,sd_x,sd_y,sd_heading."""
    rows = []
    sd = np.sqrt(np.maximum(np.diagonal(poses.covariance, axis1=1, axis2=2), 0.0))
    for time, pose, spread in zip(poses.time, poses.pose, sd):
        rows.append([f"{time:.12g}", *(f"{x:.6f}" for x in (*pose, *spread))])
    return csv_table(POSE_HEADER + SD_HEADER, rows)


def read_truth(path: Path) -> np.ndarray:
    """[N, 4] time, x, y, heading of a CSV file with that header.  Raises ValueError."""
    found: list[list[float]] = []
    for where, cells in _rows(path, POSE_HEADER):
        row = [number_of(where, *pair) for pair in zip(POSE_HEADER, cells)]
        if found and row[0] < found[-1][0]:
            raise ValueError(f"{where}: time = {cells[0]}: must not be before {found[-1][0]:g}")
        found.append(row)
    if not found:
        raise ValueError(f"{path}: no pose")
    return np.array(found)


def at(truth: np.ndarray, time: np.ndarray) -> np.ndarray:
    """True poses [N, 3] at some times, on straight lines between the rows; NaN outside of them."""
    columns = truth[:, 1], truth[:, 2], np.unwrap(truth[:, 3])
    return np.stack(
        [np.interp(time, truth[:, 0], c, left=np.nan, right=np.nan) for c in columns], axis=1
    )


class Errors(NamedTuple):
    """Per odometry row: position (m), heading (rad, absolute), and the normalised error squared
    (3 on the average where the covariance tells the truth)."""

    position: np.ndarray
    heading: np.ndarray
    squared: np.ndarray


def errors(poses: Poses, truth: np.ndarray) -> Errors:
    """Of the estimates whose time the truth covers; truth [N, 4]."""
    off = poses.pose - at(truth, poses.time)
    inside = np.isfinite(off).all(axis=1)
    off = off[inside]
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    weighed = np.linalg.solve(poses.covariance[inside].astype(float), off[..., None])[..., 0]
    return Errors(np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2]), np.sum(off * weighed, axis=1))


def report(poses: Poses, truth: np.ndarray) -> str:
    """The errors as a table.  Raises ValueError where the truth covers no pose."""
    found = errors(poses, truth)
    if not len(found.position):
        raise ValueError(
            f"truth: covers {truth[0, 0]:g} to {truth[-1, 0]:g} s, the log's odometry "
            f"{poses.time[0]:g} to {poses.time[-1]:g} s"
        )
    lines = [
        f"{f'{len(found.position)} poses':18s}{'mean':>9s}{'median':>9s}{'95 %':>9s}{'largest':>9s}"
    ]
    for name, values in (
        ("position, cm", 100 * found.position),
        ("heading, degrees", np.degrees(found.heading)),
    ):
        row = (values.mean(), np.median(values), np.quantile(values, 0.95), values.max())
        lines.append(f"{name:18s}" + "".join(f"{v:9.2f}" for v in row))
    lines.append(
        f"normalised error squared {found.squared.mean():.2f} (3 where the covariance is right); "
        f"{100 * np.mean(found.squared <= 7.815):.1f} % within the ellipsoid of 95 %"
    )
    return "\n".join(lines)
