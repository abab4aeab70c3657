"""Fig. 7: one generated trajectory, from the start where the obstacle is in the way."""

from pathlib import Path

from experiments import figures
from fntg_jax.showing import plots


def run(config: figures.Options) -> figures.Trials:
    """The first trial of the suite `paper`: its obstacle lies on the line to the ball."""
    return figures.paper_trials(config, slice(0, 1))


def plot(trials: figures.Trials, path: Path) -> Path:
    """PNG, PDF and CSV."""
    figures.write_trials_csv(path.with_suffix(".csv"), trials)
    return plots.trajectories(trials.trajectory, trials.field, path, trials.title)


if __name__ == "__main__":
    figures.main(__doc__, "fig7", run, plot)
