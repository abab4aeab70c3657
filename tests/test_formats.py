"""Exports other than JSON: each runs as its file says and agrees with the float64 reference."""

import ast
import csv
import os
import re
import stat
from pathlib import Path

import numpy as np
import pytest

from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.controller.layout import LAYOUTS, rules
from fntg_jax.export import c_format, fll_format, numpy_format, verify
from fntg_jax.files import inert_json
from tests import octave
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
    ("old", "new", "words"),
    [
        ("AlgebraicProduct", "Minimum", "rules: conjunction = 'Minimum'"),
        ("  term: A1", "  term: A3", "'d_ball is A1' is not VARIABLE is TERM"),
        ("lock-range: true", "lock-range: false", "v: lock-range = 'false': allowed is true"),
        ("d_ball", "distance", "no InputVariable d_ball"),
        ("A1 Sigmoid", "A1 Gaussian", "d_ball: term A1 is a Gaussian: allowed is Sigmoid"),
        ("A1 Sigmoid", "A1 Sigmoid 9", "d_ball: term A1 = .* allowed are 2 numbers"),
        ("le(x, 0)", "ge(x, 0)", "term D2: .* wanted are left, right, not influencing"),
        ("gt(x, 0) * exp(", "gt(x, 0) * open(", "term D1: .* cannot be read"),
        ("  rule: if d_ball is A1 and d_obstacle is B1 and theta_ball is C1 and theta_obstacle is "
         "D1 then v is V1111 and omega is W1111\n", "", "no rule for terms 1, 1, 1 and 'left'"),
        ("omega is W1111\n", "omega is W1111 with 0.5\n", "is not VARIABLE is TERM"),
        ("A1 Sigmoid -2.302132862361 1.369616873215", "A1 Sigmoid 0 20", r"\(a_A1\) = 20"),
        ("if d_ball", "if d_ball is very", "is not VARIABLE is TERM"),
    ],
)  # fmt: skip
def test_fll_of_another_structure_says_what_differs(old, new, words):
    text = (FLL / "paper-31.fll").read_text()
    assert old in text
    with pytest.raises(ValueError, match=rf"^f\.fll: .*{words}"):
        fll_format.loads(text.replace(old, new), "f.fll")


@pytest.mark.parametrize("layout", ["paper-31", "full-63"])
def test_fll_of_others_is_read(layout):
    """As QtFuzzyLite saves it: other names, three decimals, comments, rules in another order, rule
    constants as numbers."""
    ours = fll_format.dumps(random_controller(layout, seed=3, output="clip"))
    lines = ["#Code automatically generated with fuzzylite 6.0.", ""]
    rounded = []
    for line in ours.split("\n"):
        numbers = r"(?<![\w.])\d+\.\d+(?![\w.])"
        line = re.sub(numbers, lambda m: m[0] if "0.000" in m[0] else f"{float(m[0]):.3f}", line)
        found = re.match(r"  term: ([VW]\d+) Function (.*)", line)
        if found:
            line = f"  term: {found[1]} Constant {eval(found[2]):.3f}"
        rounded.append(line.replace("A1", "near").replace("D3", "clear"))
    rules_ = [line + " with 1.000" for line in rounded if line.startswith("  rule")]
    lines += [x for x in rounded if not x.startswith("  rule")]
    lines += rules_[::-1]
    text = "\n".join(lines).replace("Engine: fntg", "Engine: mine").replace("  ", "\t")
    read = fll_format.loads(text)
    # Rounded constants of mirrored rules may no longer be exactly opposite.
    assert read.layout.name in {"paper-31": ("paper-31", "reduced-47")}.get(layout, (layout,))
    assert read.output == "clip"
    back = export.fll_format.dumps(read)
    assert export.dumps(fll_format.loads(back)) == export.dumps(read)
    wanted = random_controller(layout, seed=3, output="clip").params
    for name in ("a_A", "c_B", "sigma"):
        # The sign of a sigma does not matter.
        found, meant = (
            np.abs(getattr(p, name)) if name == "sigma" else getattr(p, name)
            for p in (read.params, wanted)
        )
        np.testing.assert_allclose(found, meant, atol=2e-3)
    for n, name in enumerate(("V", "Omega")):
        found = getattr(read.params, name) + read.params.bias[n]
        np.testing.assert_allclose(found, getattr(wanted, name) + wanted.bias[n], atol=2e-3)


def test_fll_with_another_name_keeps_the_symmetry():
    """Exact decimals: the 31 genes are found again, also in the scaled reading."""
    ours = random_controller(seed=5)
    read = fll_format.loads(fll_format.dumps(ours).replace("Engine: fntg", "Engine: mine"))
    assert read.layout.name == "paper-31"
    inputs = verify.observations(2000)
    found, wanted = verify.reference(read, inputs), verify.reference(ours, inputs)
    np.testing.assert_allclose(found, wanted, atol=1e-9)


@pytest.mark.parametrize("layout", ["paper-31", pytest.param("full-63", marks=pytest.mark.slow)])
def test_octave_computes_the_same_from_a_fis(tmp_path, layout):
    if not octave.available():
        pytest.skip("no octave-cli with the package fuzzy-logic-toolkit")
    controller = random_controller(layout, seed=6)
    # Corners, then drawn ones: Octave takes about 20 ms for each.
    inputs = verify.observations(1000)[::10]
    found = octave.run(tmp_path, export.fis_format.dumps(controller), inputs, controller.limits)
    assert np.abs(found - verify.reference(controller, inputs)).max() < 1e-7


def test_a_fis_needs_one_sigma():
    with pytest.raises(ValueError, match=r"layout = 'three-sigma-31': a \.fis needs one sigma"):
        export.fis_format.dumps(random_controller("three-sigma-31"))


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


FORMATS = {"json": ".json", "numpy": ".py", "c": ".h", "fll": ".fll", "fis": ".fis"}


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "params.json"
    export.save(random_controller(), path)
    return path


@pytest.mark.parametrize("to", [*FORMATS])
def test_the_name_of_the_file_says_the_format(source, capsys, to):
    if to == "c" and c_format.compiler() is None:
        pytest.skip("no C compiler")
    out = source.with_name(f"out{FORMATS[to]}")
    cli.main(["export", str(source), str(out)])
    said = capsys.readouterr()
    assert said.out == ""
    assert to == "fis" or "largest error over 20000 observations" in said.err
    cli.main(["export", str(source), "-", "--to", to])
    assert capsys.readouterr().out == out.read_text()
    cli.main(["export", str(source), str(out)])  # our own file is replaced


def refused(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        cli.main(["export", *map(str, arguments)])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_export_replaces_nothing_of_others(source, capsys):
    other = source.with_name("precious.py")
    other.write_text("x\n")
    assert "not written by fntg export; --force replaces it" in refused(capsys, source, other)
    assert other.read_text() == "x\n"
    cli.main(["export", str(source), str(other), "--force"])
    assert "Written by fntg-jax" in other.read_text()
    capsys.readouterr()
    assert "a name for c, not for json" in refused(capsys, source, "x.h", "--to", "json")
    assert "names ending in .json" in refused(capsys, source, source.with_name("x.txt"))


def test_export_writes_through_links_and_never_over_devices(source, capsys):
    target, link = source.with_name("target.json"), source.with_name("link.json")
    link.symlink_to(target)
    cli.main(["export", str(source), str(link)])
    assert link.is_symlink() and target.read_text() == source.read_text()
    capsys.readouterr()
    pipe, null = source.with_name("pipe.json"), source.with_name("null.json")
    os.mkfifo(pipe)
    null.symlink_to("/dev/null")
    source.with_name("folder.json").mkdir()
    for name, kind in (("pipe", "a FIFO"), ("null", "a device"), ("folder", "a folder")):
        out = source.with_name(f"{name}.json")
        said = refused(capsys, source, out, "--force")
        assert f"{out}: {kind}, which is not replaced" in said
    assert stat.S_ISFIFO(pipe.stat().st_mode) and stat.S_ISCHR(os.stat("/dev/null").st_mode)
