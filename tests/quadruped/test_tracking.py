"""How well the walk follows commands: the measure, and the committed tables."""

import csv

import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs.quadruped import make
from envs.quadruped.locomotion import DEFAULT_GAIT
from experiments import tune_gait

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
