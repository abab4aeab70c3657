"""The guide "your own team in 40 lines" does what it says."""

import re

from fntg_jax.running import matches
from tests.conftest import ROOT


def test_the_guide_plays(tmp_path):
    guide = (ROOT / "docs" / "own_team.md").read_text()
    code = re.search(r"```python\n(.*?)```", guide, re.S).group(1)
    assert len(code.splitlines()) <= 40
    path = tmp_path / "mine.py"
    path.write_text(code)
    match = matches.get_match("soccer", minutes=0.5)
    home, away = matches.get_team(str(path), match, 0), matches.get_team("still", match, 1)
    results = matches.play_matches(match, home, away, 16)
    touches = results.statistics["touches"]
    assert touches[:, 0].mean() > 0.5
