"""Mutation rate a bit x share of pairs that are crossed: one compiled program."""

from typing import Any

from experiments import sweeps
from experiments.sweeps import plot
from fntg_jax.running.sweep import grid


def run(config: sweeps.Options) -> Any:
    """Table of 5 x 4 settings."""
    rates = {
        "ga.mutation_rate": [0.0, 0.0003, 0.001, 0.003, 0.01],
        "ga.crossover_rate": [0.0, 0.6, 0.8, 1.0],
    }
    return sweeps.swept(config, grid(rates))


if __name__ == "__main__":
    sweeps.main(__doc__, "sweep_mutation_crossover", run, plot)
