"""The report of a run: complete, self-contained, inert."""

import base64
import html
import json
import os
import re
import shutil

import pytest

from fntg_jax.commands import cli
from tests.small_run import small_run


@pytest.fixture
def run_folder():
    return small_run()


@pytest.mark.slow
def test_report(run_folder, capsys):
    cli.main(["report", str(run_folder), "--scenes", "20"])
    out = run_folder / "report.html"
    assert capsys.readouterr().out == f"{out}\n"
    page = out.read_text()
    assert page.count("<img alt=") == 7  # Fig. 5 to 8, memberships, surfaces, failures
    assert "<h1>Learning run &lt;b&gt;run &amp; @BODY@</h1>" in page
    without = re.sub('srcdoc=".*?"', "", page, flags=re.S)  # the replay, which has them as hints
    assert without.count("IF the ball is") == 16
    assert all(f"<th>{s}<td>" in page for s in ("open", "blocked", "moving-ball"))
    settings = page.partition("<h2>Configuration</h2>")[2].partition("<h2>")[0]
    rows = re.findall("<tr><th>(.*?)<td>(.*)", settings)
    assert dict(rows) == {  # and nothing at its default
        "seeds": "2",
        "first_seed": "5",
        "generations": "2",
        "ga.population": "8</table></div>",
    }
    assert "<th>versions.jax<td>" in page
    inside = re.search(r'download="params.json" href="data:[^,]*,([^"]*)"', page)[1]
    assert base64.b64decode(inside).decode() == (run_folder / "params.json").read_text()
    assert "<script" not in page  # the replay is an attribute
    inside = html.unescape(re.search('srcdoc="(.*?)"', page, re.S)[1])
    assert inside.count("<script") == 2 and inside.startswith("<!DOCTYPE html>")
    assert len(json.loads(re.search('id="data">(.*?)</script>', inside, re.S)[1])["panels"]) == 2
    assert not re.search(r'(src|href)="(?!data:|history\.npz")', without)
    assert len(page) < 2_500_000
    if folder := os.environ.get("FNTG_TEST_PAGES"):  # to look at
        shutil.copy(out, folder)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("config.json", "{", "not JSON"),
        ("provenance.json", "[1", "not JSON"),
        ("provenance.json", "[" * 100_000, "not JSON"),
        ("metrics.csv", None, "No such file"),
        ("params.json", "{}", "is a required property"),
        ("checkpoint.npz", None, "not finished"),
    ],
)
def test_damaged_runs_are_one_line(run_folder, tmp_path, capsys, name, content, message):
    folder = tmp_path / "run"
    shutil.copytree(run_folder, folder)
    (folder / "report.html").unlink(missing_ok=True)
    (folder / name).unlink() if content is None else (folder / name).write_text(content)
    with pytest.raises(SystemExit) as stop:
        cli.main(["report", str(folder), "--scenes", "1"])
    said = capsys.readouterr().err
    assert (stop.value.code, said.count("\n")) == (2, 1)
    assert said.startswith(f"fntg: error: {folder}")
    assert message in said
    assert not (folder / "report.html").exists()
