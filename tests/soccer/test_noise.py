"""The counter-based generator: uniform, normal, independent bits, channels, lanes, steps."""

import jax.numpy as jnp
import numpy as np
from scipy import stats
from scipy.optimize import fsolve

from envs.soccer import noise

N = 1 << 16


def words(seed=0, tick=None, lane=0, channel=0):
    tick = np.arange(N) if tick is None else tick
    key = noise.key(jnp.uint32(seed), jnp.asarray(tick, jnp.int32), jnp.asarray(lane, jnp.uint32))
    return np.asarray(noise.bits(key, channel))


def uniforms(**where):
    return words(**where) / 2**32


def test_every_bit_is_fair():
    ones = np.unpackbits(words().view(np.uint8).reshape(N, 4), axis=1).mean(0)
    assert np.abs(ones - 0.5).max() < 5 * 0.5 / np.sqrt(N)


def test_one_input_bit_flips_half_of_the_output():
    x = np.random.default_rng(0).integers(0, 2**32, N, np.uint64).astype(np.uint32)
    a = np.asarray(noise.mix(jnp.asarray(x)))
    for bit in range(32):
        b = np.asarray(noise.mix(jnp.asarray(x ^ np.uint32(1 << bit))))
        flips = np.unpackbits((a ^ b).view(np.uint8).reshape(N, 4), axis=1).mean(0)
        assert np.abs(flips - 0.5).max() < 0.02, bit


def test_uniform_against_scipy():
    x = np.asarray(noise.to_uniform(jnp.asarray(words())))
    assert x.min() >= 0 and x.max() < 1
    assert stats.kstest(x, "uniform").pvalue > 1e-3
    counts = np.histogram(x, 256, (0, 1))[0]
    assert stats.chisquare(counts).pvalue > 1e-3


def test_normal_against_scipy():
    x = np.asarray(noise.to_normal(jnp.asarray(words())))
    assert stats.kstest(x, "norm").statistic < 0.0021 + 1.95 / np.sqrt(N)
    assert abs(x.mean()) < 4 / np.sqrt(N) and abs(x.std() - 1) < 0.01
    assert abs(stats.kurtosis(x)) < 0.1 and np.abs(x).max() <= 4.05


def test_the_cubic_is_solved_for():
    p = np.ones(256) / 256
    q = np.convolve(np.convolve(p, p), np.convolve(p, p))
    z = (np.arange(q.size) - 510) / np.sqrt(4 * (256**2 - 1) / 12)
    moment = lambda c, k: (q * (c[0] * z + c[1] * z**3) ** k).sum()  # noqa: E731
    found = fsolve(lambda c: [moment(c, 2) - 1, moment(c, 4) - 3], [1.0, 0.0])
    np.testing.assert_allclose(found, noise._CUBIC, rtol=1e-5)


def test_streams_have_nothing_in_common():
    base = uniforms()
    lanes = np.tile(np.arange(64), N // 64)
    for other in (
        uniforms(seed=1),
        uniforms(lane=1),
        uniforms(channel=1),
        uniforms(lane=0x10000),
        uniforms(tick=np.arange(1, N + 1)),
        uniforms(tick=0 * lanes, lane=lanes.astype(np.uint32)),
    ):
        assert abs(np.corrcoef(base, other)[0, 1]) < 5 / np.sqrt(N)
        pairs = np.histogram2d(base, other, 16, ((0, 1), (0, 1)))[0].ravel()
        if len(np.unique(other)) == N:
            assert stats.chisquare(pairs).pvalue > 1e-4


def test_birthdays():
    # 2^16 words of 32 bits: 0.5 collisions are expected among them.
    assert N - len(np.unique(words())) <= 5
    assert N - len(np.unique(words(tick=np.zeros(N), lane=np.arange(N, dtype=np.uint32)))) <= 5
