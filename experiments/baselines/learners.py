"""The paper's budget, 60 genomes x 95 generations, spent by other people's algorithms.

Each is driven the way its documentation recommends for speed: evosax wholly under one `scan`;
DEAP and pygad hand a whole population to NumPy at a time.  DEAP has the paper's bit strings
(465 bits, roulette, flips; two cuts for want of three), evosax and pygad real genes, as their
algorithms want them.  A repetition's number seeds it; each returns the best fitness found.
"""

import random
from typing import Any

import numpy as np

from experiments.baselines import plain_numpy
from experiments.baselines.job import POPULATION, Job, Run

GENES, BITS = 31, 15


def simple_ga(job: Job) -> Run:
    """evosax's SimpleGA: the fitter half breeds, gaussian mutation."""
    import jax
    import optax
    from evosax.algorithms import SimpleGA

    # The default step of 1 is a fifth of the genes' range; nothing here depends on it in time.
    algorithm = SimpleGA(
        POPULATION, np.zeros(GENES, np.float32), std_schedule=optax.constant_schedule(0.3)
    )

    def start(key, cost):
        genes = jax.random.uniform(key, (POPULATION, GENES), minval=-5.0, maxval=5.0)
        return algorithm.init(key, genes, cost(genes), algorithm.default_params)

    return _evosax(algorithm, job, start, job.generations - 1)


def cma_es(job: Job) -> Run:
    """evosax's CMA-ES from the middle of the genes' range, first step 2."""
    from evosax.algorithms import CMA_ES

    algorithm = CMA_ES(POPULATION, np.zeros(GENES, np.float32))
    params = algorithm.default_params.replace(std_init=2.0)

    def start(key, cost):
        del cost
        return algorithm.init(key, np.zeros(GENES, np.float32), params)

    return _evosax(algorithm, job, start, job.generations, params)


def _evosax(algorithm, job, start, generations, params=None):
    import jax
    import jax.numpy as jnp

    from experiments.baselines import naive_jax

    params = algorithm.default_params if params is None else params
    scenes = jax.tree.map(jnp.asarray, job.scenes)

    def cost(theta):
        # evosax minimises; genes beyond the limits count as the limits.
        return -naive_jax.fitness(jnp.clip(theta, -5.0, 5.0), scenes)

    def generation(state, key):
        k_ask, k_tell = jax.random.split(key)
        theta, state = algorithm.ask(k_ask, state, params)
        state, _ = algorithm.tell(k_tell, theta, cost(theta), state, params)
        return state, None

    @jax.jit
    def learn(key):
        k_start, k_run = jax.random.split(key)
        state = start(k_start, cost)
        state, _ = jax.lax.scan(generation, state, jax.random.split(k_run, generations))
        return -state.best_fitness

    compiled = learn.lower(jax.random.key(0)).compile()
    return lambda number: float(compiled(jax.random.key(number)))


def deap(job: Job) -> Run:
    """DEAP's eaSimple on bit strings."""
    from deap import algorithms, base, creator, tools

    weights = 2.0 ** np.arange(BITS - 1, -1, -1)

    def evaluate(individuals: list[Any]) -> list[tuple[float]]:
        bits = np.asarray(individuals, np.float32).reshape(-1, GENES, BITS)
        theta = (bits @ weights * (10 / (2**BITS - 1)) - 5).astype(np.float32)
        return [(float(f),) for f in plain_numpy.fitness(theta, job.scenes)]

    if not hasattr(creator, "Genome"):
        creator.create("Fitness", base.Fitness, weights=(1.0,))
        creator.create("Genome", list, fitness=creator.Fitness)
    toolbox = base.Toolbox()
    toolbox.register("bit", random.getrandbits, 1)
    toolbox.register("genome", tools.initRepeat, creator.Genome, toolbox.bit, GENES * BITS)
    toolbox.register("population", tools.initRepeat, list, toolbox.genome)
    toolbox.register("evaluate", evaluate)
    toolbox.register("map", lambda function, individuals: function(individuals))
    toolbox.register("select", tools.selRoulette)
    toolbox.register("mate", tools.cxTwoPoint)
    toolbox.register("mutate", tools.mutFlipBit, indpb=0.001)

    def learn(number: int) -> float:
        random.seed(number)
        best = tools.HallOfFame(1)
        algorithms.eaSimple(
            toolbox.population(POPULATION),
            toolbox,
            cxpb=1.0,
            mutpb=1.0,
            ngen=job.generations - 1,
            halloffame=best,
            verbose=False,
        )
        return best[0].fitness.values[0]

    return learn


def pygad(job: Job) -> Run:
    """pygad's GA: roulette, two cuts, random mutation of real genes."""
    import pygad as library

    def evaluate(instance, solutions, indices):
        del instance, indices
        return list(plain_numpy.fitness(np.asarray(solutions, np.float32), job.scenes))

    def learn(number: int) -> float:
        instance = library.GA(
            num_generations=job.generations - 1,
            num_parents_mating=POPULATION,
            sol_per_pop=POPULATION,
            num_genes=GENES,
            gene_space={"low": -5, "high": 5},
            fitness_func=evaluate,
            fitness_batch_size=POPULATION,
            parent_selection_type="rws",
            crossover_type="two_points",
            mutation_type="random",
            mutation_probability=0.02,
            keep_elitism=1,
            random_seed=number,
            suppress_warnings=True,
        )
        instance.run()
        return float(instance.best_solution()[1])

    return learn
