"""Genome: bits <-> theta.  15 bits a gene, most significant first (paper: 31 x 15 = 465).

n in 0 .. 2^bits - 1 stands for low + (high - low) n / (2^bits - 1), so both bounds are
representable and the step is 10 / 32767 = 0.0003.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from fntg_jax.controller.layout import HIGH, LOW


def decode(bits: Any, num_bits: int = 15, gray: bool = False) -> Float[Array, "*batch genes"]:
    """Bit strings to genes.

    Args:
        bits: bool or 0/1, [..., genes * num_bits], in the genome's order, most significant first.
        num_bits: bits a gene.
        gray: the bits are reflected Gray code instead of plain binary.

    Returns:
        theta, float32 [..., genes], in [-5, 5].

    Raises ValueError where the length is no multiple of num_bits.
    """
    b = _split(jnp.asarray(bits), num_bits).astype(jnp.uint32)
    if gray:
        b = jnp.cumsum(b, axis=-1) & 1  # binary bit = parity of all Gray bits before it
    n = jnp.sum(b << jnp.arange(num_bits - 1, -1, -1, dtype=jnp.uint32), axis=-1)
    return LOW + n.astype(jnp.float32) * jnp.float32((HIGH - LOW) / (2**num_bits - 1))


def encode(theta: Any, num_bits: int = 15, gray: bool = False) -> Bool[Array, "*batch length"]:
    """Genes to bit strings, rounded to the nearest representable value.

    Args:
        theta: [..., genes], in [-5, 5].
        num_bits: bits a gene.
        gray: reflected Gray code instead of plain binary.

    Returns:
        bool [..., genes * num_bits].

    Raises ValueError naming the first gene outside [-5, 5] or not a number.  Inside `jit`
    nothing can be raised: there, genes are clipped and NaN becomes the lower bound.
    """
    if not isinstance(theta, jax.core.Tracer):
        t = np.asarray(theta)
        bad = ~((t >= LOW) & (t <= HIGH))
        if bad.any():
            where = tuple(int(i) for i in np.argwhere(bad)[0])
            raise ValueError(
                f"gene {where[-1]} = {t[where]}: allowed are values in [{LOW:g}, {HIGH:g}]"
            )
    top = 2**num_bits - 1
    level = (jnp.asarray(theta) - LOW) * (top / (HIGH - LOW))
    level = jnp.where(level >= 0, level, 0)  # NaN too
    n = jnp.minimum(jnp.round(level), top).astype(jnp.uint32)
    if gray:
        n = n ^ (n >> 1)
    shifts = jnp.arange(num_bits - 1, -1, -1, dtype=jnp.uint32)
    b = ((n[..., None] >> shifts) & 1).astype(bool)
    return b.reshape(*b.shape[:-2], -1)


def _split(bits, num_bits):
    if bits.shape[-1] % num_bits:
        raise ValueError(
            f"a genome of {bits.shape[-1]} bits: allowed are multiples of {num_bits} bits a gene"
        )
    return bits.reshape(*bits.shape[:-1], -1, num_bits)
