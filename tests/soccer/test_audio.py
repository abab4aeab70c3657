"""The microphones' level of sound: geometry, levels, a whole round of slots, and the symbols' table
against it."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.soccer import audio, tables
from experiments import communication as experiment
from fntg_jax.robot import acoustics, communication, ear
from fntg_jax.running import statistics
from tests.conftest import ROOT

HALL = audio.Hall()
DEAF = audio.Hall(motors=-60.0, ambient=-60.0, critical_distance=1e4)


def test_direct_sound_has_its_delay_and_level():
    position = jnp.array([[0.0, 0.0], [1.0, 0.0]])
    heading = jnp.array([np.pi / 2, np.pi])  # the listener looks left; the speaker at the listener
    click = jnp.zeros((2, 3200)).at[1, 1000].set(1.0)
    state = audio.quiet(jax.random.key(0), 2, 3040, DEAF)
    heard = np.asarray(audio.mixture(click, position, heading, state.echo, DEAF))[0]
    tone = np.sqrt(2) * 20e-6 * 10 ** (65 / 20)
    for ear_at, trace in zip((-audio.MICROPHONE, audio.MICROPHONE), heard):
        distance = 1.0 - ear_at
        spectrum = np.fft.rfft(trace)[200:1800]  # a click: flat, and of linear phase
        assert np.allclose(np.abs(spectrum), tone / distance, rtol=0.02)
        slope = np.polyfit(
            2 * np.pi * np.arange(200, 1800) / 4096, np.unwrap(np.angle(spectrum)), 1
        )
        assert np.isclose(-slope[0], 1000 + 8000 * distance / 343, atol=0.05)


def test_levels_of_echo_and_motors():
    transfer = audio.echo(jax.random.key(1), 3, audio.Hall(echo_time=0.2))
    energy = (np.abs(np.asarray(transfer)) ** 2).mean()
    assert np.isclose(energy, 1 / 2.8**2, rtol=0.1)  # as loud as the direct sound at 2.8 m
    noise = audio.motor_noise(jax.random.key(2), jnp.linspace(0, 1, 24), 8000)
    assert np.isclose(float((noise**2).mean()), 1.0, rtol=0.15)


@pytest.mark.slow
def test_a_round_of_both_teams_at_once():
    """Every robot speaks in its slot, opponents at the same time; all mates hear it, and know what
    was said, 0.1 s steps and all."""
    position = jnp.array(
        [[-1.2, 0.0], [-0.5, 0.5], [0.2, -0.4], [1.2, 0.1], [0.6, 0.6], [0.1, 0.3]]
    )
    heading = jnp.array([0.0, 0.5, -1.0, 3.0, 2.5, -2.0])
    shirt, team = jnp.arange(6) % 3, jnp.arange(6) // 3
    said = experiment.words(jax.random.key(3), 6)
    said = jax.vmap(lambda w, s: communication.pack(communication.unpack(w)[0]._replace(sender=s)))(
        said, shirt
    )

    def step(carry, n):
        state, ears, known = carry
        turn = communication.turn(shirt, n)
        words = jnp.where(turn[:, None], said, jnp.uint32(0))
        begins = jax.vmap(acoustics.encode)(words, team)
        key = jax.random.fold_in(jax.random.key(4), n)
        state, samples = audio.step(key, state, position, heading, begins, jnp.ones(6), HALL)
        ears, heard, valid = jax.vmap(ear.listen, (0, 0, 0, None))(ears, samples, team, n)
        known = jax.vmap(communication.merge, (0, 0, 0, 0, None))(known, heard, valid, shirt, 0.1)
        return (state, ears, known), (heard, valid)

    state = audio.quiet(jax.random.key(5), 6, acoustics.FRAME, HALL)
    ears = jax.vmap(lambda _: ear.silent())(shirt)
    known = jax.vmap(lambda _: communication.nothing_heard())(shirt)
    run = jax.jit(lambda c: jax.lax.scan(step, c, jnp.arange(12)))
    (_, _, known), (heard, valid) = run((state, ears, known))
    for robot in range(6):
        for speaker in range(6):
            mate = robot != speaker and robot // 3 == speaker // 3
            steps = np.flatnonzero(np.asarray(valid[:, robot, speaker % 3]))
            if mate:
                assert steps.tolist() == [4 * (speaker % 3) + 3], (robot, speaker)
                assert (heard[steps[0], robot, speaker % 3] == said[speaker]).all()
    assert np.asarray(known.age).max() <= 1.6 - 0.1 + 1e-4


def test_the_symbols_table_is_fitted_to_the_audio_level():
    air = tables.load("sound", tables.Air)
    assert air.duration >= acoustics.FRAME / acoustics.RATE
    hall = jax.tree.map(jnp.float32, HALL)
    for distance in (1.0, 3.0):
        right, wrong, *_ = experiment.on_field(jax.random.key(11), 192, hall, distance, jnp.inf)
        lost = int((~np.asarray(right)).sum())
        assert not np.asarray(wrong).any()
        _, low, high = statistics.wilson(lost, 192)
        table = 1 / (1 + np.exp((air.half - distance) / air.width))
        assert low - 0.02 <= table <= high + 0.02, (distance, lost / 192, table)


def test_the_committed_table_says_where_it_is_from():
    document = json.loads((ROOT / "envs/soccer/data/sound.json").read_text())
    assert "experiments/communication.py" in document["source"]
