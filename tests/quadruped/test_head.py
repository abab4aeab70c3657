import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Camera, Head
from envs.quadruped import head

NECK = Head()


def test_look_to_points_the_camera_axis_at_the_point():
    rng = np.random.default_rng(0)
    angle, far = rng.uniform(-1.0, 1.0, 500), rng.uniform(0.4, 2.0, 500)
    points = np.stack([far * np.cos(angle), far * np.sin(angle), rng.uniform(0, 0.25, 500)], 1)
    joints = jax.vmap(head.look_to)(jnp.asarray(points, jnp.float32))
    place, axis = jax.vmap(head.camera)(joints)
    towards = points - place
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    assert np.linalg.norm(np.cross(towards, axis), axis=1).max() < 2e-3
    assert (np.sum(towards * axis, axis=1) > 0).all()
    assert (np.abs(joints[:, 2]) == 0).all()


def test_camera_is_where_mujoco_has_it():
    mujoco = pytest.importorskip("mujoco")
    from envs.quadruped.physics import Solver, compile_model

    model = compile_model("full", Solver())
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for q in rng.uniform(NECK.low, NECK.high, (20, 3)):
        data.qpos[:7] = (0, 0, 0.105, 1, 0, 0, 0)  # standing: the neck's base is 0.13 m up
        data.qpos[19:22] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        place, axis = head.camera(jnp.asarray(q, jnp.float32))
        # MuJoCo's picture is taken at the tip of the nose, 0.05 m further.
        np.testing.assert_allclose(data.cam("nose").xpos, place + 0.05 * axis, atol=1e-5)
        np.testing.assert_allclose(-data.cam("nose").xmat.reshape(3, 3)[:, 2], axis, atol=1e-5)


def test_follow_keeps_limits_and_speeds():
    at = jnp.zeros(3)
    for _ in range(30):
        new = head.follow(at, jnp.asarray([9.0, -9.0, 9.0]), 0.1)
        assert np.all(np.abs(new - at) <= np.array(NECK.speed) * 0.1 + 1e-6)
        at = new
    np.testing.assert_allclose(at, [NECK.high[0], NECK.low[1], NECK.high[2]], atol=1e-6)


@pytest.mark.parametrize("pattern", head.SCANS)
def test_a_scan_keeps_limits_and_speeds_and_sweeps(pattern):
    times = jnp.linspace(0, 8, 1601)
    path = np.asarray(jax.vmap(lambda t: head.scan(t, pattern))(times))
    assert np.all(path >= NECK.low) and np.all(path <= NECK.high)
    assert np.all(np.abs(np.diff(path, axis=0)) / 0.005 <= np.array(NECK.speed) * 1.001)
    assert path[:, 1].min() < -1.4 and path[:, 1].max() > 1.4


def test_unknown_pattern_is_refused():
    with pytest.raises(ValueError, match="scan = 'up'"):
        head.scan(0.0, "up")


def test_a_ball_that_circles_stays_in_sight():
    """0.3 to 2 m away, up to 2 rad/s about the dog where the neck can turn to."""
    dt = 0.1
    rng = np.random.default_rng(2)
    far, rate = jnp.asarray(rng.uniform(0.3, 2.0, 200)), jnp.asarray(rng.uniform(0.2, 2.0, 200))

    def circle(far, rate):
        def step(at, n):
            # To and fro within the head's reach.
            swing = jnp.arcsin(jnp.sin(rate * n * dt / 1.4)) * 1.4 / 1.571
            point = jnp.stack([far * jnp.cos(swing), far * jnp.sin(swing), 0.042])
            at = head.follow(at, head.look_to(point), dt)
            place, axis = head.camera(at)
            towards = (point - place) / jnp.linalg.norm(point - place)
            return at, jnp.dot(towards, axis)

        return jax.lax.scan(step, jnp.zeros(3), jnp.arange(100))[1]

    cosine = np.asarray(jax.jit(jax.vmap(circle))(far, rate))
    assert np.mean(cosine > np.cos(0.5 * Camera().vertical)) > 0.9
