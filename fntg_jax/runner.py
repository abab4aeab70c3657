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
from importlib import metadata
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from fntg_jax import fitness, fntg, ga, genome
from fntg_jax.fitness import PaperWeights, SmoothWeights
from fntg_jax.ga import GAConfig
from fntg_jax.layout import Layout, get_layout
from fntg_jax.rollout import rollout_pairs

WORLDS = "fntg_jax.worlds"  # entry point group


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """One learning run, or several that differ in their seed.

    Attributes:
        env: world, by its entry point name.
        env_options: options of that world by name, e.g. dt 0.05 v_max 0.25.
        layout: gene table: paper-31, three-sigma-31, two-sigma-31, mirror-28, reduced-47,
            full-63.
        output: "scale": a gene of 5 is full speed; "clip": genes are m/s and rad/s.
        suite: training scenes: a suite, or several with their shares, open:2,blocked:3.
        num_scenes: trials of a genome; their average counts.
        scene_pool: 0: the same scenes in every generation; else as many scenes are drawn and
            every generation takes num_scenes of them at random.
        objective: "paper": the paper's fitness; "smooth": log-scaled and gated.
        seeds: number of independent runs.
        first_seed: seed of the first; the others follow.
        generations: populations evaluated.
        ga: genetic algorithm.
        refine_steps: gradient steps after evolution; 0 for none.
        refine_top: individuals of a seed that are refined; the best validated one is kept.
        fitness: weights of the paper's fitness.
        smooth: weights of the smooth objective.
    """

    env: str = "kinematic"
    env_options: dict[str, float] = dataclasses.field(default_factory=dict)
    layout: str = "paper-31"
    output: fntg.Output = "scale"
    suite: str = "paper"
    num_scenes: int = 4
    scene_pool: int = 0
    objective: Literal["paper", "smooth"] = "paper"
    seeds: int = 1
    first_seed: int = 0
    generations: int = 95
    ga: GAConfig = GAConfig()
    refine_steps: int = 0
    refine_top: int = 4
    fitness: PaperWeights = PaperWeights()
    smooth: SmoothWeights = SmoothWeights()


PRESETS = {
    # Faithful to the paper, Section "Genetic learning".
    "paper": TrainConfig(),
    # Holds on scenes never seen in training; experiments/generalization.py compares the two.
    "robust": TrainConfig(
        suite="open:2,blocked:3",
        num_scenes=48,
        scene_pool=16384,
        objective="smooth",
        generations=600,
        ga=GAConfig(
            population=256,
            gray=True,
            selection="tournament",
            tournament_size=4,
            num_islands=4,
            merge=0.4,
            mutation_rate=0.02,
            mutation_decay=0.15,
            crossover_rate=0.9,
            num_elites=2,
        ),
        refine_steps=0,
    ),
}


def validate(config: TrainConfig) -> None:
    """Check a configuration at the edge.  Raises ValueError: field, value, what is allowed."""
    for name, least in (
        ("seeds", 1),
        ("generations", 1),
        ("num_scenes", 1),
        ("first_seed", 0),
        ("scene_pool", 0),
        ("refine_steps", 0),
        ("refine_top", 1),
    ):
        value = getattr(config, name)
        if value < least:
            raise ValueError(f"{name} = {value}: allowed are whole numbers from {least}")
    get_layout(config.layout)
    fntg.output_gains(fntg.Limits(), config.output)
    ga.validate(config.ga)
    if 0 < config.scene_pool < config.num_scenes:
        raise ValueError(
            f"scene_pool = {config.scene_pool}: allowed are 0 and numbers from num_scenes = "
            f"{config.num_scenes}"
        )
    if config.refine_top > config.ga.population:
        raise ValueError(
            f"refine_top = {config.refine_top}: allowed are 1 to the population, "
            f"{config.ga.population}"
        )
    if config.objective not in OBJECTIVES:
        raise ValueError(f"objective = {config.objective!r}: allowed are {', '.join(OBJECTIVES)}")
    positive = ("gamma", "near", "still", "gate", "clearance_start", "ramp")
    for group in ("fitness", "smooth"):
        for name, value in dataclasses.asdict(getattr(config, group)).items():
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{group}.{name} = {value}: allowed are finite numbers from 0")
            if value == 0 and name in positive and (group, name) != ("fitness", "still"):
                raise ValueError(f"{group}.{name} = {value}: allowed are numbers above 0")
    world = get_world(config.env)
    get_suite(world, config.suite)
    world.make(**config.env_options)


OBJECTIVES = ("paper", "smooth")


def get_suite(world: Any, suite: str) -> Callable[..., Any]:
    """(key, num_scenes) -> scenes, for one suite or a mix "open:2,blocked:3".

    Raises ValueError naming the unknown suite or the unusable share.
    """
    if ":" not in suite:
        if suite not in world.suites:
            raise ValueError(f"suite = {suite!r}: known are {', '.join(world.suites)}")
        return world.suites[suite]
    shares = []
    for part in suite.split(","):
        name, _, share = part.partition(":")
        try:
            shares.append((name, float(share)))
        except ValueError:
            raise ValueError(f"suite = {suite!r}: {part!r} is not NAME:SHARE") from None
    return world.mix(tuple(shares))


def get_world(name: str) -> Any:
    """The world registered under that entry point.  Raises ValueError listing the known ones."""
    found = {e.name: e for e in metadata.entry_points(group=WORLDS)}
    if name not in found:
        raise ValueError(f"env = {name!r}: known worlds are {', '.join(sorted(found)) or 'none'}")
    return found[name].load()


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


_POOL_KEY = 0x9001  # of the training scenes; evaluation draws from other keys


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

    def config_static(self) -> "Static":
        c = self.config
        return Static(self.layout, c.output, c.objective, c.num_scenes, c.scene_pool > 0)

    def traced(self) -> "Traced":
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

    def best_bits(self, seed_index: int) -> tuple[np.ndarray, float]:
        """A seed's best genome of all generations and its fitness."""
        return (
            np.asarray(self.state.best_bits[seed_index]),
            float(self.state.best_fitness[seed_index]),
        )

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


class Static(NamedTuple):
    """What a program is compiled for, besides the shapes."""

    layout: Layout
    output: fntg.Output
    objective: str
    num_scenes: int
    fresh: bool


class Traced(NamedTuple):
    """What may change without compiling again."""

    ga: GAConfig
    env: Any
    fitness: PaperWeights
    smooth: SmoothWeights
    scenes: Any


def score(static: Static, traced: Traced, theta, scenes, progress=1.0, **options):
    """Fitness [P] of theta [P, genes] on scenes; options: those of `rollout.rollout`."""
    outcome = rollout_pairs(
        static.layout, theta, scenes, traced.env, output=static.output, **options
    )
    if static.objective == "paper":
        return fitness.paper_fitness(outcome, traced.fitness)
    return fitness.smooth_fitness(outcome, traced.smooth, progress)


def draw_scenes(static: Static, traced: Traced, key):
    """A generation's scenes: all, or num_scenes of the pool at random."""
    if not static.fresh:
        return traced.scenes
    size = jax.tree.leaves(traced.scenes)[0].shape[0]
    pick = jax.random.randint(key, (static.num_scenes,), 0, size)
    return jax.tree.map(lambda x: x[pick], traced.scenes)


def _make_fitness(static: Static, traced: Traced) -> ga.FitnessFn:
    def fitness_fn(key, theta, progress):
        return score(static, traced, theta, draw_scenes(static, traced, key), progress)

    return fitness_fn


def _advance(state, traced, *, mesh, num_generations, make_fitness):
    """A chunk of generations for every seed; state leaves [S, ...], records [S, n, ...]."""

    def one_seed(seed_state):
        return ga.evolve(seed_state, num_generations, make_fitness(traced), traced.ga)

    return _over_seeds(one_seed, mesh)(state)


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
