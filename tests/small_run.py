"""One tiny learning run that several tests look at, through the Python API."""

import functools
import tempfile
from pathlib import Path

import fntg_jax


@functools.cache
def small_run() -> Path:
    """Its run folder: 2 seeds from 5 on, 2 generations of 8 genomes."""
    # Marks and markup in the name: pages show it.
    folder = Path(tempfile.mkdtemp(prefix="fntg-test-")) / "<b>run & @BODY@"
    fntg_jax.train(out=folder, seeds=2, first_seed=5, generations=2, ga={"population": 8})
    return folder
