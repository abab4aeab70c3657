"""The controller of a seed: best of the last population on validation scenes, then refined."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fntg_jax.controller import genome
from fntg_jax.learning import cma
from fntg_jax.learning.objective import draw_scenes, score
from fntg_jax.running import hosts, memory, xla
from fntg_jax.running.parallel import GENOME, over_seeds

_SCREENING = 256  # validation scenes for a first look at the whole population
_FINALISTS = 16
_VALIDATE_EVERY = 20  # steps of covariance adaptation


class Chosen(NamedTuple):
    """theta: [S, genes]; fitness: [S], on the validation scenes; row: [S], of the best of the last
    population before refinement; refined: [S, n] fitness in the course of the refinement, or
    None."""

    theta: np.ndarray
    fitness: np.ndarray
    row: np.ndarray
    refined: np.ndarray | None


def conclude(run: Any, show: Callable[[int, int, float], None]) -> Chosen:
    """Choose and refine, for every seed of a `runner.Run`.

    show: called with the steps of refinement done and wanted, and the best fitness so far (median
    over seeds).
    """
    config, num, validation = run.config, run.num_rows, run.validation
    choose = jax.jit(partial(_choose, config=config, static=run.config_static(), mesh=run.mesh))
    arguments = run.state, run.floats, run.scenes, validation
    found = _compiled(run, choose, arguments)(*arguments)
    theta, value, row = (hosts.gather(x)[:num] for x in found)
    if config.refine_steps == 0:
        fitness = np.where(np.isfinite(value), value, 0)  # what is not finite counts as 0
        return Chosen(theta[:, 0], fitness[:, 0], row, None)
    refine = {"gradient": _gradient, "cma": _cma}[config.refine_method]
    theta, cost, history = refine(run, theta, 10 / value, show)
    return Chosen(theta, 10 / cost, row, 10 / history)


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


def _compiled(run, program, arguments):
    """A jitted function compiled for these arguments, where memory will do."""
    compiled = program.lower(*arguments).compile()
    memory.check(compiled, len(run.mesh.local_devices))
    return compiled


def _best_first(value):
    return jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf), axis=-1)


# Refinements: (run, theta [S, n, genes], cost [S, n], show) -> theta [S, genes],
# cost [S], costs on the way [S, ...], those of the start first.


def _gradient(run, theta, cost, show):
    # Here, because optax takes a good part of a second to load.
    from fntg_jax.learning import gradient

    config = run.config
    static = _refining(run)

    def one_seed(shared, key, seed_floats, theta):
        scenes, validation = shared
        traced = seed_floats._replace(scenes=scenes)

        def cost_fn(theta, some):
            # Checkpointed: reverse mode then stores one state a control step.
            return 10 / score(static, traced, theta, some, checkpoint=True)

        found = gradient.refine(
            jax.random.fold_in(key, config.generations),
            theta,
            cost_fn,
            lambda k: draw_scenes(static, traced, k),
            validation,
            gradient.optimiser("adam", config.refine_steps, config.refine_rate),
            config.refine_steps,
        )
        return jax.tree.map(lambda x: x[jnp.argmin(found.cost)], found)

    program = jax.jit(over_seeds(one_seed, run.mesh), compiler_options=xla.GRADIENT_OPTIONS)
    rows = (run.state.key, run.floats, run.place_rows(theta))
    arguments = (run.scenes, run.validation), rows
    found = _compiled(run, program, arguments)(*arguments)
    theta, cost, history = (hosts.gather(x)[: run.num_rows] for x in found[:3])
    show(config.refine_steps, config.refine_steps, float(np.median(10 / cost)))
    return theta, cost, history


def _cma(run, theta, cost, show):
    """A third of the steps from each theta, then the rest where that came to the lowest cost: a
    few searches end in a local optimum, and most of these show by then.

    One compiled program of a few steps for all of it: a roll-out takes seconds to compile.
    """
    config, num = run.config, run.num_rows
    static = _refining(run)

    def one_seed(shared, key, seed_floats, start, course):
        scenes, validation, num_steps = shared
        traced = seed_floats._replace(scenes=scenes)
        return cma.advance(
            jax.random.fold_in(jax.random.fold_in(key, config.generations), start),
            course,
            lambda many, some: 10 / score(static, traced, many, some, axis=GENOME),
            lambda k: draw_scenes(static, traced, k),
            validation,
            num_steps,
        )

    advance = jax.jit(over_seeds(one_seed, run.mesh))
    trial = config.refine_steps // 3 if theta.shape[1] > 1 else 0
    done, wanted = 0, config.refine_steps + (theta.shape[1] - 1) * trial
    least = np.full(num, np.inf)

    def go_on(start, course, num_steps):
        """num_steps more of the courses [S], which began at theta[:, start]; start: [S]."""
        nonlocal advance, done, least
        history = []
        start = run.place_rows(start)
        for first in range(0, num_steps, _VALIDATE_EVERY):
            length = min(_VALIDATE_EVERY, num_steps - first)
            arguments = (
                (run.scenes, run.validation, np.int32(length)),
                (run.state.key, run.floats, start, course),
            )
            if done == 0:
                advance = _compiled(run, advance, arguments)
            course, newest = advance(*arguments)
            history.append(hosts.gather(newest)[:num])
            done += length
            least = np.fmin(least, hosts.gather(course.cost)[:num])
            show(done, wanted, float(np.median(10 / least)))
        return jax.tree.map(lambda x: hosts.gather(x)[:num], course), history

    tried = []
    for n in range(theta.shape[1]):
        course = run.place_rows((theta[:, n], cost[:, n]), lambda rows: jax.vmap(cma.begin)(*rows))
        course, history = go_on(np.full(num, n), course, trial)
        first = np.where(np.isfinite(cost[:, n]), cost[:, n], np.inf)
        tried.append((course, np.stack([first, *history], axis=1)))
    best = np.argmin([course.cost for course, _ in tried], axis=0)
    course, history = jax.tree.map(lambda *x: np.stack(x)[best, np.arange(num)], *tried)
    course, rest = go_on(best, run.place_rows(course), config.refine_steps - trial)
    return course.theta, course.cost, np.concatenate([history, *(x[:, None] for x in rest)], axis=1)


def _refining(run):
    static = run.config_static()
    return static._replace(num_scenes=run.config.refine_scenes or static.num_scenes)
