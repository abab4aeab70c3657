"""The runner: evolution in jitted chunks, with progress, checkpoints and a run folder.

All seeds advance together, one chunk of generations at a time: first a single one, then as many
as take about a second.  One compiled call serves chunks of every length.  A seed's result depends
neither on these lengths, nor on how many run beside it, nor on the devices (`parallel`).
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

from fntg_jax.controller import genome
from fntg_jax.controller.layout import get_layout
from fntg_jax.learning import ga
from fntg_jax.learning.objective import Static, Traced, draw_scenes, score
from fntg_jax.running import final_choice, hosts, memory
from fntg_jax.running.parallel import GENOME, make_mesh, over_seeds
from fntg_jax.running.settings import TrainConfig, get_suite, get_world, validate


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


_POOL_KEY = 0x9001  # of the scenes of training and validation; evaluation draws others
_VALIDATION = 2048  # scenes that the final controller is chosen on
_MAX_CHUNK = 10  # generations
_CHUNK_SECONDS = 1.0  # how long a chunk should take


class Result(NamedTuple):
    """The controller of each seed, leading axis seed.

    theta: [S, genes]; fitness: [S]; bits: the genomes, None after refinement; refined: [S, n]
    fitness in the course of the refinement, None without.  Where all generations see the same
    scenes this is the best genome of all generations; where scenes change, the individual of
    the last population (or its refinement) that is best on validation scenes of their own.
    """

    theta: np.ndarray
    fitness: np.ndarray
    bits: np.ndarray | None
    refined: np.ndarray | None


class Run:
    """Learning runs of one configuration: `compile`, then `advance` until `done`.

    variants: configurations that differ in traced floats only (`program_key`), each of which runs
    with all seeds.  The seed axis of histories and results then is the flat axis of
    (variant, seed).  The object only holds what must survive between chunks; the arithmetic is in
    pure functions.  The first populations are random; `start` knows of others.
    """

    def __init__(self, config: TrainConfig, variants: Sequence[TrainConfig] = ()):
        validate(config)
        self.config = config
        self.num_rows = config.seeds * max(len(variants), 1)
        self.world = get_world(config.env)
        self.layout = get_layout(config.layout)
        self.env = self.world.make(**config.env_options)
        self.chunk = 1
        self.mesh = make_mesh(self.num_rows, config.ga.population * config.num_scenes)
        # All seeds share the pool, so that a seed's result does not depend on its company.
        scenes, validation = _draw(get_suite(self.world, config.suite), config)
        self.scenes = self._place(scenes, P())
        self.validation = self.scenes if validation is scenes else self._place(validation, P())
        self.compile_seconds = 0.0
        self.origin = ""  # of the first populations, in words; "" if they are random
        self.restart(variants or (config,))

    def restart(self, variants: Sequence[TrainConfig]) -> None:
        """Back to generation 0, with as many variants as before."""
        config = self.config
        rows = [_floats(v) for v in variants for _ in range(config.seeds)]
        seeds = np.tile(config.first_seed + np.arange(config.seeds), len(variants))

        ranges = self.layout.partition if config.initial == "partition" else None

        def init(s):
            return ga.init(jax.random.key(s), self.layout.num_genes, config.ga, ranges)

        self.floats = self.place_rows(jax.tree.map(lambda *x: np.stack(x), *rows))
        self.state = self.place_rows(seeds.astype(np.uint32), jax.vmap(init))
        self.run_seconds = 0.0
        self.records: list[History] = []

    def place_rows(self, values: Any, fn: Callable[[Any], Any] = lambda x: x) -> Any:
        """fn of values [num_rows, ...] on the devices of the rows."""
        # Every device gets as many rows; the surplus is computed and dropped.
        size = self.mesh.shape["seed"]
        row = np.arange(-(-self.num_rows // size) * size) % self.num_rows
        return self._place(jax.tree.map(lambda x: np.asarray(x)[row], values), P("seed"), fn)

    def _place(self, values: Any, spec: P, fn: Callable[[Any], Any] = lambda x: x) -> Any:
        """fn of values on the devices of the mesh: by the compiler, because `jax.device_put`
        does not reach those of other processes."""
        values = jax.tree.map(np.asarray, values)
        place = jax.jit(fn, out_shardings=NamedSharding(self.mesh, spec)).lower(values).compile()
        memory.check(place, len(self.mesh.local_devices))
        return place(values)

    def config_static(self) -> Static:
        c = self.config
        return Static(self.layout, c.output, c.objective, c.num_scenes, c.scene_pool > 0)

    def traced(self) -> Traced:
        """What the compiled program is given, of the first row."""
        return jax.tree.map(lambda x: x[0], self.floats)._replace(scenes=self.scenes)

    @property
    def generation(self) -> int:
        return sum(r.best.shape[1] for r in self.records)

    @property
    def done(self) -> bool:
        return self.generation >= self.config.generations

    @property
    def control_steps(self) -> int:
        """Control steps of all seeds so far."""
        c = self.config
        return self.generation * self.num_rows * c.ga.population * c.num_scenes * 220

    def compile(self) -> float:
        """Trace and compile a chunk; returns the seconds it took.  Raises ValueError where memory
        will not do."""
        start = time.perf_counter()
        advance = jax.jit(
            partial(
                _advance,
                mesh=self.mesh,
                make_fitness=partial(_make_fitness, self.config_static()),
            )
        )
        arguments = self.state, self.floats, self.scenes, np.int32(1)
        self._advance = advance.lower(*arguments).compile()
        self.memory_bytes = memory.check(self._advance, len(self.mesh.local_devices))
        self.compile_seconds += time.perf_counter() - start
        return time.perf_counter() - start

    def advance(self) -> Progress:
        """Run one chunk of generations, on all seeds."""
        start = time.perf_counter()
        num = min(self.chunk, self.config.generations - self.generation)
        self.state, record = self._advance(self.state, self.floats, self.scenes, np.int32(num))
        self.records.append(History(*(hosts.gather(x)[: self.num_rows, :num] for x in record)))
        seconds = time.perf_counter() - start
        self.run_seconds += seconds
        # The same on all processes, whose clocks differ.
        length = min(max(int(_CHUNK_SECONDS * num / seconds), 1), _MAX_CHUNK)
        (self.chunk,) = hosts.largest(length)
        return self.progress()

    def progress(self) -> Progress:
        newest = self.records[-1]
        return Progress(
            generation=self.generation,
            generations=self.config.generations,
            best=float(np.median(newest.best[:, -1])),
            mean=float(np.median(newest.mean[:, -1])),
            seconds=self.run_seconds,
            control_steps=self.control_steps,
        )

    def history(self) -> History:
        """All records so far."""
        length = self.state.bits.shape[-1]
        none = np.zeros((self.num_rows, 0), np.float32)
        nothing = History(none, none, none.astype(np.int32), np.zeros((*none.shape, length), bool))
        return History(*(np.concatenate(x, axis=1) for x in zip(nothing, *self.records)))

    def conclude(self, show: Callable[[int, int, float], None] = lambda *_: None) -> "Result":
        """The controller of each seed: see `Result`.  The same answer however often it is asked,
        also of a resumed run.  show: see `final_choice.conclude`."""
        if self.config.scene_pool == 0 and self.config.refine_steps == 0:
            bits = hosts.gather(self.state.best_bits)[: self.num_rows]
            theta = np.asarray(self._decode(bits))
            return Result(theta, hosts.gather(self.state.best_fitness)[: len(bits)], bits, None)
        theta, value, row, refined = final_choice.conclude(self, show)
        if refined is not None:
            return Result(theta, value, None, refined)
        bits = hosts.gather(self.state.bits)[np.arange(self.num_rows), row]
        return Result(theta, value, bits, None)

    def _decode(self, bits):
        return genome.decode(bits, self.config.ga.num_bits, self.config.ga.gray)


def _draw(suite, config: TrainConfig):
    """Scenes of training, and those of validation.  They are the same where nothing is validated,
    and in the suite `paper`, which has its four starts and no others."""
    key = jax.random.key(_POOL_KEY)
    if config.scene_pool == 0:
        scenes = suite(key, config.num_scenes)
        if config.refine_steps == 0 or config.suite == "paper":
            return scenes, scenes
        return scenes, suite(jax.random.fold_in(key, 1), _VALIDATION)
    # One draw, which takes seconds to compile.  A mix comes suite by suite: evenly spread rows
    # hold all of them.
    size = config.scene_pool + _VALIDATION
    drawn = jax.tree.map(np.asarray, suite(key, size))
    rows = np.arange(_VALIDATION) * size // _VALIDATION
    return (
        jax.tree.map(lambda x: np.delete(x, rows, axis=0), drawn),
        jax.tree.map(lambda x: x[rows], drawn),
    )


def _floats(config: TrainConfig) -> Traced:
    """The traced floats of a configuration; scenes come later."""
    horizon = dataclasses.replace(config.ga, horizon=float(config.generations))
    env = get_world(config.env).make(**config.env_options)
    traced = Traced(horizon, env, config.fitness, config.smooth, None)
    return jax.tree.map(np.asarray, traced)


def program_key(config: TrainConfig) -> tuple[Any, ...]:
    """Configurations of equal key run in one compiled program: they differ in traced floats."""
    groups = ("env_options", "ga", "fitness", "smooth")
    rest = {n: v for n, v in vars(config).items() if n not in groups}
    leaves, structure = jax.tree.flatten(_floats(config))
    return structure, [(x.shape, x.dtype) for x in leaves], rest


def _make_fitness(static: Static, traced: Traced) -> ga.FitnessFn:
    def fitness_fn(key, theta):
        scenes = draw_scenes(static, traced, key)
        return score(static, traced, theta, scenes, axis=GENOME)

    return fitness_fn


def _advance(state, floats, scenes, num, *, mesh, make_fitness):
    """`num` generations, at most `_MAX_CHUNK`, for every row: leaves of state and floats [S, ...],
    records [S, _MAX_CHUNK, ...], of which the first num are filled.

    num is traced: the first generation can be shown alone without compiling twice.
    """

    def one_seed(shared, seed_state, seed_floats):
        scenes, num = shared
        traced = seed_floats._replace(scenes=scenes)
        fitness_fn = make_fitness(traced)

        def body(n, carry):
            new, record = ga.generation(carry[0], fitness_fn, traced.ga)
            return new, jax.tree.map(lambda xs, x: xs.at[n].set(x), carry[1], record)

        zeros = jnp.zeros(_MAX_CHUNK)
        genomes = jnp.zeros((_MAX_CHUNK, seed_state.bits.shape[-1]), bool)
        records = ga.Record(zeros, zeros, zeros.astype(int), genomes)
        return jax.lax.fori_loop(0, num, body, (seed_state, records))

    return over_seeds(one_seed, mesh)((scenes, num), (state, floats))


def start(config: TrainConfig) -> Run:
    """A run at generation 0, at random or from `config.warm_start`.  Raises ValueError (one line)
    where that cannot be read or does not fit."""
    run = Run(config)
    if config.warm_start:
        from fntg_jax.running import (
            warmstart,  # which reads run folders, and so imports this module
        )

        first = warmstart.start(config)
        run.state = run.state._replace(bits=run.place_rows(first.bits))
        run.origin = first.origin
    return run


def train(
    config: TrainConfig = TrainConfig(), on_progress: Callable[[Progress], None] | None = None
) -> Run:
    """Run to the end, in memory.  `fntg train` also writes a run folder."""
    return complete(start(config), on_progress)


def complete(run: Run, on_progress: Callable[[Progress], None] | None = None) -> Run:
    """Run the rest of a run."""
    run.compile()
    while not run.done:
        progress = run.advance()
        if on_progress is not None:
            on_progress(progress)
    return run


def decode_history(history: History, config: TrainConfig) -> np.ndarray:
    """Genes of every generation's best genome, [seed, generation, genes] float32."""
    return np.asarray(genome.decode(history.best_bits, config.ga.num_bits, config.ga.gray))
