import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.quadruped import locomotion as walk
from envs.quadruped.locomotion import HIGH, LOW, SHOULDERS, Gait, leg_forward, leg_inverse


def _angles(num, seed=0):
    q = np.random.default_rng(seed).uniform(LOW, HIGH, (num, 4, 3)).astype(np.float32)
    # The knee's positive side is the one that inverse kinematics chooses.
    q[..., 2] = np.abs(q[..., 2])
    return q


def test_forward_of_inverse_is_the_identity_over_the_workspace():
    feet = leg_forward(_angles(20000))
    again = leg_forward(leg_inverse(feet))
    assert np.max(np.abs(again - feet)) < 2e-6


def test_inverse_of_forward_gives_the_angles_back_away_from_singular_poses():
    q = _angles(20000, seed=1)
    # Both a leg turned over its own shoulder and a foot straight under the J1 axis have other
    # solutions; below them, and not stretched, there is one.
    q[..., 0] = np.clip(q[..., 0], -1.0, 1.0)
    q[..., 1] = np.clip(q[..., 1], -0.1, 1.2)
    q[..., 2] = np.clip(q[..., 2], 0.2, 1.6)
    assert np.max(np.abs(leg_inverse(leg_forward(q)) - q)) < 2e-4


def test_forward_kinematics_are_the_models():
    mujoco = pytest.importorskip("mujoco")
    from envs.quadruped.physics import Solver, compile_model

    model = compile_model("lean", Solver())
    data = mujoco.MjData(model)
    for q in _angles(20, seed=2):
        data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        data.qpos[7:] = q.ravel()
        mujoco.mj_kinematics(model, data)
        feet = np.array([data.geom(f"{leg}_foot").xpos for leg in walk.c.LEGS])
        assert np.max(np.abs(feet - leg_forward(q))) < 1e-6


def test_a_target_out_of_reach_is_pulled_onto_its_ray():
    direction = np.array([0.2, 0.1, -1.0]) / np.linalg.norm([0.2, 0.1, -1.0])
    sides = np.stack([walk.FORE, walk.SIDE, np.ones(4)], axis=1)
    far = SHOULDERS + 0.5 * direction * sides
    foot = leg_forward(leg_inverse(far)) - SHOULDERS
    length = np.linalg.norm(foot, axis=1)
    np.testing.assert_allclose(foot / length[:, None], direction * sides, atol=1e-3)
    np.testing.assert_allclose(length, walk.THIGH + walk.SHIN, rtol=1e-4)


def test_inverse_is_finite_everywhere_with_finite_gradient():
    rng = np.random.default_rng(3)
    targets = jnp.asarray(
        np.concatenate([rng.uniform(-0.3, 0.3, (500, 4, 3)), SHOULDERS[None], np.zeros((1, 4, 3))]),
        jnp.float32,
    )
    q = leg_inverse(targets)
    assert np.all(np.isfinite(q))
    assert np.all((q >= LOW) & (q <= HIGH))
    gradient = jax.grad(lambda t: jnp.sum(leg_inverse(t)))(targets)
    assert np.all(np.isfinite(gradient))


def test_without_a_command_the_dog_stands_still():
    gait = walk.load_gait()
    phases = jnp.linspace(0, 1, 50)
    points = walk.set_points(gait, phases, jnp.zeros(3))
    assert np.max(np.ptp(np.asarray(points), axis=0)) < 1e-4


def test_feet_on_the_ground_move_against_the_body():
    gait = Gait(period=0.5, duty=0.6)
    velocity = jnp.asarray([0.2, -0.05, 0.7])
    ds = 1e-3
    phase = jnp.asarray([0.1, 0.1 + ds])  # left fore and right hind are on the ground
    feet = np.asarray(walk.foot_targets(gait, phase, velocity))
    speed = (feet[1] - feet[0]) / (ds * 0.5)
    stand = np.asarray(walk.stance(gait))
    wanted = -np.stack([0.2 - 0.7 * stand[:, 1], -0.05 + 0.7 * stand[:, 0]], axis=1)
    for leg in (0, 3):
        np.testing.assert_allclose(speed[leg, :2], wanted[leg], atol=2e-3)
        assert feet[0][leg, 2] == pytest.approx(stand[leg, 2], abs=1e-6)
    # The other two are in the air half a period later; nothing jumps over the whole cycle.
    cycle = np.asarray(walk.foot_targets(gait, jnp.linspace(0, 1, 501), velocity))
    assert np.max(np.abs(np.diff(cycle, axis=0))) < 2e-3
    assert cycle[..., 2].max() - stand[:, 2].max() == pytest.approx(gait.lift, rel=1e-3)


def test_mirrored_commands_give_mirrored_set_points():
    gait = walk.load_gait()
    phases = jnp.linspace(0, 1, 20)
    there = walk.set_points(gait, phases, jnp.asarray([0.1, 0.05, 0.8])).reshape(20, 4, 3)
    mirrored = walk.set_points(gait, phases + 0.5, jnp.asarray([0.1, -0.05, -0.8]))
    back = mirrored.reshape(20, 4, 3)[:, jnp.asarray([1, 0, 3, 2])]
    np.testing.assert_allclose(there, back, atol=2e-5)


def test_stride_follows_its_command_no_faster_than_the_gait_allows():
    gait = Gait(v_rate=1.0, omega_rate=10.0)
    stride = walk.follow(gait, jnp.zeros(3), jnp.asarray([0.2, -0.01, 1.5]), 0.1)
    np.testing.assert_allclose(stride, [0.1, -0.01, 1.0], atol=1e-6)


def test_a_gait_file_with_an_unknown_name_is_refused(tmp_path):
    path = tmp_path / "gait.json"
    path.write_text(json.dumps({"gait": {"tempo": 1.0}}))
    with pytest.raises(ValueError, match="tempo"):
        walk.load_gait(path)


def test_set_points_keep_to_the_servos_speed():
    gait = Gait(period=0.35)
    phases = jnp.arange(200) * 0.005 / 0.35 % 1
    wanted = walk.set_points(gait, phases, jnp.asarray([0.2, 0.0, 0.5]))
    most = 0.005 * walk.SPEED
    assert np.max(np.abs(np.diff(wanted, axis=0)) / most) > 1.5  # it asks for more
    got = np.asarray(walk.limit(wanted, wanted[0], jnp.asarray(most)))
    assert np.max(np.abs(np.diff(got, axis=0)) / most) < 1 + 1e-3
    # By hand for one joint.
    at = float(wanted[0, 2])
    for n in range(200):
        at += np.clip(float(wanted[n, 2]) - at, -most[2], most[2])
        assert got[n, 2] == pytest.approx(at, abs=1e-4)


def test_a_crawl_lifts_one_foot_after_the_other():
    gait = Gait(crawl=1.0, duty=0.76)
    feet = np.asarray(walk.foot_targets(gait, jnp.linspace(0, 1, 400), jnp.asarray([0.1, 0, 0])))
    up = feet[..., 2] > np.asarray(walk.stance(gait))[:, 2] + 1e-4
    assert up.any(axis=0).all() and up.sum(axis=1).max() == 1
