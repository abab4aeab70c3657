"""Few generations of many genomes, or many of few: population x generations is the same."""

from typing import Any

from experiments import sweeps
from experiments.sweeps import plot


def run(config: sweeps.Options) -> Any:
    """Table of 6 settings, each with about 60 genomes x config.generations evaluations."""
    evaluations = 60 * config.generations
    sizes = [20, 30, 60, 100, 190, 300]
    settings = [{"ga.population": n, "generations": max(1, evaluations // n)} for n in sizes]
    return sweeps.swept(config, settings)


if __name__ == "__main__":
    sweeps.main(__doc__, "sweep_budget", run, plot)
