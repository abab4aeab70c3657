"""The match as other libraries see it."""

import jax
import pytest

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
