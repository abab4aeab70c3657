"""Key-frame motions: what may be loaded, and what they do to dog and ball."""

import json

import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs.quadruped import make, motions
from experiments import evolve_motion

SHIPPED = sorted(p.stem for p in motions.FOLDER.glob("*.json"))


@pytest.fixture(scope="module")
def env():
    return make()


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_motions_keep_to_limits_and_end_on_their_feet(name, env):
    motion = motions.load(name, motions.standing(env))
    points = motions.set_points(motion, env.solver.timestep)
    assert np.all(points >= motions.LOW - 1e-6) and np.all(points <= motions.HIGH + 1e-6)
    speed = np.abs(np.diff(points, axis=0)) / env.solver.timestep
    assert np.all(speed <= 1.002 * motions.SPEED)
    end = motions.kick(env, points, motion.strike, np.array([[0.8, 0.6]]))
    assert end.upright > 0.7 and end.height > 0.05
    np.testing.assert_allclose(end.ball, 0, atol=1e-3)  # it lies elsewhere


def test_the_forward_kick_sends_the_ball_ahead(env):
    motion = motions.load("forward", motions.standing(env))
    points = motions.set_points(motion, env.solver.timestep)
    place = json.loads((motions.FOLDER / "forward.json").read_text())["ball"]
    ball = motions.kick(env, points, motion.strike, np.array([place])).ball[0]
    assert ball[0] > 0.1 and abs(ball[1]) < 0.1
    # The committed table is of the shipped kick.
    table = json.loads((motions.FOLDER.parent / "kicks.json").read_text())["kicks"]
    row = next(r for r in table if r["name"] == "forward")
    assert row["duration"] == pytest.approx(motion.times[-1], abs=1e-3)
    assert row["falls"] == 0


def test_places_of_the_ball_are_within_the_stated_distance():
    at = np.array([0.16, 0.0])
    places = motions.displaced(np.random.default_rng(0), at, 500)
    assert places.shape == (500, 2)
    far = np.linalg.norm(places, axis=1)
    assert far.min() > 0.14 - 1e-9 and far.max() < 0.18 + 1e-9


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([{"time": 1.0, "joints": {"lf_j2": -0.5}}], "lf_j2 = -0.5 at 1.0 s: allowed are -0.192"),
        ([{"time": 0.1, "joints": {"head_pan": 1.5}}], "head_pan moves at 15.00 rad/s"),
        ([{"time": 1.0, "joints": {"mouth": 0.1}}], "joint 'mouth': allowed are lf_j1"),
        ([{"time": 0.0, "joints": {}}], "time = 0.0: allowed are rising ones"),
        ([{"joints": {}}], "allowed is JSON with 'frames'"),
    ],
)
def test_a_motion_that_no_servo_could_do_is_refused(frames, message, tmp_path, env):
    path = tmp_path / "m.json"
    path.write_text(json.dumps({"frames": frames}))
    with pytest.raises(ValueError) as error:
        motions.load(path, motions.standing(env))
    assert message in str(error.value) and "m.json" in str(error.value)


def test_an_unknown_motion_is_named(env):
    with pytest.raises(ValueError, match="motion = 'somersault': known are forward"):
        motions.load("somersault", motions.standing(env))


def test_dropped_dogs_get_up(env):
    fallen = motions.dropped(env, np.random.default_rng(3), 12)
    shown = motions.accelerometer(fallen)
    assert np.sum(shown[:, 2] < 0.7) >= 6  # it is no test of standing dogs
    stands, end = motions.get_up(env, fallen)
    assert stands.sum() >= 11
    np.testing.assert_allclose(motions.accelerometer(end)[stands, 2], 1, atol=0.1)


def test_the_mirror_image_of_set_points_is_that_of_the_joints():
    points = np.arange(17.0)
    image = motions.mirrored(points)
    by_name = dict(zip(motions.JOINTS, points))
    for joint, value in zip(motions.JOINTS, image):
        other = {"l": "r", "r": "l"}[joint[0]] + joint[1:] if joint[1] in "fh" else joint
        sign = -1 if joint in ("head_pan", "head_roll", "tail_pan") else 1
        assert value == sign * by_name[other], joint
    np.testing.assert_array_equal(motions.mirrored(image), points)


def test_a_kick_is_evolved_and_its_file_can_be_played(tmp_path, capsys):
    path = tmp_path / "kick.json"
    evolve_motion.main(
        ["left", "--generations", "1", "--population", "4", "--seed", "4", "--out", str(path)]
    )
    assert "generation 1/1" in capsys.readouterr().out
    env = make()
    motion = motions.load(path, motions.standing(env))  # within limits and speeds
    assert motion.strike > 0 and motions.set_points(motion, env.solver.timestep).shape[1] == 17
