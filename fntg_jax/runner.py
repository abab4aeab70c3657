"""The runner: evolution in jitted chunks, with progress, checkpoints and a run folder.

All seeds advance together, one chunk of generations at a time.  A chunk is one compiled call:
seeds are spread over the local devices and mapped one after the other on each, so memory does
not grow with their number, and a seed's result does not depend on how many run beside it.
"""

import dataclasses
import json
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from fntg_jax import ga, genome, refine, xla
from fntg_jax.layout import get_layout
from fntg_jax.objective import Static, Traced, draw_scenes, score
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

    The object only holds what must survive between chunks; the arithmetic is in pure
    functions.
    """

    def __init__(self, config: TrainConfig):
        validate(config)
        self.config = config
        self.world = get_world(config.env)
        self.layout = get_layout(config.layout)
        self.env = self.world.make(**config.env_options)
        # All seeds share the pool, so that a seed's result does not depend on its company.
        self.scenes = get_suite(self.world, config.suite)(
            jax.random.key(_POOL_KEY), config.scene_pool or config.num_scenes
        )
        self.chunk = chunk_length(config.generations)
        devices = jax.local_devices()[: config.seeds]
        self.mesh = Mesh(np.asarray(devices), ("seed",))
        self.compile_seconds = 0.0
        self.run_seconds = 0.0
        seeds = config.first_seed + np.arange(self._padded_seeds())
        self.state = jax.vmap(
            lambda s: ga.init(jax.random.key(s), self.layout.num_genes, config.ga)
        )(jnp.asarray(seeds, jnp.uint32))
        self.records: list[History] = []

    def config_static(self) -> Static:
        c = self.config
        return Static(self.layout, c.output, c.objective, c.num_scenes, c.scene_pool > 0)

    def traced(self) -> Traced:
        c = self.config
        horizon = dataclasses.replace(c.ga, horizon=float(c.generations))
        return Traced(horizon, self.env, c.fitness, c.smooth, self.scenes)

    def _padded_seeds(self) -> int:
        # Every device gets as many; the surplus is computed and dropped.
        size = self.mesh.size
        return -(-self.config.seeds // size) * size

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
        return self.generation * c.seeds * c.ga.population * c.num_scenes * 220

    def compile(self) -> float:
        """Trace and compile a chunk; returns the seconds it took."""
        start = time.perf_counter()
        sharding = NamedSharding(self.mesh, P("seed"))
        self.state = jax.device_put(self.state, sharding)
        advance = jax.jit(
            partial(
                _advance,
                mesh=self.mesh,
                num_generations=self.chunk,
                make_fitness=partial(_make_fitness, self.config_static()),
            )
        )
        traced = self.traced()
        compiled = advance.lower(self.state, traced).compile()
        self._advance = lambda state: compiled(state, traced)
        self.compile_seconds += time.perf_counter() - start
        return time.perf_counter() - start

    def advance(self) -> Progress:
        """Run one chunk of generations, on all seeds."""
        start = time.perf_counter()
        self.state, record = self._advance(self.state)
        self.records.append(History(*(np.asarray(x)[: self.config.seeds] for x in record)))
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
            bits = np.asarray(self.state.best_bits)[: self.config.seeds]
            theta = np.asarray(self._decode(bits))
            return Result(theta, np.asarray(self.state.best_fitness)[: len(bits)], bits, None)
        static, traced = self.config_static(), self.traced()
        suite = get_suite(self.world, self.config.suite)
        key = jax.random.key(_POOL_KEY + 1)
        validation = suite(key, _VALIDATION) if static.fresh else self.scenes
        choose = jax.jit(
            partial(_conclude, config=self.config, static=static, mesh=self.mesh),
            compiler_options=xla.GRADIENT_OPTIONS if self.config.refine_steps else None,
        )
        theta, value, row, refined = choose(self.state, traced, validation)
        num = self.config.seeds
        bits = np.take_along_axis(
            np.asarray(self.state.bits), np.asarray(row)[:, None, None], axis=1
        )[:num, 0]
        theta, value = np.asarray(theta)[:num], np.asarray(value)[:num]
        if refined is None:
            return Result(theta, value, bits, None)
        return Result(theta, value, None, np.asarray(refined)[:num])

    def _decode(self, bits):
        return genome.decode(bits, self.config.ga.num_bits, self.config.ga.gray)

    # A checkpoint is the state and the records: everything else follows from the configuration.

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The run as named arrays, to be written; `from_arrays` continues bit for bit."""
        state, history = self.state, self.history()
        return {
            "config": np.asarray(json.dumps(dataclasses.asdict(self.config), sort_keys=True)),
            "bits": np.packbits(np.asarray(state.bits), axis=-1),
            "key": np.asarray(jax.random.key_data(state.key)),
            "generation": np.asarray(state.generation),
            "best_bits": np.packbits(np.asarray(state.best_bits), axis=-1),
            "best_fitness": np.asarray(state.best_fitness),
            "seconds": np.asarray([self.compile_seconds, self.run_seconds]),
            "history_best": history.best,
            "history_mean": history.mean,
            "history_num_nonfinite": history.num_nonfinite,
            "history_best_bits": np.packbits(history.best_bits, axis=-1),
        }

    def from_arrays(self, arrays: dict[str, np.ndarray]) -> None:
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

        num = self.config.seeds
        saved = ga.State(
            bits=jnp.asarray(unpack("bits")),
            key=jax.random.wrap_key_data(jnp.asarray(arrays["key"])),
            generation=jnp.asarray(arrays["generation"]),
            best_bits=jnp.asarray(unpack("best_bits")),
            best_fitness=jnp.asarray(arrays["best_fitness"]),
        )
        # The number of devices, and with it the padding, may have changed.
        self.state = jax.tree.map(
            lambda new, old: jnp.concatenate([old[:num], new[num:]]), self.state, saved
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


def chunk_length(generations: int) -> int:
    """Generations a compiled call: the largest divisor up to 10, so that one compilation serves
    all chunks and a resumed run repeats exactly the calls of an uninterrupted one."""
    return max(n for n in range(1, 11) if generations % n == 0)


def _make_fitness(static: Static, traced: Traced) -> ga.FitnessFn:
    def fitness_fn(key, theta, progress):
        return score(static, traced, theta, draw_scenes(static, traced, key), progress)

    return fitness_fn


def _advance(state, traced, *, mesh, num_generations, make_fitness):
    """A chunk of generations for every seed; state leaves [S, ...], records [S, n, ...]."""

    def one_seed(seed_state):
        return ga.evolve(seed_state, num_generations, make_fitness(traced), traced.ga)

    return _over_seeds(one_seed, mesh)(state)


def _conclude(state, traced, validation, *, config, static, mesh):
    """theta [S, genes], validated fitness [S], row of the population it comes from [S], and the
    course of the refinement [S, n] in fitness, or None."""
    few = jax.tree.map(lambda x: x[:_SCREENING], validation)

    def cost_fn(theta, scenes):
        # Checkpointed: reverse mode then stores one state a control step.
        return 10 / score(static, traced, theta, scenes, checkpoint=True)

    def one_seed(bits, key):
        theta = genome.decode(bits, config.ga.num_bits, config.ga.gray)
        # A screening on few scenes, then the best of it on all.
        screened = _best_first(score(static, traced, theta, few))[:_FINALISTS]
        value = score(static, traced, theta[screened], validation)
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
            refine.optimiser("adam", config.refine_steps, config.refine_rate),
            config.refine_steps,
        )
        best = jnp.argmin(refined.cost)
        return refined.theta[best], 10 / refined.cost[best], rows[best], 10 / refined.history[best]

    theta, value, row, course = _over_seeds(one_seed, mesh)(state.bits, state.key)
    return theta, value, row, course if config.refine_steps else None


def _best_first(value):
    return jnp.argsort(jnp.where(jnp.isfinite(value), -value, jnp.inf))


def _over_seeds(fn, mesh):
    """fn mapped over the leading axis: spread over devices, one after the other on each."""
    return jax.shard_map(
        lambda *xs: jax.lax.map(lambda x: fn(*x), xs),
        mesh=mesh,
        in_specs=P("seed"),
        out_specs=P("seed"),
        check_vma=False,
    )


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
