"""Fig. 5: best and average fitness of the population during the generations."""

from pathlib import Path
from typing import Any

import numpy as np

from experiments import figures
from fntg_jax.running import statistics
from fntg_jax.showing import plots


def run(config: figures.Options) -> Any:
    """History with leading axes (seed, generation)."""
    return figures.finished_run(config).history()


def plot(history: Any, path: Path) -> Path:
    """PNG, PDF and CSV: medians over seeds with their 95 % bootstrap interval."""
    best, mean = (statistics.bootstrap_median(x) for x in (history.best, history.mean))
    generation = np.arange(1, best.shape[1] + 1)
    names = [f"{q}_{s}" for q in ("best", "average") for s in ("low", "median", "high")]
    columns = [generation, *best, *mean]
    figures.write_csv(path.with_suffix(".csv"), ",".join(["generation", *names]), columns)
    return plots.fitness_curves(history, path)


if __name__ == "__main__":
    figures.main(__doc__, "fig5", run, plot)
