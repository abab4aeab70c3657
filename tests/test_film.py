"""Worlds that draw themselves: what is filmed is what is judged, and how `fntg replay` asks."""

import io
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from envs.base import Command, Observation
from fntg_jax.commands import cli
from fntg_jax.running import evaluation, registry, xla
from fntg_jax.showing import film
from tests.controllers import random_controller

KINEMATIC = registry.get_world("kinematic")


class FakeFilm(NamedTuple):
    """A kinematic trial as a film; its pictures are grey, brighter with time."""

    measured: object
    command: object
    failed: object
    dt: float = 0.05

    def pictures(self, trial, width, height):
        return [np.full((height, width, 3), 20 * n + trial, np.uint8) for n in range(12)]

    def view(self, trial):
        print(f"viewing {trial}")


def shoot_kinematic(env, scenes, control, window):
    def step(state, _):
        command = control(env.observe(state))
        return env.step(state, command), (env.measure(state), command)

    @jax.jit
    @jax.vmap
    def one(scene):
        end, (measured, command) = jax.lax.scan(step, env.reset(scene), None, length=220)
        last = env.measure(end)
        whole = jax.tree.map(lambda xs, x: jnp.append(xs, x), measured, last)
        return whole, command, env.failed(end)

    measured, command, failed = one(scenes)
    measured, command = jax.tree.map(np.transpose, (measured, command))
    return FakeFilm(measured, command, failed)


def shoot_nothing(env, scenes, control, window):
    zero = np.zeros((221, len(scenes.start)))
    return FakeFilm(Observation(*[zero] * 4), Command(zero[1:], zero[1:]), zero[0] > 0)


WORLD = KINEMATIC._replace(film=shoot_nothing)


def test_what_is_filmed_is_judged():
    controller, filmed = random_controller(seed=3), KINEMATIC._replace(film=shoot_kinematic)
    judged = evaluation.evaluate(controller, KINEMATIC, "open", 3)
    shots = film.shoot("one", controller, filmed, "open", (0, 2))
    for shot, n in zip(shots, (0, 2)):
        assert shot.scene == f"open scene {n}"
        assert f"{judged.outcome.distance[n, 1]:.2f} m at step 200" in shot.result
        assert shot.result.startswith("success" if judged.success[n] else "no success")


@pytest.mark.parametrize("image_format", ["GIF", "WEBP"])
def test_pictures_side_by_side_in_real_time(image_format):
    shots = film.shoot("one", random_controller(seed=3), WORLD, "open", (0, 1))
    data, keys = film.animation(shots, image_format)
    image = Image.open(io.BytesIO(data))
    assert (image.format, image.size, image.n_frames) == (image_format, (640, 240), 13)
    image.seek(6)
    image.load()
    assert image.info["duration"] == 50
    assert abs(int(np.asarray(image.convert("L"))[200, 100]) - 120) < 8
    keys = [np.asarray(Image.open(io.BytesIO(key)))[200, 100, 0] for key in keys]
    assert keys == [0, 40, 80, 140, 180, 220]


@pytest.fixture
def replay(monkeypatch, tmp_path, capsys):
    """The command on a controller of the filmed world; returns stdout and stderr."""
    from fntg_jax import export

    controller = random_controller(seed=3)
    controller.provenance["env"] = "filmed"
    export.save(controller, tmp_path / "one.json")
    monkeypatch.setattr(xla, "configure", lambda *args, **kwargs: None)
    worlds = {"kinematic": KINEMATIC, "filmed": WORLD}
    monkeypatch.setattr(registry, "get_world", worlds.__getitem__)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        cli.main(["replay", "one.json", *arguments])
        return capsys.readouterr()

    return run


def test_the_controllers_own_world_is_asked(replay, tmp_path):
    said = replay("--out", "dog.gif")
    assert said.out == "dog.gif\n" and "one.json, blocked scene 0:" in said.err
    names = ["dog.gif", *(f"dog-key-{n}.png" for n in range(6))]
    assert {p.name for p in tmp_path.iterdir()} == {"one.json", *names}
    assert Image.open("dog.gif").size == (400, 300)
    # A page is the field from above in every world.
    assert replay("--out", "dog.html").out == "dog.html\n"
    assert 'id="data"' in (tmp_path / "dog.html").read_text()


def test_view(replay, capsys):
    assert replay("--view", "--scene", "2").out == "viewing 0\n"
    for arguments, message in (
        (["--scene", "1", "2"], "view: name one controller and one scene"),
        (["--env", "kinematic"], "view: only worlds with a walking robot"),
    ):
        with pytest.raises(SystemExit):
            replay("--view", *arguments)
        assert capsys.readouterr().err.startswith(f"fntg: error: {message}")
