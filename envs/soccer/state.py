"""What a match remembers: NamedTuples of arrays.

One match has leaves [R] (robots: the home team by shirt, then the away team) or scalars; a batch
adds its axis *last*: [R, B], [B].  All functions of this package take either, because they only
index the leading axis.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

Many = Float[Array, " R"]


class Robots(NamedTuple):
    """Bodies, leaves [R].

    x, y: m, field's frame; cos, sin: of the heading; v, v_y, omega: m/s, rad/s, of the gait in the
    body's frame; tilt, pan, roll: rad, the neck; doing: 0, 1 + kick or 100 + posture; busy: s until
    that ends; fallen; out: s left of a penalty, 0 on the field; holding, charging, trespassing: s
    since when the referee sees it; odometry_x, _y, _turn: what the last step's displacement was
    estimated as (m, m, rad); turned: rad, the real turn; push_x, push_y: m, how far others pushed
    it in the last step (field's frame); touching: it touched the ball in the last step;
    gained_x, gained_y: m/s, change of the gait's velocity; lane: of its noise.
    """

    x: Many
    y: Many
    cos: Many
    sin: Many
    v: Many
    v_y: Many
    omega: Many
    tilt: Many
    pan: Many
    roll: Many
    doing: Int[Array, " R"]
    busy: Many
    fallen: Bool[Array, " R"]
    out: Many
    holding: Many
    charging: Many
    trespassing: Many
    odometry_x: Many
    odometry_y: Many
    odometry_turn: Many
    turned: Many
    push_x: Many
    push_y: Many
    gained_x: Many
    gained_y: Many
    touching: Bool[Array, " R"]
    lane: UInt32[Array, " R"]


class RollingBall(NamedTuple):
    """The ball's centre (m) and velocity (m/s), field's frame."""

    x: Float[Array, ""]
    y: Float[Array, ""]
    vx: Float[Array, ""]
    vy: Float[Array, ""]


class Talk(NamedTuple):
    """The air.  low, high: [R], the two words of each robot's message; left: [R], s until it is
    said, 0 for silence; garbled: [R, R], sender and receiver, something else was heard at the same
    time; arrived: [R, R], it arrived whole in this step."""

    low: UInt32[Array, " R"]
    high: UInt32[Array, " R"]
    left: Many
    garbled: Bool[Array, "R R"]
    arrived: Bool[Array, "R R"]


class Game(NamedTuple):
    """The referee's memory, scalars.

    tick: control steps since the start; played: of this half; half: 0, 1, 2 when all is over;
    phase: PLAY, KICKOFF, BREAK or FINISHED; waited: s in this phase; first, kicker: team (0 home, 1
    away) that had the first kick-off and that has this one; attack: +1 where home plays towards +x;
    spot_x, spot_y: m, from where the ball's progress is measured; stuck: s without; toucher: robot
    that touched the ball last, -1 none; shot: team + 1 of the shot on its way, else 0; call,
    caller: what the referee called in the last step (index into CALLS) and of which robot or team;
    seed: of all noise; hand: +1, or -1 in a match that is the mirror image (y to -y) of another.
    """

    tick: Int[Array, ""]
    played: Int[Array, ""]
    half: Int[Array, ""]
    phase: Int[Array, ""]
    waited: Float[Array, ""]
    first: Int[Array, ""]
    kicker: Int[Array, ""]
    attack: Float[Array, ""]
    spot_x: Float[Array, ""]
    spot_y: Float[Array, ""]
    stuck: Float[Array, ""]
    toucher: Int[Array, ""]
    shot: Int[Array, ""]
    call: Int[Array, ""]
    caller: Int[Array, ""]
    seed: UInt32[Array, ""]
    hand: Float[Array, ""]


PLAY, KICKOFF, BREAK, FINISHED = range(4)
CALLS = (
    "",
    "goal",
    "half-time",
    "end",
    "ball holding",
    "charging",
    "illegal defender",
    "stuck ball",
    "fall",
)


class Statistics(NamedTuple):
    """What is counted, leaves [2] (home, away); possession in control steps.

    shots: kicked or pushed so that the ball will roll into the opponents' goal; saves: shots that
    the defending team touched; passes: from mate to mate; penalties: calls against the team; own
    goals count as the other team's goals, too.
    """

    goals: Int[Array, "2"]
    own_goals: Int[Array, "2"]
    possession: Int[Array, "2"]
    shots: Int[Array, "2"]
    saves: Int[Array, "2"]
    passes: Int[Array, "2"]
    touches: Int[Array, "2"]
    falls: Int[Array, "2"]
    penalties: Int[Array, "2"]


class State(NamedTuple):
    """All of a match."""

    robots: Robots
    ball: RollingBall
    talk: Any  # `Talk`, at the audio level `envs.soccer.voices.Voices`
    game: Game
    statistics: Statistics


def upright(constant, like: Array) -> Array:
    """A constant [R] (or [2]) with as many trailing axes as `like` has, to meet batches."""
    constant = jnp.asarray(constant)
    return constant.reshape(constant.shape + (1,) * (like.ndim - 1))


def total(x: Array) -> Array:
    """Sum over robots [R] that does not depend on which team is called home: to the bit."""
    half = x.shape[0] // 2
    home, away = x[0], x[half]
    for n in range(1, half):
        home, away = home + x[n], away + x[half + n]
    return home + away


def by_team(x: Array) -> Array:
    """Sums of [R] over each team, [2]."""
    half = x.shape[0] // 2
    home, away = x[0], x[half]
    for n in range(1, half):
        home, away = home + x[n], away + x[half + n]
    return jnp.stack([home, away])


def side(robots: Robots) -> Array:
    """+1 for the home team's robots, -1 for the away team's, [R] ready to meet batches."""
    n = robots.x.shape[0]
    return upright([1.0] * (n // 2) + [-1.0] * (n // 2), robots.x)
