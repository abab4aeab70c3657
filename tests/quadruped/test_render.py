import os

import numpy as np
import pytest

pytest.importorskip("mujoco")

from envs.quadruped import make, render

STAND = make().rest
BALL = np.array([[0.3, 0.0]])
OBSTACLES = np.array([[[0.0, 0.5, 0.1]]])


def test_without_a_back_end_the_error_says_what_to_do(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ValueError, match="MUJOCO_GL=egl"):
        render.frames(STAND[None], BALL, OBSTACLES)


def test_the_viewer_needs_a_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ValueError, match="DISPLAY"):
        render.view(STAND[None], BALL, OBSTACLES)


def test_obstacles_are_as_wide_as_the_scene_says():
    model = render.scene_model(np.array([[0, 0, 0.08], [1, 0, 0.14]]))
    assert model.geom("obstacle0").size[0] == 0.08
    assert model.geom("obstacle1").size[0] == 0.14


def test_frames_become_an_animation_and_key_frames(tmp_path):
    pictures = [np.full((24, 32, 3), shade, np.uint8) for shade in (0, 120, 240)]
    for name in ("walk.gif", "walk.webp"):
        files = render.save(pictures, tmp_path / name, num_key_frames=2)
        assert [f.name for f in files] == [name, "walk-key-0.png", "walk-key-1.png"]
        assert all(f.stat().st_size > 0 for f in files)
    with pytest.raises(ValueError, match=r"walk\.mp4"):
        render.save(pictures, tmp_path / "walk.mp4")


@pytest.mark.skipif(not os.environ.get("MUJOCO_GL"), reason="MUJOCO_GL is not set")
def test_the_dog_and_the_ball_are_in_the_picture():
    picture = render.frames(STAND[None], BALL, OBSTACLES, width=160, height=120)[0].astype(int)
    assert picture.shape == (120, 160, 3)
    orange = (picture[..., 0] > 130) & (picture[..., 2] < 60) & (picture[..., 1] < 130)
    grey = (np.ptp(picture, axis=-1) < 25) & (picture.mean(-1) > 80)
    assert orange.sum() > 20
    assert grey.sum() > 200
