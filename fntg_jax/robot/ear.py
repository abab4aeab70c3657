"""The robot's ear at the audio level: what its microphones hear in control steps of 0.1 s, kept
for half a second, and decoded at the end of every slot."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from fntg_jax.robot import acoustics
from fntg_jax.robot.communication import SLOT, TEAM, unpack

KEPT = 4000  # samples: a slot of 0.4 s and one step


class Ear(NamedTuple):
    """The last half second at both microphones; any unit of pressure."""

    sound: Float[Array, "channels 4000"]


def silent(channels: int = 2) -> Ear:
    return Ear(jnp.zeros((channels, KEPT)))


def listen(
    ear: Ear,
    samples: Float[Array, "channels new"],
    team: Int[Array, ""] | int,
    step: Int[Array, ""],
) -> tuple[Ear, UInt32[Array, "R 2"], Bool[Array, " R"]]:
    """Take in one step's samples (8 kHz); after a slot's last, decode.

    team: 0 or 1, whose band.  step: control steps since the kick-off; where it is the same for all
    robots of a vmap (in_axes None), nothing is computed within slots.  Returns what
    `communication.merge` takes: words by shirt, and which of them were heard now.
    """
    sound = jnp.concatenate([ear.sound, samples], -1)[:, -KEPT:]

    def decode(sound: Array) -> tuple[Array, Array]:
        found = acoustics.decode(sound, team)
        mine = (jnp.arange(TEAM) == unpack(found.words)[0].sender) & found.valid
        return jnp.where(mine[:, None], found.words, jnp.uint32(0)), mine

    def wait(_: Array) -> tuple[Array, Array]:
        return jnp.zeros((TEAM, 2), jnp.uint32), jnp.zeros(TEAM, bool)

    words, heard = jax.lax.cond(step % SLOT == SLOT - 1, decode, wait, sound)
    return Ear(sound), words, heard
