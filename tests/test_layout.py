import jax
import numpy as np
import pytest

from fntg_jax.controller.layout import LAYOUTS, Params, expand, expand_scalars, get_layout
from tests.examples import layouts, random_thetas

each_layout = pytest.mark.parametrize("layout", layouts, ids=lambda x: x.name)

# Distinct rules: V and Omega together, and labels of the inputs' sigmoids, sigmas and biases.
COUNTS = {
    "full-63": 12 + 1 + 2 + 2 * 24,
    "reduced-47": 12 + 1 + 2 + 2 * 16,
    "paper-31": 12 + 1 + 2 + 2 * 8,
    "three-sigma-31": 12 + 3 + 0 + 2 * 8,
    "two-sigma-31": 12 + 2 + 1 + 2 * 8,
    "mirror-28": 10 + 1 + 1 + 2 * 8,
}


def test_gene_counts_are_those_of_the_paper_and_the_design():
    assert {x.name: x.num_genes for x in layouts} == COUNTS
    assert all(int(name.rsplit("-", 1)[1]) == n for name, n in COUNTS.items())


@each_layout
def test_every_gene_is_used_named_once_and_bounded(layout):
    used = {i for i, s in zip(layout.index, layout.sign) if s}
    assert used == set(range(layout.num_genes))
    assert len({g.name for g in layout.genes}) == layout.num_genes
    assert set(layout.low) == {-5}
    assert set(layout.high) == {5}


def test_printed_order_of_the_chromosome():
    near = [f"11{k}{m}" for k in "1" for m in "123"]
    names = [g.name for g in LAYOUTS["paper-31"].genes]
    sigmoids = [f"{kind}_{family}{n}" for family in "ABC" for n in "12" for kind in "ac"]
    rules = [*near, "121", "2111", "2112", "2113", "221"]
    expected = [*sigmoids, "sigma"]
    expected += [f"V_{r}" for r in rules] + [f"Omega_{r}" for r in rules] + ["b_21", "b_22"]
    assert names == expected
    full = [f"{i}{j}{k}{m}" for i in "12" for j in "12" for k in "12" for m in "123"]
    expected = [*sigmoids, "sigma", *(f"V_{r}" for r in full), *(f"Omega_{r}" for r in full)]
    assert [g.name for g in LAYOUTS["full-63"].genes] == [*expected, "b_21", "b_22"]


@each_layout
def test_named_genes_land_in_the_slots_of_their_names(layout):
    """Read back from the full set, with the paper's indices taken from the gene's name."""
    theta = random_thetas(layout, 1)[0].astype(np.float32)
    params = expand(layout, theta)
    for gene, value in zip(layout.genes, theta):
        kind, _, index = gene.name.partition("_")
        if kind.startswith("sigma"):
            labels = [int(c) - 1 for c in kind.removeprefix("sigma")] or [0, 1, 2]
            found = [params.sigma[n] for n in labels]
        elif kind == "b":
            found = [params.bias[int(index[1]) - 1]]
        elif kind in "ac":
            found = [getattr(params, f"{kind}_{index[0]}")[int(index[1]) - 1]]
        else:
            rule = tuple(int(c) - 1 for c in index)
            found = np.ravel(getattr(params, kind)[rule])  # without l: all three
        np.testing.assert_allclose(found, value, rtol=1e-6, err_msg=gene.name)


@each_layout
def test_rule_tables_of_reduced_and_symmetric_layouts(layout):
    params = jax.tree.map(
        np.asarray, expand(layout, random_thetas(layout, 1)[0].astype(np.float32))
    )
    far = np.concatenate([params.V[:, 1], params.Omega[:, 1]])
    far_sees_angle = not (far == far[..., :1]).all()
    assert far_sees_angle == (layout.name == "full-63")
    mirrored = (slice(None), slice(None), slice(None, None, -1), [1, 0, 2])
    symmetric = layout.name not in ("full-63", "reduced-47")
    assert (params.V[mirrored] == params.V).all() == symmetric
    assert (params.Omega == -params.Omega[mirrored]).all() == symmetric
    if layout.name == "mirror-28":
        assert params.a_C[0] == -params.a_C[1]
        assert params.c_C[0] == -params.c_C[1]
        assert params.bias[1] == 0
    if layout.name == "three-sigma-31":
        assert (params.bias == 0).all()
        assert len(set(params.sigma.tolist())) == 3
    if layout.name == "two-sigma-31":
        assert params.sigma[0] == params.sigma[1] != params.sigma[2]
        assert params.bias[1] == 0


def whole(table):
    """Three where the structure says that they are one."""
    if isinstance(table[0], tuple):
        return tuple(whole(x) for x in table)
    return 3 * table if len(table) == 1 else table


@each_layout
def test_expand_scalars_is_expand(layout):
    theta = random_thetas(layout, 3).astype(np.float32)
    arrays = expand(layout, theta)
    for n in range(3):
        scalars = expand_scalars(layout, theta[n])
        for name in Params._fields:
            np.testing.assert_array_equal(
                np.asarray(whole(getattr(scalars, name))), getattr(arrays, name)[n], err_msg=name
            )


def test_a_wrong_number_of_genes_and_an_unknown_layout_are_refused():
    with pytest.raises(ValueError, match=r"30 genes.*paper-31.*31"):
        expand(LAYOUTS["paper-31"], np.zeros(30))
    with pytest.raises(ValueError, match=r"'paper-32'.*paper-31.*full-63"):
        get_layout("paper-32")
