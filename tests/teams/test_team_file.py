import json

import pytest

import fntg_jax
from fntg_jax.robot.genes import DEFAULTS
from fntg_jax.teams import team_file


@pytest.fixture(scope="module")
def team():
    bioa = fntg_jax.load(fntg_jax.shipped("bioa"))
    return team_file.TeamFile("mine", DEFAULTS._replace(near=0.3), bioa, True, {"seed": 1})


def test_round_trip_is_exact(team, tmp_path):
    team_file.save(team, tmp_path / "mine.json")
    back = team_file.load(tmp_path / "mine.json")
    assert team_file.dumps(back) == team_file.dumps(team)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "x"}, "format"),
        ({"version": 2}, "version"),
        ({"more": 1}, "more"),
        ({"goalkeeper": 3}, "goalkeeper"),
        ({"genes": {"near": 0.3}}, "is missing"),
        ({"bioa": {}}, "bioa"),
    ],
)
def test_what_is_wrong_is_named(team, tmp_path, change, words):
    document = {**json.loads(team_file.dumps(team)), **change}
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=words) as error:
        team_file.load(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_gene_out_of_range_is_named(team, tmp_path):
    document = json.loads(team_file.dumps(team))
    document["genes"]["near"] = 7
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=r"gene near = 7.0: allowed are 0.15 to 0.8 m"):
        team_file.load(path)
