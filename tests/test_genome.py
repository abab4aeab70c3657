import hypothesis.extra.numpy as hnp
import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fntg_jax.controller import genome
from fntg_jax.controller.layout import LAYOUTS

widths = st.sampled_from([1, 2, 7, 15, 16, 24])
codes = st.booleans()


def levels(num_bits: int, num_genes: int = 7):
    return hnp.arrays(np.int64, num_genes, elements=st.integers(0, 2**num_bits - 1))


def as_bits(numbers, num_bits: int, gray: bool) -> np.ndarray:
    """The genome as a text of binary numbers, most significant bit first."""
    numbers = [int(n) ^ (int(n) >> 1) if gray else int(n) for n in numbers]
    return np.asarray([c == "1" for n in numbers for c in f"{n:0{num_bits}b}"])


@given(data=st.data(), num_bits=widths, gray=codes)
def test_bits_theta_bits(data, num_bits, gray):
    numbers = data.draw(levels(num_bits))
    bits = as_bits(numbers, num_bits, gray)
    theta = np.asarray(genome.decode(bits, num_bits, gray))
    top = 2**num_bits - 1
    np.testing.assert_allclose(theta, -5 + 10 * numbers / top, atol=1e-6, rtol=0)
    assert (np.abs(theta) <= 5).all()  # representable means inside the bounds
    if num_bits <= 16:  # beyond, neighbours are nearer than float32 can tell around 5
        np.testing.assert_array_equal(genome.encode(theta, num_bits, gray), bits)


@given(
    theta=hnp.arrays(np.float32, 9, elements=st.floats(-5, 5, width=32)),
    num_bits=st.sampled_from([2, 7, 15, 16]),
    gray=codes,
)
def test_theta_bits_theta_is_off_by_half_a_step_at_most(theta, num_bits, gray):
    back = np.asarray(genome.decode(genome.encode(theta, num_bits, gray), num_bits, gray))
    assert np.abs(back - theta).max() <= 5 / (2**num_bits - 1) + 2e-6


@pytest.mark.parametrize("num_bits", range(1, 25))
def test_the_ends_are_the_bounds(num_bits):
    ends = genome.decode(np.repeat([False, True], num_bits), num_bits)
    np.testing.assert_array_equal(ends, [-5, 5])


def test_the_papers_genome_by_hand():
    layout = LAYOUTS["paper-31"]
    bits = np.zeros(465, bool)
    assert genome.encode(np.zeros(layout.num_genes, np.float32)).shape == bits.shape
    names = [g.name for g in layout.genes]
    bits[0] = True  # the first gene's most significant bit: 16384 steps
    bits[15 * names.index("sigma") + 14] = True  # least significant: one step
    bits[-15:] = True
    theta = dict(zip(names, np.asarray(genome.decode(bits), np.float64)))
    expected = dict.fromkeys(names, -5.0)
    expected |= {"a_A1": -5 + 10 * 16384 / 32767, "sigma": -5 + 10 / 32767, "b_22": 5.0}
    assert theta == pytest.approx(expected, abs=1e-6)


@given(n=st.integers(0, 2**15 - 2))
def test_gray_neighbours_differ_in_one_bit(n):
    theta = np.float32([-5 + 10 * m / 32767 for m in (n, n + 1)])
    one, other = (np.asarray(genome.encode(t[None], gray=True)) for t in theta)
    assert (one != other).sum() == 1


def test_batches_keep_their_axes():
    theta = np.random.default_rng(0).uniform(-5, 5, (2, 3, 4)).astype(np.float32)
    bits = genome.encode(theta, 9)
    assert bits.shape == (2, 3, 36)
    np.testing.assert_array_equal(bits[1, 2], genome.encode(theta[1, 2], 9))
    np.testing.assert_array_equal(jax.jit(lambda t: genome.encode(t, 9))(theta), bits)


@given(
    place=st.integers(0, 30),
    value=st.one_of(st.floats(5.001, 1e30), st.floats(-1e30, -5.001), st.just(np.nan)),
)
def test_out_of_range_genes_are_refused_by_number(place, value):
    theta = np.zeros(31)
    theta[place] = value
    with pytest.raises(ValueError, match=rf"gene {place} = .*\[-5, 5\]") as refusal:
        genome.encode(theta)
    assert "\n" not in str(refusal.value)


def test_a_genome_of_another_width_is_refused():
    with pytest.raises(ValueError, match=r"466 bits.*15"):
        genome.decode(np.zeros(466, bool))
