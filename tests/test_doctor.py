"""fntg doctor: what is declared is what is checked."""

from importlib import metadata

import pytest

from fntg_jax.commands import cli, doctor


def run(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["doctor"])
    return stop.value.code, capsys.readouterr().out


def test_every_requirement_is_listed_with_its_range(capsys):
    code, text = run(capsys)
    lines = {line.split()[0]: line for line in text.split("\n") if line}
    for name, tested, installed, optional in doctor.packages():
        assert str(tested) in lines[name]
        assert optional or (installed == metadata.version(name) and installed in lines[name])
    assert {"jax", "numpy"} <= set(lines)
    assert "pytest" not in lines
    assert code == ("OUTSIDE" in text)
    assert "device: " in text
    assert "compilation cache: " in text
    assert "rendering: " in text


@pytest.mark.parametrize(
    ("requirement", "code", "word"),
    [
        ("numpy>=99", 1, "OUTSIDE the tested range"),
        ("no-such-package>=1", 1, "not installed"),
        ('no-such-package>=1; extra == "mjx"', 0, "not installed (optional: mjx)"),
        ("numpy>=1", 0, "ok"),
    ],
)
def test_exit_status(monkeypatch, capsys, requirement, code, word):
    monkeypatch.setattr(metadata, "requires", lambda name: [requirement])
    found, text = run(capsys)
    assert found == code
    assert word in text


def test_several_asking_for_one_package_are_one_line(monkeypatch):
    wanted = ['a>=1; extra == "x"', 'a<9; extra == "y"', "b>=1", 'b>=2; extra == "x"']
    monkeypatch.setattr(metadata, "requires", lambda name: wanted)
    found = {name: (str(tested), extra) for name, tested, _, extra in doctor.packages()}
    # What is required stays so when an extra asks for it, too.
    assert found == {"a": ("<9,>=1", "x, y"), "b": (">=1,>=2", "")}
