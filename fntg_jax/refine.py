"""Gradient refinement: any optax optimiser on the same genes, through the roll-out.

The loss is the smooth cost (`fitness.smooth_cost`), averaged over a batch of scenes that is
drawn anew each step.  Reverse mode runs through the whole roll-out; `jax.checkpoint` around
each control step keeps only the states, 220 small vectors a trial.

What the model's jumps mean for this gradient: at theta_O = 0 "left" and "right" swap, and where
another obstacle becomes the nearest one, d_O and theta_O jump.  A trajectory that meets such a
surface depends on the genes discontinuously or with a kink; its gradient is that of the side
it is on and knows nothing of the jump.  Averaging over scenes blurs the jumps, but no step is
trusted: the best *validated* iterate is returned, on scenes that no step was computed from, so
that refinement never returns something worse than it was given.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from fntg_jax.layout import HIGH, LOW

# (theta [genes], scenes) -> scalar mean cost, differentiable.
CostFn = Callable[[Float[Array, " genes"], Any], Float[Array, ""]]


class Refined(NamedTuple):
    """theta: best validated iterate; cost: its validation cost; history: [num_validations]
    validation costs, the first that of the start; num_skipped: steps whose gradient was not
    finite and was left out.  Leading axes: individuals."""

    theta: Float[Array, "P genes"]
    cost: Float[Array, " P"]
    history: Float[Array, "P validations"]
    num_skipped: Int[Array, " P"]


def adam(num_steps: int, learning_rate: float = 0.02) -> optax.GradientTransformation:
    """The default optimiser: clipped gradients, Adam, cosine decay."""
    schedule = optax.cosine_decay_schedule(learning_rate, num_steps, alpha=0.05)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule, b2=0.99))


def refine(
    key: Key[Array, ""],
    theta: Float[Array, "P genes"],
    cost_fn: CostFn,
    draw: Callable[[Key[Array, ""]], Any],
    validation: Any,
    optimiser: optax.GradientTransformation,
    num_steps: int,
    validate_every: int = 10,
) -> Refined:
    """Descend from each theta for num_steps; return the best validated iterates.

    draw: key -> a batch of training scenes, the same for all individuals.  validation: scenes
    for the choice of the iterate.  Genes are projected to [-5, 5] after every step.
    """

    def one(theta):
        def step(carry, n):
            theta, opt_state, skipped = carry
            gradient = jax.grad(cost_fn)(theta, draw(jax.random.fold_in(key, n)))
            finite = jnp.all(jnp.isfinite(gradient))
            gradient = jnp.where(finite, gradient, 0)
            updates, new_opt_state = optimiser.update(gradient, opt_state, theta)
            moved = jnp.clip(optax.apply_updates(theta, updates), LOW, HIGH)
            # A gradient that is not finite leaves no trace, in the moments neither.
            keep = lambda new, old: jnp.where(finite, new, old)  # noqa: E731
            opt_state = jax.tree.map(keep, new_opt_state, opt_state)
            return (keep(moved, theta), opt_state, skipped + ~finite), None

        def block(carry, first):
            carry, best, best_cost = carry
            carry, _ = jax.lax.scan(step, carry, first + jnp.arange(validate_every))
            cost = cost_fn(carry[0], validation)
            better = cost < best_cost  # False for NaN
            best = jnp.where(better, carry[0], best)
            return (carry, best, jnp.where(better, cost, best_cost)), cost

        start_cost = cost_fn(theta, validation)
        start_cost = jnp.where(jnp.isfinite(start_cost), start_cost, jnp.inf)
        carry = (theta, optimiser.init(theta), jnp.zeros((), int))
        firsts = jnp.arange(0, num_steps, validate_every)
        (carry, best, cost), history = jax.lax.scan(block, (carry, theta, start_cost), firsts)
        return Refined(best, cost, jnp.append(start_cost, history), carry[2])

    return jax.vmap(one)(theta)
