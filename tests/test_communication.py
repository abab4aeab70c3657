"""Words, their checksum, the slots, and what a robot makes of what it heard."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fntg_jax.robot import communication
from fntg_jax.robot.communication import Word, merge, nothing_heard, pack, unpack

POLYNOMIAL = 0x1B19E9


def word(sender=1, role=2, x=0.5, y=-0.3, heading=1.0, sd=0.1, ball=(1.0, 0.2), age=0.5):
    fields = (sender, role, x, y, heading, sd, *ball, age)
    return Word(*(jnp.asarray(value) for value in fields))


finite = st.floats(-4, 4, width=32)


@given(
    sender=st.integers(0, 3), role=st.integers(0, 3), x=finite, y=finite, heading=finite,
    ball=st.tuples(finite, finite), age=st.floats(0, 11.8),
)  # fmt: skip
@settings(max_examples=50, deadline=None)
def test_what_is_packed_comes_back_within_half_a_step(sender, role, x, y, heading, ball, age):
    back, right = unpack(pack(word(sender, role, x, y, heading, 0.1, ball, age)))
    assert bool(right) and (int(back.sender), int(back.role)) == (sender, role)
    for value, found, half in ((x, back.x, 1.7), (ball[0], back.ball_x, 1.7), (y, back.y, 1.1)):
        assert abs(np.clip(value, -half, half) - found) <= half / 128 + 1e-6
    assert abs(np.angle(np.exp(1j * (heading - float(back.heading))))) <= np.pi / 64 + 1e-6
    assert -np.pi < float(back.heading) <= np.pi + 1e-6
    assert abs(np.sqrt(age / 0.06) - np.sqrt(back.ball_age / 0.06)) <= 0.5 + 1e-4


def test_a_ball_never_seen_and_the_least_and_the_most():
    back, _ = unpack(pack(word(age=jnp.inf, sd=5.0)))
    assert np.isinf(back.ball_age) and float(back.sd) == 1.0
    assert float(unpack(pack(word(sd=0.0)))[0].sd) == np.float32(0.03)
    assert not bool(unpack(jnp.zeros(2, jnp.uint32))[1])  # silence is no word


def long_division(value: int, bits: int) -> int:
    for n in range(bits - 1, 19, -1):
        if value >> n & 1:
            value ^= POLYNOMIAL << (n - 20)
    return value


def test_the_checksum_is_the_remainder_of_long_division():
    rng = np.random.default_rng(0)
    for _ in range(20):
        content = int(rng.integers(1 << 44))
        words = jnp.array([content >> 12, content << 20 & 0xFFFFFFFF], jnp.uint32)
        found = int(communication.checksum(words))
        assert found == long_division(content << 20, 64) ^ 0xA5A5A


def test_the_checksum_finds_all_errors_of_five_bits_and_all_bursts_of_twenty():
    remainders = [long_division(1 << n, 64) for n in range(64)]
    sums = {0}
    for weight in (1, 2):  # two different sets of up to two bits never have one remainder ...
        new = {a ^ b if weight == 2 else a for a, b in itertools.combinations(remainders, 2)}
        new = new if weight == 2 else set(remainders)
        assert len(new) == (64 if weight == 1 else 64 * 63 // 2) and not new & sums
        sums |= new
    # ... so four are found; five because an odd number of bits never divides by x + 1.
    assert bin(POLYNOMIAL).count("1") % 2 == 0
    assert POLYNOMIAL & 1  # and bursts, because the last coefficient is not zero


def test_slots_take_turns_and_a_word_is_at_most_two_seconds_old():
    steps = np.arange(1200)
    turns = np.array([communication.turn(shirt, steps) for shirt in range(3)])
    assert (turns.sum(0) <= 1).all()
    gaps = np.diff(np.flatnonzero(turns[1]))
    oldest = 0.1 * (gaps.max() + communication.SLOT)
    assert oldest <= 2.0
    assert 44 / (0.1 * communication.SLOT) >= 100  # bit/s of content, the slots shared by three


def test_merging_keeps_the_last_word_and_its_age():
    known = nothing_heard()
    heard = (
        jnp.zeros((3, 2), jnp.uint32)
        .at[0]
        .set(pack(word(sender=0)))
        .at[2]
        .set(pack(word(sender=2, x=-1.0)))
    )
    valid = jnp.array([False, True, True])  # of shirt 1 itself: ignored
    known = merge(known, heard, valid, 1, 0.1)
    assert known.age[0] > 1e5 and np.isclose(known.age[1], 0.4)
    assert np.isclose(known.x[1], -1.0, atol=0.014)
    known = merge(known, heard, jnp.zeros(3, bool), 1, 0.1)
    assert np.isclose(known.age[1], 0.5)
    damaged = heard.at[2, 0].set(heard[2, 0] ^ 64)
    swapped = heard[jnp.array([2, 1, 0])]
    for wrong in (damaged, swapped):
        after = merge(known, wrong, jnp.ones(3, bool), 1, 0.1)
        assert np.isclose(after.age[1], 0.6)
    assert jax.tree.all(jax.tree.map(lambda leaf: bool(np.isfinite(leaf).all()), known))
