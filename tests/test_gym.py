"""Gymnasium: its own checker, the vector environment against single ones, the reward against the
Brax adapter's, the success against `evaluate`'s."""

import warnings

import jax
import numpy as np
import pytest

import fntg_jax
from envs.kinematic import world

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.wrappers.vector import RecordEpisodeStatistics  # noqa: E402

from fntg_jax import gym  # noqa: E402


def run(env, choose, seed=0):
    """One episode; observations, rewards and the last info."""
    observation, _ = env.reset(seed=seed)
    seen, rewards = [observation], []
    while True:
        observation, reward, terminated, truncated, info = env.step(choose(observation))
        seen.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            return np.array(seen), np.array(rewards), info


def test_gymnasium_s_checker_has_nothing_to_say():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Of an environment outside of the registry it always says that.
        warnings.filterwarnings("ignore", ".*alternative render modes.*")
        check_env(gym.make(suite="open", num_scenes=64))
        noisy = {"angle_noise": 0.1, "dropout": 0.5}
        check_env(gym.make(suite="open", num_scenes=64, env_options=noisy))


def test_the_shipped_controller_wins():
    env = gym.make(suite="open", num_scenes=64)
    controller = fntg_jax.load("bioa")
    infos = [
        run(env, lambda o: gym.action_of(*controller(*o), env.env.limits), seed)[2]
        for seed in range(10)
    ]
    assert sum(info["success"] for info in infos) >= 9
    _, rewards, info = run(env, lambda o: np.array([-1, 1]))  # turning on the spot
    assert len(rewards) == gym.EPISODE_STEPS and info["stop"] and not info["success"]


def test_success_is_the_evaluation_s():
    scenes = 200
    controller = fntg_jax.load("bioa")
    judged = fntg_jax.evaluate(controller, "crowded", scenes, env_options={"latency": 4})
    assert 0.2 < judged.success.mean() < 0.98  # both answers occur
    env = world.make(latency=4, **controller.limits._asdict())
    envs = gym.BioaVector(env, judged.scenes, scenes)
    envs._draw = lambda: np.arange(scenes, dtype=np.int32)
    observations, _ = envs.reset()
    for _ in range(gym.EPISODE_STEPS):
        actions = gym.action_of(*controller(*observations.T), env.limits)
        observations, _, terminated, truncated, infos = envs.step(actions)
    assert truncated.all() and not terminated.any() and infos["_success"].all()
    # The way there and back through actions in [-1, 1] rounds: a trial in hundreds may turn.
    assert np.mean(infos["success"] == judged.success) > 0.97
    np.testing.assert_array_equal(infos["success"], infos["reach"] & infos["safe"] & infos["stop"])


def test_a_vector_environment_is_many_single_ones():
    envs = gym.make(num_envs=3, num_scenes=64, suite="moving-ball")
    single = gym.make(num_scenes=64, suite="moving-ball")
    observations, infos = envs.reset(seed=5)
    assert envs.observation_space.contains(observations)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (gym.EPISODE_STEPS, 3, 2)).astype(np.float32)
    history = [envs.step(a) for a in actions]
    for n in range(3):
        first, _ = single.reset(options={"scene": infos["scene"][n]})
        np.testing.assert_allclose(observations[n], first, rtol=1e-5, atol=1e-6)
        for (seen, reward, *ends, _), action in zip(history, actions):
            one = single.step(action[n])
            np.testing.assert_allclose(seen[n], one[0], rtol=1e-4, atol=1e-4)
            np.testing.assert_allclose(reward[n], one[1], rtol=1e-3, atol=1e-3)
            assert [e[n] for e in ends] == list(one[2:4])
    assert history[-1][3].all()
    again = envs.step(actions[0])  # the step after the end starts anew
    assert not again[1].any() and not again[2].any() and not again[3].any() and again[4] == {}
    assert not envs.step(actions[0])[3].any()


def test_resets_are_seeded():
    envs = gym.make(suite="open", num_envs=4, num_scenes=64)
    one, two, other = (envs.reset(seed=seed)[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


def test_gymnasium_s_vector_wrappers_run():
    envs = RecordEpisodeStatistics(gym.make(suite="open", num_envs=2, num_scenes=64))
    envs.reset(seed=0)
    for _ in range(gym.EPISODE_STEPS):
        *_, infos = envs.step(envs.action_space.sample())
    assert infos["episode"]["l"].tolist() == [gym.EPISODE_STEPS] * 2
    assert np.isfinite(infos["episode"]["r"]).all()


def test_the_reward_is_the_brax_adapter_s():
    pytest.importorskip("brax")
    import envs.brax

    env = gym.make(suite="paper", num_scenes=4)
    brax = envs.brax.Bioa(env.env, env.scenes)
    env.reset(options={"scene": 2})
    state = brax.start(jax.tree.map(lambda x: x[2], env.scenes))
    step = jax.jit(brax.step)
    rng = np.random.default_rng(0)
    for action in rng.uniform([0, -0.2], [1, 0.2], (gym.EPISODE_STEPS, 2)):  # along the walls, too
        state = step(state, action.astype(np.float32))
        observation, reward, *_, info = env.step(action)
        np.testing.assert_allclose(observation, state.obs, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(reward, state.reward, rtol=1e-3, atol=1e-4)
    assert {k: float(state.metrics[k]) for k in info} == info


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"env": "moon"}, "env = 'moon': known worlds are"),
        ({"suite": "easy"}, "suite = 'easy': known are"),
        ({"env_options": {"delay": 1}}, "env option 'delay': known are"),
        ({"num_envs": 0}, "num_envs = 0: allowed are whole numbers from 1"),
        ({"num_scenes": 0}, "num_scenes = 0"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        gym.make(**options)


def test_steps_before_the_first_reset_are_refused():
    for env in (
        gym.make(suite="paper", num_scenes=4),
        gym.make(suite="paper", num_scenes=4, num_envs=2),
    ):
        with pytest.raises(ValueError, match="reset first"):
            env.step(env.action_space.sample())
    with pytest.raises(ValueError, match="scene = 4: allowed are 0 to 3"):
        gym.make(suite="paper", num_scenes=4).reset(options={"scene": 4})
