"""Independent PPO at a tiny budget: it runs, its curve is written, its advantages are right."""

import csv

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import ippo


def test_advantages_are_the_sum_of_discounted_errors():
    rng = np.random.default_rng(0)
    steps = 7
    reward, value, last = rng.normal(size=(steps, 1)), rng.normal(size=(steps, 1)), np.ones(1)
    done = np.zeros((steps, 1))
    done[3] = 1
    nothing = jnp.zeros((steps, 1))
    sample = ippo.Sample(nothing, nothing, nothing, *map(jnp.asarray, (value, reward, done)))
    found = np.asarray(ippo.advantages(sample, jnp.asarray(last)))
    after = np.concatenate([value[1:], last[None]])
    delta = reward + ippo.DISCOUNT * after * (1 - done) - value
    for n in range(steps):
        # To the end of the match that step n is in.
        end = 4 if n <= 3 else steps
        weights = (ippo.DISCOUNT * ippo.LAMBDA) ** np.arange(end - n)
        assert found[n, 0] == pytest.approx((weights * delta[n:end, 0]).sum(), abs=1e-5)


@pytest.mark.slow
def test_a_tiny_training(tmp_path):
    ippo.main(["--steps", "2048", "--matches", "16", "--minutes", "0.05", "--out", str(tmp_path)])
    rows = list(csv.DictReader((tmp_path / "ippo.csv").open()))
    assert [int(row["steps"]) for row in rows] == [1024, 2048]
    assert all(np.isfinite(float(x)) for row in rows for x in row.values())
    assert (tmp_path / "ippo.png").stat().st_size > 5000
