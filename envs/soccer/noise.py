"""Noise that a counter decides: number = hash(seed, tick, lane, channel), nothing is carried on.

`jax.random` (Threefry) costs more than the whole physics of a match.  Here a number costs two
multiplications: the 32-bit mixer "lowbias32" (C. Wellons, "Prospecting for hash functions", 2018,
github.com/skeeto/hash-prospector, constants of the issue of 2022 by TheIronBorn: bias 0.107),
twice: once for the key of a robot in a step, once for each number drawn with it.  Tests of its
quality: `tests/soccer/test_noise.py`.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

_GOLDEN = 0x9E3779B9  # 2^32 / golden ratio, odd
_TICK, _LANE = 0x85EBCA6B, 0xC2B2AE35  # odd, from MurmurHash3


def mix(x: UInt32[Array, "*n"]) -> UInt32[Array, "*n"]:
    """A bijection of 32-bit words in which every input bit flips every output bit half the time."""
    x = (x ^ (x >> 16)) * jnp.uint32(0x21F0AAAD)
    x = (x ^ (x >> 15)) * jnp.uint32(0x735A2D97)
    return x ^ (x >> 15)


def key(
    seed: UInt32[Array, "*n"], tick: Int[Array, "*n"], lane: UInt32[Array, "*n"]
) -> UInt32[Array, "*n"]:
    """The key of one lane (a robot, the ball) in one step of one match; arguments broadcast."""
    tick = tick.astype(jnp.uint32) * jnp.uint32(_TICK)
    # The seed goes through the mixer of its own: seeds that follow each other share nothing.
    return mix(mix(seed ^ tick) + lane * jnp.uint32(_LANE) + jnp.uint32(1))


def bits(key: UInt32[Array, "*n"], channel: int) -> UInt32[Array, "*n"]:
    """The 32 random bits of a channel (0, 1, ...) under a key."""
    return mix(key ^ jnp.uint32((channel + 1) * _GOLDEN & 0xFFFFFFFF))


def channels(
    key: UInt32[Array, "*n"], rows: Sequence[int], mirrored: Sequence[int], hand: Any
) -> UInt32[Array, "*m"]:
    """The bits of several channels, as rows; `mirrored` ones where hand < 0."""
    column, other = (
        jnp.asarray([(k + 1) * _GOLDEN & 0xFFFFFFFF for k in numbers], jnp.uint32).reshape(
            len(numbers), *(1,) * key.ndim
        )
        for numbers in (rows, mirrored)
    )
    return mix(key[None] ^ jnp.where(hand < 0, other, column))


def uniform(key: UInt32[Array, "*n"], channel: int) -> Float[Array, "*n"]:
    """Uniform in [0, 1), 24 bits."""
    return to_uniform(bits(key, channel))


def normal(key: UInt32[Array, "*n"], channel: int) -> Float[Array, "*n"]:
    """Standard normal, as `to_normal`."""
    return to_normal(bits(key, channel))


def to_uniform(word: UInt32[Array, "*n"]) -> Float[Array, "*n"]:
    """32 random bits as a number in [0, 1)."""
    # Through int32: there is no vector conversion from uint32.
    return (word >> 8).astype(jnp.int32).astype(jnp.float32) * jnp.float32(2**-24)


def to_normal(word: UInt32[Array, "*n"]) -> Float[Array, "*n"]:
    """32 random bits as a standard normal number, within 0.0021 of its distribution function, |z|
    at most 4.04.

    The four bytes are summed (Irwin-Hall, n = 4) and stretched by a cubic that gives the sum of
    uniforms the normal's kurtosis; steps of 0.007.  No logarithm, no square root.
    """
    pair = (word & jnp.uint32(0x00FF00FF)) + ((word >> 8) & jnp.uint32(0x00FF00FF))
    total = ((pair & jnp.uint32(0xFFFF)) + (pair >> 16)).astype(jnp.int32).astype(jnp.float32)
    z = (total - 510.0) * jnp.float32(1 / 147.80054)  # variance of the sum: 4 (256^2 - 1) / 12
    return z * (jnp.float32(_CUBIC[0]) + jnp.float32(_CUBIC[1]) * z * z)


# a z + b z^3 with variance 1 and kurtosis 3 for z of kurtosis 2.7 (solved for in test_noise).
_CUBIC = (0.94903328, 0.01864238)
