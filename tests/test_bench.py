"""The bench: cards, refusals, and that another table or opponent is told."""

import json

import numpy as np
import pytest

from fntg_jax import export
from fntg_jax.running import bench, matches


def test_controller_card(fntg, tmp_path):
    path = export.shipped("bioa")
    done = fntg("bench", path, "--share", "0.02", "--out", tmp_path / "card.json")
    assert done.returncode == 0, done.stderr
    card = json.loads(done.stdout)
    assert card == json.loads((tmp_path / "card.json").read_text())
    assert card["kind"] == "controller" and card["scenes"] == 40 and not card["complete"]
    rates = [rows["success"] for rows in card["suites"].values()]
    assert card["score"] == pytest.approx(np.mean([rate["share"] for rate in rates]))
    for rate in rates:
        assert rate["interval"][0] <= rate["share"] <= rate["interval"][1]


def test_another_version_is_told():
    match = matches.get_match("soccer", minutes=bench.MINUTES)
    found = bench.fingerprint(match)
    assert found == bench.fingerprint(matches.get_match("soccer", minutes=bench.MINUTES))
    other = bench.fingerprint(matches.get_match("soccer", minutes=2.0))
    assert [name for name in found if found[name] != other[name]] == ["rules"]
    assert "rules" in bench.differences(found | {"rules": "something else"})
    assert "balls" in bench.differences(found | {"balls": "new"})


@pytest.mark.slow
def test_team_card(fntg):
    done = fntg("bench", "random", "--share", "0.01")
    assert done.returncode == 0, done.stderr
    card = json.loads(done.stdout)
    assert set(card["against"]) == set(bench.OPPONENTS)
    for row in card["against"].values():
        low, high = row["points_interval"]
        assert row["matches"] == 4 and low <= row["points"] <= high
        assert row["points"] == pytest.approx(row["wins"] + row["draws"] / 2)


def test_refused_in_one_line(fntg, tmp_path):
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    for arguments, words in (
        (("nobody",), "nobody"),
        ((broken,), "not a readable JSON file"),
        (("chaser", "--share", "0"), "share = 0"),
        (("chaser", "--out", tmp_path), "out = "),
    ):
        done = fntg("bench", *arguments)
        assert done.returncode == 2, arguments
        assert words in done.stderr and done.stderr.count("\n") == 1, done.stderr
