"""Fig. 8: linear (8a) and angular (8b) velocity along the trajectory of Fig. 7."""

from pathlib import Path

import jax

from experiments import fig7, figures
from fntg_jax.showing import plots

run = fig7.run


def plot(trials: figures.Trials, path: Path) -> Path:
    """PNG, PDF and CSV."""
    figures.write_trials_csv(path.with_suffix(".csv"), trials)
    trial = jax.tree.map(lambda x: x[0], trials.trajectory)
    return plots.velocities(trial, trials.limits, trials.dt, path, trials.title)


if __name__ == "__main__":
    figures.main(__doc__, "fig8", run, plot)
