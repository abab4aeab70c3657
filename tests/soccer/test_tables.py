"""The match's tables: all say where they come from, and a body of one's own is checked."""

import copy
import json

import pytest

from envs.soccer import tables

BODY = json.loads((tables.DATA / "ers210.json").read_text())


def test_every_table_says_version_and_source():
    files = sorted(tables.DATA.glob("*.json"))
    assert len(files) >= 7
    for path in files:
        document = json.loads(path.read_text())
        assert document["format"].startswith("fntg-") and document["version"] == 1, path
        assert len(document["source"]) > 20, path


def test_a_shipped_body_is_a_body_of_ones_own(tmp_path):
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(BODY))
    assert tables.load_body(str(path)) == tables.load_body("ers210")


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (("length",), -0.3, "length = -0.3: allowed are numbers above 0"),
        (("width",), 0.4, "width = 0.4"),
        (("restitution",), 1.5, "restitution = 1.5: allowed are shares"),
        (("styles", 2, "slip"), -0.1, "styles[2].slip = -0.1: allowed are numbers from 0 up"),
        (("styles", 0, "forward"), [0.1, 0.2], "styles[0].forward"),
        (("kicks", 1, "speed"), -1, "kicks[1].speed = -1"),
        (("kicks", 0, "miss"), 2, "kicks[0].miss = 2"),
        (("kicks", 0, "delay"), 5.0, "kicks[0].delay = 5.0"),
        (("kicks", 0, "zone"), [0.2, 0.1, 0, 1], "kicks[0].zone"),
        (("postures", 0, "duration"), 0, "postures[0].duration = 0"),
        (("grip",), float("nan"), "grip = nan"),
        (("version",), 2, "version = 2"),
        (("source",), "", "source"),
    ],
)
def test_refused(where, value, words, tmp_path):
    document = copy.deepcopy(BODY)
    *path, last = where
    part = document
    for key in path:
        part = part[key]
    part[last] = value
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(document))
    with pytest.raises(ValueError) as error:
        tables.load_body(str(file))
    assert words in str(error.value) and "mine.json" in str(error.value)
    assert "\n" not in str(error.value)
