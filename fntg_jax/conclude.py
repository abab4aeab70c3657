"""The controller of a seed: best of the last population on validation scenes, then refined."""

import jax
import jax.numpy as jnp

from fntg_jax import cma, genome
from fntg_jax.objective import draw_scenes, score
from fntg_jax.parallel import GENOME, over_seeds

_SCREENING = 256  # validation scenes for a first look at the whole population
_FINALISTS = 16


def choose(state, floats, scenes, validation, *, config, static, mesh):
    """theta [S, genes], validated fitness [S], row of the population it comes from [S], and the
    course of the refinement [S, n] in fitness, or None."""

    def one_seed(shared, bits, key, seed_floats):
        scenes, validation = shared
        few = jax.tree.map(lambda x: x[:_SCREENING], validation)
        traced = seed_floats._replace(scenes=scenes)
        theta = genome.decode(bits, config.ga.num_bits, config.ga.gray)
        # A screening on few scenes, then the best of each island on all.
        first_look = score(static, traced, theta, few, axis=GENOME)
        islands = config.ga.num_islands
        by_island = _best_first(first_look.reshape(islands, -1))
        size = theta.shape[0] // islands
        most = min(size, max(1, _FINALISTS // islands))
        rows = (by_island[:, :most] + size * jnp.arange(islands)[:, None]).ravel()
        value = score(static, traced, theta[rows], validation, axis=GENOME)
        # Refinement starts from different islands as long as there are some.
        order = _best_first(value.reshape(islands, most)) + most * jnp.arange(islands)[:, None]
        leaders = order[_best_first(value[order[:, 0]])].T.ravel()
        rows, value = rows[leaders], value[leaders]
        if config.refine_steps == 0:
            return theta[rows[0]], value[0], rows[0], jnp.zeros((0,))
        found = _REFINE[config.refine_method](
            jax.random.fold_in(key, config.generations),
            theta[rows[: config.refine_top]],
            validation,
            config,
            static._replace(num_scenes=config.refine_scenes or config.num_scenes),
            traced,
        )
        return found.theta, 10 / found.cost, rows[0], 10 / found.history

    theta, value, row, course = over_seeds(one_seed, mesh)(
        (scenes, validation), (state.bits, state.key, floats)
    )
    return theta, value, row, course if config.refine_steps else None


def _best_first(value):
    return jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf), axis=-1)


def _gradient(key, theta, validation, config, static, traced):
    # Here, because optax takes a good part of a second to load.
    from fntg_jax import refine

    def cost_fn(theta, some):
        # Checkpointed: reverse mode then stores one state a control step.
        return 10 / score(static, traced, theta, some, checkpoint=True)

    found = refine.refine(
        key,
        theta,
        cost_fn,
        lambda k: draw_scenes(static, traced, k),
        validation,
        refine.optimiser("adam", config.refine_steps, config.refine_rate),
        config.refine_steps,
    )
    return jax.tree.map(lambda x: x[jnp.argmin(found.cost)], found)


def _cma(key, theta, validation, config, static, traced):
    """Half of the steps from each theta with large step sizes, which may leave a local optimum for
    a better one; then all of the steps, with small ones, from the best."""

    def search(key, theta, num_steps, sigma):
        return cma.adapt(
            key,
            theta,
            lambda many, some: 10 / score(static, traced, many, some, axis=GENOME),
            lambda k: draw_scenes(static, traced, k),
            validation,
            num_steps,
            sigma,
        )

    k_wide, k_fine = jax.random.split(key)
    wide = jax.lax.map(lambda t: search(k_wide, t, -(-config.refine_steps // 2), 0.5), theta)
    best = jax.tree.map(lambda x: x[jnp.argmin(wide.cost)], wide)
    fine = search(k_fine, best.theta, config.refine_steps, 0.2)
    history = jnp.concatenate([best.history, fine.history[1:]])
    return fine._replace(history=history, num_skipped=best.num_skipped + fine.num_skipped)


_REFINE = {"gradient": _gradient, "cma": _cma}
