"""A configuration with all that it names: world, layout and scenes, resolved once and passed on."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np

from envs.base import Task
from fntg_jax.controller.layout import HIGH, LOW, get_layout
from fntg_jax.learning import objective
from fntg_jax.learning.objective import VALIDATION, Static, Traced
from fntg_jax.learning.rollout import num_blocks
from fntg_jax.running import settings
from fntg_jax.running.registry import code_of, get_suite, get_task, get_world
from fntg_jax.running.settings import TrainConfig

_POOL_KEY = 0x9001  # of the scenes of training and validation; evaluation draws others


# Fields of a configuration that every task has; the others are those of bioa.
_COMMON = (
    *("task", "task_options", "seeds", "first_seed", "generations", "ga", "initial"),
    *("warm_start", "refine_steps", "refine_method"),
)


class Problem(NamedTuple):
    """What a run learns.

    genes: anything with the fields of `envs.base.Gene`.  task: None for bioa, whose task is made
    from traced floats (`task_of`).  world, layout, env, suite ((key, num_scenes) -> scenes of
    training): of bioa, None in other tasks.
    """

    config: TrainConfig
    genes: tuple[Any, ...]
    task: Task | None = None
    # Any: of bioa, whose code alone reads them, they are a World and an Environment.
    world: Any = None
    layout: Any = None
    env: Any = None
    suite: Any = None

    @property
    def static(self) -> Static:
        """What a program of bioa is compiled for."""
        c = self.config
        return Static(self.layout, c.output, c.objective, c.num_scenes, c.scene_pool > 0)

    def traced(self) -> Traced:
        """What may change without compiling again, as NumPy; scenes come later."""
        c = self.config
        found = Traced(c.ga, self.env, c.fitness, c.smooth, None, float(c.generations))
        return jax.tree.map(np.asarray, found)

    def task_of(self, traced: Traced) -> Task:
        """The task, also inside a compiled program.

        Args:
            traced: of this problem, with scenes.
        """
        return objective.bioa(self.static, traced) if self.task is None else self.task

    @property
    def blocks(self) -> int:
        """How many devices can share a generation."""
        population = self.config.ga.population
        if self.task is None:
            return num_blocks(population * self.config.num_scenes)
        return 1 if self.task.shares is None else self.task.shares(population)

    def in_units(self, theta: Any) -> Any:
        """Genes from (-5, 5) to their own ranges.

        Args:
            theta: [..., genes], NumPy's or JAX's.
        """
        low, high = (np.asarray([getattr(g, n) for g in self.genes]) for n in ("low", "high"))
        if (low == LOW).all() and (high == HIGH).all():
            return theta
        share = (theta - LOW) / (HIGH - LOW)
        low, high = low.astype(theta.dtype), high.astype(theta.dtype)
        return low * (1 - share) + high * share  # so that both ends come out exactly

    def from_units(self, values: Any) -> np.ndarray:
        """The inverse of `in_units`, float64.

        Args:
            values: [..., genes], in the genes' units.
        """
        low, high = (np.asarray([getattr(g, n) for g in self.genes]) for n in ("low", "high"))
        return LOW + (HIGH - LOW) * ((np.asarray(values) - low) / (high - low))

    @property
    def ranges(self) -> np.ndarray | None:
        """[genes, 2]: where genes start, in (-5, 5); None for anywhere."""
        if self.config.initial == "uniform":
            return None
        if self.task is None:
            return self.layout.partition
        start = np.asarray([getattr(g, "partition", (g.low, g.high)) for g in self.genes])
        return self.from_units(start.T).T.astype(np.float32)

    def code(self) -> Any:
        """A context in which failures of the task's or world's code are told from ours."""
        if self.task is not None:
            parts = (self.task.fitness, self.task.init, self.task.judge)
            return code_of(f"task {self.config.task!r}", *(p for p in parts if p is not None))
        suites = self.world.suites.values()
        return code_of(f"world {self.config.env!r}", self.env, self.world.make, *suites)

    def scenes(self) -> tuple[Any, Any]:
        """Scenes of training, and those of validation, NumPy.

        They are the same where nothing is validated, and in the suite `paper`, which has its four
        starts and no others.
        """
        if self.task is not None:
            return (nothing := ()), nothing
        config, key = self.config, jax.random.key(_POOL_KEY)
        if config.scene_pool == 0:
            scenes = self.suite(key, config.num_scenes)
            if config.refine_steps == 0 or config.suite == "paper":
                return scenes, scenes
            return scenes, self.suite(jax.random.fold_in(key, 1), VALIDATION)
        # One draw, which takes seconds to compile.  A mix comes suite by suite: evenly spread rows
        # hold all of them.
        size = config.scene_pool + VALIDATION
        drawn = jax.tree.map(np.asarray, self.suite(key, size))
        rows = np.arange(VALIDATION) * size // VALIDATION
        return (
            jax.tree.map(lambda x: np.delete(x, rows, axis=0), drawn),
            jax.tree.map(lambda x: x[rows], drawn),
        )

    def variant(self, config: TrainConfig) -> "Problem":
        """The same problem under another configuration.

        Args:
            config: differs in floats only (`program_key`).
        """
        if config.env_options == self.config.env_options:
            return self._replace(config=config)
        return self._replace(config=config, env=self.world.make(**config.env_options))


def resolve(config: TrainConfig, task: Task | None = None) -> Problem:
    """Check a configuration and look up what it names.

    Args:
        config: of a run.
        task: one that has no name in the registry; the configuration then takes its name.

    Raises ValueError: field, value, what is allowed; `registry.MemberError` where the code of a
    world or task cannot be imported.
    """
    if task is not None:
        config = dataclasses.replace(config, task=task.name)
    settings.validate(config)
    if config.task == "bioa" and task is None:
        world = get_world(config.env)
        suite = get_suite(world, config.suite)
        env = world.make(**config.env_options)
        if config.refine_steps and config.refine_method == "gradient" and not world.differentiable:
            raise ValueError(
                f"refine_method = gradient: world {config.env} has no gradient worth following; "
                "allowed is cma"
            )
        layout = get_layout(config.layout)
        return Problem(config, layout.genes, None, world, layout, env, suite)
    for field in dataclasses.fields(config):
        value, usual = getattr(config, field.name), getattr(TrainConfig(), field.name)
        if field.name not in _COMMON and value != usual:
            raise ValueError(
                f"{field.name} = {value!r}: belongs to task bioa; task {config.task!r} has none"
            )
    found = get_task(config.task)(**config.task_options) if task is None else task
    if config.refine_steps and (found.judge is None or config.refine_method != "cma"):
        raise ValueError(
            f"refine_steps = {config.refine_steps}: task {config.task!r} is refined by "
            "refine_method = 'cma' alone, and where it has a judgement"
        )
    check_genes(found)
    return Problem(config, tuple(found.genes), found)


def check_genes(task: Task) -> None:
    """Refuse a gene table that cannot be learnt.

    Args:
        task: whose genes.

    Raises ValueError: task, gene, what is allowed.
    """
    names = [gene.name for gene in task.genes]
    if not names:
        raise ValueError(f"task {task.name!r} has no genes: allowed are 1 and more")
    if twice := {name for name in names if names.count(name) > 1}:
        raise ValueError(f"task {task.name!r}: gene {min(twice)!r} is there twice")
    for gene in task.genes:
        if not (np.isfinite([gene.low, gene.high]).all() and gene.low < gene.high):
            raise ValueError(
                f"task {task.name!r}: gene {gene.name!r} has range {gene.low} to {gene.high}: "
                "allowed are two finite numbers, the first the smaller one"
            )


def program_key(problem: Problem) -> tuple[Any, ...]:
    """Problems of equal key run in one compiled program: they differ in traced floats.

    Args:
        problem: of a run.
    """
    groups = ("env_options", "ga", "fitness", "smooth")
    rest = {n: v for n, v in vars(problem.config).items() if n not in groups}
    leaves, structure = jax.tree.flatten(problem.traced())
    return structure, [(x.shape, x.dtype) for x in leaves], rest
