"""The match: kick-off, clock, goals, seeds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Action, Walk
from envs.soccer import Match

MATCH = Match(minutes=0.1)
RESET = jax.jit(MATCH.reset)
STEP = jax.jit(MATCH.step)


def action(v=0.0, omega=0.0, kick=0, robots=6):
    many = lambda value, dtype=jnp.float32: jnp.full(robots, value, dtype)  # noqa: E731
    return Action(
        Walk(many(0, jnp.int32), many(v), many(0.0), many(omega)),
        jnp.zeros((robots, 3)),
        many(kick, jnp.int32),
        many(0, jnp.int32),
        jnp.zeros((robots, 2), jnp.uint32),
    )


def test_kickoff_mirrors_with_the_team_that_has_it():
    home, away = RESET(0, 1), RESET(1, 1)
    np.testing.assert_array_equal(home.robots.x[:3], -away.robots.x[3:])
    np.testing.assert_array_equal(home.robots.y[3:], -away.robots.y[:3])
    assert list(MATCH.sense(home).signal) == [1, 1, 1, 2, 2, 2]


def test_a_match_ends_and_then_nothing_changes():
    state = RESET(0, 3)
    phases = []
    for _ in range(MATCH.steps):
        state = STEP(state, action(0.1))
        phases.append(int(state.game.phase))
    assert {1, 2, 3} <= set(phases) and phases[-1] == 3
    assert float(state.game.attack) == -1  # sides were changed
    after = STEP(state, action(0.1))
    np.testing.assert_array_equal(after.robots.x, state.robots.x)
    assert MATCH.finished(after)


def test_a_ball_that_rolls_over_the_line_counts():
    robots = jnp.array(
        [[-1.2, 0, 0], [-1, 0.5, 0], [-1, -0.5, 0], [-1, 0.8, 0], [0, 0.5, 0], [0, -0.5, 0.0]]
    )
    state = MATCH.place(RESET(0, 3), robots, jnp.array([1.2, 0.1, 1.0, 0.0]))
    for _ in range(4):
        state = STEP(state, action())
    assert list(MATCH.score(state)) == [1, 0]
    assert int(state.game.kicker) == 1
    assert float(state.ball.x) == 0


def test_the_batch_is_the_matches_one_by_one():
    seeds = jnp.arange(3)
    batch = MATCH.reset(jnp.zeros(3, jnp.int32), seeds)
    moves = action(0.15, 0.3)
    last = jax.tree.map(
        lambda a: jnp.broadcast_to(jnp.moveaxis(a, 0, -1)[..., None], (*a.shape[1:], 6, 3)), moves
    )
    step = jax.jit(MATCH.step_batch)
    one = RESET(0, 2)
    for _ in range(20):
        batch, one = step(batch, last), STEP(one, moves)
    for a, b in zip(jax.tree.leaves(batch), jax.tree.leaves(one)):
        np.testing.assert_allclose(np.asarray(a[..., 2], float), np.asarray(b, float), atol=1e-5)


@pytest.mark.parametrize(
    ("field", "value"),
    [("players", 6), ("players", 0), ("camera", "x"), ("minutes", -1.0), ("home", "/nowhere")],
)
def test_refused(field, value):
    with pytest.raises(ValueError, match=field if field != "home" else "nowhere"):
        Match(**{field: value})
