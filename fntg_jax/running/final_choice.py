"""The controller of a seed: best of the last population on validation scenes, then refined."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fntg_jax.controller import genome
from fntg_jax.learning import cma, ga
from fntg_jax.learning.fitness import from_cost, to_cost
from fntg_jax.learning.objective import Static, Traced, descent, score
from fntg_jax.running import xla
from fntg_jax.running.parallel import GENOME, Rows, over_seeds
from fntg_jax.running.problem import Problem

_SCREENING = 256  # validation scenes for a first look at the whole population
_FINALISTS = 16
JUDGE = 0x1D6E  # folded into a seed's key
_VALIDATE_EVERY = 20  # steps of covariance adaptation


class Evolved(NamedTuple):
    """What evolution came to, on the devices: states and traced floats of all rows, scenes of
    training and of validation."""

    problem: Problem
    rows: Rows
    state: ga.State
    traced: Traced
    scenes: Any
    validation: Any


class Result(NamedTuple):
    """The controller of each seed, leading axis seed.

    theta: [S, genes]; fitness: [S]; bits: the genomes, None after refinement; refined: [S, n]
    fitness in the course of the refinement, None without.  Where all generations see the same
    scenes this is the best genome of all generations; where scenes change, the individual of
    the last population (or its refinement) that is best on validation scenes of their own.

    In tasks with a judgement: the individual of the last population with the best "score" of it,
    which is its fitness here (`judged`).  judgement: all numbers [S], from other draws than the
    choice.  strength: where fitness is relative, generations [n] and their champions' scores
    [S, n].
    """

    theta: np.ndarray
    fitness: np.ndarray
    bits: np.ndarray | None
    refined: np.ndarray | None
    judgement: dict[str, np.ndarray] | None = None
    strength: tuple[np.ndarray, np.ndarray] | None = None


def conclude(evolved: Evolved, show: Callable[[int, int, float], None]) -> Result:
    """Choose and refine, for every seed.

    Args:
        evolved: what evolution came to.
        show: called with the steps of refinement done and wanted, and the best fitness so far
            (median over seeds).
    """
    problem, rows = evolved.problem, evolved.rows
    config, task = problem.config, problem.task
    if task is not None or (config.scene_pool == 0 and config.refine_steps == 0):
        bits, value = rows.gather((evolved.state.best_bits, evolved.state.best_fitness))
        theta = genome.decode(bits, config.ga.num_bits, config.ga.gray)
        return Result(np.asarray(problem.in_units(theta)), value, bits, None)
    static = evolved.problem.static
    choose = jax.jit(partial(_choose, config=config, static=static, mesh=rows.mesh))
    arguments = evolved.state, evolved.traced, evolved.scenes, evolved.validation
    theta, value, row = rows.gather(rows.compile(choose, arguments)(*arguments))
    if config.refine_steps == 0:
        fitness = np.where(np.isfinite(value), value, 0)  # what is not finite counts as 0
        bits = rows.gather(evolved.state.bits)[np.arange(rows.num), row]
        return Result(theta[:, 0], fitness[:, 0], bits, None)
    refine = {"gradient": _gradient, "cma": _cma}[config.refine_method]
    # Costs with gamma: for their order it does not matter.
    theta, cost, history = refine(evolved, theta, to_cost(value, 0), show)
    return Result(theta, from_cost(cost, 0), None, from_cost(history, 0))


def _choose(state, floats, scenes, validation, *, config, static, mesh):
    """The best `refine_top` of the last population: theta [S, n, genes] and validated fitness
    [S, n], the leaders of the islands first, from the best on; row of the first [S]."""

    def one_seed(shared, bits, seed_floats):
        scenes, validation = shared
        few = jax.tree.map(_spread, validation)
        traced = seed_floats._replace(scenes=scenes)
        theta = genome.decode(bits, config.ga.num_bits, config.ga.gray)
        # A screening on few scenes, then the best of each island on all.
        first_look = score(static, traced, theta, few, axis=GENOME)
        islands = config.ga.num_islands
        by_island = _best_first(first_look.reshape(islands, -1))
        size = theta.shape[0] // islands
        most = min(size, -(-_FINALISTS // islands))
        rows = (by_island[:, :most] + size * jnp.arange(islands)[:, None]).ravel()
        value = score(static, traced, theta[rows], validation, axis=GENOME)
        # Refinement starts from different islands as long as there are some.
        order = _best_first(value.reshape(islands, most)) + most * jnp.arange(islands)[:, None]
        leaders = order[_best_first(value[order[:, 0]])].T.ravel()[: config.refine_top]
        return theta[rows[leaders]], value[leaders], rows[leaders[0]]

    return over_seeds(one_seed, mesh)((scenes, validation), (state.bits, floats))


def _spread(x):
    """At most `_SCREENING` rows of x, evenly spread: a mix comes suite by suite."""
    return x[:: -(-len(x) // _SCREENING)]


def _best_first(value):
    return jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf), axis=-1)


# Refinements: (evolved, theta [S, n, genes], cost [S, n], show) -> theta [S, genes],
# cost [S], costs on the way [S, ...], those of the start first.


def _gradient(evolved: Evolved, theta, cost, show):
    # Here, because optax takes a good part of a second to load.
    from fntg_jax.learning import gradient

    config, rows = evolved.problem.config, evolved.rows
    static = _refining(evolved.problem)

    def one_seed(shared, key, seed_floats, theta):
        scenes, validation = shared
        traced = seed_floats._replace(scenes=scenes)
        found = gradient.refine(
            jax.random.fold_in(key, config.generations),
            theta,
            # Checkpointed: reverse mode then stores one state a control step.
            *descent(static, traced, validation, 0, checkpoint=True),
            gradient.optimiser("adam", config.refine_steps, config.refine_rate),
            config.refine_steps,
        )
        return jax.tree.map(lambda x: x[jnp.argmin(found.cost)], found)

    program = jax.jit(over_seeds(one_seed, rows.mesh), compiler_options=xla.GRADIENT_OPTIONS)
    own = (evolved.state.key, evolved.traced, rows.place(theta))
    arguments = (evolved.scenes, evolved.validation), own
    found = rows.compile(program, arguments)(*arguments)
    theta, cost, history = rows.gather(found[:3])
    show(config.refine_steps, config.refine_steps, float(np.median(from_cost(cost, 0))))
    return theta, cost, history


def _cma(evolved: Evolved, theta, cost, show):
    """A third of the steps from each theta, then the rest where that came to the lowest cost: a
    few searches end in a local optimum, and most of these show by then.

    One compiled program of a few steps for all of it: a roll-out takes seconds to compile.
    """
    config, rows, num = evolved.problem.config, evolved.rows, evolved.rows.num
    static = _refining(evolved.problem)

    def one_seed(shared, key, seed_floats, start, course):
        scenes, validation, num_steps = shared
        traced = seed_floats._replace(scenes=scenes)
        return cma.advance(
            jax.random.fold_in(jax.random.fold_in(key, config.generations), start),
            course,
            *descent(static, traced, validation, 0, axis=GENOME),
            num_steps,
        )

    advance = jax.jit(over_seeds(one_seed, rows.mesh))
    trial = config.refine_steps // 3 if theta.shape[1] > 1 else 0
    done, wanted = 0, config.refine_steps + (theta.shape[1] - 1) * trial
    least = np.full(num, np.inf)

    def go_on(start, course, num_steps):
        """num_steps more of the courses [S], which began at theta[:, start]; start: [S]."""
        nonlocal advance, done, least
        history = []
        start = rows.place(start)
        for first in range(0, num_steps, _VALIDATE_EVERY):
            length = min(_VALIDATE_EVERY, num_steps - first)
            arguments = (
                (evolved.scenes, evolved.validation, np.int32(length)),
                (evolved.state.key, evolved.traced, start, course),
            )
            if done == 0:
                advance = rows.compile(advance, arguments)
            course, newest = advance(*arguments)
            history.append(rows.gather(newest))
            done += length
            least = np.fmin(least, rows.gather(course.cost))
            show(done, wanted, float(np.median(from_cost(least, 0))))
        return rows.gather(course), history

    tried = []
    for n in range(theta.shape[1]):
        course = rows.place((theta[:, n], cost[:, n]), lambda own: jax.vmap(cma.begin)(*own))
        course, history = go_on(np.full(num, n), course, trial)
        first = np.where(np.isfinite(cost[:, n]), cost[:, n], np.inf)
        tried.append((course, np.stack([first, *history], axis=1)))
    best = np.argmin([course.cost for course, _ in tried], axis=0)
    course, history = jax.tree.map(lambda *x: np.stack(x)[best, np.arange(num)], *tried)
    course, rest = go_on(best, rows.place(course), config.refine_steps - trial)
    return course.theta, course.cost, np.concatenate([history, *(x[:, None] for x in rest)], axis=1)


def _refining(problem: Problem) -> Static:
    static = problem.static
    return static._replace(num_scenes=problem.config.refine_scenes or static.num_scenes)
