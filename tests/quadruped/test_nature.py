"""Trials whose dogs, carpets and senses differ from the model."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs.base import Command, Observation, Scene
from envs.quadruped import make, nature

ALL = {"friction_low": 0.4, "mass": 0.15, "gain": 0.3, "torque": 0.2, "latency": 0.1}
ALL |= {"angle_noise": 0.03, "range_noise": 0.05, "push": 0.3, "pose": 0.1}


def scenes(num):
    return Scene(
        jnp.zeros((num, 3)), jnp.full((num, 2), 0.5), jnp.zeros((num, 0, 3)), seed=jnp.arange(num)
    )


@pytest.fixture(scope="module")
def states():
    env = make(**ALL)
    return env, jax.jit(jax.vmap(env.reset))(scenes(400))


def test_what_trials_draw_is_uniform_in_its_ranges(states):
    drawn = states[1].fate.variation
    for value, low, high in (
        (drawn.friction, 0.4, 1.0),
        (drawn.mass, 0.85, 1.15),
        (drawn.gain, 0.7, 1.3),
        (drawn.torque, 0.8, 1.2),
    ):
        assert low <= float(value.min()) and float(value.max()) <= high
        assert np.std(value) == pytest.approx((high - low) / np.sqrt(12), rel=0.1)
    assert np.abs(np.corrcoef(np.stack(drawn)) - np.eye(4)).max() < 0.2
    off = states[1].qpos[:, 7:] - states[0].rest[7:]
    assert 0.09 < float(jnp.abs(off).max()) <= 0.1


def test_senses_are_late_by_the_latency_and_noisy_by_the_noise():
    world = nature.Nature(latency=0.15, angle_noise=0.0, range_noise=0.0)
    start = Observation(*map(jnp.float32, (1.0, 0.5, 3.1, -3.1)))
    fate = nature.draw(world, 3, start)
    for n in range(1, 5):
        seen = Observation(*map(jnp.float32, (1.0 + n, 0.5, 3.1 + 0.02 * n, 1.0)))
        fate = nature.remember(fate, seen._replace(theta_ball=nature.wrap(seen.theta_ball)))
    late = nature.sense(world, fate, 0.1)
    assert float(late.d_ball) == pytest.approx(1 + 4 - 1.5, abs=1e-5)
    across = 3.1 + 0.02 * 2.5 - 2 * np.pi
    assert float(late.theta_ball) == pytest.approx(across, abs=1e-5)
    noisy = nature.Nature(angle_noise=0.03, range_noise=0.05)
    many = jax.vmap(lambda s: nature.sense(noisy, nature.draw(noisy, s, start), 0.1))(
        jnp.arange(2000)
    )
    assert np.std(many.d_ball) == pytest.approx(0.05, rel=0.1)
    assert np.std(nature.wrap(many.theta_ball - 3.1)) == pytest.approx(0.03, rel=0.1)


def test_a_push_comes_every_four_seconds_and_the_dog_walks_on(states):
    env, state = states
    state = jax.tree.map(lambda x: x[:8], state)
    speeds = nature.push(env.nature, jax.tree.map(lambda x: x[0], state.fate), jnp.zeros(18))
    np.testing.assert_array_equal(speeds, 0)
    last = jax.tree.map(lambda x: x[0], state.fate)._replace(time=jnp.uint32(39))
    hit = nature.push(env.nature, last, jnp.zeros(18))
    assert 0 < float(jnp.abs(hit[:2]).max()) < 1.5 and not np.any(hit[2:])

    def walk(state):
        command = Command(jnp.float32(0.1), jnp.float32(0.2))
        return jax.lax.scan(lambda s, _: (env.step(s, command), None), state, None, 50)[0]

    end = jax.jit(jax.vmap(walk))(state)
    assert not np.any(end.fallen)
    far = np.linalg.norm(np.asarray(end.qpos[:, :2]), axis=1)
    assert far.min() > 0.2 and np.ptp(far) > 0.01  # they differ


def test_without_a_nature_nothing_is_carried():
    assert make().reset(jax.tree.map(lambda x: x[0], scenes(1))).fate is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass": 0.9}, "mass = 0.9: allowed are 0 to 0.5"),
        ({"friction_low": 1.5}, "friction_low = 1.5: must not be above friction_high = 1.0"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        make(**options)
    with pytest.raises(ValueError, match="only the world quadruped varies the dog"):
        make("jax", mass=0.1)
