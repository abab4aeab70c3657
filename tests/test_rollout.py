from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs import kinematic, mix, scenes
from envs.base import Limits
from fntg_jax.controller.layout import LAYOUTS, expand_scalars
from fntg_jax.learning import fitness
from fntg_jax.learning import rollout as rollout_module
from fntg_jax.learning.rollout import SAMPLE_STEPS, outcome_of, rollout, rollout_pairs, trajectory
from tests import reference
from tests.examples import document, random_thetas

NUM_THETAS = 6
LIMITS = Limits(-0.1, 0.3, 2.0)


def some(suite, num):
    """A few scenes, of draws that other tests have compiled."""
    drawn = scenes.SUITES[suite](jax.random.key(3), 4 if suite == "paper" else 1000)
    return jax.tree.map(lambda x: jnp.asarray(x[:num]), drawn)


def some_of_all():
    """Two scenes of every random suite: still and moving in one batch."""
    return mix.concatenate([some(name, 2) for name in scenes.SUITES if name != "paper"])


def doubled(tree):
    return jax.tree.map(
        lambda x: jnp.asarray(x, jnp.float64 if x.dtype == np.float32 else x.dtype), tree
    )


@pytest.mark.parametrize(
    ("draw", "name", "output"),
    [(some_of_all, "paper-31", "scale"), (partial(some, "paper", 4), "full-63", "clip")],
    ids=["random suites", "paper suite"],
)
def test_outcomes_and_fitness_are_those_of_the_reference_simulator(draw, name, output):
    layout = LAYOUTS[name]
    where = jax.tree.map(np.asarray, draw())
    thetas = random_thetas(layout, NUM_THETAS, seed=8)
    limits = dict(zip(LIMITS._fields, LIMITS))
    with jax.enable_x64(True):
        run = jax.jit(partial(rollout_pairs, layout, output=output))
        env = kinematic.make(**limits)
        outcome = run(jnp.asarray(thetas), doubled(where), env)
        found_fitness = np.asarray(fitness.paper_fitness(outcome))
        found_success = np.stack(fitness.success(outcome), -1)
        outcome = jax.tree.map(np.asarray, outcome)
    assert found_fitness.dtype == outcome.distance.dtype == np.float64
    balls = where.ball_velocity if where.ball_velocity is not None else np.zeros_like(where.ball)
    walks = where.obstacle_velocity
    for p, theta in enumerate(thetas):
        document_ = document(layout, theta, output, LIMITS)
        trials = [
            reference.simulate(
                document_,
                where.start[t],
                where.ball[t],
                where.obstacles[t],
                balls[t],
                None if walks is None else walks[t],
            )
            for t in range(len(where.start))
        ]
        for t, trial in enumerate(trials):
            for field in ("distance", "v", "omega", "clearance", "v_peak"):
                got = getattr(outcome, field)[p, t]
                np.testing.assert_allclose(got, trial[field], atol=1e-6, err_msg=field)
            assert tuple(found_success[p, t]) == reference.success(trial)
        expected = reference.paper_fitness(trials)
        assert found_fitness[p] == pytest.approx(expected, rel=1e-5)
    assert not outcome.failed.any()
    assert np.ptp(outcome.distance) > 0.5
    assert np.ptp(outcome.clearance) > 0.1


@pytest.fixture(scope="module")
def single():
    """A float32 roll-out of pairs, and the same trials one by one and step by step."""
    layout, env = LAYOUTS["paper-31"], kinematic.make()
    thetas = jnp.asarray(random_thetas(layout, 5, seed=2), jnp.float32)
    where = some("paper", 4)
    pairs = jax.jit(partial(rollout_pairs, layout))(thetas, where, env)

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    @partial(jax.vmap, in_axes=(None, 0))
    def alone(theta, scene):
        params = expand_scalars(layout, theta)
        return rollout(params, scene, env), trajectory(params, scene, env)

    return jax.tree.map(np.asarray, (pairs, *alone(thetas, where)))


def test_pairs_are_every_controller_through_every_scene(single):
    pairs, alone, _ = single
    assert pairs.distance.shape == (5, 4, 3)
    assert pairs.clearance.shape == (5, 4)
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-4), pairs, alone)


def test_outcome_is_what_the_trajectory_shows(single):
    _, alone, path = single
    assert path.measured.d_ball.shape[-1] == 221
    assert path.command.v.shape[-1] == 220
    after = np.asarray(SAMPLE_STEPS)
    close = partial(np.testing.assert_allclose, atol=1e-4)
    close(alone.distance, path.measured.d_ball[..., after])
    close(alone.v, path.command.v[..., after - 1])
    close(alone.omega, path.command.omega[..., after - 1])
    close(alone.clearance, path.measured.d_obstacle.min(-1))
    close(alone.v_peak, path.command.v.max(-1))
    judged = jax.vmap(jax.vmap(outcome_of))(path.measured, path.command, path.failed)
    jax.tree.map(close, alone, judged)
    moved = np.linalg.norm(np.diff(path.snapshot.robot[..., :2], axis=-2), axis=-1)
    close(moved, path.command.v * 0.1 * np.sinc(path.command.omega * 0.05 / np.pi))


@pytest.mark.parametrize("num_thetas", [231, 331])
def test_blocks_of_a_large_batch_change_nothing(num_thetas, monkeypatch):
    """924 and 1324 pairs: two and three blocks, the last one not full."""
    layout, env = LAYOUTS["paper-31"], kinematic.make()
    thetas = jnp.asarray(0.3 * random_thetas(layout, num_thetas, seed=6), jnp.float32)
    found = jax.jit(partial(rollout_pairs, layout))(thetas, some("paper", 4), env)
    monkeypatch.setattr(rollout_module, "_BLOCK", 10**6)
    whole = jax.jit(partial(rollout_pairs, layout))(thetas, some("paper", 4), env)
    assert found.distance.shape == (num_thetas, 4, 3) and found.failed.dtype == bool
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-4), found, whole)
    assert np.ptp(found.distance) > 0.5
