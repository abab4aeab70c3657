"""Bits a gene x plain binary or Gray code.

A bit flips with the same probability everywhere: genes of more bits mutate more often.
"""

from typing import Any

from experiments import sweeps
from experiments.sweeps import plot
from fntg_jax.running.sweep import grid


def run(config: sweeps.Options) -> Any:
    """Table of 5 x 2 settings."""
    code: dict[str, list] = {"ga.num_bits": [6, 8, 10, 15, 20], "ga.gray": [False, True]}
    return sweeps.swept(config, grid(code))


if __name__ == "__main__":
    sweeps.main(__doc__, "sweep_bits", run, plot)
