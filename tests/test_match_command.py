"""`fntg match`: what it prints, what it refuses, and that a seed decides everything."""

import csv
import json


def match(fntg, *arguments, **options):
    return fntg("match", "--matches", "3", "--minutes", "0.2", *arguments, **options)


def test_json_and_csv(fntg, tmp_path):
    done = match(fntg, "--away", "random", "--json", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["matches"] == 3 and document["home"]["team"] == "chaser"
    rows = list(csv.DictReader((tmp_path / "out" / "matches.csv").open()))
    assert len(rows) == 6
    mean = sum(int(r["goals"]) for r in rows if r["side"] == "home") / 3
    assert document["home"]["goals"] == mean
    low, high = document["home"]["goals_interval"]
    assert low <= mean <= high
    again = match(fntg, "--away", "random", "--json")
    assert again.stdout == done.stdout


def test_refused_in_one_line(fntg, tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text("def make(match, side):\n    return 1 / 0\n")
    for arguments, words in (
        (("--home", "nobody"), "nobody"),
        (("--minutes", "-1"), "minutes = -1"),
        (("--players", "6"), "players = 6"),
        (("--matches", "0"), "matches = 0"),
        (("--camera", "fog"), "fog"),
        (("--home-body", "/nowhere.json"), "nowhere"),
        (("--home", str(broken)), "division by zero"),
        (("--home", str(tmp_path / "none.py")), "no such file"),
    ):
        done = fntg("match", *arguments)
        assert done.returncode == 2, arguments
        assert words in done.stderr and done.stderr.count("\n") == 1, done.stderr
