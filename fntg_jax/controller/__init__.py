"""The paper's equations: what maps what a robot sees to how it walks.

`layout` has the gene tables, `genome` turns bits into genes, `network` is the fuzzy-neural
trajectory generator itself, `labels` says in words what a trained one has come to mean.
"""

from fntg_jax.controller import genome, layout, network
from fntg_jax.controller.controller import Controller, from_bits
from fntg_jax.controller.genome import decode, encode
from fntg_jax.controller.layout import LAYOUTS, Gene, Layout, Params, expand, get_layout
from fntg_jax.controller.network import command

__all__ = [
    "LAYOUTS",
    "Controller",
    "Gene",
    "Layout",
    "Params",
    "command",
    "decode",
    "encode",
    "expand",
    "from_bits",
    "genome",
    "get_layout",
    "layout",
    "network",
]
