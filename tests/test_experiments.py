"""The figure scripts at a tiny budget: each runs, draws, and writes the numbers it drew."""

import dataclasses
import importlib
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from experiments import figures
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
