"""The match's numbers, read from versioned JSON files: bodies, ball, rules, senses, sound.

Whoever has measured a body of his own writes a file like `data/ers210.json` and gives its path
to `Match`.  Units are SI; see docs/match.md for every field.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

DATA = Path(__file__).parent / "data"


class Styles(NamedTuple):
    """Walking styles, a tuple entry each.  forward, backward, lateral: m/s; turn: rad/s: half axes
    of the ellipsoid of velocities; lag: s, time constant; slip, slip_turn: spread of the
    displacement, relative; odometry, odometry_turn: of its estimate; stability: m/s, a push faster
    than this can fell the body."""

    name: tuple[str, ...]
    forward: tuple[float, ...]
    backward: tuple[float, ...]
    lateral: tuple[float, ...]
    turn: tuple[float, ...]
    lag: tuple[float, ...]
    slip: tuple[float, ...]
    slip_turn: tuple[float, ...]
    odometry: tuple[float, ...]
    odometry_turn: tuple[float, ...]
    stability: tuple[float, ...]


class Kicks(NamedTuple):
    """Kicks.  zone: where the ball's centre must be (x low, high, y low, high; m, body's frame);
    delay, duration: s, until the ball is hit and until the body can walk again; speed: m/s with
    relative spread; direction: rad, with spread; miss: share of kicks that do nothing."""

    name: tuple[str, ...]
    zone: tuple[tuple[float, float, float, float], ...]
    delay: tuple[float, ...]
    duration: tuple[float, ...]
    speed: tuple[float, ...]
    speed_spread: tuple[float, ...]
    direction: tuple[float, ...]
    direction_spread: tuple[float, ...]
    miss: tuple[float, ...]


class Postures(NamedTuple):
    """Postures.  duration: s; width: m, what it covers while it lasts; gets_up: how probably a
    fallen body stands afterwards."""

    name: tuple[str, ...]
    duration: tuple[float, ...]
    width: tuple[float, ...]
    gets_up: tuple[float, ...]


class Body(NamedTuple):
    """A kind of body.  length, width, height: m; chest: m, from the centre to the front that
    pushes a ball; grip: 1/s, how fast the chest takes the ball's sideways motion along;
    restitution: of a ball at the body."""

    name: str
    placeholder: bool
    source: str
    length: float
    width: float
    height: float
    chest: float
    grip: float
    restitution: float
    styles: Styles
    kicks: Kicks
    postures: Postures


class Rolling(NamedTuple):
    """The ball.  deceleration: m/s^2, constant; wall_restitution; max_speed: m/s, no kick gives
    more."""

    deceleration: float
    wall_restitution: float
    max_speed: float


class Rules(NamedTuple):
    """The referee's numbers (s, m, m/s); see `envs.soccer.referee` for what each decides."""

    half_minutes: float
    kickoff_time: float
    kickoff_circle: float
    kickoff_moved: float
    break_time: float
    holding_time: float
    holding_time_goalkeeper: float
    holding_radius: float
    charging_time: float
    charging_speed: float
    charging_ball: float
    area_depth: float
    area_half_width: float
    illegal_time: float
    penalty_time: float
    stuck_time: float
    stuck_radius: float
    restart_spots: tuple[tuple[float, float], ...]
    kickoff_own: tuple[tuple[float, float], ...]
    kickoff_theirs: tuple[tuple[float, float], ...]


class Sight(NamedTuple):
    """Noise of one kind of object in a picture; see the source in `data/camera.json`."""

    bearing: float
    elevation: float
    size: float
    size_relative: float
    miss: float
    miss_small: float
    false: float


class Sights(NamedTuple):
    ball: Sight
    landmark: Sight
    goal: Sight
    robot: Sight


class Feelings(NamedTuple):
    """Noise of the senses of the body; see the source in `data/senses.json`."""

    proximity_low: float
    proximity_high: float
    proximity: float
    gyro: float
    gyro_bias: float
    acceleration: float
    scale: float
    scale_turn: float
    drift: float


class Air(NamedTuple):
    """Sound as symbols.  duration: s of a message; of those from a distance d, m, the share
    1 / (1 + exp((half - d) / width)) is lost."""

    duration: float
    half: float
    width: float


@cache
def load_body(name: str) -> Body:
    """A body by its shipped name ("ers210", "wheels") or a file's path.  Raises ValueError naming
    file, field and value."""
    shipped = DATA / f"{name}.json"
    path = shipped if shipped.exists() else Path(name)
    document = _read(path, "fntg-body")
    parts: dict[str, Any] = {}
    for field, cls in (("styles", Styles), ("kicks", Kicks), ("postures", Postures)):
        rows = document.get(field)
        if not isinstance(rows, list) or (field == "styles" and not rows):
            raise ValueError(f"{path}: {field}: allowed is a list of objects")
        columns = [
            [_entry(path, f"{field}[{n}]", row, key) for n, row in enumerate(rows)]
            for key in cls._fields
        ]
        parts[field] = cls(*map(tuple, columns))
    flat = {key: _entry(path, "", document, key) for key in Body._fields if key not in parts}
    return Body(**flat, **parts)


@cache
def load(name: str, cls: Any) -> Any:
    """A flat table of `data/` as a NamedTuple of type cls."""
    path = DATA / f"{name}.json"
    document = _read(path, None)
    return cls(*(_entry(path, "", document, key) for key in cls._fields))


@cache
def load_sights() -> Sights:
    """The noise of the camera at the objects level, `data/camera.json`."""
    path = DATA / "camera.json"
    objects = _read(path, "fntg-camera-objects")["objects"]
    return Sights(
        *(
            Sight(*(_entry(path, kind, objects[kind], key) for key in Sight._fields))
            for kind in Sights._fields
        )
    )


def _read(path: Path, kind: str | None) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: not a readable JSON file ({error})") from None
    if not isinstance(document, dict) or (kind and document.get("format") != kind):
        raise ValueError(f"{path}: format: allowed is {kind!r}")
    if document.get("version") != 1:
        raise ValueError(f"{path}: version = {document.get('version')!r}: allowed is 1")
    return document


_TEXT = {"name", "source"}


def _entry(path: Path, where: str, row: Any, key: str) -> Any:
    """One checked entry: a finite number, a name, or a (nested) list of numbers."""
    field = f"{where}.{key}" if where else key
    if not isinstance(row, dict) or key not in row:
        raise ValueError(f"{path}: {field} is missing")
    value = row[key]

    def check(value: Any) -> Any:
        if isinstance(value, list):
            return tuple(check(v) for v in value)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
            raise ValueError(f"{path}: {field} = {value!r}: allowed are numbers below 1e6")
        return float(value)

    if key in _TEXT or key == "placeholder":
        if not isinstance(value, bool if key == "placeholder" else str):
            raise ValueError(
                f"{path}: {field} = {value!r}: allowed is a text (of placeholder: true or false)"
            )
        return value
    value = check(value)
    if key == "zone" and not (isinstance(value, tuple) and len(value) == 4):
        raise ValueError(f"{path}: {field} = {value!r}: allowed are four numbers")
    return value
