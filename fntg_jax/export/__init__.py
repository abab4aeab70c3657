"""Trained controllers in files: JSON (the exchange format), NumPy, C99, FuzzyLite Language,
MATLAB."""

import os
from pathlib import Path

from fntg_jax.controller.controller import Controller, from_bits
from fntg_jax.export import c_format, fis_format, fll_format, json_format, numpy_format
from fntg_jax.export.json_format import dumps, loads, save, schema
from fntg_jax.files import read_text

__all__ = [
    "Controller",
    "c_format",
    "dumps",
    "fis_format",
    "fll_format",
    "from_bits",
    "json_format",
    "load",
    "loads",
    "numpy_format",
    "save",
    "schema",
    "shipped",
]


def shipped(name: str) -> Path:
    """Path of a controller that comes with the package."""
    return Path(__file__).parent.parent / "data" / f"{name}.json"


def load(path: str | Path) -> Controller:
    """Read a controller.

    Args:
        path: params.json, a .fll, or a run folder; where there is nothing of that name, "bioa" is
            the one that comes with the package.

    Raises ValueError (one line) when it cannot be read or is not valid.
    """
    # os.path, because methods of Path raise on names that no file can have.
    if os.path.isdir(path):
        folder, path = path, Path(path, "params.json")
        if not os.path.lexists(path) and os.path.lexists(Path(folder, "config.json")):
            raise ValueError(f"{folder}: not finished; continue it: fntg train --resume {folder}")
    elif str(path) == "bioa" and not os.path.lexists(path):
        path = shipped("bioa")
    text = read_text(path, "parameter file")
    reader = fll_format if Path(path).suffix == ".fll" else json_format
    return reader.loads(text, str(path))
