"""`still`: robots that stand at their kick-off places, one of them in the goal's mouth."""

from typing import Any

import jax.numpy as jnp

from envs.base import Action, Walk
from fntg_jax.learning.play import Side


def make(match: Any, side: int) -> Side:
    """The team for a match (its bodies' tables) on a side, 0 home or 1 away."""
    return Side("still", (), lambda team, shirt, pose: (), _control, truth=True)


def _control(team, memory, truth):
    return memory, stand()


def stand() -> Action:
    """Nothing at all."""
    zero, none = jnp.zeros((), jnp.float32), jnp.zeros((), jnp.int32)
    return Action(
        Walk(none, zero, zero, zero),
        jnp.zeros(3, jnp.float32),
        none,
        none,
        jnp.zeros(2, jnp.uint32),
    )
