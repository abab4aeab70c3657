"""The picture of failed trials: the right ones, with the reasons named."""

import json

import numpy as np
import pytest
from PIL import Image

from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.learning.rollout import Outcome
from fntg_jax.running import evaluation, registry, statistics, xla
from fntg_jax.showing import failures, plots
from tests.controllers import random_controller

SCENES = 20


def outcome(d=0.0, v=0.0, clearance=1.0, failed=False):
    three = np.ones(3)
    return Outcome(d * three, v * three, 0 * three, np.float32(clearance), np.float32(v), failed)


def test_reasons_by_hand():
    assert failures.reasons(outcome()) == []
    assert failures.reasons(outcome(d=0.35)) == ["not reached (0.35 m)"]
    assert failures.reasons(outcome(v=-0.1)) == ["not stopped (0.100 m/s)"]
    found = failures.reasons(outcome(0.2, 0.05, 0.1, True))
    assert [x.split(" (")[0] for x in found] == ["fell", "not reached", "too near", "not stopped"]
    assert len(failures.reasons(outcome(d=np.nan))) == 1


def test_the_command_draws_the_first_failed_trials(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(xla, "configure", lambda: None)  # for a process of its own
    drawn = []
    monkeypatch.setattr(plots, "draw_path", lambda axes, robot, colour: drawn.append(robot))
    export.save(random_controller(), tmp_path / "in.json")
    picture = tmp_path / "failures.png"
    arguments = ["evaluate", tmp_path / "in.json", "--suite", "open", "--scenes", SCENES, "--json"]
    cli.main([str(a) for a in [*arguments, "--failures", picture]])
    told = capsys.readouterr()
    share = json.loads(told.out)["open"]["success"]["share"]
    assert str(picture) in told.err
    image = np.asarray(Image.open(picture).convert("L"))
    assert image.shape[1] > 1000 and 0.001 < (image < 128).mean() < 0.5
    assert picture.with_suffix(".pdf").read_bytes()[:5] == b"%PDF-"
    world = registry.get_world("kinematic")
    result = evaluation.evaluate(random_controller(), world, "open", SCENES)
    failed = np.flatnonzero(~result.success)
    assert len(drawn) == min(failures.MOST, len(failed)) > 3
    assert len(failed) == round(SCENES * (1 - share))
    for robot, scene in zip(drawn, failed):
        np.testing.assert_allclose(robot[0], result.scenes.start[scene], atol=1e-5)
    assert f"{len(failed)} of {SCENES} failed" in failures._summary(result)


def test_nothing_failed(tmp_path):
    controller, world = random_controller(), registry.get_world("kinematic")
    result = evaluation.evaluate(controller, world, "open", SCENES)
    perfect = {part: statistics.wilson(SCENES, SCENES) for part in evaluation.PARTS}
    result = result._replace(success=np.ones(SCENES, bool), rates=perfect)
    path = failures.picture(controller, world, None, [result], tmp_path / "none.png")
    assert path.exists() and "0 of 20 failed" in failures._summary(result)


@pytest.mark.parametrize("name", ["x.pdf", "x", "nowhere/x.png"])
def test_bad_names_are_refused(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        cli.main(["evaluate", "bioa", "--failures", name])
    told = capsys.readouterr()
    assert (stop.value.code, told.out, told.err.count("\n")) == (2, "", 1)
    assert name in told.err and not list(tmp_path.iterdir())
