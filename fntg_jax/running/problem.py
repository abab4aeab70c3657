"""A configuration with all that it names: world, layout and scenes, resolved once and passed on."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np

from envs.base import World
from fntg_jax.controller.layout import Layout, get_layout
from fntg_jax.learning.objective import Static, Traced
from fntg_jax.running import settings
from fntg_jax.running.registry import get_suite, get_world
from fntg_jax.running.settings import TrainConfig

_POOL_KEY = 0x9001  # of the scenes of training and validation; evaluation draws others
_VALIDATION = 2048  # scenes that the final controller is chosen on


class Problem(NamedTuple):
    """What a run learns on.  suite: (key, num_scenes) -> scenes of training."""

    config: TrainConfig
    world: World
    layout: Layout
    env: Any
    suite: Any

    @property
    def static(self) -> Static:
        """What a program is compiled for."""
        c = self.config
        return Static(self.layout, c.output, c.objective, c.num_scenes, c.scene_pool > 0)

    def traced(self) -> Traced:
        """What may change without compiling again, as NumPy; scenes come later."""
        c = self.config
        horizon = dataclasses.replace(c.ga, horizon=float(c.generations))
        return jax.tree.map(np.asarray, Traced(horizon, self.env, c.fitness, c.smooth, None))

    def scenes(self) -> tuple[Any, Any]:
        """Scenes of training, and those of validation, NumPy.

        They are the same where nothing is validated, and in the suite `paper`, which has its four
        starts and no others.
        """
        config, key = self.config, jax.random.key(_POOL_KEY)
        if config.scene_pool == 0:
            scenes = self.suite(key, config.num_scenes)
            if config.refine_steps == 0 or config.suite == "paper":
                return scenes, scenes
            return scenes, self.suite(jax.random.fold_in(key, 1), _VALIDATION)
        # One draw, which takes seconds to compile.  A mix comes suite by suite: evenly spread rows
        # hold all of them.
        size = config.scene_pool + _VALIDATION
        drawn = jax.tree.map(np.asarray, self.suite(key, size))
        rows = np.arange(_VALIDATION) * size // _VALIDATION
        return (
            jax.tree.map(lambda x: np.delete(x, rows, axis=0), drawn),
            jax.tree.map(lambda x: x[rows], drawn),
        )

    def variant(self, config: TrainConfig) -> "Problem":
        """The same problem under a configuration that differs in floats only."""
        if config.env_options == self.config.env_options:
            return self._replace(config=config)
        return self._replace(config=config, env=self.world.make(**config.env_options))


def resolve(config: TrainConfig) -> Problem:
    """Check a configuration and look up what it names.  Raises ValueError: field, value, what is
    allowed."""
    settings.validate(config)
    world = get_world(config.env)
    suite = get_suite(world, config.suite)
    env = world.make(**config.env_options)
    return Problem(config, world, get_layout(config.layout), env, suite)


def program_key(problem: Problem) -> tuple[Any, ...]:
    """Problems of equal key run in one compiled program: they differ in traced floats."""
    groups = ("env_options", "ga", "fitness", "smooth")
    rest = {n: v for n, v in vars(problem.config).items() if n not in groups}
    leaves, structure = jax.tree.flatten(problem.traced())
    return structure, [(x.shape, x.dtype) for x in leaves], rest
