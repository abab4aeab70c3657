"""Optimisers of the FNTG's genes, on one footing: our genetic algorithm, gradients, evosax.

A `Search` is a start and an iteration; every iteration draws scenes anew from one pool and uses the
smooth objective.  All start in a fuzzy partition (`Layout.partition`), but for the paper's own
settings, which start anywhere.  Each names a champion; at a checkpoint the last 16 champions (for a
distribution also its mean) meet on validation scenes, and the best goes to the unseen ones.  That
choice costs no budget, for anyone.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from fntg_jax.controller import genome
from fntg_jax.controller.layout import HIGH, LOW, Layout, get_layout
from fntg_jax.controller.network import Output
from fntg_jax.learning import cma, fitness, ga, gradient
from fntg_jax.learning.fitness import PaperWeights, SmoothWeights
from fntg_jax.learning.objective import Static, Traced, draw_scenes, score
from fntg_jax.learning.rollout import EPISODE_STEPS, rollout_pairs
from fntg_jax.running import evaluation, xla
from fntg_jax.running.registry import get_suite, get_world
from fntg_jax.running.settings import PRESETS

SUITES = ("open", "blocked")
_CHAMPIONS = 16
_VALIDATION = 1024  # scenes
_MIX = "open:2,blocked:3"  # training scenes, of the suites that are judged on
_LAYOUT = get_layout("paper-31")
_GENES = _LAYOUT.num_genes


@dataclasses.dataclass(frozen=True)
class Task:
    """What everyone learns and is judged on: open and blocked scenes, robust's objective.

    output: how genes are read; pool: training scenes; eval_scenes: unseen scenes a suite;
    num_scenes: trials of an individual.
    """

    output: Output = PRESETS["robust"].output
    pool: int = 16384
    eval_scenes: int = 1000
    num_scenes: int = 32

    @cached_property
    def world(self) -> Any:
        return get_world("kinematic")

    @cached_property
    def static(self) -> Static:
        return Static(_LAYOUT, self.output, "smooth", self.num_scenes, fresh=True)

    @cached_property
    def traced(self) -> Traced:
        scenes = get_suite(self.world, _MIX)(jax.random.key(1), self.pool)
        env = self.world.make()
        return Traced(ga.GAConfig(), env, PaperWeights(), SmoothWeights(), scenes)

    @cached_property
    def held_out(self) -> list[Any]:
        return [evaluation.held_out_scenes(self.world, s, self.eval_scenes) for s in SUITES]

    @cached_property
    def validation(self) -> Any:
        return get_suite(self.world, _MIX)(jax.random.key(2), _VALIDATION)

    @cached_property
    def _choose(self) -> Callable[..., Any]:
        @jax.jit
        def choose(theta, validation, held_out, traced):
            value = score(self.static, traced, theta, validation)
            order = jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf))
            best = theta[order[:1]]

            def success(scenes):
                outcome = rollout_pairs(_LAYOUT, best, scenes, traced.env, output=self.output)
                return jnp.mean(fitness.success(outcome).success)

            return theta[order], jnp.stack([success(s) for s in held_out])

        return choose

    def choose(self, theta: Any) -> tuple[Any, np.ndarray]:
        """theta, best validated first; success of the best on the unseen suites."""
        ordered, success = self._choose(theta, self.validation, self.held_out, self.traced)
        return ordered, np.asarray(success)


class Checkpoint(NamedTuple):
    """Control steps and seconds spent so far (without compilation), success by suite."""

    control_steps: int
    seconds: float
    success: Any  # [suite]


class Search(NamedTuple):
    """start: (key, theta of an earlier phase or None) -> state.  iterate: (key, state, iterations,
    cost_fn, draw) -> state, champion [genes]; iterations: of the whole phase.  mean:
    state -> theta [n, genes], further candidates.  steps: (num_scenes) -> control steps an
    iteration.  compiler_options: of its program."""

    start: Callable[..., Any]
    iterate: Callable[..., Any]
    mean: Callable[[Any], Any]
    steps: Callable[[int], int]
    compiler_options: dict[str, Any] | None = None


def partitions(key: Any, num: int, layout: Layout = _LAYOUT) -> Any:
    """num random fuzzy partitions [num, genes]."""
    low, high = layout.partition.T
    return jax.random.uniform(key, (num, layout.num_genes), minval=low, maxval=high)


def genetic(config: ga.GAConfig, ranges: Any = None) -> Search:
    """Our genetic algorithm, from genes between `ranges` [genes, 2], or any."""

    def start(key, theta):
        del theta
        return ga.init(key, _GENES, config, ranges)

    def iterate(key, state, iterations, cost_fn, draw):
        del key  # it draws its own, and decay goes by generation / horizon

        def fitness_fn(key, theta):
            return fitness.from_cost(cost_fn(theta, draw(key)))

        state, record = ga.generation(state, fitness_fn, config, iterations)
        return state, genome.decode(record.best_bits, config.num_bits, config.gray)

    return Search(
        start,
        iterate,
        lambda state: jnp.zeros((0, _GENES)),
        lambda n: config.population * n * EPISODE_STEPS,
    )


def gradients(num_starts: int, rate: float) -> Search:
    """Adam through the roll-out, from random starts or from the best of an earlier phase.

    An iteration costs three control steps for one: forward, forward again (checkpointing), and
    backward.
    """

    def start(key, theta):
        if theta is None:
            theta = partitions(key, num_starts)
        # The state does not depend on the length of the schedule.
        return theta[:num_starts], gradient.optimiser("adam", 1, rate).init(theta[:num_starts])

    def iterate(key, state, iterations, cost_fn, draw):
        theta, moments = state
        scenes = draw(key)

        def total(theta):  # nobody's cost depends on another's genes
            value = cost_fn(theta, scenes, checkpoint=True)
            return jnp.sum(value), value

        (_, value), slope = jax.value_and_grad(total, has_aux=True)(theta)
        slope = jnp.where(jnp.all(jnp.isfinite(slope), axis=1, keepdims=True), slope, 0)
        # Each start has its own clipping: one steep one must not stop the rest.
        norm = jnp.maximum(jnp.linalg.norm(slope, axis=1, keepdims=True), 1.0)
        updates, moments = gradient.optimiser("adam", iterations, rate).update(
            slope / norm, moments, theta
        )
        new = jnp.clip(optax.apply_updates(theta, updates), LOW, HIGH)
        return (new, moments), theta[jnp.argmin(value)]

    return Search(
        start,
        iterate,
        lambda s: s[0],
        lambda n: 3 * num_starts * n * EPISODE_STEPS,
        xla.GRADIENT_OPTIONS,
    )


def covariance(sigma: float, population: int = 48, batches: int = 2) -> Search:
    """Our covariance matrix adaptation, from the best of an earlier phase, on as many
    scenes a step as `batches` draws give: 64, as in the preset robust."""

    def start(key, theta):
        del key
        return cma.init(theta[0], sigma), jnp.asarray(0)

    def iterate(key, state, iterations, cost_fn, draw):
        del iterations
        search, count = state
        k_scenes, k_samples = jax.random.split(key)
        parts = [draw(k) for k in jax.random.split(k_scenes, batches)]
        scenes = jax.tree.map(lambda *x: jnp.concatenate(x), *parts)
        step = cma.make_step(_GENES, population, lambda theta, s: cost_fn(theta, s))
        search, _ = step(k_samples, search, scenes, count)
        return (search, count + 1), cma.inside(search.mean)

    return Search(
        start,
        iterate,
        lambda state: cma.inside(state[0].mean)[None],
        lambda n: population * batches * n * EPISODE_STEPS,
    )


def evosax_search(algorithm: Any, params: Any, population: int, distribution: bool) -> Search:
    """An algorithm of evosax; genes are clipped where they are evaluated."""

    def start(key, theta):
        del theta
        first = partitions(key, population)
        if distribution:
            return algorithm.init(key, first[0], params)
        return algorithm.init(key, first, jnp.arange(population, dtype=jnp.float32), params)

    def iterate(key, state, iterations, cost_fn, draw):
        del iterations
        k_ask, k_scenes, k_tell = jax.random.split(key, 3)
        theta, state = algorithm.ask(k_ask, state, params)
        inside = jnp.clip(theta, LOW, HIGH)
        cost = cost_fn(inside, draw(k_scenes))
        state, _ = algorithm.tell(k_tell, theta, cost, state, params)
        return state, inside[jnp.argmin(cost)]

    def mean(state):
        if not distribution:
            return jnp.zeros((0, _GENES))
        return jnp.clip(algorithm.get_mean(state), LOW, HIGH)[None]

    return Search(start, iterate, mean, lambda n: population * n * EPISODE_STEPS)


def searches() -> dict[str, list[tuple[Search, float]]]:
    """name -> phases, each with its share of the budget.

    Raises ModuleNotFoundError where evosax is not installed.
    """
    from evosax.algorithms import CMA_ES, Open_ES, SimpleGA

    robust = genetic(PRESETS["robust"].ga, _LAYOUT.partition)
    zero = jnp.zeros(_GENES)
    adapt, simple = CMA_ES(64, zero), SimpleGA(256, zero, std_schedule=_decay(0.5))
    open_es = Open_ES(256, zero, optimizer=optax.adam(0.05), std_schedule=_decay(0.5))
    wide = adapt.default_params.replace(std_init=jnp.asarray(1.0))
    crossed = simple.default_params.replace(crossover_rate=0.5)
    return {
        "ga-paper": [(genetic(ga.GAConfig()), 1.0)],
        "ga-robust": [(robust, 1.0)],
        # The preset's phases at their shares, with a quarter of its samples a step of refinement:
        # on a fifth of its control steps that leaves nearly as many such steps as it has.
        "ga-refined": [(robust, 0.21), (covariance(0.5), 0.79)],
        "ga-gradient": [(robust, 0.7), (gradients(4, 0.003), 0.3)],
        "gradient": [(gradients(16, 0.03), 1.0)],
        "cma-es": [(evosax_search(adapt, wide, 64, True), 1.0)],
        "open-es": [(evosax_search(open_es, open_es.default_params, 256, True), 1.0)],
        "simple-ga": [(evosax_search(simple, crossed, 256, False), 1.0)],
    }


def _decay(start: float) -> Callable[[Any], Any]:
    """A step size that falls geometrically by half in a hundred generations, down to 0.05."""
    return lambda n: jnp.maximum(start * 0.5 ** (n / 100), 0.05)


def _blocks(phases: Any, task: Task, budget: int, checkpoints: int) -> Iterator[tuple]:
    for search, share in phases:
        each = search.steps(task.num_scenes)
        iterations = max(1, round(share * budget / each))
        most = min(iterations, max(1, round(checkpoints * share)))
        # Blocks are of one length; as many as leave no more than a tenth of the budget unspent.
        num = max(n for n in range(1, most + 1) if n * (iterations // n) >= 0.9 * iterations)
        yield search, num, iterations // num, each


def train(name: str, phases: Any, task: Task, seed: int, budget: int, checkpoints: int):
    """Yield a `Checkpoint` after each share of the budget; seconds exclude compilation."""
    key, theta = jax.random.key(seed), None
    spent, seconds = 0, 0.0
    plan = list(_blocks(phases, task, budget, checkpoints))
    for phase, (search, num, length, each) in enumerate(plan):
        state = jax.jit(search.start)(jax.random.fold_in(key, phase), theta)
        run = _compiled(name, phase, search, task, num, length, state)
        for block in range(num):
            begin = time.perf_counter()
            first = jnp.asarray(block * length)
            state, champions = jax.block_until_ready(
                run(state, jax.random.fold_in(key, 1000 * (phase + 1)), first, task.traced)
            )
            seconds += time.perf_counter() - begin
            spent += length * each
            theta, success = task.choose(champions)
            yield Checkpoint(spent, seconds, success)


_programs: dict[tuple, Any] = {}


def _compiled(name, phase, search, task, num, length, state):
    """The program of a block: compiled once for all seeds."""
    which = (name, phase, task, num, length)
    if which not in _programs:
        _programs[which] = (
            jax.jit(partial(_block, search=search, task=task, num=num, length=length))
            .lower(state, jax.random.key(0), jnp.asarray(0), task.traced)
            .compile(compiler_options=search.compiler_options)
        )
    return _programs[which]


def _block(state, key, first, traced, *, search, task, num, length):
    def cost_fn(theta, scenes, **options):
        return fitness.to_cost(score(task.static, traced, theta, scenes, **options))

    def iterate(state, n):
        draw = partial(draw_scenes, task.static, traced)
        k = jax.random.fold_in(key, n)
        return search.iterate(k, state, num * length, cost_fn, draw)

    state, champions = jax.lax.scan(iterate, state, first + jnp.arange(length))
    # Always as many candidates: short blocks repeat theirs.
    candidates = jnp.concatenate([search.mean(state), champions[::-1]])
    pick = jnp.arange(_CHAMPIONS) % candidates.shape[0]
    return state, candidates[pick]
