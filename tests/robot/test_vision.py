"""Vision on pixels: components against scikit-image, objects in pictures of the ray caster."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.field import FIELD
from envs.soccer import image
from fntg_jax.robot import colours, vision
from fntg_jax.robot.components import components


def test_components_are_those_of_scikit_image():
    measure = pytest.importorskip("skimage.measure")
    label = jax.jit(components)
    rng = np.random.default_rng(0)
    spiral = np.zeros((40, 56), np.int32)
    for n in range(0, 20, 4):
        spiral[n : 40 - n, n] = spiral[n, n : 56 - n] = spiral[n : 40 - n, 55 - n] = 1
        spiral[39 - n, n + 2 : 56 - n] = 1
    noise = [rng.integers(0, k, (40, 56)).astype(np.int32) for k in (2, 3, 4, 9)]
    for classes in (*noise, spiral, np.zeros_like(spiral)):
        ours = np.asarray(label(classes))
        theirs = measure.label(classes, background=-1, connectivity=2)
        pairs = np.unique(np.stack([ours.ravel(), theirs.ravel()]), axis=1)
        assert len(pairs.T) == theirs.max() == len(np.unique(ours))


def test_objects_of_a_rendered_picture():
    """A ball to the right, a red mate ahead, a landmark to the left: where they are."""
    ball = (0.8, 0.0, FIELD.ball_radius)
    scene = image.Scene(
        jnp.array(ball),
        jnp.array([[0.9, 0.25, 1.0]]),
        jnp.array([0]),
        jnp.array([True]),
    )
    pose, head = jnp.array([0.0, 0.1, 0.2]), jnp.array([-0.1, 0.0, 0.0])
    eye = image.eye(pose, head)
    picture = image.render(scene, eye, image.Light(blur=0.12, noise=3.0))
    sight = jax.jit(
        lambda p: vision.see(p, colours.load("ers210"), vision.Team(), vision.bands(FIELD))
    )(picture)
    mark = FIELD.landmarks[0]
    for k, place, size in ((0, ball, 0.084), (1, (mark.x, mark.y, 0.3), 0.2)):
        ahead, left, up = eye.axes @ (jnp.array(place) - eye.place)
        assert sight.frame.visible[k] and sight.confidence[k] > 0.5
        assert sight.frame.bearing[k] == pytest.approx(float(jnp.arctan2(left, ahead)), abs=0.012)
        far = float(jnp.sqrt(ahead**2 + left**2 + up**2))
        assert sight.frame.size[k] == pytest.approx(size / far, rel=0.12)
        lift = float(jnp.arctan2(up, jnp.hypot(ahead, left)))
        assert sight.frame.elevation[k] == pytest.approx(lift, abs=0.012)
    assert sight.frame.visible[9] and not sight.frame.visible[10:].any()
    assert not sight.frame.visible[2:7].any()
