"""The referee: each rule a small pure function over arrays; its numbers are `Rules`.

Goal and length of the halves are the league's; every other rule is as remembered, and its number
assumed (`data/rules.json`).  Positions "in a team's frame" have x towards the opponents' goal.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from envs.base import Field
from envs.field import distance
from envs.soccer.state import (
    BREAK,
    FINISHED,
    KICKOFF,
    PLAY,
    Game,
    Robots,
    RollingBall,
    Statistics,
    by_team,
    side,
    upright,
)
from envs.soccer.tables import Rules

PARK_Y = 1.25  # m, where penalised robots stand, behind the wall (assumed)


def directions(robots: Robots, game: Game) -> Array:
    """+1 where a robot plays towards +x, -1 towards -x, [R]."""
    return side(robots) * game.attack


def line_up(rules: Rules, robots: Robots, kicker: Array, attack: Array, hand: Array):
    """x, y (m, field's frame) of the kick-off places and the heading's cosine, each [R]."""
    n = robots.x.shape[0] // 2
    direction = side(robots) * attack
    home_kicks = upright([True] * n + [False] * n, robots.x) == (kicker == 0)
    places = lambda rows, k: upright([row[k] for row in rows[:n]] * 2, robots.x)  # noqa: E731
    x, y = (
        jnp.where(home_kicks, places(rules.kickoff_own, k), places(rules.kickoff_theirs, k))
        for k in (0, 1)
    )
    return direction * x, direction * hand * y, direction * jnp.ones_like(robots.x)


def restart(
    rules: Rules, robots: Robots, ball: RollingBall, game: Game, now: Bool[Array, ""], kicker: Array
) -> tuple[Robots, RollingBall, Game]:
    """Where `now`: robots at their kick-off places (penalised ones stay out), ball in the middle,
    `kicker` (team) kicks off."""
    x, y, cos = line_up(rules, robots, kicker, game.attack, game.hand)
    placed = now & (robots.out <= 0)
    set_to = lambda old, new: jnp.where(placed, new, old)  # noqa: E731
    robots = robots._replace(
        x=set_to(robots.x, x),
        y=set_to(robots.y, y),
        cos=set_to(robots.cos, cos),
        sin=set_to(robots.sin, 0.0),
        v=set_to(robots.v, 0.0),
        v_y=set_to(robots.v_y, 0.0),
        omega=set_to(robots.omega, 0.0),
        doing=set_to(robots.doing, 0),
        busy=set_to(robots.busy, 0.0),
        fallen=robots.fallen & ~placed,
        holding=set_to(robots.holding, 0.0),
        charging=set_to(robots.charging, 0.0),
        trespassing=set_to(robots.trespassing, 0.0),
    )
    ball = jax.tree.map(lambda old: jnp.where(now, 0.0, old), ball)
    game = game._replace(
        phase=jnp.where(now, KICKOFF, game.phase),
        waited=jnp.where(now, 0.0, game.waited),
        kicker=jnp.where(now, kicker, game.kicker),
        spot_x=jnp.where(now, 0.0, game.spot_x),
        spot_y=jnp.where(now, 0.0, game.spot_y),
        stuck=jnp.where(now, 0.0, game.stuck),
        toucher=jnp.where(now, -1, game.toucher),
        shot=jnp.where(now, 0, game.shot),
    )
    return robots, ball, game


def keep_off(rules: Rules, before: Robots, robots: Robots, game: Game) -> Robots:
    """At a kick-off nobody crosses the halfway line and the other team stays out of the circle:
    who would is held where it is."""
    direction = directions(robots, game)
    n = robots.x.shape[0] // 2
    theirs = upright([False] * n + [True] * n, robots.x) == (game.kicker == 0)
    crosses = (direction * robots.x > 0) & (direction * robots.x > direction * before.x)
    r, r_before = distance(robots.x, robots.y), distance(before.x, before.y)
    enters = theirs & (r < rules.kickoff_circle + 0.15) & (r < r_before)
    held = (game.phase == KICKOFF) & (robots.out <= 0) & (crosses | enters)
    return robots._replace(
        x=jnp.where(held, before.x, robots.x), y=jnp.where(held, before.y, robots.y)
    )


def kickoff_over(rules: Rules, ball: RollingBall, game: Game) -> Bool[Array, ""]:
    """The ball has moved, or the team that kicks off has taken too long."""
    return (game.phase == KICKOFF) & (
        (distance(ball.x, ball.y) > rules.kickoff_moved) | (game.waited >= rules.kickoff_time)
    )


def goal(ball: RollingBall, game: Game, field: Field) -> Bool[Array, "2"]:
    """The whole ball is behind the goal line: who scores (home, away)."""
    over = jnp.abs(ball.x) > 0.5 * field.length + field.ball_radius
    over &= jnp.abs(ball.y) < 0.5 * field.goal_width
    home = (ball.x > 0) == (game.attack > 0)
    return jnp.stack([over & home, over & ~home])


def seen_for(clock: Array, condition: Array, dt: float) -> Array:
    """s for how long a condition has held."""
    return jnp.where(condition, clock + dt, 0.0)


def holds(rules: Rules, near: Bool[Array, " R"], ball: RollingBall, field: Field) -> Array:
    """A body keeps the ball where nobody can play it, [R]: it touches the ball, the ball hardly
    moves, and no wall is in the way."""
    slow = ball.vx * ball.vx + ball.vy * ball.vy < 0.05**2
    free = (jnp.abs(ball.x) < 0.5 * field.length - rules.holding_radius) & (
        jnp.abs(ball.y) < 0.5 * field.width - rules.holding_radius
    )
    return near & slow & free


def may_hold(rules: Rules, robots: Robots, direction: Array, field: Field) -> Array:
    """s for which each robot may hold the ball: the goalkeeper (shirt 0) longer in its area."""
    n = robots.x.shape[0] // 2
    keeper = upright([k == 0 for k in range(n)] * 2, robots.x)
    there = in_area(rules, robots, direction, field)
    return jnp.where(keeper & there, rules.holding_time_goalkeeper, rules.holding_time)


def in_area(rules: Rules, robots: Robots, direction: Array, field: Field) -> Array:
    """Inside of the own penalty area, [R]."""
    depth = 0.5 * field.length + direction * robots.x
    return (depth < rules.area_depth) & (jnp.abs(robots.y) < rules.area_half_width)


def charges(rules: Rules, robots: Robots, ball: RollingBall) -> Bool[Array, " R"]:
    """Walks into an opponent that it touches, far from the ball, [R]."""
    vx = robots.v * robots.cos - robots.v_y * robots.sin
    vy = robots.v * robots.sin + robots.v_y * robots.cos
    push = distance(robots.push_x, robots.push_y)
    into = -(vx * robots.push_x + vy * robots.push_y) > rules.charging_speed * push
    far = distance(ball.x - robots.x, ball.y - robots.y) > rules.charging_ball
    n = robots.x.shape[0] // 2
    dx = robots.x[:n, None] - robots.x[None, n:]
    dy = robots.y[:n, None] - robots.y[None, n:]
    on = robots.out <= 0
    close = (dx * dx + dy * dy < 0.34**2) & on[:n, None] & on[None, n:]
    home, away = _any(jnp.swapaxes(close, 0, 1)), _any(close)
    return jnp.concatenate([home, away]) & into & far & (push > 1e-3) & on


def trespasses(rules: Rules, robots: Robots, direction: Array, field: Field) -> Array:
    """A field player (any but shirt 0) in its own penalty area, [R]."""
    n = robots.x.shape[0] // 2
    player = upright([k > 0 for k in range(n)] * 2, robots.x)
    return player & (robots.out <= 0) & in_area(rules, robots, direction, field)


def send_off(rules: Rules, robots: Robots, called: Array, direction: Array, hand: Array) -> Robots:
    """Penalised robots go behind the wall, their clocks start."""
    n = robots.x.shape[0] // 2
    shirt = upright([float(k) for k in range(n)] * 2, robots.x)
    set_to = lambda old, new: jnp.where(called, new, old)  # noqa: E731
    return robots._replace(
        x=set_to(robots.x, direction * (-0.2 - 0.3 * shirt)),
        y=set_to(robots.y, -direction * hand * PARK_Y),
        cos=set_to(robots.cos, 0.0),
        sin=set_to(robots.sin, direction * hand),
        v=set_to(robots.v, 0.0),
        v_y=set_to(robots.v_y, 0.0),
        omega=set_to(robots.omega, 0.0),
        doing=set_to(robots.doing, 0),
        busy=set_to(robots.busy, 0.0),
        fallen=robots.fallen & ~called,
        out=set_to(robots.out, rules.penalty_time),
        holding=set_to(robots.holding, 0.0),
        charging=set_to(robots.charging, 0.0),
        trespassing=set_to(robots.trespassing, 0.0),
    )


def bring_back(
    robots: Robots,
    ball: RollingBall,
    direction: Array,
    hand: Array,
    playing: Array,
    dt: float,
    field: Field,
) -> Robots:
    """Penalties run while play does; then back beside the halfway line, in the own half, on the
    side away from the ball."""
    left = jnp.where(playing, jnp.maximum(robots.out - dt, 0), robots.out)
    left = jnp.where(left < 0.25 * dt, 0.0, left)
    back = (robots.out > 0) & (left <= 0)
    n = robots.x.shape[0] // 2
    shirt = upright([float(k) for k in range(n)] * 2, robots.x)
    edge = 0.5 * field.width - 0.16
    # -sign(y) of the ball; on the middle line the team's own left.
    where = jnp.where(ball.y > 0, -1.0, jnp.where(ball.y < 0, 1.0, direction * hand))
    return robots._replace(
        out=left,
        x=jnp.where(back, direction * (-0.1 - 0.2 * shirt), robots.x),
        y=jnp.where(back, edge * where, robots.y),
        cos=jnp.where(back, 0.0, robots.cos),
        sin=jnp.where(back, -where, robots.sin),
    )


def unstick(rules: Rules, robots: Robots, ball: RollingBall, game: Game, playing: Array, dt: float):
    """A ball that has not come away from where it was for too long goes to the nearest free restart
    spot.  Returns ball, spot_x, spot_y, stuck (s) and whether it was called."""
    gone = distance(ball.x - game.spot_x, ball.y - game.spot_y) > rules.stuck_radius
    stuck = jnp.where(playing, jnp.where(gone, 0.0, game.stuck + dt), game.stuck)
    spot_x, spot_y = jnp.where(gone, ball.x, game.spot_x), jnp.where(gone, ball.y, game.spot_y)
    called = playing & (stuck >= rules.stuck_time)
    best, x, y = jnp.full_like(ball.x, jnp.inf), ball.x, ball.y
    # In the frame of the team that kicked off, mirrored with the match: ties (a ball in the middle)
    # then fall alike whichever team is called home.
    ahead = jnp.where(game.kicker == 0, game.attack, -game.attack)
    for sx, sy in rules.restart_spots:
        px, py = sx * ahead, sy * ahead * game.hand
        away = distance(robots.x - px, robots.y - py)
        taken = _any(away < 0.25)
        cost = distance(ball.x - px, ball.y - py) + jnp.where(taken, 10.0, 0.0)
        nearer = cost < best
        best = jnp.where(nearer, cost, best)
        x, y = jnp.where(nearer, px, x), jnp.where(nearer, py, y)
    ball = RollingBall(
        jnp.where(called, x, ball.x),
        jnp.where(called, y, ball.y),
        jnp.where(called, 0.0, ball.vx),
        jnp.where(called, 0.0, ball.vy),
    )
    return (
        ball,
        jnp.where(called, ball.x, spot_x),
        jnp.where(called, ball.y, spot_y),
        jnp.where(called, 0.0, stuck),
        called,
    )


def on_target(ball: RollingBall, game: Game, deceleration: float, field: Field) -> Array:
    """The ball will roll into the goal that a team plays at, [2], if nobody touches it."""
    home = ball.vx * game.attack > 0
    speed2 = ball.vx * ball.vx + ball.vy * ball.vy
    line = jnp.where(ball.vx > 0, 0.5, -0.5) * field.length
    share = (line - ball.x) / jnp.where(ball.vx == 0, 1.0, ball.vx)  # s at constant speed
    y = ball.y + ball.vy * share
    # Run-out v^2 / 2a against the way to the line, v share.
    reaches = jnp.sqrt(speed2) > 2 * deceleration * share
    goes = (jnp.abs(y) < 0.5 * field.goal_width) & reaches & (speed2 > 0.1**2) & (ball.vx != 0)
    return jnp.stack([goes & home, goes & ~home])


def last_toucher(touching: Bool[Array, " R"], toucher: Array) -> Array:
    """Index of the robot that touched the ball last; a contested ball changes nothing."""
    n = touching.shape[0] // 2
    home = away = jnp.full(touching.shape[1:], -1)
    for k in reversed(range(n)):
        home = jnp.where(touching[k], k, home)
        away = jnp.where(touching[n + k], n + k, away)
    fresh = jnp.where(home >= 0, home, away)
    fresh = jnp.where((home >= 0) & (away >= 0), toucher, fresh)
    return jnp.where(fresh >= 0, fresh, toucher).astype(jnp.int32)


def judge(
    rules: Rules,
    field: Field,
    deceleration: float,
    dt: float,
    half_steps: int,
    old: Robots,
    robots: Robots,
    ball: RollingBall,
    game: Game,
    statistics: Statistics,
    near: Bool[Array, " R"],
):
    """All rules after one step of play.

    old: robots before the step; robots.touching: who touched the ball in it; near: who touches it
    now.  Returns robots, ball, game, statistics.
    """
    n = robots.x.shape[0] // 2
    count = lambda what: by_team(what.astype(jnp.int32))  # noqa: E731
    playing = (game.phase == PLAY) | (game.phase == KICKOFF)
    direction = directions(robots, game)
    game = game._replace(
        tick=game.tick + 1,
        played=game.played + playing.astype(jnp.int32),
        waited=game.waited + dt,
    )
    game = game._replace(phase=jnp.where(kickoff_over(rules, ball, game), PLAY, game.phase))

    # What is counted.
    touching = robots.touching & playing
    teams = count(touching) > 0
    toucher = last_toucher(touching, game.toucher)
    owner = jnp.where(toucher < 0, -1, toucher // n)
    mine = jnp.stack([owner == 0, owner == 1])
    passed = (toucher != game.toucher) & (toucher // n == game.toucher // n) & (game.toucher >= 0)
    aimed = on_target(ball, game, deceleration, field)
    shooting = jnp.where(aimed[0] & mine[0], 1, jnp.where(aimed[1] & mine[1], 2, 0))
    codes = upright([1, 2], teams)
    shots = (shooting == codes) & (game.shot != codes) & playing
    saved = (game.shot == codes[::-1]) & teams & (shooting != game.shot) & mine
    scored = goal(ball, game, field) & playing
    own = scored & mine[::-1]
    fell = robots.fallen & ~old.fallen
    statistics = statistics._replace(
        goals=statistics.goals + scored,
        own_goals=statistics.own_goals + own[::-1],
        possession=statistics.possession + (mine & playing),
        shots=statistics.shots + shots,
        saves=statistics.saves + saved,
        passes=statistics.passes + (mine & passed),
        touches=statistics.touches + count(touching & ~old.touching),
        falls=statistics.falls + count(fell),
    )
    game = game._replace(toucher=toucher, shot=shooting.astype(jnp.int32))

    # Rules against robots.
    on = robots.out <= 0
    robots = robots._replace(
        holding=seen_for(robots.holding, holds(rules, near, ball, field) & on & playing, dt),
        charging=seen_for(robots.charging, charges(rules, robots, ball) & playing, dt),
        trespassing=seen_for(
            robots.trespassing, trespasses(rules, robots, direction, field) & playing, dt
        ),
    )
    holding = robots.holding > may_hold(rules, robots, direction, field)
    charging = robots.charging > rules.charging_time
    trespassing = robots.trespassing > rules.illegal_time
    called = holding | charging | trespassing
    statistics = statistics._replace(penalties=statistics.penalties + count(called))
    robots = bring_back(robots, ball, direction, game.hand, playing, dt, field)
    robots = send_off(rules, robots, called, direction, game.hand)
    ball, spot_x, spot_y, stuck, freed = unstick(
        rules, robots, ball, game, (game.phase == PLAY) & playing & ~(scored[0] | scored[1]), dt
    )
    game = game._replace(spot_x=spot_x, spot_y=spot_y, stuck=stuck)

    # Goals, halves and kick-offs.
    any_goal = scored[0] | scored[1]
    over = playing & (game.played >= half_steps)
    pause = over & (game.half == 0)
    ends = over & (game.half == 1)
    resume = (game.phase == BREAK) & (game.waited >= rules.break_time)
    game = game._replace(
        phase=jnp.where(pause, BREAK, jnp.where(ends, FINISHED, game.phase)).astype(jnp.int32),
        waited=jnp.where(over, 0.0, game.waited),
        half=(game.half + resume + ends).astype(jnp.int32),
        attack=jnp.where(resume, -game.attack, game.attack),
        played=jnp.where(resume, 0, game.played),
        call=_call(
            (any_goal, 1),
            (pause, 2),
            (ends, 3),
            (_any(holding), 4),
            (_any(charging), 5),
            (_any(trespassing), 6),
            (freed, 7),
            (_any(fell), 8),
        ),
        caller=jnp.where(
            any_goal, jnp.where(scored[0], 0, 1), _first(jnp.where(_any(called), called, fell))
        ).astype(jnp.int32),
    )
    kicker = jnp.where(resume, 1 - game.first, jnp.where(scored[0], 1, 0))
    robots, ball, game = restart(
        rules, robots, ball, game, (any_goal & ~over) | resume, kicker.astype(jnp.int32)
    )
    return robots, ball, game._replace(phase=game.phase.astype(jnp.int32)), statistics


def _any(x: Any) -> Array:
    found = x[0]
    for row in x[1:]:
        found = found | row
    return found


def _first(x: Array) -> Array:
    """Index of the first robot of whom it is true, -1 for none."""
    index = jnp.full(x.shape[1:], -1)
    for k in reversed(range(x.shape[0])):
        index = jnp.where(x[k], k, index)
    return index


def _call(*cases: tuple[Array, int]) -> Array:
    """The code of the first case that holds."""
    code = jnp.zeros_like(cases[0][0], jnp.int32)
    for case, number in reversed(cases):
        code = jnp.where(case, number, code)
    return code


def signal(robots: Robots, game: Game) -> Array:
    """The referee's state of play for each robot, index into `envs.base.SIGNALS`, [R]."""
    n = robots.x.shape[0] // 2
    team = upright([0] * n + [1] * n, robots.x)
    kickoff = jnp.where(game.kicker == team, 1, 2)
    code = jnp.where(game.phase == KICKOFF, kickoff, 0)
    code = jnp.where(robots.out > 0, 3, code)
    code = jnp.where(game.phase == BREAK, 4, code)
    return jnp.where(game.phase == FINISHED, 5, code).astype(jnp.int32)


def play_time(rules: Rules, dt: float) -> int:
    """Control steps of a half."""
    return max(round(rules.half_minutes * 60 / dt), 1)
