"""WAV files, and the acoustic messages in them."""

import io
import math
import warnings
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from fntg_jax.files import read_bytes, write_atomically, writing
from fntg_jax.robot import acoustics
from fntg_jax.robot.communication import Word, unpack

LEAST_RATE, MOST_RATE = 8000, 768_000  # Hz
# Sounds are searched in blocks of one length, so that there is one compilation; a frame that does
# not end in one block is whole in the next.
_BLOCK = 2 * acoustics.RATE
_STEP = _BLOCK - 6 * acoustics.RATE // 10
_TOGETHER = 8  # blocks searched at once


class Message(NamedTuple):
    """One word found in a sound: its team, its begin in s, the 64 bits, what they say, and how sure
    that is, 0 to 1 (see docs/communication.md)."""

    team: int
    time: float
    bits: int
    word: Word
    quality: float
    confidence: float


def read_wav(path: str | Path) -> tuple[int, Float[np.ndarray, "channels samples"]]:
    """Rate (Hz) and samples of a WAV file, integers scaled to -1 to 1.

    Raises ValueError (file, reason) where it is none, is empty, or holds what is no sound.
    """
    # scipy.io costs a tenth of a second; every other command does without.
    from scipy.io import wavfile

    data = read_bytes(path, "WAV file of robots", most=500_000_000)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            rate, samples = wavfile.read(io.BytesIO(data))
    # What scipy raises depends on where the file breaks off, down to UnboundLocalError.
    except Exception as error:
        reason = "its parts are wrong" if isinstance(error, NameError) else error
        raise ValueError(f"{path}: no WAV file that can be read: {reason}") from None
    # Programs that write to a pipe don't know the length and say the greatest.
    endless = int.from_bytes(data[4:8], "little") > 0x7FFF0000
    if not endless and any("premature" in str(warning.message) for warning in warned):
        raise ValueError(f"{path}: breaks off after {len(data)} bytes")
    if not LEAST_RATE <= rate <= MOST_RATE:
        raise ValueError(
            f"{path}: {rate} samples a second: allowed are {LEAST_RATE} to {MOST_RATE}"
        )
    if samples.size == 0:
        raise ValueError(f"{path}: no samples")
    samples = samples.reshape(len(samples), -1).T
    kind = samples.dtype
    if kind == np.uint8:
        samples = samples.astype(np.float32) / 128 - 1
    elif kind.kind == "i":
        samples = samples.astype(np.float32) / -float(np.iinfo(kind).min)
    if not np.isfinite(samples).all():
        raise ValueError(f"{path}: samples that are no numbers (NaN or infinity)")
    return rate, samples.astype(np.float32)


def write_wav(path: str | Path, rate: int, samples: Float[np.ndarray, " samples"]) -> None:
    """A WAV file of 16 bits and one channel.  Raises ValueError where it cannot be written."""
    from scipy.io import wavfile

    file = io.BytesIO()
    wavfile.write(file, rate, np.round(np.clip(samples, -1, 1) * 32767).astype(np.int16))
    with writing(path):
        write_atomically(path, file.getvalue())


def resample(
    samples: Float[np.ndarray, "channels samples"], rate: int, new_rate: int
) -> Float[np.ndarray, "channels new_samples"]:
    """The same sound at another rate, frequencies kept up to 0.95 of half the lower rate."""
    if rate == new_rate:
        return samples
    from scipy import signal

    common = math.gcd(rate, new_rate)
    up, down = new_rate // common, rate // common
    largest = max(up, down)
    taps = signal.firwin(2 * 40 * largest + 1, 0.975 / largest, window=("kaiser", 6.0))
    return signal.resample_poly(samples, up, down, axis=-1, window=taps).astype(np.float32)


@jax.jit
def _search(blocks: Float[jax.Array, "blocks channels samples"]) -> acoustics.Decoded:
    """Leaves [2 teams, blocks, frames]."""
    return jax.vmap(lambda team: jax.vmap(lambda block: acoustics.find(block, team))(blocks))(
        np.arange(2)
    )


def listen(rate: int, samples: Float[np.ndarray, "channels samples"]) -> list[Message]:
    """All valid messages of both teams in a sound, in the order of their beginnings."""
    sound = resample(samples, rate, acoustics.RATE)
    # Silence around the sound: a frame may begin with the first sample and end with the last.
    margin = acoustics.TONE * 2
    num_blocks = max(1, math.ceil((sound.shape[-1] + 2 * margin) / _STEP))
    num_blocks = math.ceil(num_blocks / _TOGETHER) * _TOGETHER
    padded = np.zeros((len(sound), (num_blocks - 1) * _STEP + _BLOCK), np.float32)
    padded[:, margin : margin + sound.shape[-1]] = sound
    found: list[Message] = []
    for first in range(0, num_blocks, _TOGETHER):
        begins = np.arange(first, first + _TOGETHER) * _STEP
        blocks = np.stack([padded[:, b : b + _BLOCK] for b in begins])
        decoded = jax.tree.map(np.asarray, _search(blocks))
        for team, block, n in np.argwhere(decoded.valid):
            at = (team, block, n)
            words = decoded.words[at]
            found.append(
                Message(
                    team=int(team),
                    time=float(begins[block] + decoded.start[at] - margin) / acoustics.RATE,
                    bits=int(words[0]) << 32 | int(words[1]),
                    word=jax.tree.map(np.asarray, unpack(words)[0]),
                    quality=float(decoded.quality[at]),
                    confidence=float(acoustics.confidence(decoded.quality[at])),
                )
            )
    return _once(found)


def _once(found: list[Message]) -> list[Message]:
    """Blocks overlap and so do a frame and its echo: of equal bits within half a frame the best
    stays."""
    kept: list[Message] = []
    for message in sorted(found, key=lambda m: -m.quality):
        same = (m.team == message.team and m.bits == message.bits for m in kept)
        near = (abs(m.time - message.time) < 0.19 for m in kept)
        if not any(a and b for a, b in zip(same, near)):
            kept.append(message)
    return sorted(kept, key=lambda m: (m.time, m.team))
