"""README and docs: every example runs and shows something that works, every command line is one
that the command takes, every file that is named exists."""

import re
import shlex
from pathlib import Path

import pytest
import tyro
from PIL import Image

from fntg_jax.commands import cli

ROOT = Path(__file__).parents[1]
PAGES = {p.relative_to(ROOT).as_posix(): p for p in (ROOT / "README.md", *ROOT.glob("docs/*.md"))}


def blocks(page: str, *languages: str) -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```", PAGES[page].read_text(), re.S | re.M)
    return [code for language, code in found if language in languages]


def commands(page: str) -> list[list[str]]:
    """Arguments of all `fntg` lines of a page."""
    lines = "\n".join(blocks(page, "sh", "")).replace("\\\n", " ").split("\n")
    words = [shlex.split(line, comments=True) for line in lines if re.match(r"fntg [a-z]", line)]
    return [w[1:] for w in words]


def with_python():
    return [page for page in PAGES if blocks(page, "python")]


@pytest.mark.parametrize("page", [page for page in with_python() if page != "README.md"])
def test_the_examples_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = "\n".join(blocks(page, "python"))
    if "brax" in code:
        pytest.importorskip("brax")
    if "gym" in code:
        pytest.importorskip("gymnasium")
    exec(compile(code, page, "exec"), {})
    printed = capsys.readouterr().out
    assert not re.search(r"^\(?0\.0\b", printed, re.M)  # nothing that failed is shown
    assert "'success': False" not in printed


def test_the_readme_s_example_prints_a_success(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = blocks("README.md", "python")[0]
    assert code.count("\n") <= 10
    exec(code, {})
    first, second = capsys.readouterr().out.splitlines()
    assert float(first.split()[0]) > 99 and float(second.split()[0]) > 0


def test_the_commands_before_any_training_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lines = blocks("README.md", "sh")[1].splitlines()
    assert len(lines) == 5 and all(line.startswith("fntg ") for line in lines)
    for line in lines:
        try:
            cli.main(shlex.split(line, comments=True)[1:])
        except SystemExit as end:
            assert not end.code, line
    files = {p.name for p in tmp_path.iterdir()}
    assert {"bioa.html", "bioa-surfaces.png", "bioa-memberships.png", "bioa.h"} <= files
    printed = capsys.readouterr().out
    shown = [line for line in blocks("README.md", "")[0].splitlines() if "..." not in line]
    assert len(shown) == 5
    missing = [line for line in shown if line not in printed]
    assert not missing  # what the README shows of `fntg rules bioa` is what it prints


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_the_commands_of_a_page_are_understood(page, monkeypatch):
    class Understood(Exception):
        pass

    def parse_only(*args, real=tyro.cli, **options):
        real(*args, **options)
        raise Understood

    monkeypatch.setattr(tyro, "cli", parse_only)
    for argv in commands(page):
        try:
            cli.main(argv)
        except Understood:
            continue
        except SystemExit as end:
            assert not end.code, f"fntg {' '.join(argv)}"


@pytest.mark.parametrize("page", PAGES)
def test_files_that_a_page_names_exist(page):
    text = PAGES[page].read_text()
    named = re.findall(r"\b((?:fntg_jax|envs|experiments|tests|docs)/[\w./-]*\.\w+)", text)
    modules = re.findall(r"python -m (experiments\.\w+)", text)
    named += [module.replace(".", "/") + ".py" for module in modules]
    assert [name for name in named if not (ROOT / name).exists()] == []
    links = re.findall(r"\]\(((?!https?:|#)[^)#]+)", text)
    assert [link for link in links if not (PAGES[page].parent / link).exists()] == []


def test_the_readme_is_short_and_its_picture_moves():
    assert len(PAGES["README.md"].read_text().splitlines()) <= 200
    picture = ROOT / "docs/images/bioa.gif"
    assert picture.stat().st_size < 1_000_000
    with Image.open(picture) as image:
        assert image.n_frames > 20
