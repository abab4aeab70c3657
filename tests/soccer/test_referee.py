"""Each rule in a situation made by hand."""

import jax.numpy as jnp
import pytest

from envs.soccer import Match, referee
from envs.soccer.state import RollingBall

MATCH = Match()
FAR = [[-1.2, 0, 0], [-0.5, 0.6, 0], [-0.5, -0.6, 0], [1.2, 0, 3.1], [0.5, 0.6, 3], [0.5, -0.6, 3]]


def situation(robots=None, ball=(0, 0, 0, 0)):
    rows = [list(row) for row in FAR]
    for k, row in (robots or {}).items():
        rows[k] = row
    return MATCH.place(MATCH.reset(0, 0), jnp.asarray(rows, jnp.float32), jnp.asarray(ball, float))


@pytest.mark.parametrize(
    ("ball", "attack", "expected"),
    [
        ((1.45, 0.1), 1, [True, False]),
        ((1.45, 0.1), -1, [False, True]),
        ((-1.45, 0.0), 1, [False, True]),
        ((1.43, 0.0), 1, [False, False]),  # not wholly behind the line
    ],
)
def test_goal(ball, attack, expected):
    state = situation(ball=(*ball, 0, 0))
    game = state.game._replace(attack=jnp.float32(attack))
    assert list(referee.goal(state.ball, game, MATCH.field)) == expected


def test_holding_needs_a_resting_ball_away_from_walls():
    near = jnp.array([True] + [False] * 5)
    for ball, held in (((0, 0, 0, 0), True), ((0, 0, 0.3, 0), False), ((0, 0.85, 0, 0), False)):
        rolling = RollingBall(*jnp.asarray(ball, jnp.float32))
        found = referee.holds(MATCH.rules, near, rolling, MATCH.field)
        assert list(found) == [held] + [False] * 5
    state = situation({1: [-1.3, 0.2, 0]})
    direction = referee.directions(state.robots, state.game)
    allowed = referee.may_hold(MATCH.rules, state.robots, direction, MATCH.field)
    assert list(allowed) == [5, 3, 3, 5, 3, 3]  # goalkeepers in their areas


def test_illegal_defender():
    state = situation({1: [-1.3, 0.2, 0], 4: [-1.3, -0.2, 0]})
    direction = referee.directions(state.robots, state.game)
    found = referee.trespasses(MATCH.rules, state.robots, direction, MATCH.field)
    assert list(found) == [False, True] + [False] * 4  # in the other team's area all may be


def test_charging():
    for ball, called in (((-1, -0.8, 0, 0), True), ((0.2, 0, 0, 0), False)):
        state = situation({1: [0.0, 0, 0], 4: [0.28, 0, 3.14]}, ball)
        robots = state.robots._replace(
            v=state.robots.v.at[1].set(0.15), push_x=state.robots.push_x.at[1].set(-0.01)
        )
        found = referee.charges(MATCH.rules, robots, state.ball)
        assert list(found) == [False, called] + [False] * 4


def test_a_stuck_ball_goes_to_the_nearest_free_spot():
    for taken, y in (({}, 0.45), ({1: [0.7, 0.5, 0]}, -0.45)):
        state = situation(taken, (0.6, 0.1, 0, 0))
        game = state.game._replace(stuck=jnp.float32(19.95))
        ball, *_, called = referee.unstick(MATCH.rules, state.robots, state.ball, game, True, 0.1)
        assert called and (float(ball.x), float(ball.y)) == pytest.approx((0.7, y))


def test_a_tie_between_spots_falls_alike_for_both_teams():
    """A ball that nobody has touched lies as near to all four: the team that kicked off decides."""
    found = []
    for kicker in (0, 1):
        state = situation(ball=(0, 0, 0, 0))
        game = state.game._replace(stuck=jnp.float32(19.95), kicker=jnp.int32(kicker))
        ball, *_, called = referee.unstick(MATCH.rules, state.robots, state.ball, game, True, 0.1)
        assert called
        found.append((float(ball.x), float(ball.y)))
    assert found[0] == tuple(-a for a in found[1])


def test_a_penalty_and_the_way_back():
    state = situation(ball=(0, 0.5, 0, 0))
    direction = referee.directions(state.robots, state.game)
    called = jnp.array([False, True] + [False] * 4)
    robots = referee.send_off(MATCH.rules, state.robots, called, direction, state.game.hand)
    assert abs(float(robots.y[1])) > 0.9 and float(robots.out[1]) == 30
    assert int(referee.signal(robots, state.game)[1]) == 3
    robots = robots._replace(out=robots.out.at[1].set(0.1))
    robots = referee.bring_back(
        robots, state.ball, direction, state.game.hand, True, 0.1, MATCH.field
    )
    assert float(robots.out[1]) == 0 and float(robots.x[1]) < 0  # in its own half,
    assert -0.9 < float(robots.y[1]) < 0  # away from the ball
