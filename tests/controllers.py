"""Controllers to test with: random genes, or those a test writes by hand."""

import numpy as np

from envs.base import Limits
from fntg_jax.controller.layout import get_layout
from fntg_jax.export import Controller


def random_controller(layout: str = "paper-31", seed: int = 0, **fields) -> Controller:
    genes = get_layout(layout)
    theta = np.random.default_rng(seed).uniform(-5, 5, genes.num_genes)
    return Controller(genes, theta, **fields)


def built_controller(layout: str = "paper-31", **genes: float) -> Controller:
    """A controller with the named genes (as `layout.Gene.name`), 1 elsewhere."""
    names = [g.name for g in get_layout(layout).genes]
    assert set(genes) <= set(names)
    theta = np.array([genes.get(name, 1.0) for name in names], float)
    return Controller(get_layout(layout), theta, limits=Limits())
