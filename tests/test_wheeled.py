"""The wheeled robot: equations against MuJoCo, limits, and BIOA as it was trained elsewhere."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from envs.base import Command, Scene
from envs.wheeled import make, mjcf, world
from envs.wheeled.native import Robot
from experiments import wheeled
from fntg_jax import export


def test_equations_are_those_of_mujoco():
    env, robot = make(), Robot(ball=False)
    rng = np.random.default_rng(0)
    commands = np.repeat(rng.uniform((-0.1, -1.5), (0.3, 1.5), (10, 2)), 5, axis=0)
    scene = Scene(jnp.zeros(3), jnp.asarray([1.0, 0.0]), jnp.zeros((0, 3)))
    state, step = env.reset(scene), jax.jit(env.step)
    robot.put((0, 0, 0))
    for v, omega in commands:
        state = step(state, Command(v, omega))
        robot.step(v, omega)
    ours = [float(state.x), float(state.y), float(jnp.arctan2(state.sin, state.cos))]
    # Wheels that slip a little, and a kicker that slides, are MuJoCo's alone.
    np.testing.assert_allclose(ours[:2], robot.pose[:2], atol=0.04)
    assert abs(ours[2] - robot.pose[2]) < 0.15


def test_motors_have_limits():
    robot = Robot(ball=False)
    robot.put((0, 0, 0))
    for _ in range(20):
        robot.step(5.0, 0.0)
    speed = robot.data.qvel[0]
    assert speed == pytest.approx(mjcf.NO_LOAD * mjcf.WHEEL_RADIUS, rel=0.05)
    model = robot.model
    assert sum(model.body_mass) == pytest.approx(mjcf.MASS, abs=1e-3)
    assert model.camera("nose") is not None
    mujoco.mj_forward(model, robot.data)


def test_kick():
    speed, direction = wheeled.kicks(6)
    assert (speed > 0.5).all() and (np.abs(direction) < 0.5).all()


@pytest.mark.parametrize("suite", ["open", "blocked"])
def test_bioa_needs_no_training(suite):
    controller = export.load(export.shipped("bioa"))
    rates = wheeled.success(controller, suite, 60)
    assert min(rate.share for rate in rates.values()) >= 0.9, rates


def test_refused():
    with pytest.raises(ValueError, match="v_max = 2"):
        world.make(v_max=2.0)
    with pytest.raises(ValueError, match=r"multiples of 0\.004"):
        world.make(dt=0.03)
