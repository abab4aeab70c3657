import copy
import json

import hypothesis.extra.numpy as hnp
import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs.base import Limits
from fntg_jax import export
from fntg_jax.controller import genome
from fntg_jax.controller.layout import LAYOUTS
from tests import reference
from tests.controllers import random_controller
from tests.examples import layouts, random_observations, random_thetas

layout_names = st.sampled_from(list(LAYOUTS))


def example(name="paper-31", **fields) -> dict:
    layout = LAYOUTS[name]
    bits = np.random.default_rng(1).integers(0, 2, 15 * layout.num_genes) == 1
    controller = export.from_bits(layout, bits, provenance={"seed": 3, "fitness": 4.2}, **fields)
    return json.loads(export.dumps(controller))


@pytest.mark.parametrize("layout", layouts, ids=lambda x: x.name)
def test_documents_satisfy_the_published_schema(layout):
    schema = export.schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(example(layout.name))


@given(data=st.data(), name=layout_names)
def test_floats_round_trip_exactly(data, name):
    layout = LAYOUTS[name]
    theta = data.draw(hnp.arrays(np.float64, layout.num_genes, elements=st.floats(-5, 5)))
    v_max = data.draw(st.floats(0.01, 10))
    limits = Limits(-0.1, v_max, data.draw(st.floats(0.01, 100)))
    dt = data.draw(st.floats(1e-3, 1))
    text = export.dumps(export.Controller(layout, theta, "clip", limits, dt))
    back = export.loads(text)
    np.testing.assert_array_equal(back.theta, theta)
    assert (back.layout, back.limits, back.control_dt) == (layout, limits, dt)
    assert export.dumps(back) == text


@given(seed=st.integers(0, 2**32 - 1), name=layout_names)
def test_bits_and_theta_tell_the_same(seed, name):
    layout = LAYOUTS[name]
    bits = np.random.default_rng(seed).integers(0, 2, 15 * layout.num_genes) == 1
    back = export.loads(export.dumps(export.from_bits(layout, bits)))
    assert [c == "1" for c in back.bits] == bits.tolist()
    np.testing.assert_array_equal(genome.encode(back.theta), bits)


@pytest.mark.parametrize("layout", layouts, ids=lambda x: x.name)
def test_the_file_alone_drives_the_reference(layout, tmp_path):
    """Saved, read by plain json and evaluated without layouts: the same as the Controller."""
    theta = random_thetas(layout, 1, seed=9)[0]
    controller = export.Controller(layout, theta, limits=Limits(-0.2, 0.4, 2.0))
    path = tmp_path / "params.json"
    export.save(controller, path)
    document = json.loads(path.read_text())
    seen = random_observations(50)
    expected = [reference.command(document, o) for o in seen]
    again = export.load(path)
    np.testing.assert_allclose(np.transpose(again(*seen.T)), expected, atol=2e-4)
    assert again(*seen[0]) == pytest.approx(expected[0], abs=2e-4)
    assert [p.name for p in tmp_path.iterdir()] == ["params.json"]


def tampered(change) -> str:
    document = copy.deepcopy(example())
    change(document)
    return json.dumps(document)


def put(*path_and_value):
    *path, last, value = path_and_value

    def change(document):
        for step in path:
            document = document[step]
        document[last] = value

    return change


def drop(name):
    return lambda document: document.pop(name)


BAD = {
    "format": (put("format", "fntg"), "format"),
    "version": (put("version", 2), "version"),
    "layout type": (put("layout", 31), "layout"),
    "unknown layout": (put("layout", "paper-32"), "layout = 'paper-32'"),
    "layout with a line": (put("layout", "a\nb"), "layout"),
    "too few genes": (lambda d: d["theta"].pop(), "theta: 30"),
    "too many genes": (lambda d: d["theta"].append(0.0), "theta: 32"),
    "gene NaN": (put("theta", 3, float("nan")), "NaN"),
    "gene infinite": (put("theta", 3, float("inf")), "Infinity"),
    "gene out of range": (put("theta", 3, 5.0001), r"theta\[3\]"),
    "gene text": (put("theta", 3, "1.0"), r"theta\[3\]"),
    "gene true": (put("theta", 3, True), r"theta\[3\]"),
    "gene null": (put("theta", 3, None), r"theta\[3\]"),
    "theta object": (put("theta", {}), "theta"),
    "theta missing": (drop("theta"), "theta"),
    "parameters missing": (drop("parameters"), "parameters"),
    "limits missing": (drop("limits"), "limits"),
    "limits swapped": (put("limits", "v_min", 9.0), "v_min = 9.0"),
    "v_max zero": (put("limits", "v_max", 0), "limits.v_max"),
    "output": (put("output", "tanh"), "output"),
    "dt": (put("control_dt", -0.1), "control_dt"),
    "extra key": (put("colour", "red"), "colour"),
    "extra parameter": (put("parameters", "D", []), "D"),
    "bits": (put("bits", "0120"), "bits"),
    "tampered bit": (lambda d: d.update(bits="10"[int(d["bits"][0])] + d["bits"][1:]), "bits"),
    "too few bits": (lambda d: d.update(bits=d["bits"][:-1]), "bits"),
    "tampered rule": (put("parameters", "V", 0, 1, 0, 2, 0.125), r"parameters\.V"),
    "tampered Omega": (put("parameters", "Omega", 1, 0, 1, 2, 0.125), r"parameters\.Omega"),
    "tampered sigmoid": (put("parameters", "B", "c", 1, 0.125), r"parameters\.B"),
    "tampered sigma": (put("parameters", "sigma", 2, 0.125), r"parameters\.sigma"),
    "tampered bias": (put("parameters", "bias", 1, 0.125), r"parameters\.bias"),
    "tampered gene": (lambda d: d.pop("bits") and put("theta", 0, 0.125)(d), r"parameters\.A"),
    "gene of another genome": (put("theta", 0, 0.125), "bits"),
    "ragged table": (put("parameters", "V", 0, 0, 0, [1.0, 2.0]), r"parameters\.V"),
    "deep provenance": (put("provenance", {"a": [[[[1]]]]}), "provenance"),
}


def refusal(text, source="some/file.json") -> str:
    with pytest.raises(ValueError) as caught:
        export.loads(text, source)
    message = str(caught.value)
    assert message.startswith(f"{source}: ")
    assert "\n" not in message
    assert len(message) < 500
    return message


@pytest.mark.parametrize("name", BAD)
def test_tampered_documents_are_refused_with_the_field(name):
    change, field = BAD[name]
    with pytest.raises(ValueError, match=field):
        export.loads(tampered(change))
    refusal(tampered(change))


def test_the_untampered_document_is_accepted():
    assert export.loads(tampered(lambda d: None)).layout.name == "paper-31"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "null",
        "[]",
        "3",
        '"fntg-params"',
        "{",
        "{}",
        "\x00",
        "[" * 100_000,
        '{"a":' * 100_000,
        "[" * 900 + "]" * 900,
        json.dumps(example()).replace('"seed": 3', '"seed": ' + "9" * 5000),
        json.dumps(example()).replace('"seed": 3', '"seed": ' + "[" * 500 + "]" * 500),
        json.dumps(example()).replace('"control_dt": 0.1', '"control_dt": 1e999'),
        json.dumps(example()).replace('"seed": 3', '"seed": 1e999'),
    ],
    ids=lambda text: f"{text[:12]!r}..{len(text)}",
)
def test_hostile_text_is_refused_in_one_line(text):
    refusal(text)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.integers(),
        lambda x: st.lists(x, max_size=4) | st.dictionaries(st.text(max_size=5), x, max_size=4),
        max_leaves=10,
    ),
    st.sampled_from(sorted(example())),
)
def test_any_other_value_of_any_field_is_refused_or_harmless(value, field):
    document = {**example(), field: value}
    try:
        accepted = export.loads(json.dumps(document), "x")
    except ValueError as error:
        why = str(error)
    else:
        why = "x: accepted"
        json.loads(export.dumps(accepted))  # can be written again
    assert why.startswith("x: ")
    assert "\n" not in why


def test_unreadable_files_are_refused(tmp_path):
    huge = tmp_path / "huge.json"
    huge.write_text(json.dumps(example()) + " " * 1_000_001)
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe{}")
    for path, why in (
        (tmp_path / "none.json", "No such file"),
        (tmp_path, "No such file"),
        (huge, "1000000 bytes"),
        (binary, "UTF-8"),
    ):
        with pytest.raises(ValueError, match=why) as caught:
            export.load(path)
        assert str(path) in str(caught.value)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "params.json"
    path.write_text("old")
    broken = random_controller(provenance={"fitness": np.nan})
    with pytest.raises(ValueError):
        export.save(broken, path)
    assert path.read_text() == "old"
    with pytest.raises(OSError):
        export.save(export.loads(json.dumps(example())), tmp_path / "no" / "params.json")
    assert [p.name for p in tmp_path.iterdir()] == ["params.json"]
