"""Gradient refinement: descends, projects, skips what is not finite, never makes worse."""

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fntg_jax import refine

TARGET = jnp.asarray([1.0, -2.0, 7.0])  # the last lies outside the bounds


def bowl(theta, scenes):
    """A noisy quadratic: scenes shift the target a little."""
    return jnp.sum((theta - TARGET - scenes) ** 2)


def run(cost_fn, optimiser, theta, num_steps=100):
    draw = lambda key: 0.01 * jax.random.normal(key, (3,))  # noqa: E731
    key, validation = jax.random.key(0), jnp.zeros(3)
    return jax.jit(
        lambda t: refine.refine(key, t, cost_fn, draw, validation, optimiser, num_steps)
    )(theta)


def test_every_individual_descends_to_the_projected_minimum():
    starts = jnp.asarray([[0.0, 0.0, 0.0], [4.0, 4.0, -4.0]])
    refined = run(bowl, optax.adam(0.3), starts, 300)
    np.testing.assert_allclose(refined.theta, [[1, -2, 5]] * 2, atol=0.1)
    assert (refined.history[:, 0] == jax.vmap(lambda t: bowl(t, 0.0))(starts)).all()
    assert refined.history.shape == (2, 31)
    assert (refined.num_skipped == 0).all()


def test_it_never_returns_something_worse_than_it_was_given():
    start = jnp.asarray([[1.0, -2.0, 5.0]])  # the best there is
    refined = run(bowl, optax.sgd(100.0), start)
    assert refined.history[0, 1:].min() > refined.history[0, 0]  # the steps do harm
    np.testing.assert_array_equal(refined.theta, start)
    assert refined.cost[0] == refined.history[0, 0]


def test_gradients_that_are_not_finite_are_skipped_and_counted():
    def cliff(theta, scenes):
        # No gradient beyond theta_0 = 0.5: 0 * sqrt'(0) is NaN there.
        return bowl(theta, scenes) + jnp.sqrt(
            jnp.where(theta[0] > 0.5, 0.0, 1.0) * (1 + 0 * theta[0])
        )

    refined = run(cliff, refine.adam(100, 0.2), jnp.asarray([[0.0, 0.0, 0.0]]))
    assert 0 < refined.num_skipped[0] <= 100
    assert np.isfinite(refined.theta).all() and np.isfinite(refined.cost).all()
    assert refined.cost[0] < refined.history[0, 0]
