"""How well the walk follows commands: the measure, and the committed tables."""

import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs.quadruped import make
from envs.quadruped.locomotion import DEFAULT_GAIT
from experiments import benchmark_quadruped, tune_gait

DATA = DEFAULT_GAIT.parent


def rows_of(name):
    with (DATA / name).open(encoding="utf-8") as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def test_a_circle_sideways_is_measured_as_commanded():
    v_x, v_y, omega, dt = 0.12, -0.05, 0.7, 0.1
    steps = tune_gait.SETTLE + tune_gait.MEASURE
    fine = np.arange(100 * steps + 1) * dt / 100
    angle = omega * fine
    dx = v_x * np.cos(angle) - v_y * np.sin(angle)
    dy = v_x * np.sin(angle) + v_y * np.cos(angle)
    place = np.stack([np.cumsum(d) * dt / 100 for d in (dx, dy)], 1)[::100]
    path = np.zeros((steps + 1, 19), np.float32)
    path[:, :2], path[:, 3], path[:, 6] = place, np.cos(angle[::100] / 2), np.sin(angle[::100] / 2)
    found = tune_gait.track(path, False, 0.0, dt)
    np.testing.assert_allclose(found.velocity, [v_x, v_y, omega], atol=1e-3)
    assert float(found.swing) < 1e-3 and float(found.upright) == 1


@pytest.mark.parametrize("name", ["tracking.csv", "tracking_full.csv"])
def test_the_committed_tables_are_of_these_commands(name):
    rows = rows_of(name)
    asked = np.array([[row["v_x"], row["v_y"], row["omega"]] for row in rows])
    np.testing.assert_allclose(asked, tune_gait.COMMANDS, atol=1e-4)
    assert np.mean([row["v_error"] for row in rows]) < 0.01  # m/s
    assert np.mean([row["omega_error"] for row in rows]) < 0.05  # rad/s
    assert not any(row["fell"] for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variant", "name"), [("lean", "tracking.csv"), ("full", "tracking_full.csv")]
)
def test_the_committed_tables_are_what_is_computed(variant, name):
    for found, row in zip(tune_gait.table(make(), variant), rows_of(name), strict=True):
        for key in ("got_v_x", "got_v_y", "got_omega"):
            assert found[key] == pytest.approx(row[key], abs=0.01)


@pytest.mark.slow
def test_no_fall_in_a_hundred_random_command_sequences():
    fallen = jax.jit(tune_gait.falls)(make(), jax.random.key(0)).fallen
    assert fallen.shape == (100,) and not fallen.any()


def test_falls_in_the_full_model_are_counted(monkeypatch):
    # Commands on and on ahead into a wall, for two dogs and half a second.
    ahead = jnp.tile(jnp.asarray([0.2, 0.0, 0.0]), (2, 5, 1))
    monkeypatch.setattr(tune_gait, "random_sequences", lambda *_: ahead)
    fallen = tune_gait.falls_full(make(), jax.random.key(0), num=2, num_steps=5)
    assert fallen.shape == (2,) and not fallen.any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "allowed is a JSON file with numbers by name under 'gait'"),
        ('{"gait": {"period": "x"}}', "allowed is a JSON file with numbers by name under 'gait'"),
        ('{"gait": {"period": 0}}', "period = 0.0; allowed are numbers above 0"),
        ('{"gait": {"lift": NaN}}', "lift = nan; allowed are finite numbers"),
        ('{"gait": {"legs": 4}}', "unknown ['legs']"),
    ],
)
def test_a_wrong_gait_is_one_line_and_status_2(text, message, tmp_path, capsys):
    path = tmp_path / "gait.json"
    path.write_text(text)
    with pytest.raises(SystemExit) as stop:
        tune_gait.main(["table", "--gait", str(path)])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and message in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evolve", "--population", "0"], "population = 0: allowed are numbers from 4"),
        (["speed", "--variant", "full"], "variant = 'full': allowed with speed is lean"),
        (["evolve", "--out", "/missing/g.json"], "allowed is a file in a folder that exists"),
        (["table", "--gait", "missing.json"], "gait = missing.json: No such file"),
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
