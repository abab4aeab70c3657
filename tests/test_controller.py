"""A controller is a value and a pytree: it compares, cannot be changed, and goes through jit,
vmap and grad."""

import copy
import dataclasses
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Limits, Observation
from fntg_jax.controller import LAYOUTS, Controller, network
from tests.controllers import random_controller
from tests.examples import random_observations

SEEN = (1.0, 0.4, 0.2, -1.5)


def test_jit_of_a_controller_is_the_controller():
    controller = random_controller()
    observations = random_observations(50)
    plain = controller(*observations.T)
    compiled = jax.jit(controller)(*observations.T)
    assert all(isinstance(x, jax.Array) for x in compiled)
    np.testing.assert_allclose(compiled, plain, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(jax.vmap(controller)(*observations.T), plain, rtol=1e-5, atol=1e-6)


def test_jax_arrays_give_jax_arrays_and_numpy_gives_numpy():
    controller = random_controller()
    assert all(isinstance(x, jax.Array) for x in controller(jnp.ones(3), 0.4, 0.2, -1.5))
    assert all(type(x) is np.ndarray for x in controller(np.ones(3), 0.4, 0.2, -1.5))
    assert all(type(x) is float for x in controller(*SEEN))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_vmap_over_a_stack(layout):
    controllers = [random_controller(layout, seed, output="clip") for seed in range(3)]
    stack = jax.tree.map(lambda *x: jnp.stack(x), *controllers)
    together = jax.vmap(lambda c: c(*SEEN))(stack)
    alone = np.transpose([c(*SEEN) for c in controllers])
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6)
    assert jax.tree.map(lambda x: x[1], stack).params32.V.shape == (2, 2, 2, 3)
    assert stack.params.V.shape == (3, 2, 2, 2, 3)
    with pytest.raises(ValueError, match=r"a stack of controllers is called under jax\.vmap"):
        stack(*SEEN)


def test_gradient_by_the_genes_is_the_finite_difference():
    controller = random_controller(output="scale", limits=Limits(-1.0, 1.0, 5.0))
    theta = controller.theta / 5  # away from the limits of the output
    controller = dataclasses.replace(controller, theta=theta)
    gradient = jax.grad(lambda c: c(*SEEN)[0] + c(*SEEN)[1])(controller)
    assert isinstance(gradient, Controller)

    def value(t):
        # float64 in NumPy, by the scalar formulas of the paper
        p = dataclasses.replace(controller, theta=t).params
        command = network.command(p, Observation(*SEEN), controller.limits, "scale")
        return float(command.v) + float(command.omega)

    with jax.enable_x64(True):
        steps = 1e-5 * np.eye(31)
        difference = [(value(theta + s) - value(theta - s)) / 2e-5 for s in steps]
    np.testing.assert_allclose(gradient.theta, difference, rtol=1e-3, atol=1e-5)
    assert np.abs(difference).max() > 0.01


def test_one_compilation_serves_all_controllers_of_a_kind():
    drive = jax.jit(lambda c, d: c(d, 0.4, 0.2, -1.5))
    for seed in range(3):
        found = drive(random_controller(seed=seed), 1.0)
        np.testing.assert_allclose(found, random_controller(seed=seed)(*SEEN), rtol=1e-5, atol=1e-6)
    assert drive._cache_size() == 1


def test_nothing_of_a_trace_stays_behind():
    controller = random_controller()
    inside = jax.jit(lambda d: controller(d, 0.4, 0.2, -1.5))(1.0)  # first use: under jit
    np.testing.assert_allclose(controller(*SEEN), inside, rtol=1e-5, atol=1e-6)


def test_equal_controllers_are_equal_wherever_they_come_from():
    one, two = random_controller(), random_controller(provenance={"seed": 3})
    assert one == two and hash(one) == hash(two) and len({one, two}) == 1
    assert one == pickle.loads(pickle.dumps(one)) == copy.deepcopy(one)
    assert jax.tree.map(lambda x: x, one) == one
    others = (
        random_controller(seed=1),
        dataclasses.replace(one, output="clip"),
        dataclasses.replace(one, limits=Limits(v_max=0.1)),
        dataclasses.replace(one, control_dt=0.05),
        random_controller("two-sigma-31"),
        "a controller",
    )
    assert not any(one == other for other in others)


def test_repr_is_one_short_line():
    text = repr(random_controller(provenance={"env": "kinematic", "seed": 3, "jax": "0.10"}))
    assert text.startswith("Controller('paper-31', theta [31]") and "seed=3" in text
    assert len(text) < 250 and "\n" not in text


def test_genes_cannot_be_changed_in_place():
    genes = np.zeros(31)
    controller = Controller(LAYOUTS["paper-31"], genes)
    genes[0] = 1.0
    assert controller.theta[0] == 0
    for theta in (controller.theta, jax.tree.map(np.array, controller).theta):
        with pytest.raises(ValueError, match="read-only"):
            theta[0] = 1.0
        with pytest.raises(ValueError, match="WRITEABLE"):
            theta.flags.writeable = True
    with pytest.raises(dataclasses.FrozenInstanceError):
        controller.theta = genes


@pytest.mark.parametrize(
    ("theta", "message"),
    [
        (np.zeros(30), r"theta has shape \(30,\): layout 'paper-31' has \(31,\)"),
        (np.zeros((2, 31)), r"theta has shape \(2, 31\)"),
        (np.full(31, np.nan), r"theta: gene 0 \(a_A1\) = nan: allowed are values in \[-5, 5\]"),
        (np.r_[np.zeros(30), 5.1], r"theta: gene 30 \(b_22\) = 5.1"),
    ],
)
def test_wrong_genes_are_refused_when_built(theta, message):
    with pytest.raises(ValueError, match=message):
        Controller(LAYOUTS["paper-31"], theta)


def test_an_unknown_output_is_refused_when_built():
    with pytest.raises(ValueError, match="output = 'scaled'"):
        random_controller(output="scaled")
