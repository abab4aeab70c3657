"""Gene tables (readings of the paper) x reading of the outputs."""

from typing import Any

from experiments import sweeps
from experiments.sweeps import plot
from fntg_jax.controller.layout import LAYOUTS
from fntg_jax.running.sweep import grid


def run(config: sweeps.Options) -> Any:
    """Table of 6 x 2 settings."""
    return sweeps.swept(config, grid({"layout": list(LAYOUTS), "output": ["scale", "clip"]}))


if __name__ == "__main__":
    sweeps.main(__doc__, "sweep_layout", run, plot)
