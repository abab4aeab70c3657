import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from fntg_jax.learning.fitness import PaperWeights, paper_fitness, success
from fntg_jax.learning.rollout import Outcome
from fntg_jax.running.statistics import wilson


def outcome(**changes):
    """One genome, two trials."""
    fields = {
        "distance": [[0.5, 0.3, 0.1], [0.7, 0.1, 0.3]],
        "v": [[0.1, 0.1, -0.1], [0.2, 0.05, 0.05]],
        "omega": [[-0.6, 0.3, 0.3], [0.0, 0.0, -0.6]],
        "clearance": [0.045, 0.5],
        "v_peak": [0.2, 0.04],
        "failed": [False, False],
    }
    return Outcome(**{k: jnp.asarray(v) for k, v in {**fields, **changes}.items()})


def test_the_papers_formula_by_hand():
    # d (step 200) = 0.2, d_1 (170) = 0.6, d_2 (220) = 0.2; v_fit = 0.6 / 6 = 0.1;
    # omega_fit = 1.8 / 6 = 0.3; delta = ((20 * 0.1)^2 + 0) / 2 = 2; phi = 1 / 2.
    cost = 0.001 + (6 * 0.2) ** 2 + 0.6 + 0.2 + 2 * 0.1 + 0.5 * 0.3 + 2 + 60 * 0.5
    assert float(paper_fitness(outcome())) == pytest.approx(10 / cost, rel=1e-6)


def test_a_perfect_trial_is_bounded_by_gamma():
    nothing = np.zeros((2, 3))
    best = outcome(distance=nothing, v=nothing, omega=nothing, clearance=[0.145, 1], v_peak=[1, 1])
    assert float(paper_fitness(best)) == pytest.approx(10 / 0.001, rel=1e-6)


def test_moving_counts_from_above_the_minimal_value():
    def phi(*peaks):
        """Solved back from F."""
        moved, still = outcome(v_peak=[1.0, 1.0]), outcome(v_peak=list(peaks))
        return float(10 / paper_fitness(still) - 10 / paper_fitness(moved)) / 60

    assert phi(0.05, 0.051) == pytest.approx(0.5, abs=1e-5)
    assert phi(-0.1, 0.0) == pytest.approx(1, abs=1e-5)


def test_a_fall_counts_as_standing_still():
    fallen = outcome(failed=[True, False])
    assert float(10 / paper_fitness(fallen) - 10 / paper_fitness(outcome())) == pytest.approx(30)


def test_weights_are_traced():
    traces = []

    @jax.jit
    def fitness_of(weights):
        traces.append(1)
        return paper_fitness(outcome(), weights)

    plain, other = fitness_of(PaperWeights()), fitness_of(PaperWeights(gamma=1.0, still=0.0))
    assert len(traces) == 1
    assert float(10 / other) == pytest.approx(float(10 / plain) + 0.999 - 30, rel=1e-5)


def test_nan_is_not_hidden():
    """The genetic algorithm counts it and takes it for 0."""
    assert np.isnan(paper_fitness(outcome(clearance=[np.nan, 0.5])))


GOOD = {"distance": [1.0, 0.099, 1.0], "v": [0.029, 0.029, -0.029], "clearance": 0.145}


def judged(**changes):
    fields = {"omega": [0.0, 0.0, 0.0], "v_peak": 0.2, "failed": False, **GOOD, **changes}
    found = success(Outcome(**{k: jnp.asarray(v) for k, v in fields.items()}))
    return tuple(map(bool, (*found, found.success)))


def test_success_and_its_parts():
    assert judged() == (True, True, True, True)
    assert judged(distance=[0.0, 0.101, 0.0]) == (False, True, True, False)
    assert judged(clearance=0.1449) == (True, False, True, False)
    assert judged(failed=True) == (True, False, True, False)
    assert judged(v=[0.0, -0.1, 0.0]) == (True, True, False, False)
    assert judged(v=[0.0, 0.08, 0.0]) == (True, True, True, True)  # averaged


def test_nan_is_no_success():
    nan = np.nan
    assert judged(distance=[1.0, nan, 1.0]) == (False, True, True, False)
    assert judged(clearance=nan) == (True, False, True, False)
    for place in range(3):
        v = [0.0, 0.0, 0.0]
        v[place] = nan
        assert judged(v=v) == (True, True, False, False)


@given(st.integers(1, 5000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_interval_against_scipy(counts):
    found = wilson(*counts)
    exact = binomtest(*counts).proportion_ci(method="wilson")
    assert found == pytest.approx((counts[0] / counts[1], exact.low, exact.high), abs=1e-7)
    assert 0 <= found.low <= found.share <= found.high <= 1
