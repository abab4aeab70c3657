import json
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fntg_jax.controller import genome
from fntg_jax.learning import ga

FITNESS = np.asarray([0.0, 1.0, 2.0, 3.0, 0.5, 10.0, 1.5, 2.0], np.float32)
SIZE = len(FITNESS)


def config(**fields):
    return ga.GAConfig(**{"population": SIZE, **fields})


def selected(name, num_keys=2000, num=10, fitness=FITNESS, **fields):
    """Parents' indices [keys, num]."""
    keys = jax.random.split(jax.random.key(1), num_keys)
    choose = partial(ga.SELECTIONS[name], num=num, config=config(**fields))
    return np.asarray(jax.jit(jax.vmap(lambda k: choose(k, jnp.asarray(fitness))))(keys))


def fits(indices, expected):
    """Chi-square test of how often each genome was chosen; certain zeros must be zeros."""
    counts = np.bincount(indices.ravel(), minlength=len(expected))
    expected = np.asarray(expected, float)
    possible = expected > 0
    assert counts[~possible].sum() == 0
    expected = expected[possible] / expected.sum() * counts.sum()
    return stats.chisquare(counts[possible], expected).pvalue > 1e-4


def test_roulette_is_proportional_to_fitness():
    assert fits(selected("roulette"), FITNESS)
    assert fits(selected("roulette", fitness=FITNESS * 1e30), FITNESS)
    assert fits(selected("roulette", fitness=0 * FITNESS), np.ones(SIZE))


def test_sus_takes_everyone_between_floor_and_ceiling_of_his_share():
    chosen = selected("sus", num=SIZE)
    counts = np.stack([np.bincount(row, minlength=SIZE) for row in chosen])
    share = FITNESS / FITNESS.sum() * SIZE
    near = 1e-5  # where a share is a whole number, rounding may move one pointer
    assert (counts >= np.floor(share - near)).all()
    assert (counts <= np.ceil(share + near)).all()
    np.testing.assert_allclose(counts.mean(0), share, atol=0.06)
    assert (np.diff(chosen) >= 0).all(1).mean() < 0.1  # shuffled


def test_rank_expectations_are_linear():
    ranks = np.asarray([0, 2, 4.5, 6, 1, 7, 3, 4.5])  # the two 2.0 share places 4 and 5
    chosen = selected("rank", rank_pressure=1.6)
    counts = np.bincount(chosen.ravel(), minlength=SIZE)
    counts[[2, 7]] = counts[[2, 7]].mean()
    expected = (0.4 + 1.2 * ranks / 7) / SIZE
    np.testing.assert_allclose(counts / chosen.size, expected, atol=5 * 0.5 / np.sqrt(chosen.size))


def test_tournament_probabilities():
    """Rank r of n wins size-s tournaments with ((r+1)^s - r^s) / n^s."""
    fitness = np.arange(SIZE, dtype=np.float32)[::-1]
    rank = np.arange(SIZE)[::-1]
    for size in (1, 2, 4):
        chosen = selected("tournament", fitness=fitness, tournament_size=size)
        assert fits(chosen, (rank + 1.0) ** size - rank**size)


def test_truncation_is_uniform_over_the_best():
    best = np.isin(np.arange(SIZE), np.argsort(-FITNESS, kind="stable")[:2])
    assert fits(selected("truncation", truncation_share=0.25), best)
    assert fits(selected("truncation", truncation_share=1.0), np.ones(SIZE))
    assert set(np.unique(selected("truncation", truncation_share=1e-6))) == {5}


@pytest.mark.parametrize("points", [1, 3])
def test_crossover_cuts_are_distinct_and_uniform(points):
    keys, length = jax.random.split(jax.random.key(3), 6000), 12
    cuts = np.asarray(
        jax.jit(jax.vmap(partial(ga.crossover_cuts, num_points=points, length=length)))(keys)
    )
    assert (np.diff(cuts) > 0).all()
    assert cuts.min() == 1
    assert cuts.max() == length - 1
    counts = np.bincount(cuts.ravel(), minlength=length)[1:]
    assert stats.chisquare(counts).pvalue > 1e-4
    if points == 3:  # every one of the 165 sets equally often
        sets = np.unique(cuts, axis=0, return_counts=True)[1]
        assert len(sets) == 165
        assert stats.chisquare(sets).pvalue > 1e-4


def test_crossover_exchanges_every_second_piece():
    a, b = jnp.zeros(40, bool), jnp.ones(40, bool)
    cross = jax.jit(
        jax.vmap(lambda k: (*ga.crossover(k, a, b, 3, 1.0), *ga.crossover(k, a, b, 3, 0.5)))
    )
    first, second, sometimes, _ = (
        np.asarray(x) for x in cross(jax.random.split(jax.random.key(0), 500))
    )
    assert (first ^ second).all()
    assert (np.diff(first.astype(int), axis=1) != 0).sum(1).tolist() == [3] * 500
    assert not first[:, 0].any()  # the first piece stays
    crossed = sometimes.any(1)
    assert stats.binomtest(int(crossed.sum()), 500, 0.5).pvalue > 1e-4
    np.testing.assert_array_equal(sometimes[crossed], first[crossed])


@pytest.mark.parametrize("rate", [0.0, 0.001, 0.3, 1.0])
def test_mutation_flips_at_its_rate(rate):
    bits = jnp.arange(200_000) % 2 == 0
    flipped = np.asarray(ga.mutate(jax.random.key(1), bits, rate) ^ bits)
    assert stats.binomtest(int(flipped.sum()), flipped.size, rate).pvalue > 1e-4


# A plain Python genetic algorithm that consumes the same draws.


def plain_generation(bits, fitness_of, key, number, c):
    """Lists of 0 and 1; the draws come from the same keys, all else is loops."""
    k_fitness, k_reproduce = jax.random.split(jax.random.fold_in(key, number))
    k_select, k_cross, k_mutate = jax.random.split(k_reproduce, 3)
    raw = fitness_of(k_fitness, bits)
    fitness = [float(f) if np.isfinite(f) else 0.0 for f in raw]
    size, length = len(bits), len(bits[0])
    order = sorted(range(size), key=lambda n: (-fitness[n], n))
    if c.selection == "roulette":
        parents = []
        for u in np.asarray(jax.random.uniform(k_select, (size,))):
            aim, n = float(u) * sum(fitness), 0
            while n < size - 1 and aim >= sum(fitness[: n + 1]):
                n += 1
            parents.append(n)
    else:
        rivals = np.asarray(jax.random.randint(k_select, (size, c.tournament_size), 0, size))
        parents = [max(row.tolist(), key=lambda n: fitness[n]) for row in rivals]
    firsts, seconds = [], []
    for n, k in enumerate(jax.random.split(k_cross, size // 2)):
        a, b = list(bits[parents[n]]), list(bits[parents[n + size // 2]])
        k_cuts, k_rate = jax.random.split(k)
        if float(jax.random.uniform(k_rate)) < c.crossover_rate:
            free, cuts = list(range(1, length)), []
            for m, kc in enumerate(jax.random.split(k_cuts, max(c.num_points, 1))):
                cuts.append(free.pop(int(jax.random.randint(kc, (), 1, length - m)) - 1))
            for cut in cuts:  # swapping tails at every cut exchanges every second piece
                a[cut:], b[cut:] = b[cut:], a[cut:]
        firsts.append(a)
        seconds.append(b)
    children = firsts + seconds
    draws = np.asarray(jax.random.uniform(k_mutate, (size, length)))
    rate = np.float32(c.mutation_rate)
    for n in range(size):
        for m in range(length):
            children[n][m] ^= int(draws[n, m] < rate)
    for n in range(c.num_elites):
        children[n] = list(bits[order[n]])
    return children, max(f for f in raw if np.isfinite(f)), sum(fitness) / size


@pytest.mark.parametrize("selection", ["roulette", "tournament"])
def test_against_a_plain_genetic_algorithm_of_the_same_draws(selection):
    c = ga.GAConfig(
        population=8,
        num_bits=4,
        selection=selection,
        tournament_size=3,
        crossover_rate=0.7,
        mutation_rate=0.02,
        num_elites=2,
    )

    def fitness_fn(key, theta):
        noise = jax.random.uniform(key, (theta.shape[0],))
        value = 1 + noise + jnp.sum(theta**2, axis=1)
        return jnp.where(noise > 0.8, jnp.nan, value)

    def fitness_of(key, bits):
        return np.asarray(fitness_fn(key, genome.decode(np.asarray(bits, bool), 4)))

    state = ga.init(jax.random.key(5), 3, c)
    step = jax.jit(lambda s: ga.generation(s, fitness_fn, c, 4))
    bits = np.asarray(state.bits).astype(int).tolist()
    nonfinite = 0
    for number in range(4):
        bits, best, mean = plain_generation(bits, fitness_of, state.key, number, c)
        state, record = step(state)
        np.testing.assert_array_equal(np.asarray(state.bits).astype(int), bits)
        assert float(record.best) == pytest.approx(best)
        assert float(record.mean) == pytest.approx(mean, rel=1e-5)
        nonfinite += int(record.num_nonfinite)
    assert nonfinite > 0


def ones(key, theta):
    del key
    return jnp.mean(theta, axis=1) / 10 + 0.5  # num_bits = 1: the share of ones


def sphere(key, theta):
    del key
    return 1 / (0.01 + jnp.sum((theta - 1.5) ** 2, axis=1))


def evolve(state, fitness_fn, c, num):
    step = lambda s, _: ga.generation(s, fitness_fn, c, num)  # noqa: E731
    return jax.lax.scan(step, state, None, length=num)


def run(fitness_fn, c, genes, generations, key=0):
    state = ga.init(jax.random.key(key), genes, c)
    state, record = jax.jit(lambda s, c: evolve(s, fitness_fn, c, generations))(state, c)
    state = state._replace(key=jax.random.key_data(state.key))
    return jax.tree.map(np.asarray, (state, record))


@pytest.mark.parametrize("selection", list(ga.SELECTIONS))
def test_onemax_converges_monotonically_under_an_elite(selection):
    c = ga.GAConfig(num_bits=1, selection=selection, mutation_rate=0.01, num_elites=2)
    state, record = run(ones, c, 40, 150)
    assert (np.diff(record.best) >= 0).all()
    start = record.mean[0]
    # Roulette hardly tells 0.9 from 1.0; the others reach all ones.
    assert record.best[-1] >= (0.9 if selection in ("roulette", "sus") else 1.0)
    assert start < 0.6
    assert state.best_fitness == record.best.max()
    assert (state.best_bits == record.best_bits[record.best.argmax()]).all()


@pytest.mark.parametrize("gray", [False, True])
def test_sphere_converges(gray):
    c = ga.GAConfig(gray=gray, selection="tournament", mutation_rate=0.01)
    state, record = run(sphere, c, 4, 150)
    theta = np.asarray(genome.decode(state.best_bits, 15, gray))
    assert np.abs(theta - 1.5).max() < 0.4
    assert record.best[-1] > 10 * record.best[0]
    assert (np.diff(record.best) >= 0).all()


def test_without_an_elite_the_best_may_be_lost():
    c = ga.GAConfig(num_bits=1, num_elites=0, mutation_rate=0.2)
    assert (np.diff(run(ones, c, 40, 30)[1].best) < 0).any()


def test_elites_are_kept_unchanged_and_in_order():
    c = config(num_elites=3, mutation_rate=0.5)
    bits = jax.random.bernoulli(jax.random.key(0), 0.5, (SIZE, 30))
    new = ga.reproduce(jax.random.key(1), bits, jnp.asarray(FITNESS), c)
    best = np.argsort(-FITNESS, kind="stable")
    np.testing.assert_array_equal(new[:3], bits[best[:3]])
    assert not (np.asarray(new[3]) == np.asarray(bits)).all(1).any()


def test_nan_populations_are_counted_and_recover():
    """The first generations give nothing but NaN and infinity."""

    def fitness_fn(key, theta):
        good = ones(key, theta)
        # Everything is lost unless the (fitness-independent) key says otherwise.
        lost = jax.random.uniform(key) < 0.5
        return jnp.where(lost, jnp.where(theta[:, 0] > 0, jnp.nan, jnp.inf), good)

    c = ga.GAConfig(population=20, num_bits=1, mutation_rate=0.01)
    state, record = run(fitness_fn, c, 20, 30)
    lost = record.num_nonfinite == 20
    assert 0 < lost.sum() < 30
    assert set(record.num_nonfinite) == {0, 20}
    assert (record.best[lost] == 0).all()
    assert (record.mean[lost] == 0).all()
    assert (record.best[~lost] > 0).all()
    assert state.best_fitness == record.best.max()
    assert np.isfinite(state.best_fitness)
    state, record = run(lambda k, t: jnp.full(t.shape[0], jnp.nan), c, 20, 3)
    assert (record.num_nonfinite == 20).all()
    assert state.best_fitness == -np.inf
    assert 0 < state.bits.mean() < 1  # still a population


def test_floats_do_not_compile_twice():
    traces = []

    @jax.jit
    def two(state, c):
        traces.append(1)
        return evolve(state, ones, c, 2)

    kinds = {"mutation_rate": 0.1, "crossover_rate": 0.3, "num_elites": 4, "rank_pressure": 1.1}
    base = config(num_bits=1, selection="rank")
    state = ga.init(jax.random.key(0), 12, base)
    results = [two(state, base)[0].bits]
    for name, value in kinds.items():
        results.append(two(state, config(num_bits=1, selection="rank", **{name: value}))[0].bits)
    assert len(traces) == 1
    assert any((results[0] != other).any() for other in results[1:])
    two(state, config(num_bits=1, selection="sus"))
    assert len(traces) == 2  # a static field does


def test_the_second_generation_does_not_compile():
    c = config(num_bits=1)
    step = jax.jit(lambda s: ga.generation(s, ones, c, 3)[0])
    state = ga.init(jax.random.key(0), 12, c)
    for _ in range(3):
        state = step(state)
    assert step._cache_size() == 1


SEEDS = """
import json, jax
import numpy as np
from fntg_jax.running.runner import train
from fntg_jax.running.settings import TrainConfig
from fntg_jax.learning.ga import GAConfig
def result(first, seeds):
    config = TrainConfig(seeds=seeds, first_seed=first, generations=4, ga=GAConfig(population=6))
    run = train(config)
    h = run.history()
    bits = np.asarray(run.now.population.bits)[:seeds]
    return [[b.tobytes().hex(), m.tobytes().hex(), np.packbits(x).tobytes().hex()]
            for b, m, x in zip(h.best, h.mean, bits)]
batch = result(7, 3)
alone = result(8, 1)[0] if jax.local_device_count() == 1 else None
print(json.dumps([jax.local_device_count(), batch, alone]))
"""


@pytest.mark.slow
def test_seeds_side_by_side_equal_single_runs_bit_for_bit(python):
    """Alone, in one batch, and (padded) over two devices."""
    one, batch, alone = json.loads(python(SEEDS))
    assert one == 1
    assert batch[1] == alone
    assert batch[0] != batch[1] != batch[2]
    flags = "--xla_force_host_platform_device_count=2"
    two, sharded, _ = json.loads(python(SEEDS, XLA_FLAGS=flags))
    assert two == 2
    assert sharded == batch


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"population": -60}, "ga.population = -60.*even"),
        ({"population": 7}, "ga.population = 7.*even"),
        ({"num_elites": -1}, "ga.num_elites = -1.*from 0"),
        ({"num_elites": SIZE}, f"ga.num_elites = {SIZE}.*to {SIZE - 1}"),
        ({"num_elites": 1.5}, "ga.num_elites = 1.5"),
        ({"selection": "lottery"}, "ga.selection = 'lottery'.*roulette"),
        ({"mutation_rate": 1.1}, "ga.mutation_rate = 1.1.*0 to 1"),
        ({"mutation_rate": float("nan")}, "ga.mutation_rate = nan"),
        ({"num_bits": 25}, "ga.num_bits = 25.*1 to 24"),
        ({"rank_pressure": 2.5}, "ga.rank_pressure = 2.5.*1 to 2"),
        ({"truncation_share": 0.0}, "ga.truncation_share = 0.0.*above 0"),
        ({"tournament_size": SIZE + 1}, "ga.tournament_size"),
        ({"num_points": -1}, "ga.num_points = -1"),
    ],
)
def test_bad_settings_are_refused_by_name(fields, message):
    ga.validate(config())
    with pytest.raises(ValueError, match=message):
        ga.validate(config(**fields))
