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
    body = Body(**flat, **parts)
    _check(path, body)
    return body


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
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not a JSON file ({str(error)[:80]})") from None
    if not isinstance(document, dict) or (kind and document.get("format") != kind):
        raise ValueError(f"{path}: format: allowed is {kind!r}")
    if document.get("version") != 1:
        raise ValueError(f"{path}: version = {document.get('version')!r}: allowed is 1")
    _entry(path, "", document, "source")
    return document


_TEXT = {"name", "source"}
_POINTS = {"restart_spots", "kickoff_own", "kickoff_theirs"}
_SIGNED = {"zone", "direction", *_POINTS}  # may be negative
_POSITIVE = {"length", "width", "height", "chest", "forward", "backward", "turn", "duration"}
_SHARES = {"miss", "miss_small", "false", "gets_up", "restitution", "wall_restitution"}


def _entry(path: Path, where: str, row: Any, key: str) -> Any:
    """One checked entry: a number in its range, a name, or a list of numbers."""
    field = f"{where}.{key}" if where else key
    if not isinstance(row, dict) or key not in row:
        raise ValueError(f"{path}: {field} is missing")
    value = row[key]

    def refuse(allowed: str) -> ValueError:
        return ValueError(f"{path}: {field} = {str(value)[:60]!s}: allowed {allowed}")

    if key in _TEXT:
        if not isinstance(value, str) or not value.strip():
            raise refuse("is a text")
        return value
    if key == "placeholder":
        if not isinstance(value, bool):
            raise refuse("is true or false")
        return value
    if key == "zone":
        zone = _numbers(value)
        if zone is None or len(zone) != 4 or not (zone[0] < zone[1] and zone[2] < zone[3]):
            raise refuse("are x low, x high, y low, y high")
        return zone
    if key in _POINTS:
        points = [_numbers(row) for row in value] if isinstance(value, list) else [None]
        if not all(point is not None and len(point) == 2 for point in points):
            raise refuse("is a list of points [x, y]")
        return tuple(points)
    number = _numbers([value])
    if number is None:
        raise refuse("are numbers below 1e6")
    if key in _POSITIVE and not number[0] > 0:
        raise refuse("are numbers above 0")
    if key in _SHARES and not 0 <= number[0] <= 1:
        raise refuse("are shares, 0 to 1")
    if key not in _SIGNED and number[0] < 0:
        raise refuse("are numbers from 0 up")
    return number[0]


def _numbers(values: Any) -> tuple[float, ...] | None:
    """A list of finite numbers as a tuple, None where it is none."""
    if not isinstance(values, list):
        return None
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
            return None
    return tuple(map(float, values))


def _check(path: Path, body: Body) -> None:
    """What fits together in a body.  Raises ValueError."""
    if body.length > 1 or body.width > body.length:
        raise ValueError(
            f"{path}: length = {body.length}, width = {body.width}: allowed are a length up to 1 m"
            " and no more width"
        )
    for n, (delay, duration) in enumerate(zip(body.kicks.delay, body.kicks.duration)):
        if delay > duration:
            raise ValueError(f"{path}: kicks[{n}].delay = {delay}: allowed is up to its duration")
