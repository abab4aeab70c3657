"""The ray caster against MuJoCo's renderer: the same scene, segmented by both."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.soccer import image
from experiments import vision

POSES = 200


def looking_anywhere(rng, count):
    """Random scenes, and eyes of a sixth robot whose head looks anywhere."""
    scene, pose, _ = vision.scenes(rng, count)
    head = rng.uniform((-0.9, -1.5, -0.5), (0.5, 1.5, 0.5), (count, 3))
    scene = scene._replace(team=scene.team % 2)
    return scene, jax.vmap(image.eye)(jnp.asarray(pose, jnp.float32), jnp.float32(head))


@pytest.fixture(scope="module")
def both():
    pytest.importorskip("mujoco")
    if not (os.environ.get("DISPLAY") or os.environ.get("MUJOCO_GL")):
        pytest.skip("MuJoCo cannot draw here: neither a display nor libEGL (Debian: libegl1)")
    try:
        stage = vision.Stage()
    except Exception as error:  # whatever the machine's OpenGL says
        pytest.skip(f"MuJoCo cannot draw here: {error}")
    scene, eye = looking_anywhere(np.random.default_rng(0), POSES)
    ours = np.asarray(jax.jit(jax.vmap(image.segment))(scene, eye))
    robots = {f"robot{n}": image.FIRST_ROBOT + n for n in range(vision.ROBOTS)}
    index = np.array([robots.get(name) or image.NAMES.index(name) for name in stage.geoms])
    theirs = []
    for n in range(POSES):
        stage.put(scene, eye, n)
        geom = stage.segmented()
        theirs.append(np.where(geom < 0, 0, index[geom]))
    stage.renderer.close()
    return ours, np.stack(theirs)


def test_segmentation_agrees_with_mujoco(both):
    ours, theirs = both
    worst, compared = 1.0, 0
    for a, b in zip(ours, theirs, strict=True):
        for name in set(np.unique(a)) | set(np.unique(b)):
            mine, other = a == name, b == name
            if max(mine.sum(), other.sum()) < 30:
                continue
            share = (mine & other).sum() / (mine | other).sum()
            worst, compared = min(worst, share), compared + 1
    assert compared > 5 * POSES / 2
    assert worst >= 0.9
    assert (ours == theirs).mean() > 0.995


def test_options_do_what_they_say():
    scene, eye = looking_anywhere(np.random.default_rng(1), 1)
    scene, eye = jax.tree.map(lambda leaf: leaf[0], (scene, eye))
    draw = jax.jit(lambda light: image.render(scene, eye, light))
    f = lambda **change: np.asarray(  # noqa: E731
        draw(jax.tree.map(jnp.asarray, image.Light(**change))), float
    )
    plain = f()
    dark = f(light=0.5)
    np.testing.assert_allclose(dark, 0.5 * plain, atol=1.0)
    balanced = f(balance=(0.9, 0.8, 0.7))
    np.testing.assert_allclose(balanced, plain * (0.9, 0.8, 0.7), atol=1.0)
    noisy = f(noise=3.0, seed=1) - f(noise=3.0, seed=2)
    assert noisy.std() == pytest.approx(3 * np.sqrt(2), rel=0.05)
    assert abs(noisy.mean()) < 0.1
    blurred = f(blur=0.2)
    assert blurred.mean() == pytest.approx(plain.mean(), rel=0.01)
    assert np.abs(np.diff(blurred, axis=1)).max() < np.abs(np.diff(plain, axis=1)).max()
    assert len(np.unique(f(shading=0.0, shadows=0.0).reshape(-1, 3), axis=0)) < 15
    assert (f(shadows=0.0) >= plain).all()
    # Numbers instead of arrays leave steps out, and nothing else.
    np.testing.assert_array_equal(image.render(scene, eye), plain.astype(np.uint8))
