"""The runner: evolution in jitted chunks, with progress, checkpoints and a run folder.

All seeds advance together, one chunk of generations at a time: first a single one, then as many
as take about a second.  One compiled call serves chunks of every length.  A seed's result depends
neither on these lengths, nor on how many run beside it, nor on the devices (`parallel`).
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Task
from fntg_jax.controller import genome
from fntg_jax.learning import ga
from fntg_jax.learning.objective import Traced
from fntg_jax.learning.rollout import EPISODE_STEPS
from fntg_jax.running import final_choice, hosts, judged, memory, warmstart
from fntg_jax.running.final_choice import Evolved, Result
from fntg_jax.running.parallel import Rows, make_mesh, over_seeds
from fntg_jax.running.problem import Problem, resolve
from fntg_jax.running.settings import TrainConfig


class History(NamedTuple):
    """What evolution recorded, NumPy, leading axes (seed, generation).

    best, mean: fitness of the generation; num_nonfinite: genomes without finite fitness;
    best_bits: the generation's best genome, [seed, generation, length].
    """

    best: np.ndarray
    mean: np.ndarray
    num_nonfinite: np.ndarray
    best_bits: np.ndarray


class Progress(NamedTuple):
    """How far a run is: generations done and wanted; best and mean fitness of the newest
    generation, medians over seeds; seconds since evolution began and control steps so far."""

    generation: int
    generations: int
    best: float
    mean: float
    seconds: float
    control_steps: int
    num_nonfinite: int = 0


class RunState(NamedTuple):
    """What changes while a run advances; all the rest follows from its problem.

    population: of all rows, on the devices.  records: one for each chunk.  chunk: generations of
    the next.  compile_seconds, run_seconds: so far.
    """

    population: ga.State
    records: tuple[History, ...] = ()
    chunk: int = 1
    compile_seconds: float = 0.0
    run_seconds: float = 0.0


_MEMORY = 0x3E3  # folded into a seed's key, for the memory of its task
_MAX_CHUNK = 10  # generations
_CHUNK_SECONDS = 1.0  # how long a chunk should take


class Run:
    """Learning runs of one problem: `compile`, then `advance` until `done`.

    variants: configurations that differ in traced floats only (`problem.program_key`), each of
    which runs with all seeds.  The seed axis of histories and results then is the flat axis of
    (variant, seed).  What changes is `now`, which may be kept and put back; the arithmetic is in
    pure functions.  The first populations are random; `start` knows of others, and `origin` then
    says which.
    """

    def __init__(self, problem: Problem, variants: Sequence[TrainConfig] = ()):
        self.problem, config = problem, problem.config
        num_rows = config.seeds * max(len(variants), 1)
        # Before anything is made for each: populations alone.
        memory.refuse_beyond(
            num_rows * config.ga.population * len(problem.genes) * config.ga.num_bits
        )
        self.rows = Rows(make_mesh(num_rows, problem.blocks), num_rows)
        # All seeds share the pool, so that a seed's result does not depend on its company.
        with problem.code():
            scenes, validation = problem.scenes()
        self.scenes = self.rows.share(scenes)
        self.validation = self.scenes if validation is scenes else self.rows.share(validation)
        self.memory_bytes = 0
        self.origin = ""  # of the first populations, in words; "" if they are random
        self._chunk: Any = None  # compiled
        self.traced, self.now = self._begin(variants or (config,))

    @property
    def config(self) -> TrainConfig:
        return self.problem.config

    def restart(self, variants: Sequence[TrainConfig]) -> None:
        """Back to generation 0.

        Args:
            variants: as many as before.
        """
        self.traced, self.now = self._begin(variants)

    def _begin(self, variants: Sequence[TrainConfig]) -> tuple[Traced, RunState]:
        config, problem = self.config, self.problem
        variant = [problem.variant(v).traced() for v in variants]
        seeds = np.tile(config.first_seed + np.arange(config.seeds), len(variants))

        remember = (lambda key: ()) if problem.task is None else problem.task.init

        def init(s):
            key = jax.random.key(s)
            state = ga.init(key, len(problem.genes), config.ga, problem.ranges)
            return state._replace(memory=remember(jax.random.fold_in(key, _MEMORY)))

        each = jax.tree.map(lambda *x: np.repeat(np.stack(x), config.seeds, axis=0), *variant)
        traced = self.rows.place(each)
        with problem.code():
            return traced, RunState(self.rows.place(seeds.astype(np.uint32), jax.vmap(init)))

    @property
    def generation(self) -> int:
        return sum(r.best.shape[1] for r in self.now.records)

    @property
    def done(self) -> bool:
        return self.generation >= self.config.generations

    @property
    def control_steps(self) -> int:
        """Control steps of all seeds so far; 0 where the task is not bioa."""
        c = self.config
        if self.problem.task is not None:
            return 0
        trials = self.generation * self.rows.num * c.ga.population * c.num_scenes
        return trials * EPISODE_STEPS

    def compile(self) -> float:
        """Trace and compile a chunk; returns the seconds it took.  Raises ValueError where memory
        will not do."""
        start = time.perf_counter()
        advance = jax.jit(
            partial(
                _advance,
                mesh=self.rows.mesh,
                problem=self.problem,
            )
        )
        arguments = self.now.population, self.traced, self.scenes, np.int32(1)
        with self.problem.code():
            lowered = advance.lower(*arguments)
        self._chunk = lowered.compile()
        self.memory_bytes = memory.check(self._chunk, len(self.rows.mesh.local_devices))
        seconds = time.perf_counter() - start
        self.now = self.now._replace(compile_seconds=self.now.compile_seconds + seconds)
        return seconds

    def advance(self) -> Progress:
        """Run one chunk of generations, on all seeds; compiles it where `compile` did not."""
        if self._chunk is None:
            self.compile()
        start = time.perf_counter()
        now = self.now
        num = min(now.chunk, self.config.generations - self.generation)
        population, record = self._chunk(now.population, self.traced, self.scenes, np.int32(num))
        record = History(*(x[:, :num] for x in self.rows.gather(record)))
        seconds = time.perf_counter() - start
        # The same on all processes, whose clocks differ.
        length = min(max(int(_CHUNK_SECONDS * num / seconds), 1), _MAX_CHUNK)
        (chunk,) = hosts.largest(length)
        self.now = RunState(
            population,
            (*now.records, record),
            chunk,
            now.compile_seconds,
            now.run_seconds + seconds,
        )
        return self.progress()

    def progress(self) -> Progress:
        newest = self.now.records[-1]
        return Progress(
            generation=self.generation,
            generations=self.config.generations,
            best=float(np.median(newest.best[:, -1])),
            mean=float(np.median(newest.mean[:, -1])),
            seconds=self.now.run_seconds,
            control_steps=self.control_steps,
            num_nonfinite=int(newest.num_nonfinite[:, -1].sum()),
        )

    def history(self) -> History:
        """All records so far."""
        length = self.now.population.bits.shape[-1]
        none = np.zeros((self.rows.num, 0), np.float32)
        nothing = History(none, none, none.astype(np.int32), np.zeros((*none.shape, length), bool))
        return History(*(np.concatenate(x, axis=1) for x in zip(nothing, *self.now.records)))

    def conclude(self, show: Callable[[int, int, float], None] = lambda *_: None) -> Result:
        """The controller of each seed: see `final_choice.Result`.

        However often it is asked, also of a resumed run, the answer is the same.

        Args:
            show: see `final_choice.conclude`.
        """
        evolved = Evolved(
            self.problem, self.rows, self.now.population, self.traced, self.scenes, self.validation
        )
        task = self.problem.task
        if task is not None and task.judge is not None:
            return judged.conclude(evolved, self.history().best_bits, show)
        return final_choice.conclude(evolved, show)


def _advance(state, floats, scenes, num, *, mesh, problem):
    """`num` generations, at most `_MAX_CHUNK`, for every row: leaves of state and floats [S, ...],
    records [S, _MAX_CHUNK, ...], of which the first num are filled.

    num is traced: the first generation can be shown alone without compiling twice.
    """

    def one_seed(shared, seed_state, seed_floats):
        scenes, num = shared
        traced = seed_floats._replace(scenes=scenes)
        task, coding = problem.task_of(traced), problem.config.ga

        def body(n, carry):
            state = carry[0]
            theta = problem.in_units(genome.decode(state.bits, coding.num_bits, coding.gray))
            progress = state.generation / jnp.maximum(traced.horizon - 1, 1)
            raw, memory = task.fitness(ga.fitness_key(state), theta, state.memory, progress)
            new, record = ga.advance(state._replace(memory=memory), raw, traced.ga, traced.horizon)
            return new, jax.tree.map(lambda xs, x: xs.at[n].set(x), carry[1], record)

        zeros = jnp.zeros(_MAX_CHUNK)
        genomes = jnp.zeros((_MAX_CHUNK, seed_state.bits.shape[-1]), bool)
        records = ga.Record(zeros, zeros, zeros.astype(int), genomes)
        return jax.lax.fori_loop(0, num, body, (seed_state, records))

    return over_seeds(one_seed, mesh)((scenes, num), (state, floats))


def start(problem: Problem) -> Run:
    """A run at generation 0, at random or from `config.warm_start`.

    Args:
        problem: resolved.

    Raises ValueError (one line) where that cannot be read or does not fit.
    """
    run = Run(problem)
    if problem.config.warm_start:
        first = warmstart.start(problem)
        bits = run.rows.place(first.bits)
        run.now = run.now._replace(population=run.now.population._replace(bits=bits))
        run.origin = first.origin
    return run


def train(
    config: TrainConfig = TrainConfig(),
    on_progress: Callable[[Progress], None] | None = None,
    task: Task | None = None,
) -> Run:
    """Run to the end, in memory.  `fntg train` also writes a run folder.

    Args:
        config: of the run.
        on_progress: called after each chunk of generations.
        task: what to learn, where it is not a registered one.
    """
    return complete(start(resolve(config, task)), on_progress)


def complete(run: Run, on_progress: Callable[[Progress], None] | None = None) -> Run:
    """Run the rest of a run.

    Args:
        run: at any generation.
        on_progress: called after each chunk of generations.
    """
    run.compile()
    while not run.done:
        progress = run.advance()
        if on_progress is not None:
            on_progress(progress)
    return run


def check_finite(run: Run) -> None:
    """Refuse a run in which no genome of any generation had a finite fitness: nothing was learnt,
    and there is nothing to choose from.

    Args:
        run: completed.

    Raises ValueError (one line).
    """
    best = run.rows.gather(run.now.population.best_fitness)
    if not np.isfinite(best).any():
        config = run.config
        option, name = ("world", config.env) if run.problem.task is None else ("task", config.task)
        raise ValueError(
            f"{option} {name!r}: no genome of any generation had a finite fitness, all were NaN or "
            f"infinite; fntg doctor --{option} {name} looks for the cause"
        )


def decode_history(history: History, config: TrainConfig) -> np.ndarray:
    """Genes of every generation's best genome.

    Args:
        history: of a run.
        config: of the same run.

    Returns:
        [seed, generation, genes] float32, in (-5, 5).
    """
    return np.asarray(genome.decode(history.best_bits, config.ga.num_bits, config.ga.gray))
