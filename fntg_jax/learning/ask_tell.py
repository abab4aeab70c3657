"""The genetic algorithm behind evosax's ask/tell interface, so that either can take the other's
place.

    ga = GeneticAlgorithm(population_size=60, solution=jnp.zeros(31))
    state = ga.init(key, population, fitness, params := ga.default_params)
    population, state = ga.ask(key, state, params)
    state, metrics = ga.tell(key, population, fitness, state, params)

Signatures, shapes and the names of the metrics are those of `PopulationBasedAlgorithm` of evosax
0.3, which is not needed.  As there, fitness is *minimised*.  `params` is a `GAConfig`: its floats
may change from call to call without compiling again.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, Key

from fntg_jax.controller import genome
from fntg_jax.learning import ga
from fntg_jax.learning.ga import GAConfig


class State(NamedTuple):
    """bits: genomes of the newest population; fitness: theirs, lower is better; best_*: the best
    finite individual told of so far (NaN and inf before there is one)."""

    bits: Bool[Array, "P L"]
    fitness: Float[Array, " P"]
    best_solution: Float[Array, " genes"]
    best_fitness: Float[Array, ""]
    generation_counter: Int[Array, ""]


class GeneticAlgorithm:
    """`ga.reproduce` as ask and tell.

    Args:
        population_size: individuals, even.
        solution: any pytree of the shape of one individual.
        config: settings of the algorithm; its population is population_size.
        horizon: generations that config.mutation_decay refers to, > 0.

    Genes live in [-5, 5] on a grid of config.num_bits bits: what is told is clipped and rounded to
    it, what is asked for lies on it.

    Fitness that is minimised can have any sign, and selection wants weights from 0: it sees the
    worst finite fitness of the population minus the individual's.  Only roulette and sus depend on
    more than the order.  Raises ValueError naming the field of the configuration.

    As evosax's, the methods are compiled for the object itself (a static argument, compared by
    identity): nothing that they read of it may be changed after it is made.
    """

    def __init__(
        self,
        population_size: int,
        solution: Any,
        config: GAConfig = GAConfig(),
        horizon: float = 95.0,
    ):
        self.default_params = dataclasses.replace(config, population=population_size)
        ga.validate(self.default_params)
        flat, self._unravel = ravel_pytree(solution)
        self.population_size = population_size
        self.horizon = horizon
        self.num_dims = flat.size

    @partial(jax.jit, static_argnums=0)
    def init(
        self, key: Key[Array, ""], population: Any, fitness: Float[Array, " P"], params: GAConfig
    ) -> State:
        """The state after a first, evaluated population.

        Args:
            key: not used; part of evosax's signature.
            population: pytree with a leading axis [P].
            fitness: [P], lower is better.
            params: as `default_params`, but for its floats.
        """
        del key
        nothing = State(
            bits=jnp.zeros((self.population_size, self.num_dims * params.num_bits), bool),
            fitness=jnp.full(self.population_size, jnp.inf),
            best_solution=jnp.full(self.num_dims, jnp.nan),
            best_fitness=jnp.asarray(jnp.inf),
            generation_counter=jnp.zeros((), int),
        )
        return self._take(nothing, population, fitness, params)

    @partial(jax.jit, static_argnums=0)
    def ask(self, key: Key[Array, ""], state: State, params: GAConfig) -> tuple[Any, State]:
        """A new population: selection, crossover, mutation, elites.

        Args:
            key: random key.
            state: of the algorithm.
            params: as `default_params`, but for its floats.

        Returns:
            Individuals, a pytree with a leading axis [P], and the state as it was.
        """
        self._check(params)
        finite = jnp.isfinite(state.fitness)
        worst = jnp.max(jnp.where(finite, state.fitness, -jnp.inf), initial=-jnp.inf)
        weight = jnp.where(finite, worst - state.fitness, 0)
        progress = state.generation_counter / self.horizon
        bits = ga.reproduce(key, state.bits, weight, params, progress)
        return self._solutions(bits, params), state

    @partial(jax.jit, static_argnums=0)
    def tell(
        self,
        key: Key[Array, ""],
        population: Any,
        fitness: Float[Array, " P"],
        state: State,
        params: GAConfig,
    ) -> tuple[State, dict[str, Array]]:
        """Take over an evaluated population.

        Args:
            key: not used; part of evosax's signature.
            population: pytree with a leading axis [P].
            fitness: [P], lower is better.
            state: of the algorithm.
            params: as `default_params`, but for its floats.

        Returns:
            The new state and evosax's metrics.
        """
        state = self._take(state, population, fitness, params)
        metrics = self.metrics_fn(key, self._flat(population), fitness, state, params)
        return state._replace(generation_counter=state.generation_counter + 1), metrics

    def metrics_fn(
        self,
        key: Key[Array, ""],
        population: Float[Array, "P genes"],
        fitness: Float[Array, " P"],
        state: State,
        params: GAConfig,
    ) -> dict[str, Array]:
        """evosax's metrics.

        Args:
            key: not used.
            population: [P, genes].
            fitness: [P], lower is better.
            state: after it was told.
            params: not used.
        """
        del key, params
        best = jnp.argmin(jnp.where(jnp.isnan(fitness), jnp.inf, fitness))
        return {
            "generation_counter": state.generation_counter,
            "best_fitness_in_generation": fitness[best],
            "best_solution_in_generation": population[best],
            "best_fitness": state.best_fitness,
            "best_solution": state.best_solution,
            "best_solution_norm": jnp.linalg.norm(state.best_solution),
        }

    def get_best_solution(self, state: State) -> Any:
        """The best individual of the newest population, as a pytree.

        Args:
            state: of the algorithm.
        """
        best = jnp.argmin(jnp.where(jnp.isnan(state.fitness), jnp.inf, state.fitness))
        return jax.tree.map(lambda x: x[best], self.get_population(state))

    def get_population(self, state: State) -> Any:
        """The newest population, as a pytree with a leading axis.

        Args:
            state: of the algorithm.
        """
        return self._solutions(state.bits, self.default_params)

    def _check(self, params):
        """What a population is read by must be the same in all calls; some know no params."""
        for name in ("population", "num_bits", "gray"):
            value, own = getattr(params, name), getattr(self.default_params, name)
            if value != own:
                raise ValueError(
                    f"params.{name} = {value!r}: this algorithm was made with {own!r}; make one "
                    "with another config"
                )

    def _take(self, state, population, fitness, params):
        self._check(params)
        flat = self._flat(population)
        cost = jnp.where(jnp.isnan(fitness), jnp.inf, fitness)
        best = jnp.argmin(cost)
        better = cost[best] < state.best_fitness
        return state._replace(
            bits=genome.encode(flat, params.num_bits, params.gray),
            fitness=fitness,
            best_solution=jnp.where(better, flat[best], state.best_solution),
            best_fitness=jnp.where(better, cost[best], state.best_fitness),
        )

    def _flat(self, population):
        return jax.vmap(lambda x: ravel_pytree(x)[0])(population)

    def _solutions(self, bits, params):
        return jax.vmap(self._unravel)(genome.decode(bits, params.num_bits, params.gray))
