"""The figure scripts at a tiny budget: each runs, draws, and writes the numbers it drew."""

import dataclasses
import importlib
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from experiments import figures
from fntg_jax import export
from tests.conftest import ROOT

OPTIONS = figures.Options(seeds=2, generations=2)
ROWS = {"fig5": 2, "fig6": 4 * 220, "fig7": 220, "fig8": 220}


@pytest.fixture(scope="module")
def trained():
    """One training run for all four scripts."""
    run = figures.finished_run(OPTIONS)
    patch = pytest.MonkeyPatch()
    patch.setattr(figures, "finished_run", lambda options: run)
    yield run
    patch.undo()


@pytest.mark.parametrize("name", ROWS)
def test_figure(name, trained, tmp_path):
    script = importlib.import_module(f"experiments.{name}")
    path = script.plot(script.run(OPTIONS), tmp_path / f"{name}.png")
    assert path.with_suffix(".pdf").stat().st_size > 5000
    picture = np.asarray(Image.open(path).convert("L"))
    assert picture.shape[0] > 500 and 0.001 < (picture < 128).mean() < 0.5
    with open(path.with_suffix(".csv")) as file:
        names = file.readline().strip().split(",")
    numbers = np.loadtxt(path.with_suffix(".csv"), delimiter=",", skiprows=1)
    assert numbers.shape == (ROWS[name], len(names)) and np.isfinite(numbers).all()
    if name == "fig5":
        best = np.median(trained.history().best, axis=0)
        np.testing.assert_allclose(numbers[:, names.index("best_median")], best, rtol=1e-6)
    else:
        assert np.ptp(numbers[:220, names.index("x")]) > 0.01  # the robot moved


def test_bad_input_is_one_line(tmp_path):
    command = [sys.executable, str(ROOT / "experiments" / "fig5.py"), "--run", str(tmp_path)]
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "out")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "not a run folder" in done.stderr


def test_the_median_seed_is_shown(trained):
    trials = figures.paper_trials(dataclasses.replace(OPTIONS), slice(0, 1))
    final = np.sort(trained.history().best[:, -1])
    assert f"F = {final[(len(final) - 1) // 2]:.3g}" in trials.title


def test_failed_trials_are_drawn(tmp_path):
    pytest.importorskip("mujoco")
    from experiments import transfer

    along = np.linspace(0, 1, 221)
    robot = np.stack([along, 0 * along, 0 * along], 1)
    ball = np.tile([0.9, 0.2], (221, 1))
    trial = transfer.Failure("open 3\n0.20 m from the ball", robot, ball, np.array([[0, 0.5, 0.1]]))
    for num in (1, 30):
        transfer.draw_failures([trial] * num, tmp_path / f"{num}.png")
    one, many = (np.asarray(Image.open(tmp_path / f"{n}.png").convert("L")) for n in (1, 30))
    assert 0.001 < (one < 128).mean() < 0.5
    assert many.shape[0] > 4 * one.shape[0] and many.shape[1] > 3 * one.shape[1]


def test_transfer_refuses_a_missing_controller_in_one_line(tmp_path, capsys):
    from experiments import transfer

    missing = tmp_path / "no.json"
    with pytest.raises(SystemExit) as stop:
        transfer.main(["--controller", str(missing), "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert stop.value.code == 2 and said.count("\n") == 1 and str(missing) in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_transfer_end_to_end(tmp_path):
    pytest.importorskip("mujoco")
    from experiments import transfer
    from tests.controllers import random_controller

    controller = random_controller(seed=3)
    export.save(controller, tmp_path / "first.json")
    small = ["population", "4", "generations", "1", "num-scenes", "2"]
    small += ["eval-scenes", "4", "full-scenes", "2"]
    arguments = [f"--{x}" if n % 2 == 0 else x for n, x in enumerate(small)]
    out = tmp_path / "out"
    transfer.main(["--controller", str(tmp_path / "first.json"), "--out", str(out), *arguments])
    table = (out / "transfer.csv").read_text().splitlines()
    places = [line.split(",")[1:4] for line in table[1:]]
    worlds = ("kinematic", "quadruped", "full")
    assert places == [
        [stage, world, suite]
        for stage in ("kinematic", "fine-tuned")
        for world in worlds
        for suite in ("open", "blocked")
    ]
    assert export.load(out / "fine-tuned-0.json").layout.name == controller.layout.name
    assert (out / "failures-0.png").exists()
    # What is there is not done again.
    again = transfer.run(transfer.Config(tmp_path / "first.json", out))
    assert len(again) == len(table) - 1
    assert "| quadruped | blocked |" in transfer.table(again)
