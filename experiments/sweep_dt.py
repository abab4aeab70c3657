"""The control step, which the paper does not give: 220 steps take 11 s at 0.05 s, 44 s at 0.2 s.

Judged by success on unseen scenes, at the same control step, because F of a longer trial is
another quantity.
"""

from typing import Any

from experiments import sweeps
from experiments.sweeps import plot
from fntg_jax.running.sweep import grid


def run(config: sweeps.Options) -> Any:
    """Table of 5 settings."""
    steps = {"env.dt": [0.05, 0.075, 0.1, 0.15, 0.2]}
    return sweeps.swept(config, grid(steps), suites=("open",))


if __name__ == "__main__":
    sweeps.main(__doc__, "sweep_dt", run, plot)
