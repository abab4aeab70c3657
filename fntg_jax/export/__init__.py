"""Trained controllers in files: JSON (the exchange format), NumPy, C99, FuzzyLite Language,
MATLAB."""

from pathlib import Path

from fntg_jax.controller.controller import Controller, from_bits
from fntg_jax.export import c_format, fis_format, fll_format, json_format, numpy_format
from fntg_jax.export.json_format import dumps, loads, save, schema

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


_MAX_BYTES = 1_000_000  # a real file has 8 kB


def load(path: str | Path) -> Controller:
    """Read a controller.

    Args:
        path: params.json, or a .fll that we exported.

    Raises ValueError (one line) when it cannot be read or is not valid.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > _MAX_BYTES:
        raise ValueError(f"{path}: over {_MAX_BYTES} bytes, not a parameter file")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not UTF-8 text") from None
    reader = fll_format if Path(path).suffix == ".fll" else json_format
    return reader.loads(text, str(path))
