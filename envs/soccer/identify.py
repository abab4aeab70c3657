"""A body's table from recordings of it: maximum likelihood, by gradients through the match's own
`bodies.walk`.

A style's log is cut into stretches of constant style.  From the recorded pose at each step the
world foresees the displacement; what is left over is normal, in proportion to the motion as the
table's slip says, with a floor for what measured the poses.  Odometry and sightings need no world:
their spreads are those of the differences to the recorded truth.
"""

import json
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from envs.base import Action, Walk
from envs.soccer import bodies, noise, tables
from envs.soccer.state import Robots
from envs.soccer.tables import Feelings, Styles

FITTED = ("forward", "backward", "lateral", "turn", "lag", "slip", "slip_turn")
WARM, LENGTH = 10, 30  # steps of a stretch that only set it going, and that count
STEPS, RATE = 800, 0.03  # of the descent
KNOWN = 0.2  # relative standard error from which on the log does not say what a number is


class Log(NamedTuple):
    """A recording, rows dt apart, NumPy: style [T] (index); command [T, 3] v, v_y, omega, held from
    each row on; pose [T, 3] x, y, heading (m, rad); odometry [T, 3] dx, dy (m, body's frame before
    the step), turn (rad) since the row before, or None; starts [T]: rows before which there is
    a gap."""

    dt: float
    style: np.ndarray
    command: np.ndarray
    pose: np.ndarray
    odometry: np.ndarray | None
    starts: np.ndarray


class Fitted(NamedTuple):
    """One style: numbers by name, their relative standard errors, and steps of it that counted.  A
    number that the log does not tell (an error above `KNOWN`) is as in the table before."""

    style: str
    values: dict[str, float]
    errors: dict[str, float]
    steps: int


class Misfit(NamedTuple):
    """How a table foresees a log: mean negative log likelihood of a step, root mean square errors
    of speed, m/s, and of turning, rad/s."""

    surprise: float
    speed: float
    turning: float


class _Stretches(NamedTuple):
    """Of one style, leaves [WARM + LENGTH, stretches]; `first`: [3, stretches] speeds at the
    start."""

    command: Any
    moved: Any
    cos: Any
    sin: Any
    first: Any


def fit(log: Log, styles: Styles) -> list[Fitted]:
    """Every style that the log has long enough stretches of.

    Raises ValueError where it has none."""
    found = []
    for index, name in enumerate(styles.name):
        stretches = _cut(log, index)
        if stretches is None:
            continue
        before = np.array([max(getattr(styles, key)[index], 1e-3) for key in FITTED])
        start = jnp.log(jnp.asarray([*before, 1e-3, 1e-3], jnp.float32))
        at = _descend(stretches, start, log.dt)
        curvature = np.diag(np.asarray(_hessian(at, stretches, log.dt), float))
        steps = LENGTH * stretches.cos.shape[1]
        with np.errstate(invalid="ignore", divide="ignore"):
            errors = np.where(curvature > 0, 1 / np.sqrt(curvature * steps), np.inf)
        told = errors[: len(FITTED)] < KNOWN
        values = np.where(told, np.exp(np.asarray(at[: len(FITTED)], float)), before)
        found.append(
            Fitted(name, dict(zip(FITTED, map(float, values))), dict(zip(FITTED, errors)), steps)
        )
    if not found:
        raise ValueError(
            f"log: no stretch of {(WARM + LENGTH) * log.dt:g} s in one style that the body has"
        )
    return found


def misfit(log: Log, styles: Styles) -> Misfit:
    """How a table foresees a log, over all styles; pose noise as fits best."""
    total, count, squares = 0.0, 0, np.zeros(2)
    for index in range(len(styles.name)):
        stretches = _cut(log, index)
        if stretches is None:
            continue
        values = [max(getattr(styles, key)[index], 1e-3) for key in FITTED]
        parameters = jnp.log(jnp.asarray([*values, 1e-3, 1e-3], jnp.float32))
        parameters = _descend(stretches, parameters, log.dt, only_floors=True)
        steps = LENGTH * stretches.cos.shape[1]
        rest = np.asarray(_rest(parameters, stretches, log.dt)[0], float)[WARM:] / log.dt
        total += steps * float(_surprise(parameters, stretches, log.dt))
        count += steps
        squares += [np.sum(rest[:, :2] ** 2), np.sum(rest[:, 2] ** 2)]
    if not count:
        raise ValueError("log: nothing in it that the table could foresee")
    return Misfit(total / count, *np.sqrt(squares / count))


def odometry(log: Log) -> dict[str, float]:
    """Scale errors of odometry (scale, scale_turn: relative, of this log) and its spreads as the
    table has them (odometry, odometry_turn)."""
    assert log.odometry is not None
    moved, turned = _moved(log)
    told = log.odometry[1:]
    going = ~log.starts[1:] & np.isfinite(told).all(axis=1)
    pace = np.hypot(*moved.T)
    use = going & (pace > 1e-3)
    scale = np.sum(told[use, :2] * moved[use]) / np.sum(moved[use] ** 2)
    spread = np.sqrt(np.mean(((told[use, :2] - scale * moved[use]) / pace[use, None]) ** 2))
    way = np.abs(turned) + pace
    use = going & (way > 1e-3)
    scale_turn = np.sum(told[use, 2] * turned[use]) / np.sum(turned[use] ** 2)
    off = (told[use, 2] - scale_turn * turned[use]) / way[use]
    return {
        "scale": float(scale - 1),
        "scale_turn": float(scale_turn - 1),
        "odometry": float(spread),
        "odometry_turn": float(np.sqrt(np.mean(off**2))),
    }


def table(body: tables.Body, name: str, source: str, fitted: list[Fitted], extra: Any) -> Any:
    """The body with what was fitted, and its file's text.  extra: odometry's numbers or None."""
    columns = {key: list(getattr(body.styles, key)) for key in Styles._fields}
    for one in fitted:
        row = columns["name"].index(one.style)
        for key in FITTED:
            columns[key][row] = one.values[key]
        for key in ("odometry", "odometry_turn") if extra else ():
            columns[key][row] = extra[key]
    styles = Styles(**{key: tuple(values) for key, values in columns.items()})
    new = body._replace(name=name, placeholder=False, source=source, styles=styles)
    document: dict[str, Any] = {"format": "fntg-body", "version": 1}
    for key, value in new._asdict().items():
        if isinstance(value, tuple):
            columns = value._asdict()  # type: ignore[attr-defined]
            value = [dict(zip(columns, row)) for row in zip(*value)]
        document[key] = value
    return new, json.dumps(document, indent=1, allow_nan=False) + "\n"


def _moved(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [T - 1, 2] in the frame half-way through the turn, and the turn [T - 1]."""
    dx, dy = np.diff(log.pose[:, :2], axis=0).T
    turned = (np.diff(log.pose[:, 2]) + np.pi) % (2 * np.pi) - np.pi
    c, s = np.cos(log.pose[:-1, 2] + turned / 2), np.sin(log.pose[:-1, 2] + turned / 2)
    return np.stack([c * dx + s * dy, c * dy - s * dx], 1), turned


def _cut(log: Log, style: int) -> _Stretches | None:
    size = WARM + LENGTH
    moved, turned = _moved(log)
    good = (log.style == style)[:-1] & ~log.starts[1:]
    rows = []
    row = 1
    while row + size <= len(good):
        # One row before: its motion is the speed at the start.
        if good[row - 1 : row + size].all():
            rows.append(row)
            row += LENGTH
        else:
            row += 1
    if not rows:
        return None
    # A fixed number of sizes, so that styles share a compilation.
    index = np.array(rows)[None] + np.arange(size)[:, None]
    every = np.concatenate([moved, turned[:, None]], axis=1)
    first = every[np.array(rows) - 1] / log.dt
    as32 = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    heading = log.pose[index, 2]
    return _Stretches(
        as32(np.moveaxis(log.command[index], -1, 1)),
        as32(np.moveaxis(every[index], -1, 1)),
        as32(np.cos(heading)),
        as32(np.sin(heading)),
        as32(first.T),
    )


_STILL = Feelings(*(0.0 for _ in Feelings._fields))


def _rest(parameters, s: _Stretches, dt):
    """What the world does not foresee: ahead, to the left, turn [steps, 3, stretches] (m, rad), and
    the spreads of all three."""
    values = jnp.exp(parameters)
    named = dict(zip(FITTED, values))
    quiet = dict.fromkeys(Styles._fields, (0.0,)) | {k: (named[k],) for k in FITTED[:5]}
    kind = tables.load_body("ers210")._replace(styles=Styles(**quiet))
    both = bodies.Bodies(kind, kind)
    num = s.cos.shape[1]
    zero, whole = jnp.zeros(num), jnp.zeros(num, jnp.int32)
    robots = Robots(*(zero for _ in Robots._fields))
    robots = robots._replace(v=s.first[0], v_y=s.first[1], omega=s.first[2])
    key = noise.key(jnp.uint32(0), jnp.int32(0), whole.astype(jnp.uint32))

    def step(robots, now):
        command, moved, cos, sin = now
        action = Action(Walk(whole, *command), None, whole, whole, None)
        robots = robots._replace(x=zero, y=zero, cos=cos, sin=sin)
        before = robots
        free = jnp.ones(num, bool)
        robots = bodies.walk(both, robots, action, free, key, key, zero + 1.0, _STILL, dt)
        speeds = lambda r: (r.v, r.v_y, r.omega)  # noqa: E731
        mean = [0.5 * dt * (a + b) for a, b in zip(speeds(robots), speeds(before))]
        pace = jnp.sqrt(mean[0] ** 2 + mean[1] ** 2 + 1e-12)
        spread = named["slip"] * pace
        spread_turn = named["slip_turn"] * (jnp.abs(mean[2]) + pace)
        return robots, (moved - jnp.stack(mean), jnp.stack([spread, spread, spread_turn]))

    _, (rest, spread) = jax.lax.scan(step, robots, (s.command, s.moved, s.cos, s.sin))
    floor = jnp.stack([values[-2], values[-2], values[-1]])[:, None]
    return rest, jnp.sqrt(spread**2 + floor**2)


@jax.jit
def _surprise(parameters, s, dt):
    """Mean negative log likelihood of a step."""
    rest, spread = _rest(parameters, s, dt)
    each = 0.5 * (rest / spread) ** 2 + jnp.log(spread)
    return jnp.mean(jnp.sum(each[WARM:], axis=1))


_hessian = jax.jit(jax.hessian(_surprise))


def _descend(s, start, dt, only_floors=False):
    """The most likely parameters, logarithms, from a start."""
    mask = jnp.asarray([0.0 if only_floors else 1.0] * len(FITTED) + [1.0, 1.0])
    return _descended(s, start, mask, dt)


@jax.jit
def _descended(s, start, mask, dt):
    optimiser = optax.adam(optax.cosine_decay_schedule(RATE, STEPS))

    def step(carry, _):
        at, state = carry
        slope = mask * jax.grad(_surprise)(at, s, dt)
        change, state = optimiser.update(slope, state)
        return (jnp.clip(optax.apply_updates(at, mask * change), -12.0, 3.0), state), None

    return jax.lax.scan(step, (start, optimiser.init(start)), None, length=STEPS)[0][0]
