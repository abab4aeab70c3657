"""Connected components of a class picture, of fixed shapes: what one could touch in one piece.

A picture is first cut into runs, neighbours in a row that are of one class.  There are a few
hundred of them where there are 25 344 pixels, and all that follows counts runs.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

_JUMPS = 2  # look-ups of labels' labels a round


class Runs(NamedTuple):
    """Runs of a picture, leaves [N] in the order of its pixels, zeros after the last.

    row, start, length: pixels; colour: class; sure: sum of its pixels' numbers; label: the lowest
    run that a path of neighbours, of eight, of the same class joins it with.  number: how many
    runs the picture has, those beyond N included, which are left out.
    """

    row: Int[Array, " N"]
    start: Int[Array, " N"]
    length: Int[Array, " N"]
    colour: Int[Array, " N"]
    sure: Int[Array, " N"]
    label: Int[Array, " N"]
    number: Int[Array, ""]


def runs(
    classes: Int[Array, "H W"], kept: Bool[Array, "H W"], sure: Int[Array, "H W"], most: int
) -> Runs:
    """All runs of the pixels that are kept, and which of them hang together.

    sure: 0 to 255, summed over each run.  most: N.  At most 255 columns.
    """
    height, width = classes.shape
    classes = classes.astype(jnp.int32)
    new = kept & (classes != jnp.pad(classes[:, :-1], ((0, 0), (1, 0)), constant_values=-1))
    new |= kept & ~jnp.pad(kept[:, :-1], ((0, 0), (1, 0)))
    # Three counts of a row in one word: runs begun, pixels kept and the sum of `sure`.
    word = jnp.where(kept, sure.astype(jnp.uint32) | jnp.uint32(1 << 16), jnp.uint32(0))
    word |= new.astype(jnp.uint32) << 24
    # A loop over columns: one vector addition each.
    so_far, sums = jax.lax.scan(lambda a, b: (a + b,) * 2, jnp.zeros(height, jnp.uint32), word.T)
    last = jnp.cumsum((so_far >> 24).astype(jnp.int32))  # runs up to each row's end
    sums = sums.T

    # Where a run begins: its row, then by halving in the row's counts.
    name = jnp.arange(most, dtype=jnp.int32)
    row = jnp.minimum((last <= name[:, None]).sum(1, dtype=jnp.int32), height - 1)
    first = jnp.where(row > 0, last[row - 1], 0)
    begun = (sums >> 24).astype(jnp.int32).ravel()

    def halve(_, ends):
        low, high = ends
        middle = (low + high) // 2
        past = begun[row * width + jnp.minimum(middle, width - 1)] > name - first
        searched = low < high
        low = jnp.where(searched & ~past, middle + 1, low)
        return low, jnp.where(searched & past, middle, high)

    ends = jnp.zeros_like(name), jnp.full_like(name, width)
    low, _ = jax.lax.fori_loop(0, width.bit_length(), halve, ends)
    real = name < last[-1]
    start = jnp.where(real, low, 0)
    row = jnp.where(real, row, 0)
    at = row * width + start

    colour = jnp.where(real, classes.ravel()[at], -1)
    # Counts before this run, less those before the next one or at the end of the row.
    before = sums.ravel()[at] - word.ravel()[at]
    after = jnp.append(before[1:], jnp.uint32(0))
    closes = jnp.append(row[1:] != row[:-1], True) | (name + 1 >= last[-1])
    part = (jnp.where(closes, so_far[row], after) & 0xFFFFFF) - (before & 0xFFFFFF)
    length = jnp.where(real, (part >> 16).astype(jnp.int32), 0)
    total = jnp.where(real, (part & 0xFFFF).astype(jnp.int32), 0)

    # Runs that touch: of two, one begins beside the other, in the row above or below it.
    touching = []
    for step in (-1, 1):
        for aside in (-1, 0, 1):
            y, x = row + step, start + aside
            inside = real & (y >= 0) & (y < height) & (x >= 0) & (x < width)
            pixel = jnp.where(inside, y * width + x, 0)
            over = jnp.where(y > 0, last[jnp.maximum(y - 1, 0)], 0)
            other = over + begun[pixel] - 1
            inside &= kept.ravel()[pixel] & (other < most) & (classes.ravel()[pixel] == colour)
            touching.append(jnp.where(inside, other, name))
    edges = jnp.stack(touching)

    def round_(carry):
        label, _ = carry
        least = jnp.minimum(label, label[edges].min(0))
        found = label.at[edges.ravel()].min(jnp.broadcast_to(least, edges.shape).ravel())
        # What a run has found holds for the run that it was joined with, too.
        found = found.at[label].min(jnp.minimum(found, least))
        for _ in range(_JUMPS):
            found = found[found]
        return found, (found != label).any()

    label, _ = jax.lax.while_loop(lambda carry: carry[1], round_, (name, jnp.bool_(True)))
    return Runs(row, start, length, jnp.maximum(colour, 0), total, label, last[-1])


def components(classes: Int[Array, "H W"]) -> Int[Array, "H W"]:
    """The component of every pixel, as the number of its first run: the labelling of scikit-image's
    `measure.label` (background -1, connectivity 2), numbered otherwise."""
    height, width = classes.shape
    whole = jnp.ones(classes.shape, bool)
    found = runs(classes, whole, jnp.zeros(classes.shape, jnp.int32), height * width)
    begins = jnp.zeros(height * width, jnp.int32)
    begins = begins.at[found.row * width + found.start].add((found.length > 0).astype(jnp.int32))
    return found.label[jnp.cumsum(begins) - 1].reshape(height, width)
