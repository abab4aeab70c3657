"""The words of `communication` as sound: 38 tones of 10 ms, one of 16 pitches each, at 8 kHz.

A frame is 3 known tones, 32 tones of data, 3 known tones.  The 64 bits pass the convolutional code
(128 bits), which a permutation spreads over the frame: bit i is bit i // 32 of tone 11 i mod 32, so
that neighbours are 110 ms and more apart.  Each team has a band of its own, of 16 tones 100 Hz
apart: 500 to 2000 Hz and 2200 to 3700 Hz.  Every tone makes whole oscillations in 10 ms, so the
phase never jumps; the loudness is constant, which suits a small speaker.

The receiver knows no phases and no levels.  It measures the energy of each pitch in windows of
10 ms, adds its microphones, finds the known tones, and decodes.  All of it is pure JAX.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from fntg_jax.robot import convolutional
from fntg_jax.robot.communication import unpack

RATE = 8000  # Hz
TONE = 80  # samples of a tone
SPACING = RATE // TONE  # Hz
PITCHES = 16
LOWEST = (500, 2200)  # Hz, of each team's band
DATA = 32  # tones of a frame that carry bits
KNOWN = np.array([4, 13, 1, 10, 15, 7])  # pitches before and after them: no two the same
KNOWN_AT = np.array([0, 1, 2, 35, 36, 37])
DATA_AT = np.arange(3, 35)
FRAME = (DATA + len(KNOWN)) * TONE  # samples
HOP = 8  # samples between windows
_HOPS = TONE // HOP
_SPAN = (DATA + len(KNOWN) - 1) * _HOPS  # windows from a frame's first to its last tone

_ORDER = np.arange(4 * DATA)
_ORDER = 4 * (11 * _ORDER % DATA) + _ORDER // DATA  # place of coded bit i among the tones' bits

# What a window must have to be worth decoding, and a frame to be believed: see docs.
SYNC_LEAST = 0.2
QUALITY_LEAST = 0.8
# Odds of a frame, before its checksum is looked at: exp(SLOPE (quality - EVEN)).
SLOPE, EVEN = 60.0, 0.81


class Decoded(NamedTuple):
    """One frame found in a sound.

    words: the 64 bits.  valid: checksum and quality are right; otherwise words mean nothing.
    quality: evidence (logarithms of energies) for the 32 decoded pitches, over that for the loudest
    pitches: 1 where each decoded pitch is the loudest, about 0.55 for noise.
    sync: mean share of the known tones in the energy of their windows, 0 to 1.  start: samples from
    the sound's begin to the frame's.
    """

    words: UInt32[Array, "2"]
    valid: Bool[Array, ""]
    quality: Float[Array, ""]
    sync: Float[Array, ""]
    start: Int[Array, ""]


def _tones() -> np.ndarray:
    """[band, pitch, sample]"""
    hertz = np.array(LOWEST)[:, None] + SPACING * np.arange(PITCHES)
    return np.sin(2 * np.pi * hertz[..., None] * np.arange(TONE) / RATE).astype(np.float32)


def _receiver() -> np.ndarray:
    """[band, 160 samples, 10 pieces x 16 pitches x 2]: what a tone's 80 samples, with 40 before and
    40 after, add to the cosine and sine sums of each piece of 8 samples.

    Two steps in one matrix: a high-pass filter of 81 taps (windowed sinc) that takes away what is
    below about 350 Hz (hum, steps, wind), and the sums.  All pitches repeat after 80 samples, so
    pieces of one tone and the next can be added up.
    """
    n = np.arange(-TONE // 2, TONE // 2 + 1)
    low = np.sinc(2 * 380 / RATE * n) * np.hamming(len(n))
    taps = -low / low.sum()
    taps[TONE // 2] += 1
    filter_matrix = np.zeros((2 * TONE, TONE))
    for sample in range(TONE):
        filter_matrix[sample : sample + len(n), sample] = taps
    hertz = np.array(LOWEST)[:, None] + SPACING * np.arange(PITCHES)
    angle = 2 * np.pi * hertz[..., None] * np.arange(TONE) / RATE
    sums = np.zeros((len(LOWEST), TONE, _HOPS, PITCHES, 2))
    for sample in range(TONE):
        sums[:, sample, sample // HOP, :, 0] = np.cos(angle[..., sample])
        sums[:, sample, sample // HOP, :, 1] = np.sin(angle[..., sample])
    return (filter_matrix @ sums.reshape(len(LOWEST), TONE, -1)).astype(np.float32)


_TONES = _tones()
_RECEIVER = _receiver()


def to_bits(words: UInt32[Array, "2"]) -> Int[Array, "64"]:
    """The bits, most significant first."""
    return (
        ((words[:, None] >> jnp.arange(31, -1, -1, dtype=jnp.uint32)) & 1).astype(int).reshape(64)
    )


def from_bits(bits: Int[Array, "64"]) -> UInt32[Array, "2"]:
    shifts = jnp.arange(31, -1, -1, dtype=jnp.uint32)
    return (bits.astype(jnp.uint32).reshape(2, 32) << shifts).sum(-1).astype(jnp.uint32)


def to_pitches(words: UInt32[Array, "2"]) -> Int[Array, "38"]:
    """The pitches of a frame, 0 to 15."""
    coded = jnp.zeros(4 * DATA, int).at[_ORDER].set(convolutional.encode(to_bits(words)))
    data = coded.reshape(DATA, 4) @ jnp.array([8, 4, 2, 1])
    return jnp.concatenate([KNOWN[:3], data, KNOWN[3:]])


def encode(words: UInt32[Array, "2"], team: Int[Array, ""] | int) -> Float[Array, "3040"]:
    """The sound of a word, 0.38 s at 8 kHz, amplitude 1; silence for both words 0.

    team: 0 or 1, whose band is used.
    """
    sound = jnp.asarray(_TONES)[team, to_pitches(words)].reshape(-1)
    return jnp.where((words != 0).any(), sound, 0.0)


def energies(
    sound: Float[Array, "channels samples"], team: Int[Array, ""] | int
) -> Float[Array, "windows 16"]:
    """Energy of each pitch in windows of 10 ms, every millisecond, microphones added.

    Microphones are weighted by the inverse of their noise, for which the geometric mean over
    windows and pitches stands: even during a frame, 15 of 16 pitches are silent.
    """
    channels, samples = sound.shape[0], sound.shape[-1] // TONE * TONE
    half = jnp.zeros((channels, TONE // 2))
    padded = jnp.concatenate([half, sound[:, :samples], half], 1).reshape(channels, -1, TONE)
    around = jnp.concatenate([padded[:, :-1], padded[:, 1:]], -1)
    pieces = (around @ jnp.asarray(_RECEIVER)[team]).reshape(channels, -1, PITCHES * 2)
    windows = pieces.shape[1] - _HOPS + 1
    total = pieces[:, :windows]
    for n in range(1, _HOPS):
        total = total + pieces[:, n : n + windows]
    energy = (total**2).reshape(channels, windows, PITCHES, 2).sum(-1)
    peak = energy.max(axis=(1, 2), keepdims=True) + 1e-20
    noise = jnp.exp(jnp.log(energy + 1e-6 * peak).mean(axis=(1, 2), keepdims=True))
    return (energy / noise).sum(0)


def known_tones(energy: Float[Array, "windows 16"]) -> Float[Array, " starts"]:
    """Mean share that the six known tones have in their windows' energy, by window of the start."""
    share = energy / jnp.maximum(energy.sum(-1, keepdims=True), 1e-20)
    starts = energy.shape[0] - _SPAN
    found = [share[n * _HOPS : n * _HOPS + starts, pitch] for n, pitch in zip(KNOWN_AT, KNOWN)]
    return jnp.stack(found).mean(0)


def above_echo(tones: Float[Array, "38 16"]) -> Float[Array, "38 16"]:
    """Energies of a frame's tones and pitches, in parts of noise and of the echo to be expected.

    An echo that decays exponentially leaves in each pitch a constant share of the energy of 10 ms
    before.  That share is measured: the mean of the 24 smallest of the 37 ratios of the energy just
    after a tone, in its pitch, to its energy (larger ones come from a pitch that is sounded again).
    """
    loudest = jnp.argmax(tones[:-1], -1)[:, None]
    at_tone = jnp.take_along_axis(tones[:-1], loudest, 1)[:, 0]
    after = jnp.take_along_axis(tones[1:], loudest, 1)[:, 0]
    share = jnp.clip(1.3 * jnp.sort(after / (at_tone + 1e-20))[:24].mean(), 0.02, 0.8)
    one, two, three = (jnp.pad(tones, ((n, 0), (0, 0)))[: len(tones)] for n in (1, 2, 3))
    echo = share * jnp.maximum(one, share * jnp.maximum(two, share * three))
    return tones / (jnp.exp(jnp.log(tones + 1e-20).mean()) * 1.8 + echo)


def read(energy: Float[Array, "windows 16"], start: Int[Array, ""]) -> Decoded:
    """Decode the frame whose first tone fills the window `start`."""
    tones = energy[start + _HOPS * jnp.arange(DATA + len(KNOWN))]
    cells = above_echo(tones)[DATA_AT]
    # A logarithm, so that no single loud noise outweighs many tones.
    level = jnp.log(cells + cells.mean(-1, keepdims=True) + 1e-20)
    bit = (np.arange(PITCHES)[:, None] >> np.arange(3, -1, -1)) & 1
    zero = jnp.where(bit == 0, level[..., None], -jnp.inf).max(1)
    one = jnp.where(bit == 1, level[..., None], -jnp.inf).max(1)
    evidence = (zero - one).reshape(-1)[_ORDER]
    words = from_bits(convolutional.decode(evidence))
    mean = level.mean(-1)
    decoded = jnp.take_along_axis(level, to_pitches(words)[3:-3, None], 1)[:, 0] - mean
    quality = decoded.sum() / ((level.max(-1) - mean).sum() + 1e-20)
    share = tones[KNOWN_AT, KNOWN] / (tones[KNOWN_AT].sum(-1) + 1e-20)
    _, right = unpack(words)
    valid = right & (quality >= QUALITY_LEAST) & (share.mean() >= SYNC_LEAST)
    return Decoded(words, valid, quality, share.mean(), start * HOP)


def decode(sound: Float[Array, "channels samples"], team: Int[Array, ""] | int) -> Decoded:
    """The most likely frame of a team's band in a short sound that holds one whole frame.

    sound: 8 kHz, any loudness, at least 3040 samples.
    """
    energy = energies(sound, team)
    return read(energy, jnp.argmax(known_tones(energy)))


def find(
    sound: Float[Array, "channels samples"], team: Int[Array, ""] | int, most: int = 8
) -> Decoded:
    """The `most` likeliest frames of a team's band that lie whole in a sound, leaves [most].

    Two frames may overlap, but not begin within 10 ms of each other; `valid` says which are any.
    """
    energy = energies(sound, team)
    score = known_tones(energy)
    near = jax.lax.reduce_window(score, -jnp.inf, jax.lax.max, (2 * _HOPS + 1,), (1,), "same")
    _, starts = jax.lax.top_k(jnp.where(score == near, score, -1.0), most)
    return jax.vmap(read, (None, 0))(energy, starts)


def confidence(quality: Float[Array, "..."]) -> Float[Array, "..."]:
    """Probability that a frame with a right checksum is the one that was sent.

    By Bayes' rule from the share of right frames at this quality before the checksum is looked at,
    and from the one in 2^20 that a wrong frame has a right checksum by chance.
    """
    odds = jnp.exp(SLOPE * (quality - EVEN))
    return odds / (odds + 2.0**-20)
