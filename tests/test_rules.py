"""Rules in words: labels follow the learnt memberships, shares follow the roll-outs."""

import csv
import io
import json

import jax
import numpy as np
import pytest

from envs.base import Limits, Observation
from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.controller import labels, layout
from fntg_jax.running import evaluation, registry
from fntg_jax.showing import rules
from tests.controllers import built_controller, random_controller

WORLD = registry.get_world("kinematic")
NEAR_FAR = {"a_A1": -5, "c_A1": 0.5, "a_A2": 5, "c_A2": 0.5}


def names(controller, family):
    found, notes = labels.describe_labels(controller, WORLD.field)
    return [x.name for x in found[family]], notes


def test_labels_as_the_paper_has_them():
    controller = built_controller(**NEAR_FAR)
    assert names(controller, "A") == (["near", "far"], names(controller, "A")[1])
    found, _ = labels.describe_labels(controller, WORLD.field)
    assert [x.where for x in found["A"]] == [
        "over half for d_B < 0.50 m",
        "over half for d_B > 0.50 m",
    ]


def test_a_swapped_pair_is_named_and_noted():
    controller = built_controller(a_A1=5, c_A1=0.5, a_A2=-5, c_A2=0.5)
    found, notes = names(controller, "A")
    assert found == ["far", "near"]
    assert any("A1 and A2 have swapped" in note for note in notes)


def test_equal_labels_tell_nothing_apart():
    # All genes 1: both sigmoids of a pair are the same.
    found, notes = names(built_controller(), "C")
    assert found == ["any direction (C1)", "any direction (C2)"]
    assert any("C1 and C2 tell nothing apart" in note for note in notes)


def test_a_pair_that_splits_the_middle_from_the_ends():
    # Share of the first: 0.6 at 0 m, 0.9 at 1 m, 0.6 at 3 m.
    controller = built_controller(a_A1=5, c_A1=0.5, a_A2=1, c_A2=3)
    found, notes = names(controller, "A")
    assert found[0] == "in between"
    assert any("split the middle" in note for note in notes)


@pytest.mark.parametrize(("slope", "expected"), [(5, ["left", "right"]), (-5, ["right", "left"])])
def test_direction_of_the_ball(slope, expected):
    controller = built_controller(a_C1=slope, c_C1=0, a_C2=-slope, c_C2=0)
    assert names(controller, "C")[0] == expected


@pytest.mark.parametrize("seed", range(20))
def test_labels_follow_the_shares(seed):
    controller = random_controller(seed=seed)
    found, _ = labels.describe_labels(controller, WORLD.field)
    for family in "AB":
        low, high = labels.input_range(family, WORLD.field)
        ends = labels.shares(controller, family, np.array([low, high]))
        for label, (at_low, at_high) in zip(found[family], ends):
            if label.name in ("near", "far"):
                assert (label.name == "near") == (at_low > at_high)


@pytest.mark.parametrize(("name", "num"), [("paper-31", 16), ("full-63", 24)])
def test_strengths_and_outputs_add_up_to_the_command(name, num):
    controller = random_controller(name, 1, output="clip", limits=Limits(-10.0, 10.0, 10.0))
    rng = np.random.default_rng(0)
    seen = Observation(*rng.uniform(-1, 1, (4, 50)).astype(np.float32))
    strengths = np.asarray(rules.rule_strengths(controller, seen))
    assert strengths.shape == (50, num) == (50, len(layout.rules(controller.layout)))
    commands = np.stack(controller(*seen), axis=-1)
    expected = strengths @ rules.rule_outputs(controller)
    assert np.ptp(commands, axis=0).min() > 0.01
    np.testing.assert_allclose(expected, commands, rtol=1e-4, atol=1e-4)


def test_dead_and_dominant_rules():
    # A2, B2 and C2 never fire; with a tiny sigma the obstacle is never on a side.
    off = {f"a_{f}2": 5.0 for f in "ABC"} | {f"c_{f}2": 5.0 for f in "ABC"}
    on = {f"a_{f}1": 0.0 for f in "ABC"}
    controller = built_controller(**off, **on, sigma=1e-3)
    base = rules.rule_base(controller, WORLD, num_scenes=2)
    flags = {rule.name: rule.flag for rule in base.rules}
    assert flags.pop("1113") == "dominant"
    assert flags["221"] == flags["2111"] == "dead"
    assert sum(rule.mean for rule in base.rules) == pytest.approx(1, abs=1e-5)
    assert sum(rule.strongest for rule in base.rules) == pytest.approx(1, abs=1e-5)


def test_more_scenes_leave_the_first_as_they_are():
    few, many = (evaluation.held_out_scenes(WORLD, "blocked", n) for n in (2, 5))
    same = jax.tree.map(lambda a, b: bool((a == b[:2]).all()), few, many)
    assert all(jax.tree.leaves(same))


def test_sentence():
    controller = built_controller(**NEAR_FAR, V_1111=2, b_21=1, Omega_1111=1, b_22=1)
    base = rules.rule_base(controller, WORLD, num_scenes=2)
    text = rules.sentence(base.rules[0], base.limits)
    assert text.startswith("IF the ball is NEAR and at ANY DIRECTION (C1)")
    assert text.endswith("on the LEFT THEN v = 0.12 m/s, turn left 0.60 rad/s")


def test_command_and_formats(tmp_path, capsys):
    controller = random_controller()
    export.save(controller, tmp_path / "params.json")
    base = rules.rule_base(controller, WORLD, num_scenes=2)
    texts = {name: write(base) for name, write in rules.FORMATS.items()}
    document = json.loads(texts["json"])
    rows = list(csv.DictReader(io.StringIO(texts["csv"])))
    assert [r["rule"] for r in rows] == [r["name"] for r in document["rules"]]
    assert len(rows) == texts["text"].count("IF the ball is") == texts["md"].count("IF the") == 16
    cli.main(["rules", str(tmp_path / "params.json"), "--scenes", "2", "--format", "csv"])
    said = capsys.readouterr()
    assert (said.out, said.err) == (texts["csv"], "")


def test_unknown_suite_is_one_line(tmp_path, capsys):
    export.save(random_controller(), tmp_path / "p.json")
    with pytest.raises(SystemExit) as stop:
        cli.main(["rules", str(tmp_path / "p.json"), "--suite", "none"])
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("fntg: error: suite = 'none': known are")
