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


def test_the_head_of_the_walking_dog_keeps_the_ball_in_its_picture():
    pytest.importorskip("mujoco")
    from envs.base import Command, Scene
    from envs.quadruped import make, native

    places = np.array([[0.5, 0.3], [0.3, -0.6], [1.0, 0.0], [-0.2, 0.7]], np.float32)
    scenes = Scene(
        np.zeros((4, 3), np.float32), places, np.zeros((4, 0, 3), np.float32), seed=np.zeros(4, int)
    )

    def control(seen, _):
        turn = jnp.clip(1.5 * seen.theta_ball, -0.8, 0.8)
        return Command(0.08 * jnp.cos(seen.theta_ball).clip(0), turn)

    run = native.run(make(), scenes, control, "full", num_steps=60)
    view, seen = Camera(), []
    for qpos, ball in zip(run.qpos[1:].reshape(-1, 31), run.ball[1:].reshape(-1, 2)):
        w, i, j, k = qpos[3:7]
        rows = np.array(
            [
                [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
                [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
                [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
            ]
        )
        point = rows.T @ (np.array([*ball, 0.042]) - qpos[:3])
        tilt, pan = qpos[19:21]
        # Through the neck: tilt turns about -y at its base, pan about z 0.048 m above it.
        x, y, z = point - [0.070, 0.0, 0.025]
        x, z = x * np.cos(tilt) + z * np.sin(tilt), z * np.cos(tilt) - x * np.sin(tilt) - 0.048
        x, y = x * np.cos(pan) + y * np.sin(pan) - 0.10, y * np.cos(pan) - x * np.sin(pan)
        inside = abs(np.arctan2(y, x)) < view.horizontal / 2
        seen.append(inside and abs(np.arctan2(z, np.hypot(x, y))) < view.vertical / 2)
    seen = np.array(seen).reshape(60, 4)[10:]
    assert seen.mean() > 0.9
