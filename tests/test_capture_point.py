import jax.numpy as jnp
import pytest

from envs.base import Command, Scene
from envs.kinematic import make

SCENE = Scene(jnp.asarray([0.1, -0.2, 0.5]), jnp.asarray([0.6, 0.3]), jnp.zeros((0, 3)))


def test_ball_distance_is_measured_ahead_of_the_centre():
    plain, ahead = make(), make(capture=0.145)
    state = plain.reset(SCENE)
    point = jnp.asarray([0.1 + 0.145 * jnp.cos(0.5), -0.2 + 0.145 * jnp.sin(0.5)])
    seen = ahead.measure(state)
    assert seen.d_ball == pytest.approx(float(jnp.linalg.norm(SCENE.ball - point)), abs=1e-6)
    # Everything else stays where it was, and the robot moves alike.
    assert seen[1:] == plain.measure(state)[1:]
    moved = ahead.step(state, Command(0.1, 0.3)).x
    assert moved == plain.step(state, Command(0.1, 0.3)).x


def test_without_a_capture_point_it_is_the_centre():
    state = make().reset(SCENE)
    wanted = float(jnp.linalg.norm(SCENE.ball - SCENE.start[:2]))
    assert make().measure(state).d_ball == pytest.approx(wanted, abs=1e-6)
