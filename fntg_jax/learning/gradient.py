"""Gradient refinement: any optax optimiser on the same genes, through the roll-out.

The loss is the smooth cost (`fitness.smooth_cost`), averaged over a batch of scenes that is
drawn anew each step.  Reverse mode runs through the whole roll-out; `jax.checkpoint` around
each control step keeps only the states, 220 small vectors a trial.

What the model's jumps mean for this gradient.  At theta_O = 0 (an obstacle dead ahead) the
labels "left" and "right" swap, at theta = +-pi both angles jump, and where another obstacle or
wall becomes the nearest one d_O has a kink and theta_O jumps.  Between such events a trajectory
is smooth in the genes and the gradient is exact.  A trajectory that meets one is not: passing it
a moment earlier or later, or on its other side, changes the outcome by a finite amount that the
gradient, taken on the side the trajectory is on, does not contain.  So it is the slope of one
smooth piece, not of the cost averaged over scenes, and a step along it can make that average
worse.  Averaging over many scenes helps, but no step is trusted: the best *validated* iterate is
returned, on scenes that no step was computed from, so that refinement never returns something
worse there than it was given.
"""

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from fntg_jax.controller.layout import HIGH, LOW

# (theta [P, genes], scenes) -> mean cost of each, differentiable.
CostFn = Callable[[Float[Array, "P genes"], Any], Float[Array, " P"]]


class Refined(NamedTuple):
    """theta: best validated iterate; cost: its validation cost; history: [num_validations]
    validation costs, the first that of the start; num_skipped: steps left out because the
    gradient or what the optimiser made of it was not finite.  Leading axes: individuals."""

    theta: Float[Array, "P genes"]
    cost: Float[Array, " P"]
    history: Float[Array, "P validations"]
    num_skipped: Int[Array, " P"]


# adam: refinements are short, so its second moment forgets sooner than by default.
_ARGUMENTS = {"adam": {"b2": 0.99}}


def optimiser(name: str, num_steps: int, rate: float) -> optax.GradientTransformation:
    """The optax optimiser of that name behind clipped gradients (norm 1), its learning rate falling
    along a cosine to 5 %.

    Args:
        name: in optax: adam, sgd, rmsprop, lion, ...
        num_steps: steps that the rate falls over.
        rate: learning rate at the start; genes a step, for adam and its kin.

    Raises ValueError where optax has none that works from a learning rate and gradients alone.
    """
    schedule = optax.cosine_decay_schedule(rate, num_steps, alpha=0.05)
    try:
        make = getattr(optax, name)
        if next(iter(inspect.signature(make).parameters)) != "learning_rate":
            raise TypeError
        made = optax.chain(
            optax.clip_by_global_norm(1.0), make(schedule, **_ARGUMENTS.get(name, {}))
        )
        like = jnp.zeros(2)
        jax.eval_shape(lambda: made.update(like, made.init(like), like))  # lbfgs wants more
    except (AttributeError, TypeError, StopIteration):
        raise ValueError(
            f"optimizer = {name!r}: allowed are optax's first-order optimizers by name, such as "
            "adam, sgd, rmsprop, lion"
        ) from None
    return made


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
    """Descend from each theta; return the best validated iterates.

    Compile with `xla.GRADIENT_OPTIONS`, which makes it three to four times as fast on CPU.

    Args:
        key: random key, of the scenes.
        theta: [P, genes], where to start; projected to [-5, 5] after every step.
        cost_fn: (theta [P, genes], scenes) -> mean cost [P], differentiable.
        draw: key -> a batch of training scenes, the same for all individuals.
        validation: scenes for the choice of the iterate.
        optimiser: any of optax that works from gradients, with clipping where it is wanted.
        num_steps: how many.
        validate_every: steps between two validations.

    Returns:
        What each individual came to, never worse on `validation` than its start.
    """

    def step(carry, n):
        theta, opt_state, skipped = carry
        scenes = draw(jax.random.fold_in(key, n))
        # One flat batch of individuals x scenes, which vectorises; vmap over individuals would
        # not.  Nobody's cost depends on another's genes.
        gradient = jax.grad(lambda t: jnp.sum(cost_fn(t, scenes)))(theta)
        finite = jnp.all(jnp.isfinite(gradient), axis=1)
        gradient = jnp.where(finite[:, None], gradient, 0)
        updates, new_opt_state = jax.vmap(optimiser.update)(gradient, opt_state, theta)
        finite &= jnp.all(jnp.isfinite(updates), axis=1)
        # The last block may reach beyond num_steps.  What is not taken leaves no trace, in the
        # moments neither.
        taken = finite & (n < num_steps)
        keep = jax.vmap(lambda new, old, t: jax.tree.map(partial(jnp.where, t), new, old))
        moved = jnp.clip(optax.apply_updates(theta, updates), LOW, HIGH)
        theta, opt_state = keep((moved, new_opt_state), (theta, opt_state), taken)
        return (theta, opt_state, skipped + (~finite & (n < num_steps))), None

    def block(carry, first):
        carry, best, best_cost = carry
        carry, _ = jax.lax.scan(step, carry, first + jnp.arange(validate_every))
        cost = cost_fn(carry[0], validation)
        better = cost < best_cost  # False for NaN
        best = jnp.where(better[:, None], carry[0], best)
        return (carry, best, jnp.where(better, cost, best_cost)), cost

    start_cost = cost_fn(theta, validation)
    start_cost = jnp.where(jnp.isfinite(start_cost), start_cost, jnp.inf)
    carry = (theta, jax.vmap(optimiser.init)(theta), jnp.zeros(len(theta), int))
    firsts = jnp.arange(0, num_steps, validate_every)
    (carry, best, cost), history = jax.lax.scan(block, (carry, theta, start_cost), firsts)
    history = jnp.concatenate([start_cost[:, None], history.T], axis=1)
    return Refined(best, cost, history, carry[2])
