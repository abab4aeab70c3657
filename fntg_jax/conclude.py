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
        # A screening on few scenes, then the best of it on all.
        screened = _best_first(score(static, traced, theta, few, axis=GENOME))[:_FINALISTS]
        value = score(static, traced, theta[screened], validation, axis=GENOME)
        order = _best_first(value)
        rows, value = screened[order], value[order]
        if config.refine_steps == 0:
            return theta[rows[0]], value[0], rows[0], jnp.zeros((0,))
        refined = _REFINE[config.refine_method](
            jax.random.fold_in(key, config.generations),
            theta[rows[: config.refine_top]],
            validation,
            config,
            static._replace(num_scenes=config.refine_scenes or config.num_scenes),
            traced,
        )
        best = jnp.argmin(refined.cost)
        return refined.theta[best], 10 / refined.cost[best], rows[best], 10 / refined.history[best]

    theta, value, row, course = over_seeds(one_seed, mesh)(
        (scenes, validation), state.bits, state.key, floats
    )
    return theta, value, row, course if config.refine_steps else None


def _best_first(value):
    return jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf))


def _gradient(key, theta, validation, config, static, traced):
    # Here, because optax takes a good part of a second to load.
    from fntg_jax import refine

    def cost_fn(theta, some):
        # Checkpointed: reverse mode then stores one state a control step.
        return 10 / score(static, traced, theta[None], some, checkpoint=True)[0]

    return refine.refine(
        key,
        theta,
        cost_fn,
        lambda k: draw_scenes(static, traced, k),
        validation,
        refine.adam(config.refine_steps, config.refine_rate),
        config.refine_steps,
    )


def _cma(key, theta, validation, config, static, traced):
    def one(theta):
        return cma.adapt(
            key,
            theta,
            lambda many, some: 10 / score(static, traced, many, some, axis=GENOME),
            lambda k: draw_scenes(static, traced, k),
            validation,
            config.refine_steps,
        )

    return jax.lax.map(one, theta)


_REFINE = {"gradient": _gradient, "cma": _cma}
