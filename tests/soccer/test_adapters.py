"""The match as PettingZoo sees it."""

import pytest

pytest.importorskip("pettingzoo")


def test_pettingzoo():
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from envs.soccer.pettingzoo import parallel_env

    parallel_api_test(parallel_env(players=1, minutes=0.1), num_cycles=200)
    parallel_seed_test(lambda: parallel_env(players=1, minutes=0.1), num_cycles=10)
