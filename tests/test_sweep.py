"""Sweeps: a setting's result is that of training alone; tables, boards and pictures say so."""

import csv
import dataclasses

import numpy as np
import pytest
from PIL import Image

from fntg_jax.running import controllers, problem, runner, settings, sweep
from fntg_jax.showing import sweep_report

TINY = dataclasses.replace(
    settings.PRESETS["paper"],
    seeds=2,
    first_seed=3,
    generations=4,
    ga=dataclasses.replace(settings.PRESETS["paper"].ga, population=8),
)
AXES = {"ga.mutation_rate": [0.001, 0.05], "env.v_max": [0.15, 0.2], "fitness.v": [2.0, 3.0]}


@pytest.fixture(scope="module")
def swept():
    """A sweep over floats of the algorithm, the world and the fitness, and what it said."""
    said: list[str] = []
    return sweep.run(TINY, sweep.grid(AXES), ("open",), 50, said.append), said


def test_floats_share_one_program(swept):
    table, said = swept
    assert said[0] == "8 settings x 2 seeds in 1 compiled program"
    assert table.best.shape == table.mean.shape == table.success["open"].shape == (8, 2)
    assert len(np.unique(table.best)) == 16  # every row is a run of its own


@pytest.mark.parametrize("n", [5])
def test_a_setting_equals_training_with_its_values(swept, n):
    table, _ = swept
    alone = runner.train(sweep.apply(TINY, table.settings[n]))
    result, history = alone.conclude(), alone.history()
    np.testing.assert_array_equal(table.theta[n], result.theta)  # decoded bits: equal genomes
    np.testing.assert_array_equal(table.best[n], result.fitness.astype(float))
    np.testing.assert_array_equal(table.mean[n], history.mean[:, -1].astype(float))


def test_success_is_what_evaluate_counts(swept):
    from fntg_jax.running import evaluation

    table, _ = swept
    config = sweep.apply(TINY, table.settings[6])
    run = runner.Run(problem.resolve(config))
    result = runner.Result(table.theta[6], table.best[6], None, None)
    for seed in (3, 4):
        found = controllers.of_run(run, seed, result)
        rate = evaluation.evaluate(found, run.problem.world, "open", 50).rates["success"]
        assert rate.share == pytest.approx(table.success["open"][6, seed - 3], abs=1e-6)


def test_batches_change_nothing(swept, monkeypatch):
    """Three settings a batch, so that the last batch is filled up."""
    table, _ = swept
    row = 2 * (TINY.ga.population + TINY.generations) * 31 * 15
    monkeypatch.setattr(sweep, "_BATCH_BYTES", 3 * row * TINY.seeds)
    said = []
    again = sweep.run(TINY, table.settings, say=said.append)
    assert any("batches of 3 settings" in line for line in said)
    np.testing.assert_array_equal(again.best, table.best)
    np.testing.assert_array_equal(again.theta, table.theta)


def test_what_is_static_takes_programs():
    axes = {
        "ga.population": [8, 10],
        "ga.crossover_rate": [0.6, 1.0],
        "layout": ["paper-31", "full-63"],
        "generations": [2, 4],
        "ga.gray": [False, True],
    }
    for name, values in axes.items():
        found = sweep.problems(TINY, sweep.grid({name: values}))
        assert len(sweep.programs(found)) == (1 if name == "ga.crossover_rate" else 2), name
    points = sweep.grid(axes)
    groups = sweep.programs(sweep.problems(TINY, points))
    assert [len(g) for g in groups] == [2] * 16
    assert sweep._split(points, groups) == (
        ": one is compiled for each ga.population x layout x generations x ga.gray"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("ga.mutation_rat=1", ("ga.mutation_rat", "known are", "ga.mutation_rate")),
        ("mutation_rate=1", ("known are ga.mutation_rate",)),
        ("seeds=1,2", ("'seeds'",)),
        ("ga.horizon=1,2", ("ga.horizon",)),
        ("ga.mutation_rate", ("NAME=VALUE",)),
        ("ga.mutation_rate=", ("NAME=VALUE",)),
        ("ga.mutation_rate=0.1,,0.2", ("NAME=VALUE",)),
        ("ga.mutation_rate=much", ("'much'", "numbers")),
        ("ga.population=60.5", ("'60.5'", "whole")),
        ("ga.gray=yes", ("'yes'", "True and False")),
        ("generations=5,5", ("twice",)),
    ],
)
def test_bad_axes_are_refused(text, words):
    with pytest.raises(ValueError) as refusal:
        sweep.parse_axis(text)
    assert all(word in str(refusal.value) for word in words), refusal.value


def test_values_that_no_run_takes_are_refused_before_anything_runs():
    for setting, words in (
        ({"ga.mutation_rate": 2.0}, "ga.mutation_rate = 2.0"),
        ({"env.gravity": 9.81}, "gravity"),
        ({"layout": "paper-32"}, "paper-32"),
    ):
        with pytest.raises(ValueError, match=words):
            sweep.problems(TINY, [setting])
    with pytest.raises(ValueError, match="moon"):
        sweep.problems(TINY, [{}], ["moon"])


def test_command_refuses_in_one_line(fntg, tmp_path):
    done = fntg("sweep", "--axis", "ga.mutation_rate=0.1,3", "--out", tmp_path / "s")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("fntg: error: ga.mutation_rate = 3.0") and (
        done.stderr.count("\n") == 1
    )
    assert not (tmp_path / "s").exists()


def hand_made(axes):
    """A table whose medians are known: setting n has 10 n + (0, 1, 5)."""
    points = sweep.grid(axes)
    best = 10.0 * np.arange(len(points))[:, None] + np.asarray([0, 1, 5])
    return sweep.Table(points, best, best / 2, {}, [])


def test_table_board_and_pictures(tmp_path):
    table = hand_made({"ga.mutation_rate": [0.001, 0.01], "layout": ["paper-31", "full-63"]})
    sweep_report.write_csv(table, 7, tmp_path / "t.csv")
    rows = list(csv.DictReader((tmp_path / "t.csv").open()))
    assert len(rows) == 12 and list(rows[0]) == [
        "ga.mutation_rate",
        "layout",
        "seed",
        "best",
        "mean",
    ]
    assert rows[5] == {
        "ga.mutation_rate": "0.001", "layout": "full-63", "seed": "9", "best": "15", "mean": "7.5"
    }  # fmt: skip
    board = sweep_report.leaderboard(table).split("\n")
    assert [line.split()[:4] for line in board[1:3]] == [
        ["1", "0.01", "full-63", "31"],
        ["2", "0.01", "paper-31", "21"],
    ]
    assert board[1].split()[4:] == ["30", "to", "35", "30.5", "to", "33"]
    for name, axes in (
        ("map", {"ga.mutation_rate": [0.001, 0.01], "layout": ["paper-31", "full-63"]}),
        ("line", {"env.dt": [0.05, 0.1, 0.2], "layout": ["paper-31"]}),
    ):
        path = sweep_report.plot(hand_made(axes), tmp_path / f"{name}.png")
        assert path.with_suffix(".pdf").stat().st_size > 5000
        picture = np.asarray(Image.open(path).convert("L"))
        assert picture.shape[0] > 300 and 0.001 < (picture < 128).mean() < 0.6
    assert sweep_report.plot(hand_made({k: [1, 2] for k in "abc"}), tmp_path / "n.png") is None
    assert "another thing" in sweep_report.leaderboard(hand_made({"env.dt": [0.1, 0.2]}))
