"""The commands on the walking dog, at a tiny budget: train, resume, evaluate, draw."""

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("mujoco")

from fntg_jax.learning import ga
from fntg_jax.running import problem, run_folder, runner, settings

pytestmark = pytest.mark.slow

TINY = ("--seeds", 1, "--generations", 2, "--ga.population", 4, "--ga.num-elites", 1)


@pytest.fixture(scope="module")
def kinematic(fntg, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "kinematic"
    done = fntg("train", *TINY, "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def walked(fntg, kinematic, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "walked"
    options = ("--env", "quadruped", "--warm-start", kinematic, "--out", folder)
    done = fntg("train", *TINY, *options)
    assert done.returncode == 0, done.stderr
    assert "generation 2/2" in done.stderr
    return folder


def test_it_is_judged_where_it_was_trained(fntg, walked):
    done = fntg("evaluate", walked, "--suite", "open", "--scenes", 4)
    assert done.returncode == 0 and "world quadruped\n" in done.stderr, done.stderr
    assert done.stdout.splitlines()[1].split()[:2] == ["open", "4"]


def test_figure_6_shows_its_paths(walked, tmp_path, clean_env):
    done = subprocess.run(
        [sys.executable, "experiments/fig6.py", "--run", walked, "--out", tmp_path],
        env=clean_env, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "fig6.png").stat().st_size > 10_000


def test_resumed_is_uninterrupted(tmp_path):
    config = settings.TrainConfig(
        env="quadruped", generations=3, ga=ga.GAConfig(population=4, num_elites=1)
    )
    whole = runner.train(config).conclude()
    folder = tmp_path / "part"
    run_folder.create(folder, config)
    run = runner.Run(problem.resolve(config))
    run.compile()
    run.advance()
    assert run.generation < 3
    run_folder.save_checkpoint(folder, run)
    again = runner.complete(run_folder.restore(folder)).conclude()
    np.testing.assert_array_equal(again.theta, whole.theta)
    np.testing.assert_array_equal(again.fitness, whole.fitness)


def test_stock_mjx_trains_on_one_device(fntg, tmp_path):
    options = ("train", *TINY, "--env", "quadruped-mjx", "--out", tmp_path / "run")
    done = fntg(*options)
    assert done.returncode == 2 and "FNTG_XLA_FLAGS=off" in done.stderr
    done = fntg(*options, FNTG_XLA_FLAGS="off")
    one = "--xla_force_host_platform_device_count=1"
    # A machine with one core has one device anyway.
    assert done.returncode == 0 or one in done.stderr
    if done.returncode:
        done = fntg(*options, FNTG_XLA_FLAGS="off", XLA_FLAGS=one)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "params.json").exists()
