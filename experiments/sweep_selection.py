"""Selection schemes: roulette wheel (the paper, as we read it) and four others."""

from typing import Any

from experiments import sweeps
from experiments.sweeps import plot
from fntg_jax.running.sweep import grid


def run(config: sweeps.Options) -> Any:
    """Table of 5 settings."""
    schemes = ["roulette", "sus", "rank", "tournament", "truncation"]
    return sweeps.swept(config, grid({"ga.selection": schemes}))


if __name__ == "__main__":
    sweeps.main(__doc__, "sweep_selection", run, plot)
