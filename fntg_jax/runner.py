"""The runner: evolution in jitted chunks, with progress, checkpoints and a run folder.

All seeds advance together, one chunk of generations at a time.  A chunk is one compiled call:
a seed's result depends neither on how many run beside it nor on the devices (`parallel`).
"""

import dataclasses
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from fntg_jax import ga, genome, hosts, memory
from fntg_jax.layout import get_layout
from fntg_jax.objective import Static, Traced, draw_scenes, score
from fntg_jax.parallel import make_mesh, over_seeds, shared_score
from fntg_jax.settings import TrainConfig, get_suite, get_world, validate


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


_POOL_KEY = 0x9001  # of the training scenes; the next of validation; evaluation draws others
_VALIDATION = 2048  # scenes that the final controller is chosen on
_SCREENING = 256  # of them, for a first look at the whole population
_FINALISTS = 16


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
    pure functions.
    """

    def __init__(self, config: TrainConfig, variants: Sequence[TrainConfig] = ()):
        validate(config)
        self.config = config
        self.num_rows = config.seeds * max(len(variants), 1)
        self.world = get_world(config.env)
        self.layout = get_layout(config.layout)
        self.env = self.world.make(**config.env_options)
        # All seeds share the pool, so that a seed's result does not depend on its company.
        scenes = get_suite(self.world, config.suite)(
            jax.random.key(_POOL_KEY), config.scene_pool or config.num_scenes
        )
        self.chunk = chunk_length(config.generations)
        self.mesh = make_mesh(self.num_rows, config.ga.population, config.num_scenes)
        self.scenes = self._placed(scenes, P())
        self.compile_seconds = 0.0
        self.start(variants or (config,))

    def start(self, variants: Sequence[TrainConfig]) -> None:
        """Back to generation 0, with as many variants as before."""
        config = self.config
        # Every device gets as many rows; the surplus is computed and dropped.
        size = self.mesh.shape["seed"]
        row = np.arange(-(-self.num_rows // size) * size) % self.num_rows
        rows = [_floats(v) for v in variants for _ in range(config.seeds)]
        floats = jax.tree.map(lambda *x: np.stack(x), *(rows[n] for n in row))
        seeds = (config.first_seed + row % config.seeds).astype(np.uint32)

        def init(s):
            return ga.init(jax.random.key(s), self.layout.num_genes, config.ga)

        self.floats = self._placed(floats, P("seed"))
        self.state = self._placed(seeds, P("seed"), jax.vmap(init))
        self.run_seconds = 0.0
        self.records: list[History] = []

    def _placed(self, values: Any, spec: P, fn: Callable[[Any], Any] = lambda x: x) -> Any:
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
                num_generations=self.chunk,
                make_fitness=partial(_make_fitness, self.config_static(), self.mesh),
            )
        )
        self._advance = advance.lower(self.state, self.floats, self.scenes).compile()
        self.memory_bytes = memory.check(self._advance, len(self.mesh.local_devices))
        self.compile_seconds += time.perf_counter() - start
        return time.perf_counter() - start

    def advance(self) -> Progress:
        """Run one chunk of generations, on all seeds."""
        start = time.perf_counter()
        self.state, record = self._advance(self.state, self.floats, self.scenes)
        self.records.append(History(*(hosts.gather(x)[: self.num_rows] for x in record)))
        self.run_seconds += time.perf_counter() - start
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
        return History(*(np.concatenate(x, axis=1) for x in zip(*self.records)))

    def conclude(self) -> "Result":
        """The controller of each seed: see `Result`.  The same answer however often it is asked,
        also of a resumed run."""
        if self.config.scene_pool == 0 and self.config.refine_steps == 0:
            bits = hosts.gather(self.state.best_bits)[: self.num_rows]
            theta = np.asarray(self._decode(bits))
            return Result(theta, hosts.gather(self.state.best_fitness)[: len(bits)], bits, None)
        static = self.config_static()
        suite = get_suite(self.world, self.config.suite)
        key = jax.random.key(_POOL_KEY + 1)
        validation = self._placed(suite(key, _VALIDATION), P()) if static.fresh else self.scenes
        choose = jax.jit(
            partial(_conclude, config=self.config, static=static, mesh=self.mesh),
        )
        theta, value, row, refined = choose(self.state, self.floats, self.scenes, validation)
        num = self.num_rows
        bits = np.take_along_axis(
            hosts.gather(self.state.bits), hosts.gather(row)[:, None, None], axis=1
        )[:num, 0]
        theta, value = hosts.gather(theta)[:num], hosts.gather(value)[:num]
        if refined is None:
            return Result(theta, value, bits, None)
        return Result(theta, value, None, hosts.gather(refined)[:num])

    def _decode(self, bits):
        return genome.decode(bits, self.config.ga.num_bits, self.config.ga.gray)

    # A checkpoint is the state and the records: everything else follows from the configuration.

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The run as named arrays, to be written; `from_arrays` continues bit for bit."""
        state, history = self.state, self.history()
        return {
            "config": np.asarray(json.dumps(dataclasses.asdict(self.config), sort_keys=True)),
            "bits": np.packbits(hosts.gather(state.bits), axis=-1),
            "key": hosts.gather(jax.random.key_data(state.key)),
            "generation": hosts.gather(state.generation),
            "best_bits": np.packbits(hosts.gather(state.best_bits), axis=-1),
            "best_fitness": hosts.gather(state.best_fitness),
            "seconds": np.asarray([self.compile_seconds, self.run_seconds]),
            "history_best": history.best,
            "history_mean": history.mean,
            "history_num_nonfinite": history.num_nonfinite,
            "history_best_bits": np.packbits(history.best_bits, axis=-1),
        }

    def from_arrays(self, arrays: dict[str, Any]) -> None:
        """Take over a checkpoint.  Raises ValueError when it belongs to another configuration
        or lacks something."""
        missing = [name for name in CHECKPOINT_ARRAYS if name not in arrays]
        if missing:
            raise ValueError(f"no {missing[0]} in it")
        if str(arrays["config"]) != json.dumps(dataclasses.asdict(self.config), sort_keys=True):
            raise ValueError("it was written by a run of another configuration")
        length = self.state.bits.shape[-1]

        def unpack(name):
            return np.unpackbits(arrays[name], axis=-1, count=length).astype(bool)

        saved = ga.State(
            unpack("bits"),
            arrays["key"],
            arrays["generation"],
            unpack("best_bits"),
            arrays["best_fitness"],
        )
        # The number of devices, and with it the padding, may have changed.
        row = np.arange(self.state.bits.shape[0]) % self.num_rows
        saved = jax.tree.map(lambda x: x[row], saved)
        self.state = self._placed(
            saved, P("seed"), lambda x: x._replace(key=jax.random.wrap_key_data(x.key))
        )
        self.compile_seconds, self.run_seconds = map(float, arrays["seconds"])
        self.records = [
            History(
                arrays["history_best"],
                arrays["history_mean"],
                arrays["history_num_nonfinite"],
                unpack("history_best_bits"),
            )
        ]


CHECKPOINT_ARRAYS = (
    "config",
    "bits",
    "key",
    "generation",
    "best_bits",
    "best_fitness",
    "seconds",
    "history_best",
    "history_mean",
    "history_num_nonfinite",
    "history_best_bits",
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


def chunk_length(generations: int) -> int:
    """Generations a compiled call: the largest divisor up to 10, so that one compilation serves
    all chunks and a resumed run repeats exactly the calls of an uninterrupted one."""
    return max(n for n in range(1, 11) if generations % n == 0)


def _make_fitness(static: Static, mesh: Mesh, traced: Traced) -> ga.FitnessFn:
    def fitness_fn(key, theta, progress):
        scenes = draw_scenes(static, traced, key)
        return shared_score(static, mesh, traced, theta, scenes, progress)

    return fitness_fn


def _advance(state, floats, scenes, *, mesh, num_generations, make_fitness):
    """A chunk of generations for every row; leaves of state and floats [S, ...], records
    [S, n, ...]."""

    def one_seed(scenes, seed_state, seed_floats):
        traced = seed_floats._replace(scenes=scenes)
        return ga.evolve(seed_state, num_generations, make_fitness(traced), traced.ga)

    return over_seeds(one_seed, mesh)(scenes, (state, floats))


def _conclude(state, floats, scenes, validation, *, config, static, mesh):
    """theta [S, genes], validated fitness [S], row of the population it comes from [S], and the
    course of the refinement [S, n] in fitness, or None."""
    if config.refine_steps:
        # Here, because optax takes a good part of a second to load.
        from fntg_jax import refine

    def one_seed(shared, bits, key, seed_floats):
        scenes, validation = shared
        few = jax.tree.map(lambda x: x[:_SCREENING], validation)
        traced = seed_floats._replace(scenes=scenes)

        def cost_fn(theta, some):
            # Checkpointed: reverse mode then stores one state a control step.
            return 10 / score(static, traced, theta[None], some, checkpoint=True)[0]

        theta = genome.decode(bits, config.ga.num_bits, config.ga.gray)
        # A screening on few scenes, then the best of it on all.
        screened = _best_first(shared_score(static, mesh, traced, theta, few))[:_FINALISTS]
        value = shared_score(static, mesh, traced, theta[screened], validation)
        order = _best_first(value)
        rows, value = screened[order], value[order]
        if config.refine_steps == 0:
            return theta[rows[0]], value[0], rows[0], jnp.zeros((0,))
        refined = refine.refine(
            jax.random.fold_in(key, config.generations),
            theta[rows[: config.refine_top]],
            cost_fn,
            lambda k: draw_scenes(static, traced, k),
            validation,
            refine.adam(config.refine_steps, config.refine_rate),
            config.refine_steps,
        )
        best = jnp.argmin(refined.cost)
        return refined.theta[best], 10 / refined.cost[best], rows[best], 10 / refined.history[best]

    theta, value, row, course = over_seeds(one_seed, mesh)(
        (scenes, validation), (state.bits, state.key, floats)
    )
    return theta, value, row, course if config.refine_steps else None


def _best_first(value):
    return jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf))


def train(
    config: TrainConfig = TrainConfig(), on_progress: Callable[[Progress], None] | None = None
) -> Run:
    """Run to the end, in memory.  `fntg train` also writes a run folder."""
    run = Run(config)
    run.compile()
    while not run.done:
        progress = run.advance()
        if on_progress is not None:
            on_progress(progress)
    return run


def decode_history(history: History, config: TrainConfig) -> np.ndarray:
    """Genes of every generation's best genome, [seed, generation, genes] float32."""
    return np.asarray(genome.decode(history.best_bits, config.ga.num_bits, config.ga.gray))
