"""Intervals of what was measured: shares, medians, means.

The resampling is seeded, so that a figure drawn twice is the same figure.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Rate(NamedTuple):
    """A share of successes with its Wilson 95 % interval."""

    share: float
    low: float
    high: float

    def __str__(self) -> str:
        # One failure in thousands is not "100.0 %".
        share = min(self.share, 0.999) if self.share < 1 else 1.0
        share = max(share, 0.001) if self.share > 0 else 0.0
        return f"{100 * share:.1f} % ({100 * self.low:.1f}-{100 * self.high:.1f})"


def wilson(successes: int, trials: int, z: float = 1.959964) -> Rate:
    """Wilson score interval of a binomial share (E. B. Wilson, JASA 22, 1927).

    Args:
        successes: how many of the trials.
        trials: at least 1.
        z: quantile of the normal distribution; the default is that of 95 %.
    """
    p = successes / trials
    centre = p + z * z / (2 * trials)
    half = z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    # Rounding must not push a bound past the share itself at 0 and 1.
    low, high = (centre - half) / scale, (centre + half) / scale
    return Rate(p, max(0.0, min(p, low)), min(1.0, max(p, high)))


def bootstrap_median(
    values: Float[np.ndarray, "N ..."], level: float = 0.95, draws: int = 1000
) -> Float[np.ndarray, "3 ..."]:
    """Median over axis 0 and its percentile bootstrap interval.

    Args:
        values: [N, ...].
        level: of the interval, 0 to 1.
        draws: resamples.

    Returns:
        [3, ...]: low, median, high.
    """
    rng = np.random.default_rng(0)
    picks = rng.integers(0, values.shape[0], (draws, values.shape[0]))
    medians = np.stack([np.median(values[p], axis=0) for p in picks])
    tail = 50 * (1 - level)
    low, high = np.percentile(medians, [tail, 100 - tail], axis=0)
    return np.stack([low, np.median(values, axis=0), high])


def bootstrap_means(
    values: Float[np.ndarray, " N"], draws: int = 2000, seed: int = 0
) -> Float[np.ndarray, " draws"]:
    """Means of resamples.

    Args:
        values: [N].
        draws: resamples.
        seed: of the resampling; two samples that are compared take two.
    """
    rng = np.random.default_rng(seed)
    return values[rng.integers(0, len(values), (draws, len(values)))].mean(axis=1)


def bootstrap_mean(
    values: Float[np.ndarray, " N"], draws: int = 2000
) -> tuple[float, float, float]:
    """Mean and its 95 % percentile bootstrap interval: low, mean, high.

    Args:
        values: [N].
        draws: resamples.
    """
    low, high = np.percentile(bootstrap_means(values, draws), [2.5, 97.5])
    return float(low), float(values.mean()), float(high)


def bootstrap_mean_of_counts(
    counts: Int[np.ndarray, " N"], draws: int = 2000
) -> tuple[float, float]:
    """95 % percentile interval of the mean of whole numbers, by resampling their histogram: for
    many of them.

    Args:
        counts: [N].
        draws: resamples.
    """
    values, times = np.unique(counts, return_counts=True)
    means = np.random.default_rng(0).multinomial(len(counts), times / len(counts), draws)
    low, high = np.quantile(means @ values / len(counts), (0.025, 0.975))
    return float(low), float(high)
