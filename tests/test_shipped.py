"""The controller that comes with the package: what it promises, judged by an independent
simulator, and the commands that show it."""

import json

import numpy as np
import pytest

import fntg_jax
from fntg_jax.commands import cli
from fntg_jax.running import evaluation, registry
from tests import reference

DOCUMENT = json.loads(fntg_jax.shipped("bioa").read_text())


@pytest.mark.parametrize("suite", ["open", "blocked"])
def test_it_succeeds_on_unseen_scenes(suite):
    scenes = evaluation.held_out_scenes(registry.get_world("kinematic"), suite, 100, seed=7)
    start, ball, obstacles = (np.asarray(x) for x in (scenes.start, scenes.ball, scenes.obstacles))
    trials = [reference.simulate(DOCUMENT, *scene) for scene in zip(start, ball, obstacles)]
    failed = [n for n, trial in enumerate(trials) if not all(reference.success(trial))]
    # Of 2000 scenes at most 0.6 % fail.
    assert len(failed) <= 3, failed


def test_its_genes_have_the_units_its_outputs_are_read_in():
    assert DOCUMENT["output"] == "clip"
    units = {gene["name"]: gene["unit"] for gene in DOCUMENT["genes"]}
    assert units["V_1111"] == "m/s" and units["Omega_1111"] == "rad/s" and units["b_21"] == "m/s"


def test_commands_show_it(capsys, tmp_path):
    cli.main(["rules", "bioa", "--scenes", "4"])
    assert "share of the firing over 4 scenes" in capsys.readouterr().out
    cli.main(["evaluate", "bioa", "--suite", "open", "--scenes", "20", "--json"])
    assert json.loads(capsys.readouterr().out)["open"]["success"]["share"] >= 0.9
    page = tmp_path / "replay.html"
    cli.main(["replay", "bioa", "--out", str(page)])
    assert page.stat().st_size > 10_000
