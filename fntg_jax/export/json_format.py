"""params.json: the exchange format, with its published schema (params.schema.json beside
this file).  Writing is atomic; floats round-trip exactly; NaN and infinity do not exist."""

import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from envs.base import Limits
from fntg_jax.controller import genome
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import get_layout
from fntg_jax.files import write_atomically

FORMAT, VERSION = "fntg-params", 1


def schema() -> dict:
    """The published JSON Schema of the format."""
    return json.loads(resources.files("fntg_jax.export").joinpath("params.schema.json").read_text())


def to_dict(controller: Controller) -> dict[str, Any]:
    """The document as plain lists, strings and floats, as params.schema.json describes it.

    Args:
        controller: any, of one theta.
    """
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
            {"name": g.name, "symbol": g.symbol, "unit": _unit(g.unit, controller.output)}
            for g in controller.layout.genes
        ],
        "provenance": controller.provenance,
    }
    if controller.bits is not None:
        document["bits"] = controller.bits
    return document


def _unit(unit: str, output: str) -> str:
    """Of a gene, as the outputs read it."""
    read = {"v_max/5": "m/s", "omega_max/5": "rad/s"} if output == "clip" else {}
    return read.get(unit, unit)


def dumps(controller: Controller) -> str:
    """The document of a controller as text.  Raises ValueError where its provenance holds NaN or
    infinity, which JSON does not know."""
    return json.dumps(to_dict(controller), indent=1, allow_nan=False) + "\n"


def save(controller: Controller, path: str | Path) -> None:
    """Write a controller's document to a file, whole or not at all.

    Raises ValueError as `dumps`, and OSError when the path cannot be written.
    """
    write_atomically(path, dumps(controller).encode())


def loads(text: str, source: str = "params.json") -> Controller:
    """Read a document.

    Args:
        text: JSON.
        source: what error messages call it.

    Raises ValueError with one line: source, field, value, what is allowed.
    """
    return from_dict(parse_json(text, source), source)


def parse_json(text: str, source: str) -> Any:
    """Strict JSON: finite numbers only.  Raises ValueError with one line."""

    def no_constant(name):
        raise ValueError(f"{name} is not a number that JSON knows")

    def number(digits):
        if len(digits) > 400 or not math.isfinite(float(digits)):
            no_constant(_shorten(digits))
        return float(digits) if set(digits) & set(".eE") else int(digits)

    try:
        return json.loads(text, parse_constant=no_constant, parse_float=number, parse_int=number)
    except RecursionError:
        raise ValueError(f"{source}: not a parameter file: nested too deeply") from None
    except ValueError as error:
        # Also Python's own limit on the digits of a whole number.
        raise ValueError(f"{source}: not JSON ({error})") from None


def from_dict(document: Any, source: str) -> Controller:
    """The controller of a parsed document.  Raises ValueError as `loads`."""

    def refuse(why: str):
        raise ValueError(f"{source}: {why}")

    import jsonschema  # here: it costs start-up time that only loading needs

    validator = jsonschema.Draft202012Validator(schema())
    try:
        wrong = jsonschema.exceptions.best_match(validator.iter_errors(document))
        message = "" if wrong is None else _shorten(wrong.message)
    except RecursionError:
        refuse("not a parameter file: nested too deeply")
    if wrong is not None:
        refuse(f"{wrong.json_path.removeprefix('$.')}: {message}")
    try:
        layout = get_layout(document["layout"])
    except ValueError as unknown:
        refuse(str(unknown))
    if len(document["theta"]) != layout.num_genes:
        refuse(f"theta: {len(document['theta'])} genes, {layout.name} has {layout.num_genes}")
    limits = Limits(**{k: float(v) for k, v in document["limits"].items()})
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
    if controller.bits is not None and not _bits_fit(controller):
        refuse("bits do not decode to theta")
    # The expanded parameters are for other readers; here they show tampering.
    ours = to_dict(controller)["parameters"]
    for name, value in document["parameters"].items():
        if value != ours[name]:
            refuse(f"parameters.{name} does not follow from theta under layout {layout.name}")
    return controller


def _bits_fit(controller: Controller) -> bool:
    """Whether the genome decodes to the genes, plain or Gray."""
    width, rest = divmod(len(controller.bits or ""), controller.layout.num_genes)
    if rest or not 1 <= width <= 24:
        return False
    bits = np.asarray([b == "1" for b in controller.bits or ""])
    # One rounding of 5 in float32: decoding may be fused differently on another device.
    return any(
        np.allclose(genome.decode(bits, width, gray), controller.theta, rtol=0, atol=1e-6)
        for gray in (False, True)
    )


def _shorten(message: str) -> str:
    message = " ".join(message.split())
    return message if len(message) <= 200 else f"{message[:120]} ... {message[-70:]}"
