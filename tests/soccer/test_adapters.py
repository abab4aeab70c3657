"""The match as other libraries see it."""

import inspect

import jax
import jax.numpy as jnp
import pytest

from envs.soccer.flat import rewards
from envs.soccer.jaxmarl import Soccer


def test_pettingzoo():
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from envs.soccer.pettingzoo import parallel_env

    parallel_api_test(parallel_env(players=1, minutes=0.1), num_cycles=200)
    parallel_seed_test(lambda: parallel_env(players=1, minutes=0.1), num_cycles=10)


def test_jaxmarl_form():
    """Dictionaries inside jit, and a new match where one is over."""
    env = Soccer(players=1, minutes=0.05, progress=1.0)
    key = jax.random.key(0)
    state = jax.jit(env.reset)(key)[1]
    step = jax.jit(env.step)
    actions = {agent: env.action_space(agent).sample(key) for agent in env.agents}
    over = []
    for _ in range(80):
        seen, state, reward, done, _ = step(key, state, actions)
        over.append(bool(done["__all__"]))
    assert over.count(True) == 1 and int(state.game.tick) < 20
    assert set(seen) == set(reward) == set(env.agents)
    assert float(reward["home_0"]) == -float(reward["away_0"])
    assert env.observation_space("home_0").contains(seen["home_0"])


def test_approach_pays_who_comes_nearer_and_placing_pays_nobody():
    env = Soccer(players=1, minutes=1, goal=0.0, approach=1.0)
    state = env.match.place(
        env.match.reset(0, 0), jnp.array([[-0.5, 0, 0], [1.2, 0, 3.1]]), jnp.zeros(4)
    )
    ahead = jnp.array([1.0, 0, 0, 0, 0, 0])
    far = float(state.ball.x - state.robots.x[0])
    step = jax.jit(env.step_env)
    paid = 0.0
    for _ in range(15):
        _, state, reward, *_ = step(jax.random.key(0), state, dict.fromkeys(env.agents, 0 * ahead))
        paid += float(reward["home_0"])
    assert paid == 0
    for _ in range(15):
        actions = {"home_0": ahead, "away_0": 0 * ahead}
        _, state, reward, *_ = step(jax.random.key(0), state, actions)
        paid += float(reward["home_0"])
    near = float(state.ball.x - state.robots.x[0])
    assert paid == pytest.approx(far - near, abs=0.01) and paid > 0.1
    placed = env.match.place(
        env.match.reset(0, 0), jnp.array([[-1.2, 0, 0], [1.2, 0, 3.1]]), jnp.zeros(4)
    )
    assert float(rewards(placed, state, 0.0, 0.0, 1.0)[0]) == 0


def test_jaxmarls_own_base_class_and_wrappers():
    """Every method of `MultiAgentEnv`, with its arguments; `LogWrapper` counts whole matches."""
    jaxmarl = pytest.importorskip("jaxmarl.environments.multi_agent_env")
    baselines = pytest.importorskip("jaxmarl.wrappers.baselines")
    env = Soccer(players=1, minutes=0.05, approach=1.0)
    for name, theirs in vars(jaxmarl.MultiAgentEnv).items():
        # Actions are vectors: there is no mask of those that are available.
        if name.startswith("_") or name == "get_avail_actions":
            continue
        assert hasattr(env, name), name
        if callable(theirs):
            wanted = list(inspect.signature(theirs).parameters)[1:]
            assert list(inspect.signature(getattr(env, name)).parameters) == wanted, name
    logged = baselines.LogWrapper(env)
    still = {agent: jnp.zeros(6) for agent in env.agents}
    _, state = logged.reset(jax.random.key(0))

    def step(state, key):
        _, state, reward, _, info = logged.step(key, state, still)
        return state, (reward["home_0"], info["returned_episode"][0])

    _, (rewarded, over) = jax.lax.scan(step, state, jax.random.split(jax.random.key(1), 80))
    assert over.sum() == 1
    assert float(jnp.abs(rewarded).sum()) < 1e-6  # nobody moves
