"""From a configuration to fitness: what is compiled for, what may change, and the score."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
from jaxtyping import Array, Float, Key

from envs.base import Environment, Task
from fntg_jax.controller import network
from fntg_jax.controller.layout import Layout
from fntg_jax.learning import fitness
from fntg_jax.learning.fitness import PaperWeights, SmoothWeights
from fntg_jax.learning.ga import GAConfig
from fntg_jax.learning.rollout import rollout_pairs

AXIS = "genome"  # of the devices that share a generation
POOL, VALIDATION = 16384, 2048  # scenes: to draw from, and to choose on


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
    env: Environment
    fitness: PaperWeights
    smooth: SmoothWeights
    scenes: Any
    horizon: Any = 1.0  # generations that the decay of the mutation rate refers to


class Descent(NamedTuple):
    """What a refinement minimises: the leading arguments of `gradient.refine` and `cma.adapt` after
    key and theta.

    cost_fn: (theta [P, genes], scenes) -> cost [P].  draw: key -> a step's scenes.  validation:
    scenes that the best iterate is chosen on.
    """

    cost_fn: Callable[..., Any]
    draw: Callable[..., Any]
    validation: Any


def bioa(static: Static, traced: Traced) -> Task:
    """The paper's learning problem: genes of the FNTG, judged in scenes of a world.

    Args:
        static: what it is compiled for.
        traced: world, weights and scenes.
    """

    def fitness(key, theta, memory, progress):
        del progress
        return score(static, traced, theta, draw_scenes(static, traced, key), axis=AXIS), memory

    return Task("bioa", static.layout.genes, fitness)


def score(
    static: Static, traced: Traced, theta: Float[Array, "P genes"], scenes: Any, **options: Any
) -> Float[Array, " P"]:
    """Fitness of genes on scenes: `fitness.paper_fitness` or `fitness.smooth_fitness`.

    Args:
        static: layout, output and objective.
        traced: world and weights; its scenes are not used.
        theta: [P, genes].
        scenes: T scenes, leaves with a leading axis.
        options: further arguments of `rollout.rollout_pairs`.

    Returns:
        Fitness [P], maximised.
    """
    outcome = rollout_pairs(
        static.layout, theta, scenes, traced.env, output=static.output, **options
    )
    if static.objective == "paper":
        return fitness.paper_fitness(outcome, traced.fitness)
    return fitness.smooth_fitness(outcome, traced.smooth)


def descent(
    static: Static, traced: Traced, validation: Any, gamma: float, **options: Any
) -> Descent:
    """`score` as a cost that a refinement minimises.

    Args:
        static: what it is compiled for.
        traced: world, weights, and the scenes that steps draw from.
        validation: scenes that the best iterate is chosen on.
        gamma: of `fitness.to_cost`.
        options: further arguments of `rollout.rollout_pairs`.
    """

    def cost_fn(theta, scenes):
        return fitness.to_cost(score(static, traced, theta, scenes, **options), gamma)

    return Descent(cost_fn, partial(draw_scenes, static, traced), validation)


_KEY = 0x4EF1  # apart from the scenes of evolution and of evaluation, which use other keys


def smooth_descent(
    layout: Layout,
    env: Environment,
    suite: Callable[..., Any],
    num_scenes: int,
    output: network.Output = "scale",
    seed: int = 0,
    **options: Any,
) -> Descent:
    """The mean `fitness.smooth_cost` over scenes that are drawn anew each step.

    Args:
        layout: gene table.
        env: the world's environment.
        suite: (key, num_scenes) -> scenes; of these 16384 to draw from, 2048 others to choose on.
        num_scenes: scenes of a step.
        output: how genes are read, see `network.command`.
        seed: of the scenes.
        options: further arguments of `rollout.rollout_pairs`; checkpoint=True for a gradient.
    """
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), _KEY))
    static = Static(layout, output, "smooth", num_scenes, fresh=True)
    traced = Traced(GAConfig(), env, PaperWeights(), SmoothWeights(), suite(keys[0], POOL))
    return descent(static, traced, suite(keys[1], VALIDATION), fitness.GAMMA, **options)


def draw_scenes(static: Static, traced: Traced, key: Key[Array, ""]) -> Any:
    """A generation's scenes: all, or num_scenes of the pool at random.

    Args:
        static: how many, and whether they are drawn.
        traced: holds the pool.
        key: random key.
    """
    if not static.fresh:
        return traced.scenes
    size = jax.tree.leaves(traced.scenes)[0].shape[0]
    pick = jax.random.randint(key, (static.num_scenes,), 0, size)
    return jax.tree.map(lambda x: x[pick], traced.scenes)
