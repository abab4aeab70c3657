"""How well the walk follows commands: the measure, and the committed tables."""

import csv
import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs.base import Command, Scene
from envs.field import Ball, roll_ball
from envs.quadruped import gait_task, make, measure, native
from envs.quadruped.locomotion import DEFAULT_GAIT
from experiments import benchmark_quadruped, locomotion, tune_gait

DATA = DEFAULT_GAIT.parent


def rows_of(name):
    with (DATA / name).open(encoding="utf-8") as file:
        return [{k: float(v) for k, v in row.items() if v != "nan"} for row in csv.DictReader(file)]


def test_a_circle_sideways_is_measured_as_commanded():
    v_x, v_y, omega, dt = 0.12, -0.05, 0.7, 0.1
    steps = measure.SETTLE + measure.MEASURE
    fine = np.arange(100 * steps + 1) * dt / 100
    angle = omega * fine
    dx = v_x * np.cos(angle) - v_y * np.sin(angle)
    dy = v_x * np.sin(angle) + v_y * np.cos(angle)
    place = np.stack([np.cumsum(d) * dt / 100 for d in (dx, dy)], 1)[::100]
    path = np.zeros((steps + 1, 19), np.float32)
    path[:, :2], path[:, 3], path[:, 6] = place, np.cos(angle[::100] / 2), np.sin(angle[::100] / 2)
    found = measure.track(path, False, dt)
    np.testing.assert_allclose(found.velocity, [v_x, v_y, omega], atol=1e-3)
    assert float(found.swing) < 1e-3 and float(found.upright) == 1


@pytest.mark.parametrize("name", ["tracking.csv", "tracking_full.csv"])
def test_the_committed_tables_are_of_these_commands(name):
    rows = rows_of(name)
    asked = np.array([[row["v_x"], row["v_y"], row["omega"]] for row in rows])
    np.testing.assert_allclose(asked, gait_task.TABLE, atol=1e-4)
    assert np.mean([row["error_v"] for row in rows]) < 0.012  # m/s
    assert np.mean([row["error_omega"] for row in rows]) < 0.05  # rad/s
    # The time step is converged: within 3 %, but for a walk or two at the ellipsoid's rim.
    off = np.abs([row["step_ratio"] - 1 for row in rows])
    assert np.sum(off > 0.03) <= 1 and off.max() < 0.04
    assert not any(row["fell"] for row in rows)


def test_training_commands_and_judged_ones_differ_and_lie_in_the_ellipsoid():
    for commands in (gait_task.TRAIN, gait_task.TABLE):
        assert np.sum((commands / np.array(measure.RANGE)) ** 2, axis=1).max() < 1.02
    jumps = np.asarray(measure.random_sequences(jax.random.key(0), 50, 220))
    assert np.sum((jumps / np.array(measure.RANGE)) ** 2, axis=-1).max() < 1.001
    assert (np.diff(jumps[:, ::4], axis=1) != 0).all() and (jumps[:, 1:4] == jumps[:, :1]).all()


@pytest.mark.slow
def test_the_committed_full_table_is_what_is_computed():
    walks = measure.steady_native(make(), gait_task.TABLE[:6], "full")
    for got, row in zip(walks.velocity, rows_of("tracking_full.csv")):
        assert got[0] == pytest.approx(row["got_v_x"], abs=0.01)


@pytest.mark.slow
def test_no_fall_in_a_hundred_random_command_sequences():
    fallen = jax.jit(measure.falls)(make(), jax.random.key(0)).fallen
    assert fallen.shape == (100,) and not fallen.any()


def test_falls_in_the_full_model_are_counted(monkeypatch):
    # Commands on and on ahead into a wall, for two dogs and half a second.
    ahead = jnp.tile(jnp.asarray([0.2, 0.0, 0.0]), (2, 5, 1))
    monkeypatch.setattr(measure, "random_sequences", lambda *_: ahead)
    fallen = measure.falls_full(make(), jax.random.key(0), num=2, num_steps=5)
    assert fallen.shape == (2,) and not fallen.any()
    # Where standing is not high enough, both have fallen.
    strict = dataclasses.replace(make(), fall_height=0.5)
    assert measure.falls_full(strict, jax.random.key(0), num=2, num_steps=5).all()


def test_the_ball_runs_out_in_mujoco_as_on_the_kinematic_field():
    env, speed = make(), 0.25
    course = np.array([0.0, 0.4, 0.785, 2.2])
    velocity = speed * np.stack([np.cos(course), np.sin(course)], axis=1)
    scene = Scene(
        start=jnp.tile(jnp.asarray([-1.0, -0.7, 0.0]), (4, 1)),
        ball=jnp.zeros((4, 2)),
        obstacles=jnp.zeros((4, 0, 3)),
        ball_velocity=jnp.asarray(velocity, jnp.float32),
        seed=jnp.zeros(4, int),
    )
    still = Command(jnp.zeros(4), jnp.zeros(4))
    rolled = native.run(env, scene, lambda *_: still, "full", num_steps=55).ball
    ball = Ball(jnp.zeros(4), jnp.zeros(4), *jnp.asarray(velocity.T, jnp.float32))
    for n in range(56):
        np.testing.assert_allclose(rolled[n], np.stack([ball.x, ball.y], 1), atol=2e-3)
        ball = roll_ball(ball, env.dt, env.ball_deceleration)
    run_out = np.linalg.norm(rolled[-1], axis=1)
    np.testing.assert_allclose(run_out, speed**2 / 2 / env.ball_deceleration, atol=2e-3)


def test_the_table_is_json_for_machines(capsys, monkeypatch):
    monkeypatch.setattr(gait_task, "TABLE", gait_task.TABLE[3:4])
    monkeypatch.setattr(locomotion, "FINE", 0.002)
    locomotion.main(["table", "--variant", "full", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["falls"] == 0 and 0.97 < found["step_ratio"] < 1.03
    assert found["rows"][0]["v_x"] == pytest.approx(0.12)
    assert found["rows"][0]["joint_speed_ratio_p99"] is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "allowed is a JSON file with numbers by name under 'gait'"),
        ('{"gait": {"period": "x"}}', "allowed is a JSON file with numbers by name under 'gait'"),
        ('{"gait": {"period": 0}}', "period = 0.0; allowed are numbers above 0"),
        ('{"gait": {"lift": NaN}}', "lift = nan; allowed are finite numbers"),
        ('{"gait": {}, "calibration": {"scale": [1, 1, 1], "rows": [[1, 2]]}}', "rows of six"),
        ('{"gait": {}, "calibration": {"scale": [1, 0, 1], "rows": []}}', "three above 0"),
        ('{"gait": {"legs": 4}}', "unknown ['legs']"),
    ],
)
def test_a_wrong_gait_is_one_line_and_status_2(text, message, tmp_path, capsys):
    path = tmp_path / "gait.json"
    path.write_text(text)
    with pytest.raises(SystemExit) as stop:
        tune_gait.main(["speed", "--gait", str(path)])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and message in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["falls", "--num", "0"], "num = 0: allowed are numbers from 1"),
        (["speed", "--variant", "full"], "variant = 'full': allowed with speed is lean"),
        (["calibrate", "--out", "/missing/g.json"], "allowed is a file in a folder that exists"),
        (["speed", "--gait", "missing.json"], "gait = missing.json: No such file"),
    ],
)
def test_wrong_options_are_one_line_and_status_2(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        tune_gait.main(arguments)
    error = capsys.readouterr().err
    assert stop.value.code == 2 and message in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--batches", "240", "0"], "batches = (240, 0): allowed are numbers from 1"),
        (["--impls"], "impls = (): allowed is one back end or more"),
        (["--num-threads", "0"], "num_threads = 0: allowed are numbers from 1"),
        (["--csv", "/missing/t.csv"], "allowed is a file in a folder that exists"),
    ],
)
def test_the_benchmark_refuses_wrong_options_in_one_line(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        benchmark_quadruped.main(arguments)
    error = capsys.readouterr().err
    assert stop.value.code == 2 and message in error and error.count("\n") == 1
