import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fntg_jax.robot import geometry, sight

angles = st.floats(-9.375, 9.375, width=32)


@given(st.lists(angles, min_size=1, max_size=40))
def test_unit_is_cosine_and_sine(values):
    cos, sin = geometry.unit(np.asarray(values, np.float32))
    theta = np.asarray(values, np.float32).astype(float)
    np.testing.assert_allclose(cos, np.cos(theta), atol=2e-6)
    np.testing.assert_allclose(sin, np.sin(theta), atol=2e-6)


def test_angle_is_atan2_all_around():
    theta = np.linspace(-np.pi, np.pi, 4001)
    for far in (1e-3, 1.0, 3e3):
        x, y = (far * f(theta).astype(np.float32) for f in (np.cos, np.sin))
        np.testing.assert_allclose(geometry.angle(x, y), np.arctan2(y, x), atol=2e-6)
    assert geometry.angle(np.float32(0), np.float32(0)) == 0


def test_the_necks_rotation_is_that_of_its_three_joints():
    def about(axis, a):
        c, s = np.cos(a), np.sin(a)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        m = np.eye(3)
        m[i, i], m[j, j], m[i, j], m[j, i] = c, c, -s, s
        return m

    tilt, pan, roll = 0.3, -0.9, 0.2
    wanted = about(1, -tilt) @ about(2, pan) @ about(0, roll)
    found = np.array(sight.rotation(np.asarray([tilt, pan, roll], np.float32)))
    np.testing.assert_allclose(found, wanted, atol=1e-6)
