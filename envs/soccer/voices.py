"""The audio level of sound in a match: what every robot's microphones pick up in a control step.

`Action.say` is then a sound of up to 0.4 s, and `Senses.heard` samples (`envs.soccer.audio`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import Action
from envs.soccer import audio
from envs.soccer.state import Game, Robots

SAY = 4 * audio.STEP  # samples of the longest sound that a robot says
HALL = audio.Hall()
_LOUD, _LOUD_TURN = 0.05, 0.5  # m/s, rad/s, from which on motors are as loud as ever (assumed)


class Voices(NamedTuple):
    """The air and the last step's samples of every robot's two microphones, in Pa."""

    air: audio.State
    samples: Float[Array, "2 800 R"]


def silence(robots: Robots, game: Game) -> Voices:
    """Nobody has spoken."""
    count = robots.x.shape[0]

    def one(seed: Array) -> Voices:
        air = audio.quiet(jax.random.key(seed), count, SAY, HALL)
        return Voices(air, jnp.zeros((2, audio.STEP, count)))

    return jax.vmap(one, out_axes=-1)(game.seed) if game.seed.ndim else one(game.seed)


def speak(voices: Voices, robots: Robots, action: Action, may: Array, game: Game) -> Voices:
    """One step of the air.  action.say: [samples, R], or anything shorter for silence; what is said
    while a robot still speaks is added."""
    pace = jnp.abs(robots.v) + jnp.abs(robots.v_y)
    loud = jnp.maximum(pace / _LOUD, jnp.abs(robots.omega) / _LOUD_TURN)
    loud = jnp.minimum(loud, 1.0)
    say = action.say
    if say.shape[0] != SAY:
        say = jnp.zeros((SAY, *robots.x.shape))
    say = jnp.where(may, jnp.clip(say, -1, 1), 0.0)

    def one(voices, x, y, cos, sin, say, loud, seed, tick) -> Voices:
        key = jax.random.fold_in(jax.random.key(seed ^ jnp.uint32(0x5EED)), tick)
        place, heading = jnp.stack([x, y], -1), jnp.arctan2(sin, cos)
        air, heard = audio.step(key, voices.air, place, heading, say.T, loud, HALL)
        return Voices(air, jnp.moveaxis(heard, 0, -1))

    rest = robots.x, robots.y, robots.cos, robots.sin, say, loud, game.seed, game.tick
    if game.seed.ndim:
        return jax.vmap(one, in_axes=-1, out_axes=-1)(voices, *rest)
    return one(voices, *rest)
