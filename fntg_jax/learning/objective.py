"""From a configuration to fitness: what is compiled for, what may change, and the score."""

from typing import Any, NamedTuple

import jax

from envs.base import Task
from fntg_jax.controller import network
from fntg_jax.controller.layout import Layout
from fntg_jax.learning import fitness
from fntg_jax.learning.fitness import PaperWeights, SmoothWeights
from fntg_jax.learning.ga import GAConfig
from fntg_jax.learning.rollout import rollout_pairs

AXIS = "genome"  # of the devices that share a generation


class Static(NamedTuple):
    """What a program is compiled for, besides the shapes."""

    layout: Layout
    output: network.Output
    objective: str
    num_scenes: int
    fresh: bool


class Traced(NamedTuple):
    """What may change without compiling again."""

    ga: GAConfig
    env: Any
    fitness: PaperWeights
    smooth: SmoothWeights
    scenes: Any
    horizon: Any = 1.0  # generations that the decay of the mutation rate refers to


def bioa(static: Static, traced: Traced) -> Task:
    """The paper's learning problem: genes of the FNTG, judged in scenes of a world."""

    def fitness(key, theta, memory, progress):
        del progress
        return score(static, traced, theta, draw_scenes(static, traced, key), axis=AXIS), memory

    return Task("bioa", static.layout.genes, fitness)


def score(static: Static, traced: Traced, theta, scenes, **options):
    """Fitness [P] of theta [P, genes] on scenes; options: those of `rollout.rollout`."""
    outcome = rollout_pairs(
        static.layout, theta, scenes, traced.env, output=static.output, **options
    )
    if static.objective == "paper":
        return fitness.paper_fitness(outcome, traced.fitness)
    return fitness.smooth_fitness(outcome, traced.smooth)


def draw_scenes(static: Static, traced: Traced, key):
    """A generation's scenes: all, or num_scenes of the pool at random."""
    if not static.fresh:
        return traced.scenes
    size = jax.tree.leaves(traced.scenes)[0].shape[0]
    pick = jax.random.randint(key, (static.num_scenes,), 0, size)
    return jax.tree.map(lambda x: x[pick], traced.scenes)
