"""Connected components of a class picture, of fixed shape: what one could touch in one piece."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int


def components(classes: Int[Array, "H W"]) -> Int[Array, "H W"]:
    """Label of every pixel: the lowest index (row by row) of a pixel that a path of neighbours, of
    eight, of the same class joins it with.

    Labels fall to the least among the neighbours and, by following what they point at, jump ahead
    of them until nothing changes: about as many rounds as the logarithm of a component's breadth.
    The labelling of scikit-image's `measure.label` (background -1, connectivity 2), numbered
    otherwise.
    """
    height, width = classes.shape
    index = jnp.arange(height * width, dtype=jnp.int32).reshape(height, width)

    def shifted(a, dy, dx, fill):
        a = jnp.pad(a, 1, constant_values=fill)
        return a[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]

    # Half of the eight neighbours from each side: a label passes both ways.
    steps = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]
    same = [shifted(classes, dy, dx, -1) == classes for dy, dx in steps]

    def round_(carry):
        label, _ = carry
        new = label
        for (dy, dx), joined in zip(steps, same):
            new = jnp.where(joined, jnp.minimum(new, shifted(label, dy, dx, 0)), new)
        # A loop of its own: XLA would fuse the look-ups and find every neighbour anew for each.
        new = jax.lax.fori_loop(0, 3, lambda _, ahead: ahead[ahead], new.ravel())
        new = new.reshape(height, width)
        return new, (new != label).any()

    label, _ = jax.lax.while_loop(lambda carry: carry[1], round_, (index, jnp.bool_(True)))
    return label
