"""Fig. 6: the four trial motions of the learning set-up, by the best genome of the last
generation."""

from pathlib import Path

from experiments import figures
from fntg_jax.showing import plots


def run(config: figures.Options) -> figures.Trials:
    """The four trials of the suite `paper`."""
    return figures.paper_trials(config, slice(None))


def plot(trials: figures.Trials, path: Path) -> Path:
    """PNG, PDF and CSV."""
    figures.write_trials_csv(path.with_suffix(".csv"), trials)
    return plots.trajectories(trials.trajectory, trials.field, path, trials.title)


if __name__ == "__main__":
    figures.main(__doc__, "fig6", run, plot)
