"""The genetic algorithm, wholly on-device: small pure operators and `generation`.

Fitness is maximised.  Keys go in and never come out: generation n uses fold_in(key, n), so
that a run resumes from (bits, key, n) alone.  Every float of the configuration, and num_elites, is
traced: two settings that differ only in those share one compilation, and a sweep over them is one
vmap.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key

from fntg_jax.controller import genome
from fntg_jax.learning import bounds
from fntg_jax.learning.bounds import bounded

Selection = Literal["roulette", "sus", "rank", "tournament", "truncation"]
# (key, theta) -> fitness.
FitnessFn = Callable[[Key[Array, ""], Float[Array, "P genes"]], Float[Array, " P"]]


def _static(default):
    return dataclasses.field(default=default, metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class GAConfig:
    """Settings; the defaults are the paper's (roulette wheel is our reading of "the candidate
    with higher value had the higher opportunity to reproduce").

    Attributes:
        population: genomes; even, and so within each island.
        num_bits: bits a gene.
        gray: Gray code instead of plain binary.
        selection: roulette; sus: stochastic universal sampling; rank: linear; tournament;
            truncation.
        num_points: cuts of the crossover.
        tournament_size: rivals of a tournament.
        num_islands: the population is split into so many, which never mix.
        crossover_rate: share of pairs that are crossed.
        mutation_rate: probability to flip, a bit, at the start.
        mutation_decay: the rate falls geometrically to this share of it at the horizon.
        num_elites: best genomes copied unchanged, of each island.
        rank_pressure: expected copies of the best under rank selection, 1 to 2.
        truncation_share: share of the population that breeds under truncation.
    """

    population: int = _static(60)
    num_bits: int = bounded(15, 1, 24, static=True)
    gray: bool = _static(False)
    selection: Selection = _static("roulette")
    num_points: int = bounded(3, 0, 32, static=True)
    tournament_size: int = _static(2)
    num_islands: int = _static(1)
    crossover_rate: float = bounded(1.0, 0, 1)
    mutation_rate: float = bounded(0.001, 0, 1)
    mutation_decay: float = bounded(1.0, 0, 1, above=True)
    num_elites: int = 1
    rank_pressure: float = bounded(1.8, 1, 2)
    truncation_share: float = bounded(0.5, 0, 1, above=True)


def validate(config: GAConfig) -> None:
    """Check a configuration at the edge.

    Args:
        config: its floats are numbers, not traced.

    Raises ValueError: field, value, what is allowed.
    """

    bounds.check(config, "ga")
    islands = max(config.num_islands, 1)
    for name, allowed, ok in (
        ("population", "even numbers from 2 to 2^31 - 2", lambda n: 2 <= n < 2**31 and n % 2 == 0),
        ("tournament_size", "1 to the population", lambda n: 1 <= n <= config.population),
        (
            "num_islands",
            f"divisors of population = {config.population} that leave islands of even size",
            lambda n: n >= 1 and config.population % (2 * n) == 0,
        ),
        (
            "num_elites",
            f"whole numbers from 0 to {config.population // islands - 1}",
            lambda n: n == int(n) and 0 <= n < config.population // islands,
        ),
    ):
        if not ok(value := getattr(config, name)):
            raise ValueError(f"ga.{name} = {value!r}: allowed are {allowed}")


# Selection: (key, fitness [P] >= 0, number of parents, config) -> parents' indices [number].
SelectionFn = Callable[[Key[Array, ""], Float[Array, " P"], int, GAConfig], Int[Array, " num"]]


def select_roulette(
    key: Key[Array, ""], fitness: Float[Array, " P"], num: int, config: GAConfig
) -> Int[Array, " num"]:
    """Probability proportional to fitness; uniform where all fitness is zero.

    Args:
        key: random key.
        fitness: [P], >= 0.
        num: how many parents.
        config: not used here.

    Returns:
        Indices of the parents, [num].
    """
    del config
    wheel = _wheel(fitness)
    return _spin(wheel, jax.random.uniform(key, (num,)))


def select_sus(
    key: Key[Array, ""], fitness: Float[Array, " P"], num: int, config: GAConfig
) -> Int[Array, " num"]:
    """Baker's stochastic universal sampling: one spin, `num` equally spaced pointers.

    The parents are shuffled, since the pointers meet them in order and neighbours mate.

    Args:
        key: random key.
        fitness: [P], >= 0.
        num: how many parents.
        config: not used here.

    Returns:
        Indices of the parents, [num].
    """
    del config
    k_spin, k_shuffle = jax.random.split(key)
    pointers = (jnp.arange(num) + jax.random.uniform(k_spin)) / num
    return jax.random.permutation(k_shuffle, _spin(_wheel(fitness), pointers))


def select_rank(
    key: Key[Array, ""], fitness: Float[Array, " P"], num: int, config: GAConfig
) -> Int[Array, " num"]:
    """Linear ranking: the best expects rank_pressure copies, the worst 2 - rank_pressure.

    Args:
        key: random key.
        fitness: [P].
        num: how many parents.
        config: holds rank_pressure.

    Returns:
        Indices of the parents, [num].
    """
    size = fitness.shape[0]
    rank = jnp.argsort(jnp.argsort(fitness))  # 0 is the worst
    low = 2 - config.rank_pressure
    weight = low + (config.rank_pressure - low) * rank / max(size - 1, 1)
    return _spin(_wheel(weight), jax.random.uniform(key, (num,)))


def select_tournament(
    key: Key[Array, ""], fitness: Float[Array, " P"], num: int, config: GAConfig
) -> Int[Array, " num"]:
    """The best of tournament_size genomes drawn with replacement.

    Args:
        key: random key.
        fitness: [P].
        num: how many parents.
        config: holds tournament_size.

    Returns:
        Indices of the parents, [num].
    """
    rivals = jax.random.randint(key, (num, config.tournament_size), 0, fitness.shape[0])
    winner = jnp.argmax(fitness[rivals], axis=1)
    return jnp.take_along_axis(rivals, winner[:, None], axis=1)[:, 0]


def select_truncation(
    key: Key[Array, ""], fitness: Float[Array, " P"], num: int, config: GAConfig
) -> Int[Array, " num"]:
    """Uniform among the best truncation_share of the population (at least one genome).

    Args:
        key: random key.
        fitness: [P].
        num: how many parents.
        config: holds truncation_share.

    Returns:
        Indices of the parents, [num].
    """
    size = fitness.shape[0]
    breeders = jnp.maximum(jnp.round(config.truncation_share * size), 1)
    pick = jnp.floor(jax.random.uniform(key, (num,)) * breeders).astype(int)
    return jnp.argsort(-fitness)[jnp.minimum(pick, size - 1)]


SELECTIONS: dict[str, SelectionFn] = {
    "roulette": select_roulette,
    "sus": select_sus,
    "rank": select_rank,
    "tournament": select_tournament,
    "truncation": select_truncation,
}


def _wheel(weight):
    """Cumulative probabilities [P]; uniform where no weight is positive."""
    weight = jnp.maximum(weight, 0)
    # Divided by the largest first: a sum of huge fitness values must not overflow.
    weight = weight / jnp.maximum(jnp.max(weight), 1e-30)
    weight = jnp.where(jnp.max(weight) > 0, weight, jnp.ones_like(weight))
    edges = jnp.cumsum(weight)
    return edges / edges[-1]


def _spin(wheel, u):
    # The last edge is left out: rounding must not select beyond the end.
    return jnp.sum(u[:, None] >= wheel[None, :-1], axis=1)


def crossover(
    key: Key[Array, ""], a: Bool[Array, " L"], b: Bool[Array, " L"], num_points: int, rate: float
) -> tuple[Bool[Array, " L"], Bool[Array, " L"]]:
    """Exchange every second piece between num_points distinct random cuts.

    Args:
        key: random key.
        a: genome of a parent, bool [L].
        b: genome of the other.
        num_points: number of cuts.
        rate: probability that it happens; else the children are the parents.

    Returns:
        Two children, bool [L] each.
    """
    k_cuts, k_rate = jax.random.split(key)
    cuts = crossover_cuts(k_cuts, num_points, a.shape[0])
    swap = jnp.sum(jnp.arange(a.shape[0])[:, None] >= cuts[None, :], axis=1) % 2 == 1
    swap &= jax.random.uniform(k_rate) < rate
    return jnp.where(swap, b, a), jnp.where(swap, a, b)


def crossover_cuts(key: Key[Array, ""], num_points: int, length: int) -> Int[Array, " points"]:
    """Sorted distinct cut positions, uniform over 1 .. length - 1.

    Args:
        key: random key.
        num_points: how many.
        length: of the genome, bits.
    """
    keys = jax.random.split(key, max(num_points, 1))
    cuts = jnp.zeros((0,), int)
    for n in range(num_points):
        # The n-th free position: step over the cuts already taken, in rising order.
        cut = jax.random.randint(keys[n], (), 1, length - n)
        for m in range(n):
            cut = cut + (cut >= cuts[m])
        cuts = jnp.sort(jnp.append(cuts, cut))
    return cuts


def mutate(key: Key[Array, ""], bits: Bool[Array, "..."], rate: float) -> Bool[Array, "..."]:
    """Flip every bit independently.

    Args:
        key: random key.
        bits: bool, of any shape.
        rate: probability of a flip.
    """
    return bits ^ (jax.random.uniform(key, bits.shape) < rate)


class State(NamedTuple):
    """Everything a run needs to go on.  best_*: best finite genome of all generations."""

    bits: Bool[Array, "P L"]
    key: Key[Array, ""]
    generation: Int[Array, ""]
    best_bits: Bool[Array, " L"]
    best_fitness: Float[Array, ""]
    memory: Any = ()  # of the task


class Record(NamedTuple):
    """One generation in the history.  best_bits is this generation's best genome."""

    best: Float[Array, ""]
    mean: Float[Array, ""]
    num_nonfinite: Int[Array, ""]
    best_bits: Bool[Array, " L"]


def init(
    key: Key[Array, ""],
    num_genes: int,
    config: GAConfig,
    ranges: Float[Array, "genes 2"] | None = None,
) -> State:
    """A uniformly random population.

    Args:
        key: random key: also of all that follows from this state.
        num_genes: genes of a genome.
        config: genetic algorithm.
        ranges: [genes, 2], least and largest value that a gene starts from; None for any genome.
    """
    k_bits, k_run = jax.random.split(key)
    length = num_genes * config.num_bits
    if ranges is None:
        bits = jax.random.bernoulli(k_bits, 0.5, (config.population, length))
    else:
        share = jax.random.uniform(k_bits, (config.population, num_genes))
        theta = ranges[:, 0] + share * (ranges[:, 1] - ranges[:, 0])
        bits = genome.encode(theta, config.num_bits, config.gray)
    return State(
        bits=bits,
        key=k_run,
        generation=jnp.zeros((), int),
        best_bits=jnp.zeros((length,), bool),
        best_fitness=jnp.asarray(-jnp.inf, jnp.float32),  # not weak: a second call compiles nothing
    )


def reproduce(
    key: Key[Array, ""],
    bits: Bool[Array, "P L"],
    fitness: Float[Array, " P"],
    config: GAConfig,
    progress: float | Array = 0.0,
) -> Bool[Array, "P L"]:
    """The next population: select, cross neighbours, mutate, put the elite in front; every island
    by itself.

    Args:
        key: random key.
        bits: genomes, bool [P, L].
        fitness: [P], finite, >= 0.
        config: genetic algorithm.
        progress: share of the run that is over, 0 to 1, for the decay of the mutation rate.

    Returns:
        Genomes, bool [P, L].
    """
    rate = config.mutation_rate * config.mutation_decay**progress
    if config.num_islands == 1:
        return _breed(key, bits, fitness, config, rate)
    islands = (config.num_islands, -1)
    bred = jax.vmap(lambda k, b, f: _breed(k, b, f, config, rate))(
        jax.random.split(key, config.num_islands),
        bits.reshape(*islands, bits.shape[-1]),
        fitness.reshape(islands),
    )
    return bred.reshape(bits.shape)


def _breed(key, bits, fitness, config, rate):
    k_select, k_cross, k_mutate = jax.random.split(key, 3)
    size = bits.shape[0]
    parents = bits[SELECTIONS[config.selection](k_select, fitness, size, config)]
    cross = jax.vmap(lambda k, a, b: crossover(k, a, b, config.num_points, config.crossover_rate))
    pair = cross(jax.random.split(k_cross, size // 2), parents[: size // 2], parents[size // 2 :])
    children = mutate(k_mutate, jnp.concatenate(pair), rate)
    by_rank = bits[jnp.argsort(-fitness)]
    return jnp.where(jnp.arange(size)[:, None] < config.num_elites, by_rank, children)


def generation(
    state: State, fitness_fn: FitnessFn, config: GAConfig, horizon: float | Array
) -> tuple[State, Record]:
    """Evaluate the population, then `advance`.

    Args:
        state: of the run.
        fitness_fn: (key, theta [P, genes]) -> fitness [P], maximised.
        config: genetic algorithm.
        horizon: generations that `config.mutation_decay` refers to, > 0.

    Returns:
        The state one generation later, and the record of this one.
    """
    theta = genome.decode(state.bits, config.num_bits, config.gray)
    return advance(state, fitness_fn(fitness_key(state), theta), config, horizon)


def fitness_key(state: State) -> Key[Array, ""]:
    """What this generation's fitness may draw from.

    Args:
        state: before the generation.
    """
    return jax.random.split(jax.random.fold_in(state.key, state.generation))[0]


def advance(
    state: State, raw: Float[Array, " P"], config: GAConfig, horizon: float | Array
) -> tuple[State, Record]:
    """Record a population, breed the next.

    Args:
        state: of the run.
        raw: fitness of its population, maximised.  What is not finite counts as 0, is never best,
            and is counted.
        config: genetic algorithm.
        horizon: as of `generation`.

    Returns:
        The state one generation later, and the record of this one.
    """
    k_reproduce = jax.random.split(jax.random.fold_in(state.key, state.generation))[1]
    finite = jnp.isfinite(raw)
    fitness = jnp.where(finite, raw, 0)
    champion = jnp.argmax(jnp.where(finite, raw, -jnp.inf))
    champion_fitness = jnp.where(finite[champion], raw[champion], -jnp.inf)
    better = champion_fitness > state.best_fitness
    record = Record(
        best=fitness[champion],
        mean=jnp.mean(fitness),
        num_nonfinite=jnp.sum(~finite),
        best_bits=state.bits[champion],
    )
    new = State(
        bits=reproduce(k_reproduce, state.bits, fitness, config, state.generation / horizon),
        key=state.key,
        generation=state.generation + 1,
        best_bits=jnp.where(better, state.bits[champion], state.best_bits),
        best_fitness=jnp.where(better, champion_fitness, state.best_fitness),
        memory=state.memory,
    )
    return new, record
