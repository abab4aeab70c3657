import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Limits, Observation
from fntg_jax import export
from fntg_jax.controller import network
from fntg_jax.controller.layout import LAYOUTS, Gene, Layout, expand, expand_scalars
from tests import reference
from tests.examples import (
    document,
    extreme_observations,
    extreme_thetas,
    layouts,
    random_observations,
    random_thetas,
)

each_layout = pytest.mark.parametrize("layout", layouts, ids=lambda x: x.name)
SMALL = Limits(v_min=-0.05, v_max=0.3, omega_max=2.0)
WIDE = Limits(v_min=-1.0, v_max=2.0, omega_max=3.0)


# The full parameter set as 65 genes of its own: one compilation serves every layout.
SLOTS = Layout("slots", (Gene("", "", ""),) * 65, tuple(range(65)), (1,) * 65)


def slots_of(layout, thetas) -> tuple:
    """All slots of every genome, as 65 vectors: what `expand_scalars` takes."""
    full = expand(layout, jnp.asarray(thetas))
    return tuple(np.concatenate([x.reshape(len(thetas), -1) for x in full], 1).T)


@partial(jax.jit, static_argnames="output")
@partial(jax.vmap, in_axes=(0, 0, None, None))
def jitted_command(slots, seen, limits, output):
    return network.command(expand_scalars(SLOTS, slots), Observation(*seen), limits, output)


def commands(layout, thetas, observations, limits=Limits(), output="scale", dtype=np.float32):
    """Pairs of genome and observation -> [N, 2]."""
    with jax.enable_x64(dtype is np.float64):
        limits = Limits(*(jnp.asarray(x, dtype) for x in limits))
        seen = tuple(jnp.asarray(observations.T, dtype))
        found = jitted_command(slots_of(layout, thetas.astype(dtype)), seen, limits, output)
        assert found.v.dtype == dtype
        return np.stack((found.v, found.omega), axis=-1)


@each_layout
@pytest.mark.parametrize("output", ["scale", "clip"])
def test_command_agrees_with_the_reference(layout, output):
    thetas, seen = random_thetas(layout, 200), random_observations(200)
    expected = np.asarray(
        [reference.command(document(layout, t, output, WIDE), o) for t, o in zip(thetas, seen)]
    )
    scale = np.asarray([WIDE.v_max, WIDE.omega_max])
    assert len(np.unique(expected[:, 0])) > 40  # not all of it clipped
    double = commands(layout, thetas, seen, WIDE, output, np.float64)
    np.testing.assert_allclose(double / scale, expected / scale, rtol=0, atol=1e-12)
    single = commands(layout, thetas, seen, WIDE, output, np.float32)
    # exp(-a (x - c)) with |a (x - c)| up to 40 loses 40 roundings of float32.
    atol = 5e-5 * (1 if output == "scale" else 5 / min(scale))
    np.testing.assert_allclose(single / scale, expected / scale, rtol=0, atol=atol)


@pytest.mark.parametrize("name", ["paper-31", "mirror-28", "reduced-47"])
def test_sixteen_rules_give_the_same_as_twenty_four(name):
    """With one sigma the three D sum to 1, so that dropping D for "far" changes nothing."""
    layout = LAYOUTS[name]
    for theta, seen in zip(random_thetas(layout, 50), random_observations(50)):
        parameters = document(layout, theta)["parameters"]
        np.testing.assert_allclose(
            reference.averages(parameters, seen, near_only=True),
            reference.averages(parameters, seen),
            atol=1e-12,
        )


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
@partial(jax.vmap, in_axes=(0, None))
def values_and_gradients(slots, seen):
    """Before clipping, which would hide gradients: v and omega, and their slopes."""

    def averages(slots, seen):
        return network.weighted_averages(expand_scalars(SLOTS, slots), Observation(*seen))

    found, pull = jax.vjp(averages, slots, seen)
    return found, jax.vmap(pull)(tuple(jnp.eye(2, dtype=found[0].dtype)))


@each_layout
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_value_and_gradient_are_finite_everywhere(layout, dtype):
    """At all extremes of genes and observations.  Slopes of genes are sums of slots' slopes."""
    thetas = np.concatenate([extreme_thetas(layout, 100), random_thetas(layout, 20)])
    seen = np.concatenate([extreme_observations(), random_observations(16)])
    with jax.enable_x64(dtype is np.float64):
        slots = slots_of(layout, thetas.astype(dtype))
        found, gradients = values_and_gradients(slots, tuple(jnp.asarray(seen.T, dtype)))
        found = np.asarray(found)
        assert found.dtype == dtype
        assert np.isfinite(found).all()
        assert np.abs(found).max() <= 5 * (1 + 1e-5)  # averages stay inside the constants
        assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradients))
        assert any(np.any(g) for g in jax.tree.leaves(gradients))


def test_gradient_agrees_with_finite_differences():
    """Of the reference, along one random direction through genes and observation at once."""
    layout = LAYOUTS["three-sigma-31"]
    thetas, seen = random_thetas(layout, 20, seed=3), random_observations(20, seed=3)
    rng = np.random.default_rng(4)
    along_theta = rng.normal(size=thetas.shape) * (abs(thetas) < 4.99)
    along_seen = rng.normal(size=seen.shape)

    @jax.jit
    @jax.vmap
    def slope(*where_and_along):
        def averages(theta, o):
            return jnp.stack(network.weighted_averages(expand(layout, theta), Observation(*o)))

        where, along = where_and_along[:2], where_and_along[2:]
        return jax.jvp(averages, where, along)[1]

    with jax.enable_x64(True):
        found = np.asarray(slope(thetas, seen, along_theta, along_seen))

    def ends(step):
        moved = zip(thetas + step * along_theta, seen + step * along_seen)
        return np.asarray(
            [reference.averages(document(layout, t)["parameters"], o) for t, o in moved]
        )

    difference = (ends(1e-6) - ends(-1e-6)) / 2e-6
    assert np.abs(difference).max() > 1
    np.testing.assert_allclose(found, difference, atol=1e-6, rtol=1e-6)


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
@partial(jax.vmap, in_axes=(None, 0))
def jitted_strengths(slots, seen):
    return network.firing_strengths(expand_scalars(SLOTS, slots), Observation(*seen))


@each_layout
def test_firing_strengths_are_a_partition_of_unity(layout):
    thetas = np.concatenate([extreme_thetas(layout, 40), random_thetas(layout, 40)])
    seen = np.concatenate([extreme_observations(), random_observations(16)])

    slots = slots_of(layout, thetas.astype(np.float32))
    found = np.asarray(jitted_strengths(slots, tuple(seen.T.astype(np.float32))))
    assert found.min() >= 0
    np.testing.assert_allclose(found.sum((2, 3, 4, 5)), 1, atol=2e-6)


def test_firing_strengths_are_the_papers_products():
    layout = LAYOUTS["paper-31"]
    for theta, seen in zip(random_thetas(layout, 20), random_observations(20)):
        with jax.enable_x64(True):
            found = network.firing_strengths(
                expand(layout, jnp.asarray(theta)), Observation(*jnp.asarray(seen))
            )
        naive = [s for s, _, _ in reference.rules(document(layout, theta)["parameters"], seen)]
        np.testing.assert_allclose(np.ravel(found), np.asarray(naive) / sum(naive), atol=1e-12)


def test_weighted_averages_are_the_sum_over_firing_strengths():
    layout = LAYOUTS["full-63"]
    with jax.enable_x64(True):
        for theta, seen in zip(random_thetas(layout, 10), random_observations(10)):
            params = expand(layout, jnp.asarray(theta))
            o = Observation(*jnp.asarray(seen))
            strength = network.firing_strengths(params, o)
            v, omega = network.weighted_averages(params, o)
            np.testing.assert_allclose(v, (strength * params.V).sum(), atol=1e-12)
            np.testing.assert_allclose(omega, (strength * params.Omega).sum(), atol=1e-12)


def test_obstacle_labels_know_left_from_right():
    d = partial(network.obstacle_side, sigma=jnp.asarray([0.7, 0.7, 0.7]))
    left, right = d(jnp.float32(0.5)), d(jnp.float32(-0.5))
    assert left[0] > 0 == left[1]
    assert right[1] > 0 == right[0]
    ahead = [float(x) for x in d(jnp.float32(0))]
    assert ahead == [0, 1, 0]  # the paper counts theta_O = 0 to the right
    for theta in np.linspace(-np.pi, np.pi, 33, dtype=np.float32):
        np.testing.assert_allclose(sum(d(theta)), 1, atol=1e-6)


def test_three_vanishing_labels_count_as_not_influencing():
    shares = network.obstacle_side_shares(jnp.float32(0.01), jnp.asarray([1e-4, 1e-4, 1e6]))
    assert [float(x) for x in shares] == [0, 0, 1]


def mirrored(seen):
    return seen * np.asarray([1, 1, -1, -1])


def test_mirror_28_is_exactly_equivariant():
    layout = LAYOUTS["mirror-28"]
    thetas, seen = random_thetas(layout, 500), random_observations(500)
    for dtype, atol in ((np.float64, 1e-14), (np.float32, 5e-6)):
        there = commands(layout, thetas, seen, dtype=dtype)
        back = commands(layout, thetas, mirrored(seen), dtype=dtype)
        np.testing.assert_allclose(there, back * [1, -1], rtol=0, atol=atol)
    assert np.ptp(there[:, 1]) > 1
    # The symmetric tables alone are not enough: C_1 and C_2 differ in paper-31.
    layout = LAYOUTS["paper-31"]
    thetas = random_thetas(layout, 500)
    there, back = (commands(layout, thetas, s) for s in (seen, mirrored(seen)))
    assert np.abs(there - back * [1, -1]).max() > 0.1


def test_scale_reading_and_limits():
    layout = LAYOUTS["paper-31"]
    params = jax.tree.map(jnp.zeros_like, expand(layout, np.zeros(31, np.float32)))
    o = Observation(1.0, 0.5, 0.1, 0.2)

    def with_bias(b_21, b_22, **options):
        found = network.command(
            params._replace(bias=jnp.asarray([b_21, b_22])), o, SMALL, **options
        )
        return [float(found.v), float(found.omega)]

    assert with_bias(2.5, -2.5) == pytest.approx([0.15, -1.0])
    assert with_bias(2.5, -2.5, output="clip") == pytest.approx([0.3, -2.0])
    assert with_bias(0.1, 0.1, output="clip") == pytest.approx([0.1, 0.1])
    assert with_bias(-5, 5) == pytest.approx([-0.05, 2.0])
    with pytest.raises(ValueError, match=r"'tanh'.*'scale'.*'clip'"):
        with_bias(0, 0, output="tanh")


GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize("library", ["simpful", "pyfuzzylite"])
@each_layout
def test_command_agrees_with_fuzzy_libraries(layout, library):
    """Golden vectors: see golden/make_golden.py."""
    controller = export.load(GOLDEN / f"controller-{layout.name}.json")
    golden = json.loads((GOLDEN / f"expected-{layout.name}.json").read_text())
    expected = np.asarray(golden[library])
    assert controller.layout == layout
    thetas = np.tile(controller.theta, (len(expected), 1))
    seen = np.asarray(golden["observations"])
    for dtype, atol in ((np.float64, 1e-12), (np.float32, 2e-4)):
        found = commands(layout, thetas, seen, controller.limits, controller.output, dtype)
        np.testing.assert_allclose(found, expected, rtol=0, atol=atol)
