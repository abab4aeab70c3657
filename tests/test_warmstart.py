"""Populations that start from an earlier run: what they are, and that a run survives its source."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

import fntg_jax
from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.controller import genome
from fntg_jax.running import config_file, problem, run_folder, runner, settings, warmstart, xla
from tests.small_run import small_run

CONFIG = dataclasses.replace(
    settings.TrainConfig(),
    seeds=2,
    first_seed=5,
    generations=2,
    ga=dataclasses.replace(settings.GAConfig(), population=8),
)


@pytest.fixture
def source(tmp_path):
    """A folder of the small run that a test may damage."""
    return shutil.copytree(small_run(), tmp_path / "source")


def warm(source, **changes):
    return dataclasses.replace(CONFIG, warm_start=str(source), **changes)


def start(config):
    return runner.start(problem.resolve(config))


def genes(config, state):
    bits = np.asarray(state.bits)[: config.seeds]
    return np.asarray(genome.decode(bits, config.ga.num_bits, config.ga.gray))


def test_the_same_shape_takes_over_the_last_populations(source):
    run = start(warm(source))
    last = run_folder.restore(source).now.population
    np.testing.assert_array_equal(run.now.population.bits, last.bits)
    assert run.generation == 0 and run.origin == f"the populations of {source}"
    # All but the populations is that of a new run: its keys are not the old ones.
    fresh = runner.Run(problem.resolve(CONFIG)).now.population
    assert (jax.random.key_data(run.now.population.key) == jax.random.key_data(fresh.key)).all()
    assert np.isneginf(run.now.population.best_fitness).all()
    # An elite on the same scenes: it goes on from where it was.
    before = run_folder.load_history(source).best[:, -1]
    assert (runner.complete(run).history().best[:, 0] >= before).all()


@pytest.mark.parametrize(
    "changes",
    [
        {"seeds": 3},
        {"ga": dataclasses.replace(CONFIG.ga, population=10)},
        {"ga": dataclasses.replace(CONFIG.ga, gray=True, num_bits=12)},
    ],
    ids=["seeds", "population", "coding"],
)
def test_another_shape_takes_neighbours_of_the_best_controller(source, changes):
    config = warm(source, **changes)
    run = start(config)
    theta, found = fntg_jax.load(source).theta, genes(config, run.now.population)
    assert "neighbours" in run.origin
    step = 10 / (2**config.ga.num_bits - 1)
    np.testing.assert_allclose(found[:, 0], np.tile(theta, (config.seeds, 1)), atol=step)
    away = np.abs(found[:, 1:] - theta)
    assert 0.2 < np.mean(away > step) < 0.5  # a third of the genes moved
    assert 0.05 < away[away > step].std() < 0.3
    assert not np.array_equal(found[0], found[1])  # every seed has its own


def test_a_file_and_another_world(source):
    options = {"v_max": 0.25, "capture": 0.145}
    from_file = warm(source / "params.json", env_options=options)
    found = genes(from_file, start(from_file).now.population)
    np.testing.assert_allclose(found[:, 0], fntg_jax.load(source).theta[None].repeat(2, 0), 1e-4)
    from_run = warm(source, env_options=options)  # the populations fit in any world
    last = run_folder.restore(source).now.population.bits
    np.testing.assert_array_equal(start(from_run).now.population.bits, last)


def test_a_seed_does_not_depend_on_its_company(source):
    file = source / "params.json"
    three = genes(warm(file, seeds=3), start(warm(file, seeds=3)).now.population)
    last = warm(file, seeds=1, first_seed=7)
    np.testing.assert_array_equal(genes(last, start(last).now.population)[0], three[2])


def test_command_and_resume_after_the_source_is_gone(source, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(xla, "configure", lambda *args, **kwargs: None)
    small = ["--seeds", "2", "--generations", "3", "--ga.population", "8"]
    whole, part = tmp_path / "whole", tmp_path / "part"
    warm_start = ["--warm-start", str(source)]
    cli.main(["train", *small, *warm_start, "--out", str(whole)])
    assert f"starting from the populations of {source}" in capsys.readouterr().err
    config = config_file.load(whole)
    assert json.loads((whole / "config.json").read_text())["warm_start"] == str(source)

    # As `train` leaves it when it is killed before the first checkpoint of evolution.
    from fntg_jax.commands import train

    monkeypatch.setattr(train, "_learn", lambda *_: (_ for _ in ()).throw(SystemExit(137)))
    with pytest.raises(SystemExit):
        cli.main(["train", *small, *warm_start, "--out", str(part)])
    monkeypatch.undo()
    with pytest.raises(ValueError, match="nothing recorded yet"):
        run_folder.load_history(part)
    shutil.rmtree(source)
    resumed = runner.complete(run_folder.restore(part))
    assert resumed.config == config
    for found, expected in zip(resumed.history(), run_folder.load_history(whole)):
        np.testing.assert_array_equal(found, expected)


def damaged(folder):
    path = folder / "checkpoint.npz"
    path.write_bytes(path.read_bytes()[:-60])


@pytest.mark.parametrize(
    ("prepare", "options", "message"),
    [
        (shutil.rmtree, [], "No such file or directory"),
        (lambda f: (f / "config.json").unlink(), [], "not a run folder"),
        (damaged, [], "not the checkpoint of this run"),
        (lambda f: (f / "params.json").write_text("{}"), ["--seeds", "3"], "params.json"),
        (None, ["--layout", "mirror-28"], "its layout is paper-31, the new run's is mirror-28"),
        (None, ["--output", "clip"], "its output is scale, the new run's is clip"),
    ],
    ids=["missing", "no run", "damaged", "no controller", "layout", "output"],
)
def test_bad_sources_are_one_line_and_leave_nothing(
    source, tmp_path, capsys, monkeypatch, prepare, options, message
):
    monkeypatch.setattr(xla, "configure", lambda *args, **kwargs: None)
    if prepare is not None:
        prepare(source)
    small = ["--seeds", "2", "--ga.population", "8", *options]
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", *small, "--warm-start", str(source), "--out", str(tmp_path / "new")])
    said = capsys.readouterr().err
    assert stop.value.code == 2 and said.count("\n") == 1
    assert said.startswith(f"fntg: error: warm_start = {source}: ") and message in said
    assert not (tmp_path / "new").exists()


def test_neighbours_stay_in_range():
    theta = np.full(31, 5.0, np.float32)
    bits = warmstart.neighbours(jax.random.key(0), theta, 64, num_bits=15, spread=1.0)
    found = np.asarray(genome.decode(bits))
    assert found.max() <= 5 and found.min() < 4
    assert export.from_bits(settings.get_layout("paper-31"), bits[0]).theta == pytest.approx(theta)
