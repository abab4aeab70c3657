"""The acoustic code: its parts against independent references, and what it must stand."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.robot import acoustics, convolutional
from fntg_jax.robot.communication import Word, pack


def random_words(key, number):
    keys = jax.random.split(key, 6)
    floats = jax.random.uniform(keys[0], (7, number), minval=-2.0, maxval=2.0)
    sender = jax.random.randint(keys[1], (number,), 0, 3)
    return pack(Word(sender, sender, *floats[:6], 3 * jnp.abs(floats[6])))


def test_convolutional_encoder_is_a_shift_register():
    bits = np.random.default_rng(1).integers(0, 2, 64)
    register = [int(b) for b in bits[:-7:-1]]  # the six before bit 0, newest first: a ring
    coded = []
    for bit in bits:
        window = [int(bit), *register]
        for generator in ("1111001", "1011011"):
            coded.append(sum(w for w, g in zip(window, generator) if g == "1") % 2)
        register = window[:6]
    assert (np.asarray(convolutional.encode(jnp.asarray(bits))) == coded).all()


def test_decoder_repairs_what_the_free_distance_promises():
    rng = np.random.default_rng(2)
    bits = jnp.asarray(rng.integers(0, 2, (32, 64)))
    evidence = 1.0 - 2.0 * jax.vmap(convolutional.encode)(bits)
    for row in range(32):  # four wrong of the 14 that a bit reaches: half of the free distance 10
        at = (rng.integers(128) + rng.choice(14, 4, replace=False)) % 128
        evidence = evidence.at[row, at].multiply(-1)
    assert (jax.jit(jax.vmap(convolutional.decode))(evidence) == bits).all()


def test_sound_has_the_length_loudness_and_band_it_says():
    words = random_words(jax.random.key(0), 8)
    for team, (low, high) in enumerate(((500, 2000), (2200, 3700))):
        sound = np.asarray(jax.vmap(lambda w, t=team: acoustics.encode(w, t))(words))
        assert sound.shape == (8, 3040) and np.abs(sound).max() <= 1.0 + 1e-6
        assert np.isclose((sound**2).mean(), 0.5, atol=1e-3)
        power = np.abs(np.fft.rfft(sound * np.hanning(3040))) ** 2
        hertz = np.fft.rfftfreq(3040, 1 / 8000)
        inside = (hertz >= low - 100) & (hertz <= high + 100)
        assert power[:, inside].sum() / power.sum() > 0.98
    assert not np.asarray(acoustics.encode(jnp.zeros(2, jnp.uint32), 0)).any()


def received(key, words, team, noise):
    sound = jax.vmap(lambda w: acoustics.encode(w, team))(words)
    at = jax.random.randint(key, (len(words),), 0, 900)
    place = jax.vmap(lambda s, n: jax.lax.dynamic_update_slice(jnp.zeros(4000), s, (n,)))
    sound = place(sound, at)
    return at, sound + noise * jax.random.normal(key, sound.shape)


DECODE = jax.jit(jax.vmap(lambda s, t: acoustics.decode(s[None], t), (0, None)))


@pytest.mark.parametrize("team", [0, 1])
def test_99_of_100_frames_at_12_db(team):
    words = random_words(jax.random.key(team), 256)
    energy_per_bit = 0.5 * acoustics.FRAME / 64
    noise = np.sqrt(energy_per_bit / 10**1.2 / 2)  # density N0 / 2 is the variance of a sample
    at, sound = received(jax.random.key(5), words, team, noise)
    found = DECODE(sound, team)
    right = found.valid & (found.words == words).all(-1)
    assert right.mean() >= 0.99
    assert (np.abs(found.start - at)[np.asarray(right)] <= acoustics.HOP).all()
    # The other team hears nothing of it.
    assert not DECODE(sound, 1 - team).valid.any()


def test_noise_and_silence_are_no_messages():
    noise = jax.random.normal(jax.random.key(7), (256, 4000))
    found = DECODE(noise, 0)
    assert not found.valid.any()
    assert (found.quality < acoustics.QUALITY_LEAST).mean() > 0.99
    assert not DECODE(jnp.zeros((256, 4000)), 0).valid.any()


def test_two_frames_at_once_the_louder_is_heard_and_no_other():
    words = random_words(jax.random.key(8), 256)
    _, sound = received(jax.random.key(9), words, 0, 0.0)
    both = sound[::2] + 0.3 * sound[1::2]
    found = jax.jit(jax.vmap(lambda s: acoustics.decode(s[None], 0)))(both)
    louder = (found.words == words[::2]).all(-1)
    softer = (found.words == words[1::2]).all(-1)
    assert (found.valid & louder).mean() > 0.95
    assert not (found.valid & ~louder & ~softer).any()


def test_the_known_tones_do_not_resemble_themselves_shifted():
    known = dict(zip(acoustics.KNOWN_AT, acoustics.KNOWN))
    for a, b in itertools.pairwise(sorted(known)):
        assert known[a] != known[b]
    assert len(set(known.values())) == 6
