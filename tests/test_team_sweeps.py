"""The sweeps of task team: each has its script, options reach the match, and a tiny one runs."""

import csv
from pathlib import Path

import pytest

from experiments import team_sweeps
from fntg_jax.running import matches, team_task


def test_every_sweep_has_its_script():
    folder = Path(team_sweeps.__file__).parent
    found = {p.stem.removeprefix("team_"): p.read_text() for p in folder.glob("team_*.py")}
    del found["sweeps"]
    assert set(found) == set(team_sweeps.SWEEPS)
    for name, text in found.items():
        assert f'team_sweeps.main("{name}")' in text
    for sweep in team_sweeps.SWEEPS.values():
        for task, _ in sweep.settings.values():
            team_task.task(**task)


def test_conditions_reach_the_match():
    plain = matches.get_match("soccer")
    loud = matches.get_match("soccer", noise=2.0, hearing=1.0)
    assert loud.sights.ball.bearing == 2 * plain.sights.ball.bearing
    assert loud.air == plain.air._replace(half=1.0)
    with pytest.raises(ValueError, match="noise = -1"):
        matches.get_match("soccer", noise=-1.0)


@pytest.mark.slow
def test_tiny_budget(tmp_path):
    options = ["--seeds", "2", "--generations", "1", "--population", "4", "--seconds", "2"]
    path = team_sweeps.main("players", [*options, "--out", str(tmp_path)])
    rows = list(csv.DictReader(path.with_suffix(".csv").open()))
    assert len(rows) == 8 and all(0 <= float(row["score"]) <= 1 for row in rows)
    assert path.stat().st_size > 5000
