"""Covariance matrix adaptation, on costs whose minimum is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.learning import cma

TARGET = jnp.linspace(-2.0, 3.0, 8)
SCALES = 10.0 ** jnp.linspace(0, 2, 8)  # condition number 10^4


def ellipsoid(theta, noise):
    """Rotated, so that no gene can be improved alone; the scenes are noise here."""
    turn = jnp.linalg.qr(jax.random.normal(jax.random.key(3), (8, 8)))[0]
    return jnp.sum(((theta - TARGET) @ turn * SCALES) ** 2, axis=1) * (1 + 0.1 * jnp.mean(noise))


def adapt(costs_fn, theta=jnp.zeros(8), num_steps=400, **options):
    search = jax.jit(
        lambda key, theta: cma.adapt(
            key,
            theta,
            costs_fn,
            lambda k: jax.random.normal(k, (4,)),
            jnp.zeros(4),
            num_steps,
            population=16,
            **options,
        )
    )
    return search(jax.random.key(0), theta)


def test_it_finds_the_minimum_of_an_ill_conditioned_cost():
    found = adapt(ellipsoid)
    np.testing.assert_allclose(found.theta, TARGET, atol=1e-3)
    assert found.num_skipped == 0
    assert found.cost < 1e-6 * found.history[0]


def test_a_minimum_on_the_bounds_is_reached():
    def slope(theta, noise):
        return jnp.sum(5 - theta, axis=1) + 0 * jnp.sum(noise)

    found = adapt(slope, num_steps=200)
    np.testing.assert_allclose(found.theta, 5.0, atol=0.02)
    assert (found.theta <= 5).all()


def test_the_result_is_never_worse_than_the_start():
    def bumpy(theta, noise):
        """Training prefers larger genes, validation (no noise) the start."""
        return jnp.where(jnp.all(noise == 0), 1, -1) * jnp.sum(theta**2, axis=1)

    start = jnp.full(8, 0.5)
    found = adapt(bumpy, start, num_steps=50)
    assert found.history[-1] > found.history[0]
    np.testing.assert_array_equal(found.theta, start)
    assert found.cost == found.history[0]


def test_samples_without_finite_cost_are_skipped_and_counted():
    def holes(theta, noise):
        cost = jnp.sum((theta - TARGET) ** 2, axis=1) + 0 * jnp.sum(noise)
        return jnp.where(theta[:, 0] > 0.05, jnp.nan, cost)

    found = adapt(holes, num_steps=100)
    assert found.num_skipped > 5
    assert np.isfinite(found.cost) and found.cost < found.history[0]
    np.testing.assert_allclose(found.theta, TARGET, atol=0.05)


def test_the_last_round_may_be_short():
    short, long = (adapt(ellipsoid, num_steps=n, validate_every=20) for n in (25, 40))
    assert short.history.shape == long.history.shape == (3,)
    assert short.history[1] == long.history[1] and short.history[2] != long.history[2]


def test_fifty_steps_are_those_of_another_implementation():
    """PyPI's `cmaes` (Nomura and Shibata), without its negative weights, told the same samples."""
    cmaes = pytest.importorskip("cmaes")
    asked = []

    def cost(theta, scenes):
        asked.append(np.asarray(theta, float))
        return ellipsoid(theta, jnp.zeros(1))

    search, other = cma.init(jnp.zeros(8), 0.3), cmaes.CMA(np.zeros(8), 0.3, population_size=16)
    other._weights = np.maximum(other._weights, 0)
    step = cma.make_step(8, 16, cost)
    for n in range(50):
        search, skipped = step(jax.random.key(n), search, None, n)
        value = np.asarray(ellipsoid(jnp.asarray(asked[-1], jnp.float32), jnp.zeros(1)))
        assert skipped == 0 and (abs(asked[-1]) < 5).all()  # no bound took part
        other.tell(list(zip(asked[-1], value)))
        np.testing.assert_allclose(search.mean, other.mean, atol=1e-4)
        np.testing.assert_allclose(search.sigma, other._sigma, rtol=1e-3)
        np.testing.assert_allclose(search.C, other._C, rtol=1e-2, atol=1e-3 * other._C.max())
    assert other._C.max() > 3 * np.median(np.diag(other._C)) or search.sigma < 0.2  # it adapted
