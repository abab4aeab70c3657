"""The script of the comparison at a tiny budget, and its ablations."""

import csv
import dataclasses

import numpy as np
import pytest
from PIL import Image

from experiments import generalization
from fntg_jax.learning import objective
from fntg_jax.running import evaluation, problem, runner, settings
from tests.controllers import random_controller

ROBUST = settings.PRESETS["robust"]


def test_every_ablation_takes_one_thing_away():
    found = generalization.ablations(ROBUST)
    for part in ("gray", "num_islands", "mutation_decay", "scene_pool", "selection", "gate"):
        assert sum(part in name for name in found) == 1, part
    for name, config in found.items():
        settings.validate(config)
        groups = [("", ROBUST, config)] + [
            (f"{g}.", getattr(ROBUST, g), getattr(config, g)) for g in ("ga", "smooth", "fitness")
        ]
        changed = [
            prefix + field.name
            for prefix, old, new in groups
            for field in dataclasses.fields(old)
            if not dataclasses.is_dataclass(getattr(old, field.name))
            and getattr(old, field.name) != getattr(new, field.name)
        ]
        assert changed == [name.partition("=")[0]]
    assert generalization.ablations(settings.TrainConfig(suite="open")).keys() == {
        "smooth.gate=1000", "smooth.margin=0.145"
    }  # fmt: skip


TINY = dataclasses.replace(
    ROBUST,
    ga=dataclasses.replace(ROBUST.ga, population=64),
    num_scenes=4,
    scene_pool=16,
    generations=2,
    refine_steps=0,
)


@pytest.mark.slow
def test_evolved_controllers_are_those_of_the_run(monkeypatch):
    monkeypatch.setattr(problem, "VALIDATION", 32)
    found = list(generalization.evolved(TINY, 2))
    result = runner.train(dataclasses.replace(TINY, seeds=2)).conclude()
    assert [seed for seed, _, _ in found] == [0, 1]
    for theta, (_, seconds, controller) in zip(result.theta, found):
        np.testing.assert_array_equal(controller.theta, theta)
        assert seconds > 0


def test_the_script(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(evaluation, "held_out_suites", lambda world: ["open", "blocked"])
    monkeypatch.setitem(settings.PRESETS, "robust", TINY)
    # Learning itself has tests of its own.
    monkeypatch.setattr(
        generalization,
        "evolved",
        lambda config, seeds: ((s, 1.0, random_controller(seed=s)) for s in range(seeds)),
    )
    monkeypatch.setattr(
        objective,
        "smooth_descent",
        lambda *options, **more: objective.Descent(
            lambda theta, scenes: (theta**2).sum(axis=-1) + 0 * scenes.sum(),
            lambda key: np.zeros(2),
            np.zeros(2),
        ),
    )
    options = generalization.Options(
        out=tmp_path, seeds=2, generations=2, gradient_steps=2, gradient_starts=2, scenes=8,
        ablations=("smooth.gate=1000",),
    )  # fmt: skip
    compared, ablated = generalization.run(options)
    assert [(r.method, r.seed) for r in compared] == [
        (method, seed) for method in ("paper", "gradient", "robust") for seed in (0, 1)
    ]
    assert [r.method for r in ablated] == ["robust"] * 2 + ["smooth.gate=1000"] * 2
    assert ablated[:2] == compared[4:]
    assert all(0 <= share <= 1 for row in compared for share in row.success)
    for name, rows in (("generalization", compared), ("ablations", ablated)):
        with (tmp_path / f"{name}.csv").open() as file:
            lines = list(csv.DictReader(file))
        assert [line["method"] for line in lines] == [r.method for r in rows]
        assert [float(line["open"]) for line in lines] == [r.success[0] for r in rows]
    path = generalization.plot(compared, tmp_path / "generalization.png")
    picture = np.asarray(Image.open(path).convert("L"))
    assert picture.shape[0] > 300 and 0.001 < (picture < 128).mean() < 0.5
    assert path.with_suffix(".pdf").stat().st_size > 5000


def test_tables_by_hand():
    def rows(method, *shares):
        return [generalization.Row(method, n, 1.0, (s,) * 4) for n, s in enumerate(shares)]

    found = rows("robust", 0.9, 0.8, 1.0) + rows("ga.gray=False", 0.7, 0.5, 0.9)
    text = generalization.table(found)
    assert "median of 3 seeds" in text and "| robust | 90.0 [80.0, 100.0], 80.0 |" in text
    text = generalization.differences(found)
    assert "| ga.gray=False | -20.0 [-30.0, -10.0] | 80.0 -> 50.0 |" in text


@pytest.mark.parametrize(
    "wrong",
    [{"seeds": 0}, {"generations": -1}, {"scenes": 0}, {"ablations": ("moon",)}],
    ids=lambda x: next(iter(x)),
)
def test_bad_options_are_refused(wrong, tmp_path):
    name, value = next(iter(wrong.items()))
    with pytest.raises(ValueError, match=f"{name} = .*(allowed|known)") as refusal:
        generalization.run(generalization.Options(out=tmp_path, **wrong))
    assert str(value[0] if isinstance(value, tuple) else value) in str(refusal.value)
    assert not list(tmp_path.iterdir())
