import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.robot import behaviors
from fntg_jax.robot.messages import Need

SPEEDS = behaviors.Speeds(*(jnp.full(9, x) for x in (0.15, 0.08, 1.0)))


def need(**given):
    plain = Need(0.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0)._replace(**given)
    return Need(*(jnp.asarray(x) for x in plain))


def act(number, **given):
    nowhere = lambda *_: (jnp.asarray(9.0), jnp.asarray(-9.0))  # noqa: E731
    return behaviors.act(jnp.asarray(number), need(**given), SPEEDS, nowhere)


def test_standing_stands():
    motion = act(1)
    assert float(motion.v) == float(motion.v_y) == float(motion.omega) == 0


@pytest.mark.parametrize(("distance", "side"), [(0.5, -1), (-0.5, 1)])
def test_lateral_movement_to_the_right_is_a_positive_distance(distance, side):
    motion = act(2, distance=distance)
    assert np.sign(float(motion.v_y)) == side and float(motion.v) == float(motion.omega) == 0


@pytest.mark.parametrize(("number", "field"), [(2, "v_y"), (4, "v")])
def test_distances_end(number, field):
    assert float(getattr(act(number, distance=0.002), field)) == 0


@pytest.mark.parametrize("number", [3, 9])
def test_the_ball_is_circled_away_from_the_goals_side(number):
    motion = act(number, d_ball=0.2, goal=0.5)  # the goal is to the left: step to the right
    assert float(motion.v_y) < 0 < float(motion.omega)
    assert np.allclose(
        np.array(act(number, d_ball=0.2, goal=-0.5)[:3])[1:], -np.array(motion[:3])[1:]
    )


def test_bioa_is_the_one_handed_in_within_the_bodys_limits():
    motion = act(7)  # asks for (9, -9): the same way, slower
    assert float(motion.v) == pytest.approx(0.15) and float(motion.omega) == pytest.approx(-0.15)


def test_a_kick_is_an_index_from_one():
    assert int(act(6, kick=2).kick) == 3 and int(act(5).kick) == 0


def test_every_behavior_is_within_the_limits_and_finite():
    rng = np.random.default_rng(0)
    for number in range(1, 10):
        for _ in range(20):
            far, angles = rng.uniform(-2, 2), rng.uniform(-3.2, 3.2, 2)
            given = {"distance": far, "d_ball": abs(far), "ball": angles[0], "goal": angles[1]}
            v, v_y, omega = (float(x) for x in act(number, **given)[:3])
            assert abs(v) <= 0.15 + 1e-6 and abs(v_y) <= 0.08 + 1e-6 and abs(omega) <= 1 + 1e-6
