"""The scenes of `experiments.behaviors`, and when one counts as mastered."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from envs import scenes as suites
from envs.field import FIELD

LOOK = 20  # steps in which the robot stands and looks around before it is told what to do
STEPS = 340  # control steps of 0.1 s of every scene
HALF_X, HALF_Y = 0.5 * FIELD.length, 0.5 * FIELD.width
GOAL_X = HALF_X + 0.1  # m, where the ball is to go
AWAY = (0.0, 3.0, 0.0)
CAPTURE = 0.145  # m, from the robot's centre to that of a ball at its chest
FREE = 0.15  # m, from the wall: a ball that far is free
# Of the kick's zone in the body's table, m.
ZONE = (0.12, 0.18, 0.05)
DIRECTIONS = (0.0, 1.2, -1.2, 0.0)  # rad, of the body's four kicks


class Scene(NamedTuple):
    """Leaves [B, ...]: own and other robot (x, y, heading; m, rad; the other at `AWAY`: none), ball
    (x, y; m), shot (m/s, given to the ball after `LOOK` steps), distance D (m), kick."""

    own: Any
    other: Any
    ball: Any
    shot: Any
    distance: Any
    kick: Any


class Trace(NamedTuple):
    """Leaves [STEPS, B] in the field's frame (m, m/s): robot, ball, clear (from the robot's centre
    to the nearest wall or robot), goals (ours less theirs), out (a penalty)."""

    x: Any
    y: Any
    cos: Any
    sin: Any
    v: Any
    ball_x: Any
    ball_y: Any
    clear: Any
    goals: Any
    out: Any


class Case(NamedTuple):
    """name; order: of `behaviors.ORDERS`; scenes: (generator, number) -> Scene; good: (trace,
    scene) -> mastered [B]; measure: name and (trace, scene) -> number [B]; target: share, or None;
    keeper: plays as goalkeeper; undisturbed: which scenes count, from the trace without the robot.
    """

    name: str
    order: str
    scenes: Callable[..., Scene]
    good: Callable[..., Any]
    measure: tuple[str, Callable[..., Any]]
    target: float | None = None
    keeper: bool = False
    undisturbed: Callable[..., Any] | None = None


def _wrap(a):
    return (a + np.pi) % (2 * np.pi) - np.pi


def _scene(own, ball=None, other=None, shot=None, distance=0.0, kick=0) -> Scene:
    num = len(own[0])
    column = lambda *xs: np.stack([np.broadcast_to(x, num) for x in xs], 1).astype(np.float32)  # noqa: E731
    return Scene(
        column(*own),
        column(*(AWAY if other is None else other)),
        column(*((1.0, 0.7) if ball is None else ball)),
        column(*((0, 0) if shot is None else shot)),
        np.broadcast_to(np.float32(distance), num),
        np.broadcast_to(np.int32(kick), num),
    )


def _anywhere(rng, num, margin=0.4):
    return (
        rng.uniform(margin - HALF_X, HALF_X - margin, num),
        rng.uniform(margin - HALF_Y, HALF_Y - margin, num),
        rng.uniform(-np.pi, np.pi, num),
    )


def free(rng, num, distance=(0.0, 0.0)):
    """A robot somewhere, no ball near."""
    size = rng.uniform(*distance, num) * rng.choice([-1, 1], num)
    x, y, heading = _anywhere(rng, num, 0.75)
    return _scene((x, y, heading), ball=(-1.3, -0.8), distance=size)


def at_ball(rng, num, far, around, off, distance=0.0, home=False):
    """A ball anywhere 0.4 m from walls, the robot `far` from it, up to `around` rad off from behind
    it, and facing it up to `off` rad.  home: a ball before the own goal."""
    x, y, _ = _anywhere(rng, num)
    if home:
        x = rng.uniform(-0.95, -0.6, num)
    d = rng.uniform(*far, num)
    direction = np.arctan2(-y, GOAL_X - x) + rng.uniform(-around, around, num)
    heading = direction + rng.uniform(-off, off, num)
    own = (x - d * np.cos(direction), y - d * np.sin(direction), heading)
    return _scene(
        own, (x, y), distance=distance if np.isscalar(distance) else rng.uniform(*distance, num)
    )


def in_zone(rng, num, kick):
    """A ball before the chest, in the kick's zone."""
    x, y, heading = _anywhere(rng, num, 0.5)
    ahead, left = rng.uniform(ZONE[0], ZONE[1], num), rng.uniform(-ZONE[2], ZONE[2], num)
    c, s = np.cos(heading), np.sin(heading)
    return _scene((x, y, heading), (x + c * ahead - s * left, y + s * ahead + c * left), kick=kick)


def suite(rng, num, name):
    """Scenes of `envs.scenes`, the first obstacle another robot."""
    drawn = suites.get_suite(name)(jax.random.key(int(rng.integers(2**31))), num)
    own, ball, disc = (np.asarray(a) for a in (drawn.start, drawn.ball, drawn.obstacles[:, 0]))
    other = (disc[:, 0], disc[:, 1], rng.uniform(-np.pi, np.pi, num))
    return _scene(tuple(own.T), tuple(ball.T), other)


def shots(rng, num):
    """The goalkeeper before the middle of its goal; shots from 1 to 1.8 m, uniform over the
    mouth."""
    goal_y = rng.uniform(-0.5, 0.5, num) * FIELD.goal_width
    far, side = rng.uniform(1.0, 1.8, num), rng.uniform(-1.0, 1.0, num)
    x, y = far * np.cos(side) - HALF_X, np.clip(far * np.sin(side), 0.1 - HALF_Y, HALF_Y - 0.1)
    speed = rng.normal(1.0, 0.15, num)  # as the body's kick
    dx, dy = -HALF_X - x, goal_y - y
    size = np.hypot(dx, dy)
    own = (np.full(num, 0.16 - HALF_X), np.clip(0.35 * y, -0.24, 0.24), np.zeros(num))
    return _scene(own, (x, y), shot=(speed * dx / size, speed * dy / size))


def at_wall(rng, num):
    """A ball that touches a wall, corners included; a robot anywhere that has room."""
    touch = FIELD.ball_radius + rng.uniform(0.0, 0.02, num)
    end = rng.uniform(0, 1, num) < HALF_Y / (HALF_X + HALF_Y)
    sx, sy = rng.choice([-1, 1], num), rng.choice([-1, 1], num)
    # On the end walls beside the mouth.
    beside = sy * rng.uniform(0.5 * FIELD.goal_width + 0.05, HALF_Y - 0.045, num)
    along = rng.uniform(0.045 - HALF_X, HALF_X - 0.045, num)
    x, y = np.where(end, sx * (HALF_X - touch), along), np.where(end, beside, sy * (HALF_Y - touch))
    own = np.stack(_anywhere(rng, num, 0.2))
    while (near := np.hypot(own[0] - x, own[1] - y) < 0.3).any():
        own = np.where(near, np.stack(_anywhere(rng, num, 0.2)), own)
    return _scene(tuple(own), (x, y))


# Judging.  Angles in rad.


def _last(trace, step=-1):
    return Trace(*(a[step] for a in trace))


def drift(trace, scene):
    moved = np.hypot(trace.x - trace.x[LOOK], trace.y - trace.y[LOOK])
    return moved[LOOK : LOOK + 101].max(0)


def _walked(trace):
    c, s = trace.cos[LOOK], trace.sin[LOOK]
    dx, dy = trace.x[-1] - trace.x[LOOK], trace.y[-1] - trace.y[LOOK]
    return c * dx + s * dy, c * dy - s * dx


def sideways_error(trace, scene):
    return np.abs(-_walked(trace)[1] - scene.distance)


def straight_error(trace, scene):
    return np.abs(_walked(trace)[0] - scene.distance)


def within(error, share, more):
    return lambda trace, scene: error(trace, scene) < share * np.abs(scene.distance) + more


def behind_error(trace, scene, step=-1):
    """The larger of two angles: between robot-ball and ball-goal, and between heading and
    ball-goal."""
    t = _last(trace, step)
    goal = np.arctan2(-t.ball_y, GOAL_X - t.ball_x)
    to_ball = np.arctan2(t.ball_y - t.y, t.ball_x - t.x)
    heading = np.arctan2(t.sin, t.cos)
    return np.maximum(np.abs(_wrap(to_ball - goal)), np.abs(_wrap(heading - goal)))


def is_behind(trace, scene):
    t = _last(trace)
    near = np.hypot(t.ball_x - t.x, t.ball_y - t.y) < 0.25
    return near & (behind_error(trace, scene) < 0.15) & ~trace.out.any(0)


def touched(trace, scene):
    return np.hypot(trace.ball_x - scene.ball[:, 0], trace.ball_y - scene.ball[:, 1]).max(0)


def turned(trace, scene):
    return is_behind(trace, scene) & (touched(trace, scene) < 0.1)


def _dribbled(trace, scene):
    """Along and to the side of the straight line to the goal, of the ball when it lies again."""
    dx, dy = GOAL_X - scene.ball[:, 0], -scene.ball[:, 1]
    far = np.hypot(dx, dy)
    x, y = trace.ball_x[-1] - scene.ball[:, 0], trace.ball_y[-1] - scene.ball[:, 1]
    return (dx * x + dy * y) / far, np.abs(dx * y - dy * x) / far


def dribbled(trace, scene):
    along, side = _dribbled(trace, scene)
    return (along >= 0.8 * scene.distance) & (side <= 0.15)


def kick_error(trace, scene):
    """Between where the ball goes and where the kick should send it; pi where it lies still."""
    x, y = trace.ball_x - scene.ball[:, 0], trace.ball_y - scene.ball[:, 1]
    gone = np.hypot(x, y) > 0.15
    first = np.where(gone.any(0), gone.argmax(0), -1)
    each = np.arange(x.shape[1])
    wanted = scene.own[:, 2] + np.float32(DIRECTIONS)[scene.kick]
    error = np.abs(_wrap(np.arctan2(y[first, each], x[first, each]) - wanted))
    return np.where(gone.any(0), error, np.pi)


def capture(trace, scene):
    """m, from the point before the chest to the ball, at the end."""
    t = _last(trace)
    return np.hypot(t.x + CAPTURE * t.cos - t.ball_x, t.y + CAPTURE * t.sin - t.ball_y)


def intercepted(trace, scene):
    stops = np.abs(trace.v[[-51, -21, -1]]).mean(0) < 0.03
    return (capture(trace, scene) < 0.10) & (trace.clear.min(0) >= 0.145) & stops


def conceded(trace, scene):
    return trace.goals.min(0) < 0


def freed_at(trace, scene):
    """s until the ball is free of the walls or in the opponents' goal; 99: never."""
    to_wall = np.minimum(HALF_X - np.abs(trace.ball_x), HALF_Y - np.abs(trace.ball_y))
    free = (to_wall > FREE) | (trace.goals > 0)
    return np.where(free.any(0), 0.1 * (free.argmax(0) - LOOK), 99.0)


ANGLE, FAR = ("error rad", behind_error), ("m", touched)
_ring = partial(at_ball, far=(0.18, 0.36), around=np.pi, off=0.5)
_push = partial(at_ball, far=(0.16, 0.3), around=0.3, off=0.3, distance=(0.3, 1.0))
_home = partial(at_ball, far=(0.18, 0.30), around=np.pi, off=0.5, home=True)
_side = ("along less D m", lambda t, s: _dribbled(t, s)[0] - s.distance)

CASES = (
    Case(
        "1 standing: drift < 1 cm in 10 s",
        "1",
        free,
        lambda t, s: drift(t, s) < 0.01,
        ("drift m", drift),
        1.0,
    ),
    Case(
        "2 lateral +-D: 10 % + 2 cm",
        "2",
        partial(free, distance=(0.1, 0.6)),
        within(sideways_error, 0.1, 0.02),
        ("error m", sideways_error),
        0.9,
    ),
    Case("3 align: behind the ball, 0.15 rad", "3", _ring, is_behind, ANGLE, 0.95),
    Case("3 literal", "3 literal", _ring, is_behind, ANGLE),
    Case(
        "4 straight D: 10 % + 3 cm",
        "4",
        partial(free, distance=(0.1, 0.7)),
        within(straight_error, 0.1, 0.03),
        ("error m", straight_error),
        0.9,
    ),
    Case("5 dribble D: 0.8 D, 0.15 m aside", "5", _push, dribbled, _side, 0.9),
    Case("5 literal", "5 literal", _push, dribbled, _side),
    *(
        Case(
            f"6 kick {name}: 0.35 rad",
            "6",
            partial(in_zone, kick=n),
            lambda t, s: kick_error(t, s) < 0.35,
            ("error rad", kick_error),
            0.9,
        )
        for n, name in enumerate(("forward", "left", "right", "head"))
    ),
    Case("7 BIOA, eyes: open", "7", partial(suite, name="open"), intercepted, ("m", capture), 0.95),
    Case(
        "7 BIOA, eyes: blocked",
        "7",
        partial(suite, name="blocked"),
        intercepted,
        ("m", capture),
        0.95,
    ),
    Case(
        "7 BIOA, truth: open",
        "7 truth",
        partial(suite, name="open"),
        intercepted,
        ("m", capture),
        0.99,
    ),
    Case(
        "7 BIOA, truth: blocked",
        "7 truth",
        partial(suite, name="blocked"),
        intercepted,
        ("m", capture),
        0.99,
    ),
    Case(
        "8 goalkeeper: shots saved",
        "8",
        shots,
        lambda t, s: ~conceded(t, s),
        ("goals", conceded),
        0.8,
        keeper=True,
        undisturbed=conceded,
    ),
    Case(
        "9 rotate around the ball, not touched away", "9", _home, turned, ANGLE, 0.95, keeper=True
    ),
    Case("9 literal", "9 literal", _home, turned, ANGLE, keeper=True),
    Case(
        "ball at a wall: free within 30 s",
        "planner",
        at_wall,
        lambda t, s: freed_at(t, s) <= 30,
        ("s", freed_at),
        0.9,
    ),
)
