import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs import scenes
from envs.base import Command, Scene
from envs.quadruped import constants as c
from envs.quadruped import make
from envs.quadruped.locomotion import SPEED


@pytest.fixture(scope="module")
def env():
    return make()


@pytest.fixture(scope="module")
def drive(env):
    """(scenes, v, omega [scenes, steps]) -> states at the start and after every step."""

    def one(scene, v, omega):
        def control_step(state, u):
            new = env.step(state, Command(*u))
            return new, new

        start = env.reset(scene)
        return start, jax.lax.scan(control_step, start, (v, omega))[1]

    return jax.jit(jax.vmap(one))


@pytest.fixture(scope="module")
def batch():
    return scenes.open_field(jax.random.key(0), 8)


def test_reset_puts_a_settled_dog_at_the_start(env, batch, drive):
    nothing = jnp.zeros((8, 20))
    start, after = drive(batch, nothing, nothing)
    pose = jax.vmap(env.snapshot)(start).robot
    np.testing.assert_allclose(pose[:, :2], batch.start[:, :2], atol=1e-6)
    turn = np.asarray(pose[:, 2] - batch.start[:, 2])
    np.testing.assert_allclose(np.sin(turn), 0, atol=2e-3)
    # Settled: two seconds of standing move it by less than half a millimetre (soft contacts creep).
    assert np.max(np.abs(after.qpos[:, -1, :3] - start.qpos[:, :3])) < 5e-4
    assert not after.fallen.any()


def test_it_walks_where_it_is_told(env, batch, drive):
    v = jnp.full((8, 40), 0.12)
    _, after = drive(batch, v, jnp.zeros((8, 40)))
    # The first steps from a stand turn it by about a tenth of a radian: look at the last three
    # seconds, from the heading it then has.
    pose = jax.vmap(jax.vmap(env.snapshot))(after).robot
    moved = pose[:, -1, :2] - pose[:, 9, :2]
    heading = pose[:, 9, 2]
    ahead = moved[:, 0] * jnp.cos(heading) + moved[:, 1] * jnp.sin(heading)
    aside = moved[:, 1] * jnp.cos(heading) - moved[:, 0] * jnp.sin(heading)
    # A period lasts 0.9 s, and the trunk swings with it.
    np.testing.assert_allclose(ahead, 0.36, atol=0.06)
    np.testing.assert_allclose(aside, 0, atol=0.1)
    omega = jnp.full((8, 40), -1.0)
    _, after = drive(batch, 0 * v, omega)
    pose = jax.vmap(env.snapshot)(jax.tree.map(lambda x: x[:, -1], after)).robot
    turned = np.angle(np.exp(1j * (np.asarray(pose[:, 2] - batch.start[:, 2]) + 4.0)))
    np.testing.assert_allclose(turned, 0, atol=0.4)


def test_observation_is_measured_from_capture_point_and_centre(env):
    scene = Scene(
        start=jnp.asarray([0.1, -0.2, np.pi / 2]),
        ball=jnp.asarray([0.1, -0.2 + c.CAPTURE_X + 0.5]),
        obstacles=jnp.asarray([[0.1 - 0.4, -0.2, 0.1]]),
    )
    seen = env.observe(env.reset(scene))
    assert seen.d_ball == pytest.approx(0.5, abs=1e-3)
    assert seen.theta_ball == pytest.approx(0.0, abs=5e-3)
    assert seen.d_obstacle == pytest.approx(0.3, abs=1e-3)
    assert seen.theta_obstacle == pytest.approx(np.pi / 2, abs=5e-3)


def test_a_fall_is_final_and_finite(env, batch):
    # Thrown over its side.
    def one(scene):
        start = env.reset(scene)
        thrown = start._replace(qvel=start.qvel.at[3].set(20.0).at[2].set(1.0))

        def control_step(state, _):
            new = env.step(state, Command(0.1, 0.0))
            return new, new

        return jax.lax.scan(control_step, thrown, length=40)[1]

    after = jax.jit(jax.vmap(one))(batch)
    fallen = np.asarray(after.fallen)
    assert fallen[:, -1].all()
    assert np.all(np.diff(fallen.astype(int), axis=1) >= 0)
    for leaf in jax.tree.leaves(after):
        assert np.isfinite(np.asarray(leaf, float)).all()
    np.testing.assert_array_equal(after.qpos[0, -1], after.qpos[0, -2])
    assert jax.vmap(env.failed)(jax.tree.map(lambda x: x[:, -1], after)).all()


def test_the_dog_keeps_to_its_servos_speed(env, batch, drive):
    _, after = drive(batch, jnp.full((8, 40), 0.15), jnp.full((8, 40), 0.3))
    most = env.dt * SPEED * (1 + 1e-4)
    assert np.all(np.abs(np.diff(after.set_points, axis=1)) <= most)


def test_a_dog_with_numbers_that_are_none_has_fallen(env, batch):
    state = env.reset(jax.tree.map(lambda x: x[0], batch))
    broken = env.accept(state, state.qpos * jnp.nan, state.qvel, state.phase, *state[3:5])
    assert broken.fallen
    assert np.isfinite(broken.qpos).all()


def test_balls_roll_and_obstacles_walk(env):
    one = jax.tree.map(lambda x: x[0], scenes.moving_ball(jax.random.key(1), 1))
    state = env.reset(one)
    new = env.accept(state, state.qpos, state.qvel, state.phase, *state[3:5])
    moved = np.hypot(new.ball.x - state.ball.x, new.ball.y - state.ball.y)
    assert moved == pytest.approx(0.1 * np.hypot(*one.ball_velocity), rel=0.1)
    one = jax.tree.map(lambda x: x[0], scenes.moving_obstacles(jax.random.key(1), 1))
    state = env.reset(one)
    new = env.accept(state, state.qpos, state.qvel, state.phase, *state[3:5])
    assert new.discs[0].x != state.discs[0].x


def test_options_are_checked():
    with pytest.raises(ValueError, match="known are"):
        make(legs=5)
    with pytest.raises(ValueError, match="v_max = 3"):
        make(v_max=3.0)
    with pytest.raises(ValueError, match=r"dt = 0\.05"):
        make(dt=0.05)
    assert make(dt=0.08).dt == pytest.approx(0.08)
    with pytest.raises(ValueError, match=r"servo_speed = 0\.0"):
        make(servo_speed=0.0)
    assert make().limits.v_max == 0.15  # its own, not the kinematic world's
    assert make(v_max=0.25).limits.v_max == 0.25


def test_batches_agree_with_single_trials(env, batch, drive):
    v, omega = jnp.full((8, 20), 0.12), jnp.full((8, 20), 0.5)
    _, together = drive(batch, v, omega)
    first = jax.tree.map(lambda x: x[:1], batch)
    _, alone = drive(first, v[:1], omega[:1])
    # Other vector widths round differently; contacts let that grow a little.
    np.testing.assert_allclose(together.qpos[0, -1], alone.qpos[0, -1], atol=2e-3)


def test_making_the_world_does_not_start_jax():
    # Command lines set XLA's flags after checking options; XLA reads them when it starts.
    import subprocess
    import sys

    code = """
from jax._src import xla_bridge
from envs.quadruped import make
from envs.quadruped.locomotion import SPEED
make()
print(xla_bridge.backends_are_initialized())
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=True
    )
    assert done.stdout.split() == ["False"]
