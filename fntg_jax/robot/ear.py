"""The robot's ear and voice at the audio level.

Its microphones are heard in control steps of 0.1 s, kept for half a second, and decoded at the end
of every slot."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from fntg_jax.robot import acoustics
from fntg_jax.robot.communication import SLOT, TEAM, unpack

KEPT = 4000  # samples: a slot of 0.4 s and one step
SAID = 3200  # samples of `envs.base.Action.say`, a slot


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

    team: 0 or 1, whose band.  step: control steps from the kick-off to the one of the samples; on a
    CPU nothing is computed within slots.  Returns what
    `communication.merge` takes: words by shirt, and which of them were heard now.
    """
    # Under `vmap` one robot after the other, as a `cond` of many would compute both of its sides.
    one = jax.custom_batching.sequential_vmap(_listen) if _on_cpu() else _listen
    return one(ear, samples, team, step)


def say(words: UInt32[Array, "2"], team: Int[Array, ""] | int) -> Float[Array, "3200"]:
    """A word as `envs.base.Action.say` at the audio level; silence for both words 0."""
    one = jax.custom_batching.sequential_vmap(_say) if _on_cpu() else _say
    return one(words, jnp.asarray(team))


def _say(words, team):
    sound = lambda: jnp.pad(acoustics.encode(words, team), (0, SAID - acoustics.FRAME))  # noqa: E731
    return jax.lax.cond((words != 0).any(), sound, lambda: jnp.zeros(SAID))


def _on_cpu() -> bool:
    return jax.default_backend() == "cpu"


def _listen(ear, samples, team, step):
    sound = jnp.concatenate([ear.sound, samples], -1)[:, -KEPT:]

    def decode(sound: Array) -> tuple[Array, Array]:
        found = acoustics.decode(sound, team)
        mine = (jnp.arange(TEAM) == unpack(found.words)[0].sender) & found.valid
        return jnp.where(mine[:, None], found.words, jnp.uint32(0)), mine

    def wait(_: Array) -> tuple[Array, Array]:
        return jnp.zeros((TEAM, 2), jnp.uint32), jnp.zeros(TEAM, bool)

    words, heard = jax.lax.cond(step % SLOT == SLOT - 1, decode, wait, sound)
    return Ear(sound), words, heard
