"""Malformed, truncated and hostile input: always one clear line, never a traceback or a file."""

import ast
import copy
import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.export import c_format, fll_format, json_format, numpy_format
from fntg_jax.showing import replay
from tests.controllers import random_controller

CONTROLLER = random_controller(provenance={"note": "plain", "seed": 1})
TEXT = export.dumps(CONTROLLER)
FLL = fll_format.dumps(CONTROLLER)
MARKUP = '<script>alert(1)</script>*/\n"""\nimport os #\\ ../../etc \x1b[2J\u2028\ud800'
fast = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


def refused_or_read(read, text):
    """The controller, or None when `text` was refused in one clear line."""
    try:
        return read(text, "some file")
    except ValueError as error:
        message = str(error)
        assert message.startswith("some file: ")
        assert "\n" not in message
        assert len(message) < 1000
        return None


def paths(value, here=()):
    """Paths to all parts of a document."""
    yield here
    items = value.items() if isinstance(value, dict) else ()
    items = enumerate(value) if isinstance(value, list) else items
    for key, part in items:
        yield from paths(part, (*here, key))


PATHS = [p for p in paths(json.loads(TEXT)) if p]
HOSTILE = [
    "NaN",
    "Infinity",
    "-1e999",
    "1" + "0" * 400,
    "9" * 5000,
    "5.000001",
    "-0.0",
    "null",
    "true",
    "[]",
    "{}",
    '""',
    "[" * 300 + "]" * 300,
    "[" * 100_000 + "]" * 100_000,
    "[" + "0," * 100_000 + "0]",
    json.dumps(MARKUP),
    json.dumps("x" * 100_000),
    '"\\ud800"',
]


@fast
@given(st.sampled_from(PATHS), st.sampled_from(HOSTILE))
def test_a_part_replaced(path, value):
    document = copy.deepcopy(json.loads(TEXT))
    part = document
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = "@here@"
    text = json.dumps(document).replace('"@here@"', value)
    read = refused_or_read(json_format.loads, text)
    if read is not None:  # what is accepted can be written in every format, and read again
        assert np.all(np.abs(read.theta) <= 5)
        for write in (export.dumps, fll_format.dumps, numpy_format.dumps, c_format.dumps):
            write(read).encode()
        assert export.dumps(export.loads(export.dumps(read))) == export.dumps(read)


@fast
@given(st.integers(0, len(TEXT) - 2))
def test_json_truncated(length):
    assert refused_or_read(json_format.loads, TEXT[:length]) is None


@fast
@given(st.text() | st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps))
def test_json_anything(text):
    assert refused_or_read(json_format.loads, text) is None


@fast
@given(st.integers(0, len(FLL) - 1), st.integers(0, 40), st.text(max_size=8))
def test_fll_cut_and_spliced(start, length, text):
    changed = FLL[:start] + text + FLL[start + length :]
    read = refused_or_read(fll_format.loads, changed)
    # A changed number, name or comment may be another valid engine; nothing else passes, and what
    # does is one that we can write and read again.
    assert read is None or fll_format.loads(fll_format.dumps(read)) == read


@fast
@given(st.binary(max_size=200) | st.sampled_from([b"\xff\xfe", b"{" * 10, b"0" * 1_000_001]))
@pytest.mark.parametrize("suffix", [".json", ".fll"])
def test_files_of_any_bytes(tmp_path, suffix, data):
    path = tmp_path / f"file{suffix}"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=re.escape(str(path))) as error:
        export.load(path)
    assert "\n" not in str(error.value)


@fast
@given(st.dictionaries(st.text(max_size=20), st.text(max_size=40) | st.just(MARKUP), max_size=4))
def test_strings_stay_data_in_every_format(provenance):
    controller = random_controller(provenance=provenance)
    assert export.loads(export.dumps(controller)).provenance == provenance
    assert fll_format.loads(fll_format.dumps(controller)).provenance == provenance
    # NumPy and C differ from those of a controller without provenance in one comment line.
    for write in (numpy_format.dumps, c_format.dumps):
        ours, plain = write(controller), write(random_controller())
        different = [a for a, b in zip(ours.split("\n"), plain.split("\n")) if a != b]
        assert len(ours.split("\n")) == len(plain.split("\n"))
        assert len(different) <= 1
        assert ours.isascii()
        assert ours.count("*/") == plain.count("*/")
    same = ast.dump(ast.parse(numpy_format.dumps(random_controller())))
    assert ast.dump(ast.parse(numpy_format.dumps(controller))) == same


@fast
@given(st.text(max_size=40) | st.just(MARKUP), st.text(max_size=40))
def test_strings_stay_data_in_pages(title, name):
    page = replay.page([{"title": name}], title)
    blocks = re.findall(r"<script[^>]*>(.*?)</script>", page, re.S)
    assert len(blocks) == page.lower().count("<script") == 2
    assert json.loads(blocks[0]) == {"panels": [{"title": name}]}
    page.encode()


@pytest.mark.parametrize(
    "name",
    ["", ".", "no/such", "a\nb.json", "\x1b[2J.json", "x" * 5000, "nul\0.json", "../../../no.json"],
    ids=["empty", "folder", "missing", "newline", "escape", "long", "nul", "up"],
)
@pytest.mark.parametrize("command", ["export", "rules", "plot", "replay", "report", "evaluate"])
def test_strange_names_are_one_line(tmp_path, monkeypatch, capsys, command, name):
    monkeypatch.chdir(tmp_path)
    rest = ["out.json"] if command == "export" else []
    with pytest.raises(SystemExit) as stop:
        cli.main([command, name, *rest])
    said = capsys.readouterr()
    assert stop.value.code == 2
    assert said.out == ""
    assert said.err.startswith("fntg: error: ")
    assert said.err.count("\n") == 1
    assert said.err.rstrip("\n").isprintable()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", ["no/such/file", ".", "x" * 300])
@pytest.mark.parametrize("command", ["export", "replay", "plot"])
def test_outputs_that_cannot_be_written(tmp_path, monkeypatch, capsys, command, out):
    monkeypatch.chdir(tmp_path)
    export.save(CONTROLLER, "p.json")
    name = out + {"replay": ".html", "export": ".json"}.get(command, "")
    arguments = [name] if command == "export" else ["--out", name]
    if command == "plot" and out == ".":
        pytest.skip("a fine beginning of a name")
    if command != "plot" and out == ".":
        arguments[-1] = "no/" + name[1:]
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "p.json", *arguments])
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("fntg: error: out = ") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["p.json"]
