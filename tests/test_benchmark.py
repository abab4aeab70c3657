"""The benchmark compares equal things: every contestant computes the same fitness and learns."""

import numpy as np
import pytest

from experiments import benchmark
from experiments.baselines import jobs, plain_numpy
from experiments.baselines.job import STEPS, Job
from fntg_jax.controller.layout import LAYOUTS
from fntg_jax.learning.rollout import EPISODE_STEPS
from tests import reference
from tests.examples import document


def prepared(contestant, job):
    if contestant.missing:
        pytest.skip(f"{contestant.needs} is not installed")
    return contestant.prepare(job)


@pytest.fixture(scope="module")
def judged():
    """Genomes whose fitness float32 can tell, scenes, and F by the tests' own simulator."""
    theta, scenes = benchmark.genomes(3), benchmark.scenes()
    right = []
    for genome in theta:
        controller = document(LAYOUTS["paper-31"], genome)
        trials = [
            reference.simulate(controller, scenes.start[t], scenes.ball[t], scenes.obstacles[t])
            for t in range(4)
        ]
        right.append(reference.paper_fitness(trials))
    return Job(scenes, theta), np.asarray(right)


@pytest.mark.parametrize(
    "contestant",
    [jobs.OURS_1, jobs.C_1, jobs.C_2, jobs.NAIVE_1, jobs.NUMPY],
    ids=lambda c: c.name,
)
def test_fitness_is_that_of_the_reference(contestant, judged):
    job, right = judged
    np.testing.assert_allclose(prepared(contestant, job)(0), right, rtol=1e-4)


def test_numpy_in_float64_is_the_reference(judged):
    job, right = judged
    found = plain_numpy.fitness(job.theta, job.scenes, np.float64)
    np.testing.assert_allclose(found, right, rtol=1e-6)


def test_c_shares_odd_work_among_threads():
    scenes, theta = benchmark.scenes(), benchmark.genomes(37)
    one, two = (prepared(c, Job(scenes, theta))(0) for c in (jobs.C_1, jobs.C_2))
    np.testing.assert_array_equal(one, two)


@pytest.mark.slow
@pytest.mark.parametrize("contestant", jobs.LEARNING[2:], ids=benchmark.label)
def test_learners_learn(contestant):
    """More generations find more, the same number again finds the same."""
    few, many, again = (
        prepared(contestant, Job(benchmark.scenes(), generations=n))(7) for n in (2, 30, 30)
    )
    assert few < many == again


def test_growth_is_drawn(tmp_path):
    row = dict.fromkeys(("controller_steps", "steps_per_second", "peak_memory_mb"), 1)
    rows = [
        {
            "axis": axis,
            "size": n,
            "contestant": "ours",
            "cores": 1,
            "seconds": f"{n / 7:.5g}",
            **row,
        }
        for axis in ("population", "trials", "seeds")
        for n in (1, 10)
    ]
    assert benchmark.write_growth(rows, tmp_path).stat().st_size > 10_000
    assert (tmp_path / "growth.csv").read_text().count("\n") == 7


def test_a_trial_is_as_long_as_the_librarys():
    assert STEPS == EPISODE_STEPS
