"""The physical match: one model, the match's own referee, and what it moves moved in the model."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Action, Walk
from envs.soccer import Match, physical_model
from envs.soccer.physical import Physical


def act(robots, **walk):
    none = jnp.zeros((robots, 1), jnp.int32)
    zero = jnp.zeros((robots, 1))
    values = {"v": zero, "v_y": zero, "omega": zero} | walk
    return Action(
        Walk(none, **values),
        jnp.zeros((3, robots, 1)),
        none,
        none,
        jnp.zeros((2, robots, 1), jnp.uint32),
    )


def test_model():
    match = Match()
    model = physical_model.build(match.field, 6, 0.004)
    assert (model.nq, model.nu) == (7 + 6 * 24, 6 * 17)
    dog = sum(model.body_mass[model.body_rootid == model.body("robot0_trunk").id])
    every = [model.body(physical_model.prefix(k) + "trunk").id for k in range(6)]
    masses = [sum(model.body_mass[model.body_rootid == root]) for root in every]
    np.testing.assert_allclose(masses, dog)
    assert 1.3 < dog < 1.5


@pytest.fixture(scope="module")
def physical():
    return Physical(Match(players=1, minutes=1))


def test_walks_as_it_is_told(physical):
    state = physical.reset(0, 3)
    start = np.asarray(state.robots.x)[:, 0]
    action = act(2, v=jnp.asarray([[0.0], [0.12]]), omega=jnp.asarray([[0.5], [0.0]]))
    turned = 0.0
    for _ in range(30):
        state = physical.step(state, action)
        turned += float(state.robots.turned[0, 0])
        np.testing.assert_allclose(
            state.robots.x[:, 0], physical.data.qpos[physical._base], atol=1e-4
        )
    assert not state.robots.fallen.any()
    # Away plays towards -x; its own odometry is the gait's, not the truth.
    assert -0.40 < float(state.robots.x[1, 0]) - start[1] < -0.20
    assert 1.0 < turned < 1.8
    assert float(state.robots.odometry_x[1, 0]) == pytest.approx(0.012, abs=1e-4)


def test_a_goal_is_a_goal_and_the_referee_moves_bodies(physical):
    state = physical.reset(0, 3)
    stand = act(2)
    for _ in range(2):
        state = physical.step(state, stand)
    at, speed = physical._ball
    physical.data.qpos[at : at + 2] = 1.2, 0.0
    physical.data.qpos[physical._base[1] + 1] = 0.6  # the goalkeeper is elsewhere
    physical.data.qvel[speed] = 1.0
    for _ in range(12):
        state = physical.step(state, stand)
    assert np.asarray(state.statistics.goals)[:, 0].tolist() == [1, 0]
    # The kick-off: bodies and ball stand at their places in the model, too.
    np.testing.assert_allclose(physical.data.qpos[at : at + 2], 0, atol=0.02)
    np.testing.assert_allclose(
        state.robots.y[:, 0], physical.data.qpos[physical._base + 1], atol=1e-3
    )


def test_a_fall_is_seen_and_got_up_from(physical):
    state = physical.reset(0, 4)
    base = physical._base[0]
    physical.data.qpos[base + 2 : base + 7] = 0.08, np.sqrt(0.5), np.sqrt(0.5), 0, 0  # on its side
    state = physical.step(state, act(2))
    assert state.robots.fallen[0, 0] and not state.robots.fallen[1, 0]
    names = physical.match.bodies.home.postures.name
    up = act(2)._replace(posture=jnp.full((2, 1), 1 + names.index("get-up"), jnp.int32))
    for _ in range(80):
        state = physical.step(state, up)
        if not state.robots.fallen[0, 0]:
            break
    assert not state.robots.fallen[0, 0]
    assert physical.data.qpos[base + 2] > 0.07


def test_deterministic(physical):
    def course():
        state = physical.reset(1, 9)
        for _ in range(5):
            state = physical.step(state, act(2, v=jnp.full((2, 1), 0.1)))
        return jax.device_get(state)

    for one, other in zip(jax.tree.leaves(course()), jax.tree.leaves(course())):
        np.testing.assert_array_equal(one, other)


def test_wheels_do_not_walk():
    with pytest.raises(ValueError, match="only ers210 can walk"):
        Physical(Match(home="wheels"))
