"""What a contestant is asked to do."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

# STEPS: `rollout.EPISODE_STEPS`, for contestants that know no JAX.
POPULATION, TRIALS, STEPS, GENERATIONS = 60, 4, 220, 95


class Scenes(NamedTuple):
    """The scenes as NumPy arrays, for contestants that know no JAX: see `envs.base.Scene`."""

    start: np.ndarray
    ball: np.ndarray
    obstacles: np.ndarray


class Job(NamedTuple):
    """theta: [P, 31] for a generation's fitness, None for a learning run of `generations` x 60
    genomes, with `seeds` side by side (ours only)."""

    scenes: Scenes
    theta: np.ndarray | None = None
    generations: int = GENERATIONS
    seeds: int = 1

    @property
    def steps(self) -> int:
        """Controller steps of one repetition."""
        genomes = POPULATION * self.generations if self.theta is None else len(self.theta)
        return genomes * len(self.scenes.start) * STEPS * self.seeds


Run = Callable[[int], Any]
