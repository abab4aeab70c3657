"""The genetic algorithm behind evosax's interface: evosax's own tests of population-based
algorithms, on ours and on its SimpleGA, and what holds for ours alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.controller import genome
from fntg_jax.learning import ga
from fntg_jax.learning.ask_tell import GeneticAlgorithm

POPULATION, DIMS, GENERATIONS = 16, 2, 10


def sphere(population):
    return jnp.sum((population - 1) ** 2, axis=-1)


def uniform(key, size=POPULATION, dims=DIMS):
    return jax.random.uniform(key, (size, dims), minval=-5, maxval=5)


@pytest.fixture(params=["ours", "SimpleGA"])
def algorithm_class(request):
    population_based = pytest.importorskip("evosax.algorithms.population_based")
    if request.param == "ours":
        return GeneticAlgorithm
    return population_based.population_based_algorithms[request.param]


@pytest.fixture
def problem():
    bbob = pytest.importorskip("evosax.problems")
    return bbob.BBOBProblem("sphere", num_dims=DIMS)


# The three tests of evosax 0.3 (tests/test_algorithms/test_population_based.py), in our words.


def start(algorithm_class, problem):
    keys = jax.random.split(jax.random.key(0), 4)
    algorithm = algorithm_class(population_size=POPULATION, solution=problem.sample(keys[0]))
    params = algorithm.default_params
    population = jax.vmap(problem.sample)(jax.random.split(keys[1], POPULATION))
    problem_state = problem.init(keys[2])
    fitness, _, _ = problem.eval(keys[2], population, problem_state)
    return algorithm, params, algorithm.init(keys[3], population, fitness, params), problem_state


def test_evosax_run(algorithm_class, problem):
    algorithm, params, state, problem_state = start(algorithm_class, problem)
    best, key = [], jax.random.key(1)
    for _ in range(GENERATIONS):
        key, key_ask, key_tell = jax.random.split(key, 3)
        population, state = algorithm.ask(key_ask, state, params)
        fitness, problem_state, _ = problem.eval(key_tell, population, problem_state)
        state, metrics = algorithm.tell(key_tell, population, fitness, state, params)
        best.append(float(metrics["best_fitness"]))
    assert len(best) == GENERATIONS and best == sorted(best, reverse=True)
    assert int(state.generation_counter) == GENERATIONS


def test_evosax_run_scan(algorithm_class, problem):
    algorithm, params, state, problem_state = start(algorithm_class, problem)

    def step(carry, _):
        key, state, problem_state = carry
        key, key_ask, key_tell = jax.random.split(key, 3)
        population, state = algorithm.ask(key_ask, state, params)
        fitness, problem_state, _ = problem.eval(key_tell, population, problem_state)
        state, metrics = algorithm.tell(key_tell, population, fitness, state, params)
        return (key, state, problem_state), metrics["best_fitness"]

    carry = (jax.random.key(1), state, problem_state)
    _, best = jax.lax.scan(step, carry, jnp.zeros(GENERATIONS))
    assert best.shape == (GENERATIONS,) and np.isfinite(best).all()


def test_evosax_base_api(algorithm_class):
    algorithm = algorithm_class(population_size=POPULATION, solution=jnp.zeros(DIMS))
    params = algorithm.default_params
    population, fitness = jnp.zeros((POPULATION, DIMS)), jnp.zeros(POPULATION)
    state = algorithm.init(jax.random.key(0), population, fitness, params)
    assert algorithm.get_best_solution(state).shape == (DIMS,)
    assert algorithm.get_population(state).shape == (POPULATION, DIMS)
    metrics = algorithm.metrics_fn(jax.random.key(1), population, fitness, state, params)
    assert {
        "best_fitness",
        "best_solution",
        "best_fitness_in_generation",
        "best_solution_in_generation",
    } <= set(metrics)


def test_metrics_have_the_same_names_and_shapes():
    population_based = pytest.importorskip("evosax.algorithms.population_based")
    shapes = []
    for cls in (GeneticAlgorithm, population_based.SimpleGA):
        algorithm = cls(population_size=POPULATION, solution=jnp.zeros(DIMS))
        params = algorithm.default_params
        population = uniform(jax.random.key(0))
        state = algorithm.init(jax.random.key(1), population, sphere(population), params)
        _, metrics = algorithm.tell(
            jax.random.key(2), population, sphere(population), state, params
        )
        shapes.append({name: jnp.shape(x) for name, x in metrics.items()})
    assert shapes[0] == shapes[1]


def run(config=ga.GAConfig(mutation_rate=0.02), generations=40, fitness_fn=sphere, seed=0):
    algorithm = GeneticAlgorithm(POPULATION, jnp.zeros(DIMS), config)
    params = algorithm.default_params
    population = uniform(jax.random.key(seed))
    state = algorithm.init(jax.random.key(1), population, fitness_fn(population), params)
    for key in jax.random.split(jax.random.key(seed), generations):
        population, state = algorithm.ask(key, state, params)
        state, metrics = algorithm.tell(key, population, fitness_fn(population), state, params)
    return algorithm, state, metrics


@pytest.mark.parametrize("selection", ["roulette", "tournament"])
def test_it_minimises(selection):
    _, _, metrics = run(ga.GAConfig(selection=selection, mutation_rate=0.02))
    # The best of 640 random points is at about 0.05 in the median.
    assert metrics["best_fitness"] < 0.1


def test_fitness_may_have_any_sign():
    _, _, metrics = run(fitness_fn=lambda p: sphere(p) - 100)
    assert metrics["best_fitness"] < -99.9


def test_ask_is_our_reproduction():
    config = ga.GAConfig(population=POPULATION, selection="tournament", mutation_rate=0.1)
    algorithm = GeneticAlgorithm(POPULATION, jnp.zeros(DIMS), config)
    bits = jax.random.bernoulli(jax.random.key(0), 0.5, (POPULATION, DIMS * 15))
    theta = genome.decode(bits)
    state = algorithm.init(jax.random.key(1), theta, sphere(theta), config)
    np.testing.assert_array_equal(state.bits, bits)  # told values come back to the bit
    asked, _ = algorithm.ask(jax.random.key(2), state, config)
    expected = ga.reproduce(jax.random.key(2), bits, -sphere(theta), config, 0.0)
    np.testing.assert_array_equal(genome.encode(asked), expected)


def test_what_is_not_finite_is_never_best():
    def partly_nan(population):
        return jnp.where(population[:, 0] > 0, jnp.nan, sphere(population))

    algorithm, state, metrics = run(generations=5, fitness_fn=partly_nan)
    assert np.isfinite(metrics["best_fitness"]) and state.best_solution[0] <= 0
    assert algorithm.get_best_solution(state)[0] <= 0


def test_solutions_are_pytrees():
    solution = {"a": jnp.zeros(3), "b": jnp.zeros((2, 2))}
    algorithm = GeneticAlgorithm(8, solution)
    population = jax.tree.map(lambda x: jnp.ones((8, *x.shape)), solution)
    state = algorithm.init(jax.random.key(0), population, jnp.ones(8), algorithm.default_params)
    asked, _ = algorithm.ask(jax.random.key(1), state, algorithm.default_params)
    assert asked["b"].shape == (8, 2, 2)
    assert algorithm.get_best_solution(state)["a"].shape == (3,)


def test_a_bad_setting_is_named():
    with pytest.raises(ValueError, match=r"ga\.population = 7"):
        GeneticAlgorithm(7, jnp.zeros(2))


def test_params_that_read_genomes_otherwise_are_refused():
    algorithm = GeneticAlgorithm(8, jnp.zeros(3))
    params = dataclasses.replace(algorithm.default_params, gray=True)
    with pytest.raises(ValueError, match=r"params.gray = True.*made with False"):
        algorithm.init(jax.random.key(0), jnp.zeros((8, 3)), jnp.zeros(8), params)
