"""Exports other than JSON: each runs as its file says and agrees with the float64 reference."""

import ast
import csv
from pathlib import Path

import numpy as np
import pytest

from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.controller.layout import LAYOUTS, rules
from fntg_jax.export import c_format, fll_format, numpy_format, verify
from fntg_jax.files import inert_json
from tests.controllers import random_controller

FLL = Path(__file__).parent / "fll"
HOSTILE = {
    "note": '*/ int x; /* """ \n import os # </script><b> ??/\n \\',
    "\u2028": "\ud800 @A@ @tables@",
}
needs_compiler = pytest.mark.skipif(c_format.compiler() is None, reason="no C compiler")


def error_share(controller, commands) -> float:
    error = verify.max_error(controller, commands)
    return max(error.v / controller.limits.v_max, error.omega / controller.limits.omega_max)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("output", ["scale", "clip"])
def test_reference_agrees_with_the_trainer(layout, output):
    controller = random_controller(layout, output=output)
    assert error_share(controller, lambda x: np.stack(controller(*x.T), -1)) < verify.FLOAT32


def test_the_check_sees_a_wrong_controller():
    right, wrong = random_controller(seed=0), random_controller(seed=1)
    error = verify.max_error(right, lambda x: verify.reference(wrong, x))
    assert not verify.within(right, error, verify.FLOAT32)
    assert verify.max_error(right, lambda x: np.full((len(x), 2), np.nan)).v == np.inf


@pytest.mark.parametrize("layout", LAYOUTS)
def test_numpy_file(layout):
    controller = random_controller(layout, seed=2, provenance=HOSTILE)
    text = numpy_format.dumps(controller)
    assert error_share(controller, lambda x: numpy_format.commands(text, x)) < verify.FLOAT64
    imports = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Import | ast.ImportFrom)]
    assert [name.name for n in imports for name in n.names] == ["numpy"]


@needs_compiler
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("layout", ["paper-31", "three-sigma-31", "full-63"])
def test_c_header(layout, double):
    controller = random_controller(layout, seed=3, provenance=HOSTILE)
    flags = (*c_format.FLAGS, "-Wconversion", "-Wdouble-promotion", "-Wshadow")
    text = c_format.dumps(controller)
    share = error_share(controller, lambda x: c_format.run(text, x, double, flags).commands)
    assert share < (verify.FLOAT64 if double else verify.FLOAT32)
    assert not any(word in text for word in ("malloc", "static const", "@gain"))


@needs_compiler
def test_a_header_that_does_not_compile_is_an_error():
    with pytest.raises(RuntimeError, match="failed"):
        c_format.run("int unused(", np.zeros((1, 4)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_fll_comes_back_without_loss(layout):
    controller = random_controller(layout, seed=4, provenance={"note": "</b> # : \u00e9"})
    text = fll_format.dumps(controller)
    read = fll_format.loads(text)
    assert export.dumps(read) == export.dumps(controller)
    assert text.count("  rule: ") == len(rules(controller.layout))


@pytest.mark.parametrize("layout", ["paper-31", "three-sigma-31", "full-63"])
def test_fll_golden_vectors_of_pyfuzzylite(layout):
    # The .csv holds what pyfuzzylite made of the .fll (fll/verify.py).
    controller = export.load(FLL / f"{layout}.fll")
    assert fll_format.dumps(controller) == (FLL / f"{layout}.fll").read_text()
    rows = np.array(list(csv.reader((FLL / f"{layout}.csv").open()))[1:], float)
    assert len(rows) == 300
    assert np.abs(verify.reference(controller, rows[:, :4]) - rows[:, 4:]).max() < 1e-12


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("AlgebraicProduct", "Minimum"),
        ("V1111 and omega", "V1112 and omega"),
        ("V1111 Function 0.04", "V1111 Function 0.05"),
        ("  term: A1", "  term: A3"),
        ("Engine: fntg", "Engine: other"),
        ("lock-range: true", "lock-range: false"),
        ("paper-31", "no-such"),
    ],
)
def test_fll_of_others_is_refused(old, new):
    text = (FLL / "paper-31.fll").read_text()
    assert old in text
    with pytest.raises(ValueError, match=r"^f\.fll: "):
        fll_format.loads(text.replace(old, new), "f.fll")


def test_edited_parameters_of_an_fll_are_read_from_its_terms():
    text = fll_format.dumps(random_controller())
    old = next(line for line in text.split("\n") if "A1 Sigmoid" in line)
    read = fll_format.loads(text.replace(old, "  term: A1 Sigmoid 1.25 -2.5"))
    assert read.theta[:2].tolist() == [-2.5, 1.25]


def test_inert_json_is_json_without_marks():
    text = inert_json(HOSTILE)
    assert not set("<>&/*#?\n\u2028") & set(text)
    assert text.isascii()
    assert ast.literal_eval(text) == HOSTILE


@pytest.mark.parametrize("to", ["json", "numpy", "fll", pytest.param("c", marks=needs_compiler)])
def test_export_command_says_its_error_and_writes(tmp_path, capsys, to):
    source = tmp_path / "params.json"
    export.save(random_controller(), source)
    cli.main(["export", str(source), str(tmp_path / "out"), "--to", to])
    said = capsys.readouterr()
    assert said.out == ""
    assert "largest error over 20000 observations" in said.err
    cli.main(["export", str(source), "-", "--to", to])
    assert capsys.readouterr().out == (tmp_path / "out").read_text()
