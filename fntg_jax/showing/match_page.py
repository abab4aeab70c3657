"""A match to watch: one self-contained page."""

import base64
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from envs.base import Camera, Field
from fntg_jax.files import inert_json

_COLOURS = {"pink": "#f06aa8", "yellow": "#e8c83a", "green": "#2faa5a", "skyblue": "#5bb8e8"}
_MOST_STEPS = 20_000  # a page of about 5 MB
_NOWHERE = -32.0  # m: no belief


_GOAL = "goal"


class Call(NamedTuple):
    """A mark on the time bar: s, words, kind ("goal0", "goal1" for a goal of home or away)."""

    time: float
    text: str
    kind: str


class Recording(NamedTuple):
    """A recorded match of T steps and R robots (home first), NumPy, m and rad, field's frame.

    dt: s; teams: names; robots: [T, R, 4] x, y, heading, pan of the head; on: [T, R] on the field;
    ball: [T, 2]; score: [T, 2]; calls: the referee's.  Where a team says what it thinks: beliefs
    [T, R, 5], x, y, heading and ball's x, y as it believes (NaN: none); labels [T, R, 3], indices
    of role, behaviour and rule; roles, behaviors, rules: names, per team.  says: [T, R], it asks to
    say a word.  size: m, length and width of a robot.
    """

    dt: float
    teams: tuple[str, str]
    robots: np.ndarray
    on: np.ndarray
    ball: np.ndarray
    score: np.ndarray
    calls: tuple[Call, ...]
    field: Field
    size: tuple[float, float] = (0.289, 0.152)
    beliefs: np.ndarray | None = None
    labels: np.ndarray | None = None
    roles: tuple[tuple[str, ...], ...] = ((), ())
    behaviors: tuple[tuple[str, ...], ...] = ((), ())
    rules: tuple[tuple[str, ...], ...] = ((), ())
    says: np.ndarray | None = None


def page(match: Recording) -> str:
    """The page.  Raises ValueError where the recording is too long for one."""
    steps, num_robots = match.robots.shape[:2]
    if steps > _MOST_STEPS:
        raise ValueError(f"steps = {steps}: a page holds up to {_MOST_STEPS}; record fewer minutes")
    half = num_robots // 2
    data: dict[str, Any] = {
        "steps": steps,
        "dt": match.dt,
        "teams": match.teams,
        "names": [str(n % half + 1) for n in range(num_robots)],
        "robots": _packed(match.robots),
        "on": _bytes(match.on),
        "ball": _packed(match.ball),
        "score": _bytes(match.score),
        "calls": [list(call) for call in match.calls],
        "field": {k: v for k, v in match.field._asdict().items() if isinstance(v, float)},
        "landmarks": [
            [mark.x, mark.y, _COLOURS[mark.upper], _COLOURS[mark.lower]]
            for mark in match.field.landmarks
        ],
        "view": Camera().horizontal,
        "size": match.size,
        "beliefs": None if match.beliefs is None else _packed(match.beliefs),
        "labels": None if match.labels is None else _bytes(match.labels),
        "says": None if match.says is None else _bytes(match.says),
        "roles": match.roles,
        "behaviors": match.behaviors,
        "rules": match.rules,
    }
    template = resources.files("fntg_jax.showing").joinpath("match.html").read_text("utf-8")
    return template.replace("/*DATA*/", inert_json(data))


def _packed(values: np.ndarray) -> dict[str, str]:
    """Millimetres and milliradians as int16."""
    filled = np.where(np.isfinite(values), values, _NOWHERE)
    whole = np.round(1000 * np.clip(filled, -32.767, 32.767)).astype("<i2")
    return {"type": "i2", "data": base64.b64encode(whole.tobytes()).decode()}


def _bytes(values: np.ndarray) -> dict[str, str]:
    whole = np.clip(values, 0, 255).astype(np.uint8)
    return {"type": "u1", "data": base64.b64encode(whole.tobytes()).decode()}


def recording(
    match: Any, history: Any, sides: tuple[Any, Any], calls: tuple[str, ...]
) -> Recording:
    """What a page shows of a `learning.play.History`.

    match: with field and dt; sides: both teams' `learning.play.Side`; calls: the referee's words.
    """
    picture = history.picture
    call, caller = np.asarray(picture.call), np.asarray(picture.caller)
    num = match.players
    marks = []
    for n in np.flatnonzero(call):
        word, who = calls[call[n]], int(caller[n])
        if word == _GOAL:
            marks.append(Call(n * match.dt, f"goal for {sides[who].name}", f"goal{who}"))
        elif word in ("half-time", "end", "stuck ball"):
            marks.append(Call(n * match.dt, word, "call"))
        else:
            name = f"{sides[who // num].name} {who % num + 1}"
            marks.append(Call(n * match.dt, f"{word}: {name}", "call"))
    beliefs = labels = None
    if history.home is not None or history.away is not None:
        shape = np.shape(picture.robots)[:2]
        beliefs = np.full((*shape, 5), np.nan)
        labels = np.full((*shape, 3), 255)
        for k, belief in enumerate((history.home, history.away)):
            if belief is None:
                continue
            rows = slice(k * num, (k + 1) * num)
            beliefs[:, rows, :3], beliefs[:, rows, 3:] = belief.pose, belief.ball
            stacked = np.stack([belief.role, belief.behavior, belief.rule], -1)
            labels[:, rows] = np.where(stacked < 0, 255, stacked)
            # From the team's frame into the field's: half a turn where it plays towards -x.
            turned = (np.asarray(picture.attack) * (1 - 2 * k) < 0)[:, None]
            for column in (0, 1, 3, 4):
                beliefs[:, rows, column] *= np.where(turned, -1, 1)
            heading = beliefs[:, rows, 2] + np.where(turned, np.pi, 0)
            beliefs[:, rows, 2] = (heading + np.pi) % (2 * np.pi) - np.pi
    words = [side.words for side in sides]
    says = np.asarray(np.asarray(history.action.say).any(-1))
    return Recording(
        dt=match.dt,
        teams=(sides[0].name, sides[1].name),
        robots=np.concatenate([picture.robots, np.asarray(picture.head)[..., 1:2]], -1),
        on=~np.asarray(picture.out),
        ball=np.asarray(picture.ball),
        score=np.asarray(picture.score),
        calls=tuple(marks),
        field=match.field,
        beliefs=beliefs,
        labels=labels,
        roles=tuple(word.roles for word in words),
        behaviors=tuple(word.behaviors for word in words),
        rules=tuple(word.rules for word in words),
        says=np.concatenate([says, np.zeros_like(says[-1:])]),
    )
