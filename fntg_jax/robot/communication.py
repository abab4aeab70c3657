"""What robots of a team tell each other: one word of 64 bits, and what a robot makes of the words
it heard.

A word has 44 bits of content and 20 of checksum; as two uint32 it is `envs.base.Action.say` and
`Senses.heard`.  From the most significant bit of the first uint32:

    bits  field      step, range
    2     sender     shirt, 0 to 3
    2     role       index into the planner's roles, 0 to 3
    7, 7  x, y       3.4 m / 128 in -1.7 to 1.7; 2.2 m / 128 in -1.1 to 1.1 (team's frame)
    6     heading    2 pi / 64
    2     sd         of the place: 0.03, 0.1, 0.3, 1 m (the nearest in ratio)
    7, 7  ball x, y  like x, y
    4     ball age   0.06 n^2 s: 0 to 11.8 s in 15 steps; 15: no ball known
    20    checksum   of the 44 bits, polynomial 0x1B19E9

The checksum finds every error of up to 5 bits and every burst of up to 20 (checked in
tests/test_communication.py).  It is never all zeros for a word of zeros, which is silence.

The team's three robots speak in turn, each in a slot of its own: `turn`.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from fntg_jax.robot.messages import Heard

HALF_LENGTH, HALF_WIDTH = 1.7, 1.1  # m: field, goals and a margin
SD = (0.03, 0.1, 0.3, 1.0)  # m
AGE_STEP = 0.06  # s
NO_BALL = 15
TEAM = 3  # robots of a team, and so slots of a round
SLOT = 4  # control steps of 0.1 s a slot: a robot is heard every 1.2 s
NEVER = 1e6  # s, age of what was never heard

_POLYNOMIAL = 0x1B19E9
_SEED = 0xA5A5A  # what the checksum of zeros is


class Word(NamedTuple):
    """One robot's word, before it is packed and after; fields of any one shape.

    sender: shirt.  role: index.  x, y: m, heading: rad, the sender's own pose in its team's frame;
    sd: m, how far the place may be off.  ball_x, ball_y: m.  ball_age: s since it saw the ball;
    infinite: it knows of none.
    """

    sender: Int[Array, "..."]
    role: Int[Array, "..."]
    x: Float[Array, "..."]
    y: Float[Array, "..."]
    heading: Float[Array, "..."]
    sd: Float[Array, "..."]
    ball_x: Float[Array, "..."]
    ball_y: Float[Array, "..."]
    ball_age: Float[Array, "..."]


def _remainders() -> tuple[int, ...]:
    """What each of the 44 content bits, from the last, adds to the checksum."""
    value, found = 1, []
    for n in range(64):
        if n >= 20:
            found.append(value)
        value <<= 1
        if value >> 20:
            value ^= _POLYNOMIAL
    return tuple(found)


_REMAINDERS = _remainders()


def checksum(words: UInt32[Array, "... 2"]) -> UInt32[Array, "..."]:
    """Remainder of the 44 content bits by the polynomial 0x1B19E9, a cyclic code over GF(2).

    words: the last 20 bits are ignored.
    """
    high, low = words[..., 0], words[..., 1]
    total = jnp.full(high.shape, _SEED, jnp.uint32)
    for n, remainder in enumerate(_REMAINDERS):
        word, shift = (low, n + 20) if n < 12 else (high, n - 12)
        total ^= ((word >> shift) & 1) * jnp.uint32(remainder)
    return total


def _cell(value: Array, half: float) -> Array:
    return jnp.clip(jnp.floor((value + half) * (64 / half)), 0, 127).astype(jnp.uint32)


def _middle(cell: Array, half: float) -> Array:
    return (cell.astype(jnp.float32) + 0.5) * (half / 64) - half


def pack(word: Word) -> UInt32[Array, "... 2"]:
    """The 64 bits of a word, checksum included.  Values out of range take the nearest in range.

    Places are off by at most 13.3 mm along x and 8.6 mm along y, headings by 0.049 rad.
    """
    turn = jnp.round(word.heading * (64 / (2 * np.pi))).astype(jnp.int32).astype(jnp.uint32) & 63
    sd = sum((word.sd > np.sqrt(a * b)).astype(jnp.uint32) for a, b in zip(SD, SD[1:]))
    age = jnp.round(jnp.sqrt(jnp.maximum(word.ball_age, 0.0) / AGE_STEP))
    age = jnp.clip(age, 0, NO_BALL).astype(jnp.uint32)  # NaN-free: infinity becomes NO_BALL
    sender = jnp.clip(word.sender, 0, 3).astype(jnp.uint32)
    role = jnp.clip(word.role, 0, 3).astype(jnp.uint32)
    ball_x, ball_y = _cell(word.ball_x, HALF_LENGTH), _cell(word.ball_y, HALF_WIDTH)
    known = age < NO_BALL
    ball_x, ball_y = jnp.where(known, ball_x, 0), jnp.where(known, ball_y, 0)
    x, y = _cell(word.x, HALF_LENGTH), _cell(word.y, HALF_WIDTH)
    high = sender << 30 | role << 28 | x << 21 | y << 14 | turn << 8 | sd << 6 | ball_x >> 1
    low = (ball_x & 1) << 31 | ball_y << 24 | age << 20
    words = jnp.stack([high, low], -1)
    return words.at[..., 1].set(low | checksum(words))


def unpack(words: UInt32[Array, "... 2"]) -> tuple[Word, Bool[Array, "..."]]:
    """A word from its 64 bits, and whether its checksum is right (else the word means nothing)."""
    high, low = words[..., 0], words[..., 1]
    heading = (high >> 8 & 63).astype(jnp.float32)
    heading = jnp.where(heading > 32, heading - 64, heading) * (2 * np.pi / 64)
    code = high >> 6 & 3
    sd = jnp.where(code < 2, jnp.where(code < 1, SD[0], SD[1]), jnp.where(code < 3, SD[2], SD[3]))
    age = low >> 20 & 15
    word = Word(
        sender=(high >> 30).astype(jnp.int32),
        role=(high >> 28 & 3).astype(jnp.int32),
        x=_middle(high >> 21 & 127, HALF_LENGTH),
        y=_middle(high >> 14 & 127, HALF_WIDTH),
        heading=heading,
        sd=sd,
        ball_x=_middle((high & 63) << 1 | low >> 31, HALF_LENGTH),
        ball_y=_middle(low >> 24 & 127, HALF_WIDTH),
        ball_age=jnp.where(age == NO_BALL, jnp.inf, AGE_STEP * age.astype(jnp.float32) ** 2),
    )
    return word, checksum(words) == (low & 0xFFFFF)


def turn(shirt: Int[Array, "..."], step: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Whether a robot's slot begins in this control step.

    shirt: 0 to 2.  step: control steps of 0.1 s since the kick-off.  Slots last `SLOT` steps and go
    round the team, so that a robot may speak every 1.2 s, and its word, sent from the slot's begin
    to its end, is at most 1.6 s old when the next one replaces it.
    """
    return step % (TEAM * SLOT) == shirt * SLOT


def nothing_heard(num_mates: int = TEAM - 1) -> Heard:
    """What a robot knows from its mates at the kick-off."""
    zero = jnp.zeros(num_mates)
    never = jnp.full(num_mates, NEVER)
    return Heard(zero, zero, zero, zero, never, jnp.zeros(num_mates, jnp.int32), never)


def merge(
    known: Heard,
    heard: UInt32[Array, "R 2"],
    heard_valid: Bool[Array, " R"],
    shirt: Int[Array, ""],
    dt: float,
    delay: float = 0.1 * SLOT,
) -> Heard:
    """What the mates last said, with its age: `known` after one more control step.

    heard, heard_valid: `envs.base.Senses`, by shirt.  A word whose checksum is wrong or whose
    sender is another than its place says counts as not heard.  shirt: of the robot itself, whose
    own words are ignored; mates keep the order of their shirts.  dt: s since the last call.
    delay: s from the moment a word was made to its end.
    """
    num_mates = known.age.shape[0]
    mates = jnp.arange(num_mates)
    mates = mates + (mates >= shirt)
    words, right = unpack(heard[mates])
    new = heard_valid[mates] & right & (words.sender == mates)
    return Heard(
        x=jnp.where(new, words.x, known.x),
        y=jnp.where(new, words.y, known.y),
        ball_x=jnp.where(new, words.ball_x, known.ball_x),
        ball_y=jnp.where(new, words.ball_y, known.ball_y),
        ball_age=jnp.where(new, jnp.minimum(words.ball_age, NEVER), known.ball_age),
        role=jnp.where(new, words.role, known.role),
        age=jnp.where(new, delay, jnp.minimum(known.age + dt, NEVER)),
    )
