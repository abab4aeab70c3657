"""Controllers around physics: our step against MuJoCo's C code, and gradients."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("mujoco")

from scipy.stats import spearmanr

from envs import scenes as suites
from envs.base import Command
from envs.quadruped import make, native
from fntg_jax.controller import network
from fntg_jax.controller.layout import expand, get_layout
from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import Outcome, rollout_pairs

LAYOUT = get_layout("paper-31")
ROOT = Path(__file__).parents[2]


def _flat(scenes, num):
    return jax.tree.map(lambda x: jnp.concatenate([x] * num), scenes)


@pytest.mark.slow
def test_closed_loop_ranks_like_c_over_240_roll_outs():
    env = make()
    scenes = suites.paper(jax.random.key(0), 4)
    theta = jax.random.uniform(jax.random.key(1), (60, 31), minval=-5, maxval=5)
    ours = jax.jit(lambda t, s: rollout_pairs(LAYOUT, t, s, env))(theta, scenes)
    params = expand(LAYOUT, jnp.repeat(theta, 4, axis=0))
    control = jax.vmap(lambda p, seen: network.command(p, seen, env.limits))
    episode = native.run(env, _flat(scenes, 60), lambda seen, _: control(params, seen))
    steps = np.array([170, 200, 220])
    theirs = Outcome(
        distance=episode.observation.d_ball[steps].T,
        v=episode.command.v[steps - 1].T,
        omega=episode.command.omega[steps - 1].T,
        clearance=episode.observation.d_obstacle.min(0),
        v_peak=episode.command.v.max(0),
        failed=episode.fallen[-1],
    )
    ours = jax.tree.map(lambda x: np.asarray(x).reshape(240, *x.shape[2:]), ours)

    def score(outcome):
        return np.asarray(fitness.paper_fitness(jax.tree.map(lambda x: x[:, None], outcome)))

    assert np.std(np.log(score(theirs))) > 0.1  # the roll-outs differ at all
    assert spearmanr(score(ours), score(theirs)).statistic >= 0.95


def _distance_after(env, scene, num_steps):
    def run(u):
        def control_step(state, _):
            return env.step(state, Command(u[0], u[1])), None

        body = jax.checkpoint(control_step)
        state, _ = jax.lax.scan(body, env.reset(scene), None, length=num_steps)
        return env.measure(state).d_ball

    return run


GRADIENT = """
import jax, jax.numpy as jnp, numpy as np
from envs import scenes as suites
from envs.quadruped import make
from tests.quadruped.test_closed_loop import _distance_after
scene = jax.tree.map(lambda x: x[0], suites.paper(jax.random.key(0), 4))
run = _distance_after(make("jax"), scene, 20)
at = jnp.asarray([0.12, 0.4])
value = jax.jit(jax.vmap(run))
# Contacts switch on and off between two samples: over a wider baseline their jumps average.
offsets = np.linspace(-1, 1, 21)
slopes = []
for eps in ([1e-3, 0.0], [0.0, 1e-2]):
    line = at + jnp.asarray(offsets[:, None] * np.array(eps), jnp.float32)
    slopes.append(np.polyfit(offsets * max(eps), np.asarray(value(line)), 1)[0])
print(*np.asarray(jax.jit(jax.grad(run))(at)), *slopes)
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.xfail(
    reason="since set-points are limited to the servos' speeds and friction is dry, the gradient of"
    " one parameter is a third too small"
)
def test_gradient_through_twenty_control_steps_equals_finite_differences():
    # Through stock MJX: reverse mode through the structured step takes minutes to compile.
    env = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", GRADIENT],
        env=env,
        capture_output=True,
        text=True,
        timeout=590,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    gradient, slopes = np.array(done.stdout.split(), float).reshape(2, 2)
    assert np.all(np.isfinite(gradient))
    np.testing.assert_allclose(gradient, slopes, rtol=0.05, atol=0.005)
