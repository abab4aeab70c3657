"""`random`: walks wherever chance has it, and kicks now and then."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from envs.base import Truth, Walk
from fntg_jax.learning.play import Side
from fntg_jax.teams.still import stand


class Memory(NamedTuple):
    """word: of a generator; v, v_y, omega: of the present walk, m/s, rad/s."""

    word: UInt32[Array, ""]
    v: Float[Array, ""]
    v_y: Float[Array, ""]
    omega: Float[Array, ""]


def make(match: Any, side: int) -> Side:
    """The team for a match on a side, 0 home or 1 away: the two sides walk differently."""
    body = match.bodies[side]
    styles = body.styles
    limits = tuple(jnp.float32(x[0]) for x in (styles.forward, styles.lateral, styles.turn))
    get_up = _index(body.postures.name, "get-up")
    team = (jnp.uint32(side + 1), *limits, jnp.int32(len(body.kicks.name)), jnp.int32(get_up))
    return Side("random", team, _begin, _control, truth=True)


def _index(names, name):
    """1 + index of a name in a table, 0 where it has none."""
    return names.index(name) + 1 if name in names else 0


def _begin(team, shirt, pose):
    zero = jnp.zeros((), jnp.float32)
    word = team[0] * jnp.uint32(0x9E3779B9) + shirt.astype(jnp.uint32) * jnp.uint32(0x85EBCA6B)
    return Memory(word, zero, zero, zero)


def _control(team, memory, truth: Truth):
    _, forward, lateral, turn, kicks, get_up = team
    # What the match does moves the generator too, so that matches of other seeds differ.
    word = memory.word + (truth.ball[0] * 1e6).astype(jnp.int32).astype(jnp.uint32)
    draws = []
    for _ in range(4):
        word = word * jnp.uint32(747796405) + jnp.uint32(2891336453)
        mixed = (word ^ (word >> 16)) * jnp.uint32(0x21F0AAAD)
        draws.append(((mixed >> 9).astype(jnp.int32)).astype(jnp.float32) * jnp.float32(2**-22) - 1)
    change = draws[3] > 0.9  # a new walk once in two seconds
    v = jnp.where(change, draws[0] * forward, memory.v)
    v_y = jnp.where(change, draws[1] * lateral, memory.v_y)
    omega = jnp.where(change, draws[2] * turn, memory.omega)
    kick = jnp.where(draws[3] < -0.98, 1 + (0.5 * (draws[0] + 1) * kicks).astype(jnp.int32), 0)
    action = stand()._replace(
        walk=Walk(jnp.zeros((), jnp.int32), v, v_y, omega),
        kick=jnp.minimum(kick, kicks),
        posture=jnp.where(truth.upright, 0, get_up),
    )
    return Memory(word, v, v_y, omega), action
