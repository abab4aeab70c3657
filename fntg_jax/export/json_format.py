"""params.json: the exchange format, with its published schema (params.schema.json beside
this file).  Writing is atomic; floats round-trip exactly; NaN and infinity do not exist."""

import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from fntg_jax import fntg
from fntg_jax.export.controller import Controller
from fntg_jax.files import write_atomically
from fntg_jax.layout import get_layout

FORMAT, VERSION = "fntg-params", 1
_MAX_BYTES = 1_000_000  # a real file has 8 kB


def schema() -> dict:
    """The published JSON Schema of the format."""
    return json.loads(resources.files("fntg_jax.export").joinpath("params.schema.json").read_text())


def to_dict(controller: Controller) -> dict[str, Any]:
    """The document as plain lists, strings and floats."""
    p = controller.params
    tables = {name: np.asarray(value).tolist() for name, value in p._asdict().items()}
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "layout": controller.layout.name,
        "theta": controller.theta.tolist(),
        "output": controller.output,
        "limits": {k: float(v) for k, v in controller.limits._asdict().items()},
        "control_dt": float(controller.control_dt),
        "parameters": {
            **{f: {"a": tables[f"a_{f}"], "c": tables[f"c_{f}"]} for f in "ABC"},
            "sigma": tables["sigma"],
            "V": tables["V"],
            "Omega": tables["Omega"],
            "bias": tables["bias"],
        },
        "units": {
            "d_B, d_O": "m",
            "theta_B, theta_O": "rad, > 0 is left",
            "v": "m/s",
            "omega": "rad/s",
            "V, Omega, bias": "output 'scale': v_max/5 and omega_max/5; 'clip': m/s and rad/s",
            "control_dt": "s",
        },
        "genes": [
            {"name": g.name, "symbol": g.symbol, "unit": g.unit} for g in controller.layout.genes
        ],
        "provenance": controller.provenance,
    }
    if controller.bits is not None:
        document["bits"] = controller.bits
    return document


def dumps(controller: Controller) -> str:
    """The document as text."""
    return json.dumps(to_dict(controller), indent=1, allow_nan=False) + "\n"


def save(controller: Controller, path: str | Path) -> None:
    """Write atomically.  Raises OSError when the path cannot be written."""
    write_atomically(path, dumps(controller).encode())


def loads(text: str, source: str = "params.json") -> Controller:
    """Read a document.  Raises ValueError with one line: source, field, value, what is allowed."""

    def refuse(why: str):
        raise ValueError(f"{source}: {why}")

    def no_constant(name):
        refuse(f"{name} is not a number that JSON knows")

    try:
        document = json.loads(text, parse_constant=no_constant)
    except json.JSONDecodeError as error:
        refuse(f"not JSON ({error})")
    except RecursionError:
        refuse("not a parameter file: nested too deeply")
    import jsonschema  # here: it costs start-up time that only loading needs

    validator = jsonschema.Draft202012Validator(schema())
    wrong = jsonschema.exceptions.best_match(validator.iter_errors(document))
    if wrong is not None:
        refuse(f"{wrong.json_path.removeprefix('$.')}: {_shorten(wrong.message)}")
    try:
        layout = get_layout(document["layout"])
    except ValueError as unknown:
        refuse(str(unknown))
    if len(document["theta"]) != layout.num_genes:
        refuse(f"theta: {len(document['theta'])} genes, {layout.name} has {layout.num_genes}")
    limits = fntg.Limits(**{k: float(v) for k, v in document["limits"].items()})
    if limits.v_min >= limits.v_max:
        refuse(f"limits: v_min = {limits.v_min} must be below v_max = {limits.v_max}")
    controller = Controller(
        layout=layout,
        theta=np.asarray(document["theta"], np.float64),
        output=document["output"],
        limits=limits,
        control_dt=float(document["control_dt"]),
        bits=document.get("bits"),
        provenance=document.get("provenance", {}),
    )
    # The expanded parameters are for other readers; here they show tampering.
    ours = to_dict(controller)["parameters"]
    for name, value in document["parameters"].items():
        if value != ours[name]:
            refuse(f"parameters.{name} does not follow from theta under layout {layout.name}")
    return controller


def load(path: str | Path) -> Controller:
    """Read a file.  Raises ValueError (one line) when it cannot be read or is not valid."""
    try:
        with open(path, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
    if len(data) > _MAX_BYTES:
        raise ValueError(f"{path}: over {_MAX_BYTES} bytes, not a parameter file")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not UTF-8 text") from None
    return loads(text, str(path))


def _shorten(message: str) -> str:
    message = " ".join(message.split())
    return message if len(message) <= 200 else f"{message[:120]} ... {message[-70:]}"
