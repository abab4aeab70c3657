"""Recordings of a robot as CSV, for `fntg fit`: rows a control step apart.

time (s), style (a name of the body's table), v, v_y (m/s), omega (rad/s): the command held from
there on; x, y (m), heading (rad): the pose.  Optional: dx, dy (m), dtheta (rad): odometry since the
row before; seen, bearing (rad), distance (m), object_x, object_y (m): a sighting from the robot's
centre, and where the object was.
"""

import csv
import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fntg_jax.files import number_of, read_text

REQUIRED = ("time", "style", "v", "v_y", "omega", "x", "y", "heading")
ODOMETRY = ("dx", "dy", "dtheta")
SIGHTING = ("seen", "bearing", "distance", "object_x", "object_y")


class Recording(NamedTuple):
    """dt: s; style [T] (names); command, pose [T, 3]; odometry [T, 3] or None; starts [T]: after a
    gap; sightings by object: bearing's error (rad) and relative error of the distance, [n, 2]."""

    dt: float
    style: np.ndarray
    command: np.ndarray
    pose: np.ndarray
    odometry: np.ndarray | None
    starts: np.ndarray
    sightings: dict[str, np.ndarray]


def read(path: Path, styles: tuple[str, ...]) -> Recording:
    """Raises ValueError naming file, row, column, value and what is allowed."""
    text = read_text(path, "log", most=500_000_000).removeprefix("\ufeff")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        rows = [[cell.strip() for cell in cells] for cells in reader if any(cells)]
    except csv.Error as error:
        raise ValueError(f"{path} row {reader.line_num}: {error}") from None
    header = rows[0] if rows else []
    odometry, sighting = header[8:11] == [*ODOMETRY], header[-5:] == [*SIGHTING]
    wanted = [*REQUIRED, *(ODOMETRY if odometry else ()), *(SIGHTING if sighting else ())]
    if header != wanted:
        raise ValueError(
            f"{path} row 1: {','.join(header)[:200]!r}: must be {','.join(REQUIRED)}, then perhaps "
            f"{','.join(ODOMETRY)}, then perhaps {','.join(SIGHTING)}"
        )
    names = [name for name in wanted if name not in ("style", "seen")]
    numbers, kinds, seen = [], [], []
    for line, cells in enumerate(rows[1:], start=2):
        where = f"{path} row {line}"
        if len(cells) != len(wanted):
            raise ValueError(f"{where}: {len(cells)} cells: must be {len(wanted)}")
        row = dict(zip(wanted, cells))
        if row["style"] not in styles:
            raise ValueError(f"{where}: style = {row['style']!r}: known are {', '.join(styles)}")
        blank = SIGHTING[1:] if sighting and not row["seen"] else ()
        numbers.append([math.nan if n in blank else number_of(where, n, row[n]) for n in names])
        kinds.append(row["style"])
        seen.append(row.get("seen", ""))
    if len(numbers) < 50:
        raise ValueError(f"{path}: {len(numbers)} rows: at least 50 are needed")
    table = np.array(numbers)
    time = table[:, 0]
    gaps = np.diff(time)
    if (gaps <= 0).any():
        bad = int(np.argmax(gaps <= 0)) + 3
        raise ValueError(f"{path} row {bad}: time = {rows[bad - 1][0]}: must rise from row to row")
    dt = float(np.median(gaps))
    if not 0.005 <= dt <= 0.5:
        raise ValueError(f"{path}: rows are {dt:.3g} s apart: allowed are 0.005 to 0.5")
    starts = np.concatenate([[True], np.abs(gaps - dt) > 0.1 * dt])
    column = lambda *which: table[:, [names.index(n) for n in which]]  # noqa: E731
    pose = column("x", "y", "heading")
    found: dict[str, np.ndarray] = {}
    if sighting:
        bearing, distance, x, y = column(*SIGHTING[1:]).T
        dx, dy = x - pose[:, 0], y - pose[:, 1]
        off = bearing - np.arctan2(dy, dx) + pose[:, 2]
        errors = np.stack([(off + np.pi) % (2 * np.pi) - np.pi, distance / np.hypot(dx, dy) - 1], 1)
        for kind in sorted(set(seen) - {""}):
            found[kind] = errors[[s == kind for s in seen]]
    return Recording(
        dt,
        np.array(kinds),
        column("v", "v_y", "omega"),
        pose,
        column(*ODOMETRY) if odometry else None,
        starts,
        found,
    )


def as_log(recording: Recording, styles: tuple[str, ...], log_type: Any) -> Any:
    """As the match's `identify.Log`."""
    index = np.array([styles.index(name) for name in recording.style])
    return log_type(
        recording.dt,
        index,
        recording.command,
        recording.pose,
        recording.odometry,
        recording.starts,
    )
