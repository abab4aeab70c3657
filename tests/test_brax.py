"""Our worlds under brax: its wrappers run on them, and both judge a trial alike."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fntg_jax
from envs.base import Command, Observation
from fntg_jax.controller import network
from fntg_jax.controller.layout import expand
from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import rollout_pairs
from fntg_jax.running.evaluation import environment_for, held_out_scenes
from fntg_jax.running.registry import get_world
from tests.conftest import ROOT

NUM_SCENES = 64


def test_without_brax_the_message_is_one_line(python):
    code = """
import sys
sys.modules["brax"] = None
try:
    import envs.brax
except ModuleNotFoundError as error:
    print(error)
"""
    message = python(code)
    assert message.count("\n") == 1 and "fntg-jax[compare]" in message


@pytest.fixture(scope="module")
def adapter():
    pytest.importorskip("brax")
    import envs.brax

    return envs.brax


@pytest.fixture(scope="module")
def driven(adapter):
    """The shipped controller under brax's own wrappers, and the same trials in our roll-out."""
    from brax.envs.wrappers import training

    controller = fntg_jax.load(fntg_jax.shipped("bioa"))
    world = get_world("kinematic")
    model = environment_for(controller, world)
    scenes = held_out_scenes(world, "blocked", NUM_SCENES)
    env = adapter.Bioa(model, scenes)
    wrapped = training.EvalWrapper(training.wrap(env, adapter.EPISODE_LENGTH))
    params = expand(controller.layout, jnp.asarray(controller.theta, jnp.float32))
    observe = Observation._make

    @jax.jit
    def episodes(keys):
        def step(state, _):
            seen = observe(jnp.moveaxis(state.obs, -1, 0))
            action = env.action(network.command(params, seen, model.limits, controller.output))
            state = wrapped.step(state, action)
            return state, (state.reward, state.done, state.metrics["success"])

        state = wrapped.reset(keys)
        first = state.pipeline_state
        return first, *jax.lax.scan(step, state, None, length=adapter.EPISODE_LENGTH)

    # brax's wrappers count the axes of a key: they want the old kind.
    result = episodes(jax.random.split(jax.random.PRNGKey(0), NUM_SCENES))
    theta = jnp.asarray(controller.theta, jnp.float32)[None]
    # Which scene each copy started in, read from where the ball lies.
    ball = np.stack([result[0].world.ball.x, result[0].world.ball.y], axis=1)
    pick = np.argmin(np.abs(ball[:, None] - np.asarray(scenes.ball)).sum(-1), axis=1)
    chosen = jax.tree.map(lambda x: x[pick], scenes)
    judge = jax.jit(
        lambda t, s: rollout_pairs(controller.layout, t, s, model, output=controller.output)
    )
    outcome = jax.tree.map(lambda x: x[0], judge(theta, chosen))
    return env, result, outcome


def test_an_episode_is_judged_as_by_the_trainer(driven):
    _, (_, state, _), outcome = driven
    metrics = state.info["eval_metrics"].episode_metrics
    ours = fitness.success(outcome)
    for part in ("reach", "safe", "stop", "success"):
        expected = np.asarray(getattr(ours, part))
        # Rounding may move a trial across a threshold, rarely.
        assert np.mean(np.asarray(metrics[part]) == expected) > 0.95
    assert 0.5 < np.mean(metrics["success"]) <= 1


def test_reward_sums_up_to_its_parts_and_to_the_distance_gained(driven, adapter):
    env, (first, state, (reward, _, _)), _ = driven
    metrics = state.info["eval_metrics"].episode_metrics
    parts = sum(np.asarray(metrics[f"reward_{p}"]) for p in ("progress", "stop", "clearance"))
    np.testing.assert_allclose(np.sum(reward, axis=0), parts, rtol=1e-4, atol=1e-4)
    start = np.asarray(jax.vmap(env.env.measure)(first.world).d_ball)
    most = 1.3 * np.log1p((start / 0.05) ** 2)
    progress = np.asarray(metrics["reward_progress"])
    assert np.all(progress <= most + 1e-3) and np.median(progress / most) > 0.8
    assert np.all(np.asarray(metrics["reward_stop"]) <= 0)


def test_an_episode_ends_after_220_steps_and_starts_again(driven):
    _, (first, state, (_, done, success)), _ = driven
    assert np.all(done[:-1] == 0) and np.all(done[-1] == 1)
    assert np.all(success[:-1] == 0)
    again = state.pipeline_state
    np.testing.assert_array_equal(again.world.x, first.world.x)
    assert np.all(again.time == 0)


def test_actions_span_the_limits(driven):
    env, _, _ = driven
    for action, v, omega in (((-1, 0), 0.0, 0.0), ((1, 1), 0.2, 1.5), ((9, -9), 0.2, -1.5)):
        command = env.command(jnp.asarray(action, jnp.float32))
        np.testing.assert_allclose((command.v, command.omega), (v, omega), atol=1e-7)
    command = Command(jnp.asarray(0.07), jnp.asarray(-0.4))
    back = env.command(env.action(command))
    np.testing.assert_allclose(back[:2], command[:2], rtol=1e-6)


def test_registered_names_and_options(adapter):
    from brax import envs as brax_envs

    env = brax_envs.get_environment("bioa_kinematic", num_scenes=8, latency=2, v_max=0.1)
    assert (env.observation_size, env.action_size, env.backend) == (4, 2, "kinematic")
    assert env.env.latency == 2 and env.env.limits.v_max == 0.1
    state = jax.jit(env.reset)(jax.random.key(3))
    assert state.obs.shape == (4,) and state.reward == 0 and state.done == 0
    with pytest.raises(ValueError, match="lag_time"):
        brax_envs.get_environment("bioa_kinematic", num_scenes=8, lag_time=1)


@pytest.mark.slow
def test_the_quadruped_steps_under_brax(adapter):
    from brax import envs as brax_envs

    env = brax_envs.get_environment("bioa_quadruped", num_scenes=4)
    state = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)
    for _ in range(20):
        state = step(state, jnp.asarray([1.0, 0.0]))
    assert np.isfinite(state.reward) and state.done == 0
    start = env.env.reset(jax.tree.map(lambda x: x[0], env.scenes))
    assert float(state.pipeline_state.world.qpos[2]) > 0.5 * float(start.qpos[2])


@pytest.mark.slow
def test_a_trainer_of_brax_runs_on_it(adapter):
    from brax import envs as brax_envs
    from brax.training.agents.es import train

    env = brax_envs.get_environment("bioa_kinematic", num_scenes=64)
    seen = []
    train.train(
        env,
        num_timesteps=10 * 16 * 220,
        episode_length=adapter.EPISODE_LENGTH,
        population_size=8,
        num_evals=2,
        num_eval_envs=8,
        progress_fn=lambda steps, metrics: seen.append(metrics["eval/episode_success"]),
    )
    assert len(seen) == 2 and all(0 <= share <= 1 for share in seen)


def test_the_file_says_what_the_trainer_judges_by():
    """The worlds cannot import the trainer, so its thresholds stand in both."""
    text = (ROOT / "envs" / "brax.py").read_text()
    for value in (fitness.REACH, fitness.CLEARANCE, fitness.STOP):
        assert f"{value:g}" in text
    weights = fitness.SmoothWeights()
    line = next(s for s in text.splitlines() if s.startswith("_NEAR"))
    for value in (weights.near, weights.still, weights.gate, weights.margin):
        assert f"{value:g}" in line
