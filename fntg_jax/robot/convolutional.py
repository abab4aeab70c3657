"""The error-correcting code of the acoustic messages: convolutional, rate 1/2, tail-biting.

Generators 171 and 133 (octal) [Odenwalder 1970], memory 6, free distance 10, over 64 bits as a
ring, so that no tail is sent.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

BITS = 64
_MEMORY = 6
_STATES = 1 << _MEMORY
_GENERATORS = (0o171, 0o133)
# The decoder runs over the ring and this many bits more on either side, five times the memory.
_EXTRA = 32


def _outputs() -> np.ndarray:
    """[state entered, which of its two predecessors, output]: the coded bit, as +1 (0) or -1.

    A state holds the last 6 bits, the newest as most significant; its predecessors differ in the
    bit that drops out.
    """
    table = np.zeros((_STATES, 2, 2), np.float32)
    for state in range(_STATES):
        for dropped in range(2):
            register = state << 1 | dropped
            for n, generator in enumerate(_GENERATORS):
                table[state, dropped, n] = 1 - 2 * (bin(register & generator).count("1") % 2)
    return table


_OUTPUTS = _outputs()
_BRANCH = np.concatenate([_OUTPUTS[:, 0], _OUTPUTS[:, 1]])  # [128, 2]


def encode(bits: Int[Array, "64"]) -> Int[Array, "128"]:
    """128 coded bits: for each message bit the two parities over it and the six before (a ring)."""
    past = jnp.stack([jnp.roll(bits, n) for n in range(_MEMORY + 1)], 0)
    taps = np.array([[g >> (_MEMORY - n) & 1 for n in range(_MEMORY + 1)] for g in _GENERATORS])
    return ((jnp.asarray(taps) @ past) % 2).T.reshape(-1)


def decode(evidence: Float[Array, "128"]) -> Int[Array, "64"]:
    """The message bits with the greatest sum of evidence for their coded bits (Viterbi 1967).

    evidence: of each coded bit, positive for 0.  The ring is opened with some of its other end on
    both sides, so the answer may, rarely, not be a ring; it then is no code word, and the checksum
    and the quality of the frame say so.
    """
    pairs = evidence.reshape(BITS, 2)
    pairs = jnp.concatenate([pairs[-_EXTRA:], pairs, pairs[:_EXTRA]])
    gains = pairs @ _BRANCH.T  # [steps, 128]: predecessor 0 of all states, then predecessor 1

    def step(metric: Array, gain: Array) -> tuple[Array, Array]:
        before = metric.reshape(_STATES // 2, 2)
        even = jnp.concatenate([before[:, 0], before[:, 0]]) + gain[:_STATES]
        odd = jnp.concatenate([before[:, 1], before[:, 1]]) + gain[_STATES:]
        best = jnp.maximum(even, odd)
        return best - best[0], odd > even

    def back(state: Array, odd: Array) -> tuple[Array, Array]:
        before = (state << 1 & (_STATES - 1)) | odd[state].astype(jnp.int32)
        return before, state >> (_MEMORY - 1)

    metric, choices = jax.lax.scan(step, jnp.zeros(_STATES), gains)
    last = jnp.argmax(metric).astype(jnp.int32)
    _, bits = jax.lax.scan(back, last, choices, reverse=True)
    return bits[_EXTRA : _EXTRA + BITS]
