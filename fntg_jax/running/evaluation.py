"""Success of a controller on suites of scenes, with Wilson intervals."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Environment, World
from fntg_jax.controller.controller import Controller
from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import Outcome, rollout_pairs
from fntg_jax.running import memory
from fntg_jax.running.registry import get_suite
from fntg_jax.running.settings import MOST_SCENES
from fntg_jax.running.statistics import Rate, wilson

PARTS = ("reach", "safe", "stop", "success")


class Evaluation(NamedTuple):
    """One suite: rates by part, and per trial the outcome and whether it succeeded."""

    suite: str
    num_scenes: int
    rates: dict[str, Rate]
    scenes: Any
    outcome: Outcome
    success: np.ndarray

    def __repr__(self) -> str:  # not pages of arrays
        rates = ", ".join(f"{name} {rate}" for name, rate in self.rates.items())
        return f"Evaluation({self.suite!r}, {self.num_scenes} scenes: {rates})"


def evaluate(
    controller: Controller,
    world: World,
    suite: str,
    num_scenes: int,
    seed: int = 0,
    env: Environment | None = None,
) -> Evaluation:
    """Run a controller through scenes that training never saw: it draws from other keys.

    Args:
        controller: who drives.
        world: `envs.base.World`.
        suite: of scenes.
        num_scenes: how many.
        seed: of the scenes.
        env: the world's environment; None for `environment_for` the controller.

    Raises ValueError on an unknown suite, a wrong number, or too little memory.
    """
    env = environment_for(controller, world) if env is None else env
    scenes = held_out_scenes(world, suite, num_scenes, seed)
    theta = jnp.asarray(controller.theta, jnp.float32)[None]
    program = _run.lower(controller.layout, theta, scenes, env, output=controller.output).compile()
    memory.check(program)
    outcome = program(theta, scenes, env)
    outcome = jax.tree.map(lambda x: np.asarray(x[0]), outcome)
    parts = fitness.success(outcome)
    rates = {name: wilson(int(np.sum(getattr(parts, name))), num_scenes) for name in PARTS}
    return Evaluation(suite, num_scenes, rates, scenes, outcome, np.asarray(parts.success))


# Suites whose scenes are alike, and several controllers, share a compilation.
_run = jax.jit(rollout_pairs, static_argnums=0, static_argnames="output")


def held_out_suites(world: World) -> list[str]:
    """The suites of a world that test: all but the paper's learning set-up.

    Args:
        world: `envs.base.World`.
    """
    return [name for name in world.suites if name != "paper"]


def held_out_scenes(world: World, suite: str, num_scenes: int, seed: int = 0) -> Any:
    """Scenes of a suite; asking for more leaves the first ones as they are.

    Args:
        world: `envs.base.World`.
        suite: one of its suites, with options, or a mix (`registry.get_suite`).
        num_scenes: how many, from 1.
        seed: of the scenes, from 0.

    Raises ValueError on an unknown suite or a wrong number.
    """
    check_scenes(num_scenes)
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed = {seed}: allowed are whole numbers from 0 below 2^32")
    # Training seeds are folded from small whole numbers; this constant keeps the suites apart.
    key = jax.random.fold_in(jax.random.key(seed), 0x5CE4E)
    return get_suite(world, suite)(key, num_scenes)


def check_scenes(num_scenes: int) -> None:
    """Refuse a number of scenes.

    Args:
        num_scenes: wanted.

    Raises ValueError: scenes, value, what is allowed.
    """
    if not 1 <= num_scenes <= MOST_SCENES:
        raise ValueError(
            f"scenes = {num_scenes}: allowed are whole numbers from 1 to {MOST_SCENES}"
        )


def environment_for(controller: Controller, world: World, **options: float) -> Any:
    """The world's environment at the controller's limits and control step.

    Args:
        controller: who will drive.
        world: `envs.base.World`.
        options: of the world by name, over these.

    Raises ValueError on an unknown option or value.
    """
    limits = {k: float(v) for k, v in controller.limits._asdict().items()}
    return world.make(**{"dt": controller.control_dt, **limits, **options})
