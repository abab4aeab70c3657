import mujoco
import numpy as np
import pytest

pytest.importorskip("mujoco")

import jax

from envs import scenes
from envs.base import Command
from envs.quadruped import make, render, world

OBSTACLES = np.array([[[0.0, 0.5, 0.1]]])


def pose():
    """The dog at rest, and the ball beside its nose, in the full model's coordinates."""
    env, qpos = make(), render.scene_model(OBSTACLES[0]).qpos0
    qpos[: len(env.rest)] = env.rest
    qpos[len(env.rest) + 5 :][:2] = 0.3, 0.0
    return qpos[None]


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_back_end_the_error_says_what_to_do(monkeypatch):
    def fail(*args):
        raise AttributeError("no such function")

    monkeypatch.setattr(mujoco, "Renderer", fail)
    with pytest.raises(ValueError, match=r"no such function.*MUJOCO_GL=egl"):
        render.frames(pose(), OBSTACLES)


@pytest.mark.usefixtures("no_display")
def test_the_viewer_needs_a_display():
    with pytest.raises(ValueError, match="DISPLAY"):
        render.view(pose(), OBSTACLES, 0.1)
    # Before anything is simulated.
    with pytest.raises(ValueError, match="DISPLAY"):
        world.film(make(), None, None, True)


def test_obstacles_are_as_wide_as_the_scene_says():
    model = render.scene_model(np.array([[0, 0, 0.08], [1, 0, 0.14]]))
    assert model.geom("obstacle0").size[0] == 0.08
    assert model.geom("obstacle1").size[0] == 0.14


@pytest.fixture
def draw():
    """frames(), where this machine can draw."""
    try:
        render.frames(pose(), OBSTACLES, 16, 16)
    except ValueError as error:
        pytest.skip(str(error))
    return render.frames


@pytest.mark.usefixtures("no_display")
def test_the_dog_and_the_ball_are_in_the_picture(draw):
    picture = draw(pose(), OBSTACLES, width=160, height=120)[0].astype(int)
    assert picture.shape == (120, 160, 3)
    orange = (picture[..., 0] > 130) & (picture[..., 2] < 60) & (picture[..., 1] < 130)
    grey = (np.ptp(picture, axis=-1) < 25) & (picture.mean(-1) > 80)
    assert orange.sum() > 20
    assert grey.sum() > 100


def test_a_film_is_a_walk_in_the_full_model(monkeypatch):
    monkeypatch.setattr(render, "_need_display", lambda: None)
    batch = scenes.open_field(jax.random.key(2), 2)
    film = world.film(make(), batch, lambda seen: Command(0.1 + 0 * seen.d_ball, 0.0), True)
    assert film.measured.d_ball.shape == (221, 2) and film.command.v.shape == (220, 2)
    assert film.failed.shape == (2,) and film.dt == pytest.approx(0.05)
    dog, radii = film._qpos[..., :2], film._obstacles[..., 2]
    assert dog.shape == (441, 2, 2) and film._qpos.shape[-1] > 24  # head, tail and ball, too
    np.testing.assert_allclose(dog[0], batch.start[:, :2], atol=1e-3)
    np.testing.assert_allclose(radii, np.tile(batch.obstacles[:, :, 2], (441, 1, 1)), atol=1e-6)
    # 0.1 m/s, which the servos allow, for the first seconds, before anything is in the way.
    steps = np.linalg.norm(dog[60] - dog[20], axis=-1) / 2
    np.testing.assert_allclose(steps, 0.1, atol=0.02)


def test_a_back_end_that_does_not_load_is_one_line(python):
    code = """
from fntg_jax.running.registry import get_world
try:
    get_world("quadruped").make()
except ValueError as error:
    print(error)
"""
    assert python(code, MUJOCO_GL="bogus").startswith("MUJOCO_GL = 'bogus': MuJoCo does not start")
