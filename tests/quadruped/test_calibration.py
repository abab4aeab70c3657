"""The calibration's spline, against SciPy's and against what a table must mean."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import RBFInterpolator

from envs.quadruped.calibration import ask, fit, sites
from envs.quadruped.locomotion import load_gait

SCALE = np.array([0.15, 0.08, 1.0])


def slippery(wanted):
    """A dog that slips: what must be asked for, its own mirror image."""
    v, v_y, omega = (wanted / SCALE).T
    asked = [v + 0.3 * v**2 + 0.2 * omega**2, v_y * (1.2 + 0.1 * v), omega * (1.1 - 0.3 * v) + v_y]
    return np.stack(asked, axis=1) * SCALE


def test_the_spline_is_scipys():
    wanted = sites(SCALE)
    found = fit(np.concatenate([wanted, slippery(wanted)], axis=1), SCALE)
    images = np.concatenate([wanted, wanted * [1, -1, -1], np.zeros((1, 3))])
    both = np.unique(np.round(images / SCALE, 5), axis=0)
    theirs = RBFInterpolator(
        both, slippery(both * SCALE) / SCALE, kernel="cubic", degree=1, smoothing=1e-3
    )
    x = np.random.default_rng(0).normal(size=(200, 3))
    x *= np.random.default_rng(1).uniform(0, 1, (200, 1)) / np.linalg.norm(x, axis=1, keepdims=True)
    ours = jax.vmap(lambda w: ask(found, w))(jnp.asarray(x * SCALE, jnp.float32))
    # Ours is moved so that nothing is asked for a standstill.
    expected = (theirs(x) - theirs(np.zeros((1, 3)))) * SCALE
    np.testing.assert_allclose(ours / SCALE, expected / SCALE, atol=2e-4)
    np.testing.assert_allclose(ours / SCALE, slippery(x * SCALE) / SCALE, atol=0.02)


def test_what_is_asked_for_has_its_mirror_image_and_none_for_standing():
    table = load_gait().calibration
    wanted = jnp.asarray(sites(SCALE) * 1.3, jnp.float32)
    mirror = jnp.asarray([1.0, -1.0, -1.0])
    one, other = (jax.vmap(lambda w: ask(table, w))(w) for w in (wanted, wanted * mirror))
    np.testing.assert_allclose(one, other * mirror, atol=1e-5)
    np.testing.assert_allclose(ask(table, jnp.zeros(3)), 0, atol=1e-6)


def test_beyond_the_ellipsoid_requests_grow_in_proportion():
    table = load_gait().calibration
    rim = jnp.asarray([0.6 * 0.15, 0.0, 0.8])
    np.testing.assert_allclose(ask(table, 2 * rim), 2 * ask(table, rim), rtol=1e-4)
    gradient = jax.jacobian(lambda w: ask(table, w))(jnp.zeros(3))
    assert np.isfinite(gradient).all()
