"""Gene tables: which parameters of the FNTG are free, and how they fill the full set.

A layout is data.  It lists its genes (name, symbol, unit, bounds) and, for every slot of the
full parameter set `Params`, the index of the gene that fills it and a sign (+1, -1, or 0 for
a slot that stays zero), so that expanding theta is one gather.

Paper: "63 tunable parameters ... reduced to 31" fits the printed chromosome, with two output
biases, only if one sigma is shared by the three D labels: 12 + 1 + 2 + 48 = 63; 24 -> 16
rules: 12 + 1 + 2 + 32 = 47; left-right symmetry: 12 + 1 + 2 + 16 = 31.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

LOW, HIGH = -5.0, 5.0  # paper: "real values of the parameters were limited to (-5, 5)"


class Params(NamedTuple):
    """The full parameter set of the FNTG, in the paper's symbols.

    a_*, c_*: slope (1/m or 1/rad) and centre (m or rad) of the sigmoids A_i(d_B), B_j(d_O),
    C_k(theta_B), shape [2]; sigma: rad, shape [3], D_1 "left", D_2 "right", D_3 "not
    influencing"; V, Omega: rule constants [2, 2, 2, 3] indexed i, j, k, l; bias: b_21, b_22.

    In nested tuples (`expand_scalars`) sigma, and V and Omega along l, have length 1 where all
    three share one gene: the structure says which form of an equation applies.
    """

    # Arrays, or nested tuples of scalars (`expand_scalars`); leading batch axes are allowed.
    a_A: Any
    c_A: Any
    a_B: Any
    c_B: Any
    a_C: Any
    c_C: Any
    sigma: Any
    V: Any
    Omega: Any
    bias: Any


SHAPES = Params((2,), (2,), (2,), (2,), (2,), (2,), (3,), (2, 2, 2, 3), (2, 2, 2, 3), (2,))
NUM_SLOTS = sum(int(np.prod(s)) for s in SHAPES)  # 65


class Gene(NamedTuple):
    """One free parameter: plain-text name, LaTeX symbol, unit, bounds, and the range that it starts
    in where the first population is a fuzzy partition (`TrainConfig.initial`)."""

    name: str
    symbol: str
    unit: str
    low: float = LOW
    high: float = HIGH
    partition: tuple[float, float] = (LOW, HIGH)


class Layout(NamedTuple):
    """A gene table and the gather that expands it.

    index: [65] gene of every slot of `Params` in order; sign: [65] in {-1, 0, 1}.  A slot with
    sign 0 has index 0 and stays zero.
    """

    name: str
    genes: tuple[Gene, ...]
    index: tuple[int, ...]  # type: ignore[assignment]  # not tuple.index
    sign: tuple[int, ...]

    @property
    def num_genes(self) -> int:
        """How many parameters are free."""
        return len(self.genes)

    @property
    def low(self) -> np.ndarray:
        """[genes]: lower bounds."""
        return np.asarray([g.low for g in self.genes], np.float32)

    @property
    def high(self) -> np.ndarray:
        """[genes]: upper bounds."""
        return np.asarray([g.high for g in self.genes], np.float32)

    @property
    def partition(self) -> np.ndarray:
        """[genes, 2]: where each gene starts in a fuzzy partition."""
        return np.asarray([g.partition for g in self.genes], np.float32)


def expand(layout: Layout, theta: Float[Array, "*batch genes"]) -> Params:
    """Fill the full parameter set from the free genes: one gather.

    Args:
        layout: gene table.
        theta: [..., genes].

    Returns:
        `Params` whose leaves carry the same leading axes.

    Raises ValueError when the last axis does not fit the layout.
    """
    if theta.shape[-1] != layout.num_genes:
        raise ValueError(
            f"theta has {theta.shape[-1]} genes: layout {layout.name!r} has {layout.num_genes}"
        )
    sign = jnp.asarray(layout.sign, theta.dtype)
    slots = theta[..., np.asarray(layout.index)] * sign
    leaves, start = [], 0
    for shape in SHAPES:
        size = int(np.prod(shape))
        leaves.append(slots[..., start : start + size].reshape(*slots.shape[:-1], *shape))
        start += size
    return Params(*leaves)


def expand_scalars(layout: Layout, theta: Float[Array, " genes"]) -> Params:
    """`expand` for one theta, as nested tuples of scalars, one where three slots share a gene.

    For loops under `vmap`: every scalar becomes one contiguous vector over the batch (slices
    of a [batch, 2, 2, 2, 3] table would be strided, several times slower on CPU), and what
    shared genes have in common is computed once.

    Args:
        layout: gene table.
        theta: [genes].
    """
    genes = [theta[n] for n in range(layout.num_genes)]
    values = {(n, 1): gene for n, gene in enumerate(genes)}
    values |= {(n, -1): -gene for n, gene in enumerate(genes)}
    values[0, 0] = jnp.zeros_like(genes[0])
    slots = iter(zip(layout.index, layout.sign))

    def fill(shape):
        if len(shape) > 1:
            return tuple(fill(shape[1:]) for _ in range(shape[0]))
        own = [next(slots) for _ in range(shape[0])]
        shared = len(own) == 3 and len(set(own)) == 1
        return tuple(values[slot] for slot in (own[:1] if shared else own))

    return Params(*(fill(shape) for shape in SHAPES))


def rules(layout: Layout) -> list[tuple[int, ...]]:
    """The rules as 0-based (i, j, k, l) in the printed order; (i, j, k) where the obstacle is
    far (j = 1) and the layout drops its angle.  16 or 24."""
    start = sum(int(np.prod(s)) for s in SHAPES[: Params._fields.index("V")])
    gene = np.asarray(layout.index[start : start + 24]).reshape(2, 2, 2, 3)
    found: list[tuple[int, ...]] = []
    for i, j, k in np.ndindex(2, 2, 2):
        merged = j == 1 and len(set(gene[i, j, k])) == 1
        found += [(i, j, k)] if merged else [(i, j, k, side) for side in range(3)]
    return found


def get_layout(name: str) -> Layout:
    """The layout of that name.  Raises ValueError that lists the known ones."""
    if name not in LAYOUTS:
        raise ValueError(f"layout = {name!r}: known layouts are {', '.join(LAYOUTS)}")
    return LAYOUTS[name]


# Genes of a fuzzy partition: the first label of a family falls, the second rises, and both change
# within the range of their input (m, m, rad); biases are small.  Most of (-5, 5) lies outside of
# the field, and labels that start there are the same everywhere: no rule can be told from another.
_FALLING, _RISING = (-5.0, -1.0), (1.0, 5.0)
_CENTRES = {
    "A": ((0.0, 2.0), (0.0, 2.0)),
    "B": ((0.0, 1.0), (0.0, 1.0)),
    # "Right" and "left" leave a gap around straight ahead, where their normalised pair then
    # switches sharply.  Where they overlap, most populations keep to a soft middle for good.
    "C": ((-1.0, 0.0), (0.0, 1.0)),
}
_WIDTHS = (0.3, 1.5)
_BIASES = (-1.0, 1.0)


def _mirror(l: int) -> int:
    """Left <-> right; "not influencing" stays."""
    return (1, 0, 2)[l]


def _build(
    name: str,
    *,
    sigmas: tuple[int, int, int] = (0, 0, 0),
    biases: tuple[bool, bool] = (True, True),
    far_sees_angle: bool = False,
    symmetric: bool = True,
    mirrored_ball: bool = False,
) -> Layout:
    """Assemble a gene table in the printed order.

    sigmas: which free sigma serves D_1, D_2, D_3.  biases: whether b_21, b_22 are free (else
    zero).  far_sees_angle: keep theta_O in the rules for a far obstacle (24 rules, else 16).
    symmetric: mirror rules (k, l) <-> (3-k, mirror(l)) share V and have opposite Omega.
    mirrored_ball: C_2(theta) = C_1(-theta).
    """
    genes: list[Gene] = []
    slots: dict[tuple, tuple[int, int]] = {}  # slot -> (gene, sign)

    def add(gene: Gene) -> int:
        genes.append(gene)
        return len(genes) - 1

    for family, unit in (("A", "m"), ("B", "m"), ("C", "rad")):
        for n in range(2):
            if family == "C" and n == 1 and mirrored_ball:
                # 1/(1+exp(-a(-x-c))) = 1/(1+exp(a(x+c))): both slope and centre change sign.
                slots["a_C", 1] = (slots["a_C", 0][0], -1)
                slots["c_C", 1] = (slots["c_C", 0][0], -1)
                continue
            slope = (_FALLING, _RISING)[n]
            for kind, u, start in (("a", f"1/{unit}", slope), ("c", unit, _CENTRES[family][n])):
                symbol = f"{kind}_{{{family}_{n + 1}}}"
                gene = Gene(f"{kind}_{family}{n + 1}", symbol, u, partition=start)
                slots[f"{kind}_{family}", n] = (add(gene), 1)
    labels: dict[int, list[str]] = {}
    for label, group in enumerate(sigmas):
        labels.setdefault(group, []).append(str(label + 1))
    sigma_genes = {}
    for group, members in labels.items():
        which = "" if len(labels) == 1 else "".join(members)
        symbol = r"\sigma" if not which else rf"\sigma_{{D_{{{which}}}}}"
        sigma_genes[group] = add(Gene(f"sigma{which}", symbol, "rad", partition=_WIDTHS))
    for label, group in enumerate(sigmas):
        slots["sigma", label] = (sigma_genes[group], 1)
    # "speed of v_max / 5": with output="scale" a gene of 5 is full speed.
    for table, symbol, unit, flip in (
        ("V", "V", "v_max/5", 1),
        ("Omega", r"\Omega", "omega_max/5", -1),
    ):
        for i, j, k, l in np.ndindex(2, 2, 2, 3):
            far = j == 1 and not far_sees_angle
            if far and l > 0:
                slots[table, i, j, k, l] = slots[table, i, j, k, 0]
            elif symmetric and k == 1:
                gene_index, sign = slots[table, i, j, 0, l if far else _mirror(l)]
                slots[table, i, j, k, l] = (gene_index, sign * flip)
            else:
                rule = f"{i + 1}{j + 1}{k + 1}" + ("" if far else str(l + 1))
                gene = Gene(f"{table}_{rule}", f"{symbol}_{{{rule}}}", unit)
                slots[table, i, j, k, l] = (add(gene), 1)
    for n, free in enumerate(biases):
        unit = ("v_max/5", "omega_max/5")[n]
        gene = Gene(f"b_2{n + 1}", f"b_{{2{n + 1}}}", unit, partition=_BIASES)
        slots["bias", n] = (add(gene), 1) if free else (0, 0)
    order = [
        slots[(field, *position)]
        for field, shape in zip(Params._fields, SHAPES)
        for position in np.ndindex(*shape)
    ]
    return Layout(name, tuple(genes), tuple(g for g, _ in order), tuple(s for _, s in order))


LAYOUTS: dict[str, Layout] = {
    layout.name: layout
    for layout in (
        _build("paper-31"),
        # The other readings of "31": three sigmas and no bias, or two sigmas and one bias.
        _build("three-sigma-31", sigmas=(0, 1, 2), biases=(False, False)),
        _build("two-sigma-31", sigmas=(0, 0, 1), biases=(True, False)),
        # Exactly equivariant under mirroring of the scene.
        _build("mirror-28", mirrored_ball=True, biases=(True, False)),
        _build("reduced-47", symmetric=False),
        _build("full-63", symmetric=False, far_sees_angle=True),
    )
}
