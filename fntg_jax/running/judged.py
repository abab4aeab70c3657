"""The result of a task with a judgement: best of the last population on draws of its own, then
refined by covariance matrix adaptation, then judged once more."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from fntg_jax.controller import genome
from fntg_jax.learning import cma
from fntg_jax.running.final_choice import JUDGE, Evolved, Result
from fntg_jax.running.parallel import over_seeds

_CHOICE, _REPORT, _STRENGTH, _VALIDATION = range(4)  # draws of a judgement
_VALIDATE_EVERY = 10  # steps of the refinement


def conclude(
    evolved: Evolved, champions: np.ndarray, show: Callable[[int, int, float], None]
) -> Result:
    """Choose, refine and judge, for every seed.

    champions: genomes, [S, generations, length], the best of each generation.  show: as of
    `final_choice.conclude`.
    """
    problem, rows, coding = evolved.problem, evolved.rows, evolved.problem.config.ga
    config, task = problem.config, problem.task
    assert task is not None and task.judge is not None
    judge = task.judge
    names: list[str] = []

    def one_seed(draw, state, theta):
        key = jax.random.split(jax.random.fold_in(state.key, JUDGE), 4)[draw]
        numbers = judge(key, problem.in_units(theta), state.memory)
        names[:] = numbers  # jax would sort a dict by its names
        return list(numbers.values())

    program: Any = None

    def numbers_of(draw: int, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Judgements of theta [S, population, genes] in (-5, 5): numbers [S, population] by name.
        One program serves all: compiling a match takes longer than judging in some."""
        nonlocal program
        arguments = np.int32(draw), (evolved.state, rows.place(theta))
        if program is None:
            program = rows.compile(jax.jit(over_seeds(one_seed, rows.mesh)), arguments)
        return dict(zip(names, rows.gather(program(*arguments))))

    def mean_of(draw: int, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Judgements of theta [S, genes], each as often as there are genomes: means [S]."""
        many = np.repeat(theta[:, None], coding.population, axis=1)
        return {name: x.mean(axis=1) for name, x in numbers_of(draw, many).items()}

    def decode(bits):
        return np.asarray(genome.decode(bits, coding.num_bits, coding.gray))

    with problem.code():
        bits = rows.gather(evolved.state.bits)
        every = np.arange(rows.num)
        value = numbers_of(_CHOICE, decode(bits))["score"]
        best = np.argmax(np.where(np.isfinite(value), value, -np.inf), axis=1)
        theta, bits = decode(bits)[every, best], bits[every, best]
        value = np.nan_to_num(value[every, best], nan=0, posinf=0, neginf=0)  # as in evolution
        strength = None
        if task.relative:
            num = champions.shape[1]
            shown = np.unique(np.linspace(0, num - 1, coding.population).round().astype(int))
            padded = np.resize(shown, coding.population)
            scores = numbers_of(_STRENGTH, decode(champions[:, padded]))["score"]
            strength = shown + 1, scores[:, : len(shown)]
        refined = None
        if config.refine_steps:
            validate = lambda theta: mean_of(_VALIDATION, theta)["score"]  # noqa: E731
            theta, value, refined = _refined(evolved, theta, validate, show)
            bits = None
        judgement = mean_of(_REPORT, theta)
    return Result(np.asarray(problem.in_units(theta)), value, bits, refined, judgement, strength)


def _refined(evolved: Evolved, theta, validate, show):
    """CMA-ES from theta [S, genes]: the best validated means, their scores, all scores [S, n].

    A step is one population of the genetic algorithm's size under the fitness as it is at the end
    of evolution, memory included."""
    problem, rows, config = evolved.problem, evolved.rows, evolved.problem.config
    task = problem.task

    def one_seed(count, state, search):
        key = jax.random.fold_in(jax.random.fold_in(state.key, config.generations), count)
        k_fitness, k_samples = jax.random.split(key)

        def costs(x, k):
            return -task.fitness(k, problem.in_units(x), state.memory, 1.0)[0]

        step = cma.make_step(theta.shape[1], config.ga.population, costs)
        return step(k_samples, search, k_fitness, count)[0]

    program: Any = jax.jit(over_seeds(one_seed, rows.mesh))
    search = rows.place(theta, jax.vmap(lambda x: cma.init(x, cma.SIGMA)))
    best, score = theta, validate(theta)
    history = [score]
    for n in range(config.refine_steps):
        arguments = np.int32(n), (evolved.state, search)
        if n == 0:
            program = rows.compile(program, arguments)
        search = program(*arguments)
        if (n + 1) % _VALIDATE_EVERY and n + 1 < config.refine_steps:
            continue
        mean = np.asarray(cma.inside(rows.gather(search.mean)))
        found = validate(mean)
        history.append(found)
        better = found > score  # never with NaN
        best, score = np.where(better[:, None], mean, best), np.where(better, found, score)
        show(n + 1, config.refine_steps, float(np.median(score)))
    return best, score, np.stack(history, axis=1)
