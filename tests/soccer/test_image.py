"""The ray caster against MuJoCo's renderer: the same scene, segmented by both."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.soccer import image, image_mjcf

POSES, ROBOTS = 200, 5


def scenes(rng, count, robots=ROBOTS):
    """Random scenes and eyes of a sixth robot, that stands clear of all."""
    xy = lambda *n: rng.uniform((-1.3, -0.8), (1.3, 0.8), (*n, 2))  # noqa: E731
    ball = np.concatenate([xy(count), np.full((count, 1), 0.042)], 1)
    turn = rng.uniform(-np.pi, np.pi, (count, robots, 1))
    others = np.concatenate([xy(count, robots), turn], -1)
    team = np.tile(np.arange(robots) % 2, (count, 1))
    present = rng.random((count, robots)) < 0.8
    own = np.empty((count, 3))
    for n in range(count):
        while True:
            own[n, :2] = xy()
            gaps = np.hypot(*(others[n, :, :2] - own[n, :2]).T)
            if gaps.min() > 0.3 and np.hypot(*(ball[n, :2] - own[n, :2])) > 0.25:
                break
    own[:, 2] = rng.uniform(-np.pi, np.pi, count)
    low, high = np.array([-0.9, -1.5, -0.5]), np.array([0.5, 1.5, 0.5])
    head = rng.uniform(low, high, (count, 3))
    own[:, :2] = np.clip(own[:, :2], (-1.2, -0.7), (1.2, 0.7))
    return (
        image.Scene(
            jnp.asarray(ball, jnp.float32),
            jnp.asarray(others, jnp.float32),
            jnp.asarray(team),
            jnp.asarray(present),
        ),
        jax.vmap(image.eye)(jnp.asarray(own, jnp.float32), jnp.asarray(head, jnp.float32)),
    )


def stage(mujoco, model, data, scene, eye, n):
    """Put everything of scene n on MuJoCo's stage."""
    num = scene.robots.shape[1]
    data.mocap_pos[0] = scene.ball[n]
    for k in range(num):
        x, y, heading = np.asarray(scene.robots[n, k], float)
        data.mocap_pos[1 + k] = (x, y, 0.0 if scene.present[n, k] else -5.0)
        data.mocap_quat[1 + k] = (np.cos(heading / 2), 0, 0, np.sin(heading / 2))
    ahead, left, up = np.asarray(eye.axes[n], float)
    data.mocap_pos[1 + num] = np.asarray(eye.place[n])
    # MuJoCo's cameras look along -z, with x to the right and y up.
    mujoco.mju_mat2Quat(data.mocap_quat[1 + num], np.stack([-left, up, -ahead], 1).ravel())
    mujoco.mj_forward(model, data)


@pytest.fixture(scope="module")
def both():
    mujoco = pytest.importorskip("mujoco")
    if not (os.environ.get("DISPLAY") or os.environ.get("MUJOCO_GL")):
        pytest.skip("MuJoCo cannot draw here: neither a display nor libEGL (Debian: libegl1)")
    model = mujoco.MjModel.from_xml_string(image_mjcf.mjcf(ROBOTS))
    data = mujoco.MjData(model)
    try:
        renderer = mujoco.Renderer(model, 144, 176)
    except Exception as error:  # whatever the machine's OpenGL says
        pytest.skip(f"MuJoCo cannot draw here: {error}")
    scene, eye = scenes(np.random.default_rng(0), POSES)
    ours = np.asarray(jax.jit(jax.vmap(image.segment))(scene, eye))
    names = [model.geom(g).name.split(":")[0] for g in range(model.ngeom)]
    robots = {f"robot{n}": image.FIRST_ROBOT + n for n in range(ROBOTS)}
    index = np.array([robots.get(name) or image.NAMES.index(name) for name in names])
    renderer.enable_segmentation_rendering()
    theirs = []
    for n in range(POSES):
        stage(mujoco, model, data, scene, eye, n)
        renderer.update_scene(data, camera="eye")
        geom = renderer.render()[:, :, 0]
        theirs.append(np.where(geom < 0, 0, index[geom]))
    renderer.close()
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
    scene, eye = scenes(np.random.default_rng(1), 1)
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
