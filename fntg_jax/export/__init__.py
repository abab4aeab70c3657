"""Export of trained controllers: JSON (the exchange format)."""

from fntg_jax.export.controller import Controller, from_bits
from fntg_jax.export.json_format import dumps, load, loads, save, schema

__all__ = ["Controller", "dumps", "from_bits", "load", "loads", "save", "schema"]
