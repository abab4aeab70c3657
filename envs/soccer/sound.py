"""Sound as symbols: a message takes its time, is lost more often from farther away, and two of one
team at once garble each other; the other team's voices have a band of their own.

The losses are fitted to the audio level (`envs.soccer.audio`) by experiments/communication.py.
"""

import jax.numpy as jnp
from jaxtyping import Array

from envs.base import Action
from envs.soccer import noise
from envs.soccer.state import Robots, Talk, upright
from envs.soccer.tables import Air

FIRST_CHANNEL = 140  # of a robot's noise in a step; one number a sender from here on


def silence(robots: Robots) -> Talk:
    """Nobody speaks."""
    n = robots.x.shape[0]
    nobody = jnp.zeros((n, *robots.x.shape), bool)
    words = jnp.zeros_like(robots.lane)
    return Talk(words, words, jnp.zeros_like(robots.x), nobody, nobody)


def speak(
    talk: Talk, robots: Robots, action: Action, may: Array, air: Air, key: Array, dt: float
) -> Talk:
    """One step of the air.  action.say: [2, R]; both words 0 is silence.  A robot that still speaks
    cannot begin anew."""
    starts = may & (talk.left <= 0) & ((action.say[0] | action.say[1]) != 0)
    low = jnp.where(starts, action.say[0], talk.low)
    high = jnp.where(starts, action.say[1], talk.high)
    left = jnp.where(starts, jnp.float32(air.duration), talk.left)
    left = jnp.where(may, left, 0.0)  # sent off: cut short
    speaks = left > 0
    n = robots.x.shape[0]
    dx = robots.x[:, None] - robots.x[None]
    dy = robots.y[:, None] - robots.y[None]
    alike = (n, n, *(1,) * (robots.x.ndim - 1))
    same = jnp.eye(n, dtype=bool).reshape(alike)
    mates = jnp.kron(jnp.eye(2), jnp.ones((n // 2, n // 2))).astype(bool).reshape(alike)
    # [sender, receiver]: in the receiver's band; who speaks hears itself, and then nobody else.
    audible = speaks[:, None] & mates
    voices = audible[0].astype(jnp.int32)
    for k in range(1, n):
        voices = voices + audible[k]
    lost = 1 / (1 + jnp.exp((air.half - jnp.sqrt(dx * dx + dy * dy)) / air.width))
    garbled = (talk.garbled & ~starts[:, None]) | ~audible | (voices[None] > 1)
    after = jnp.maximum(left - dt, 0)
    after = jnp.where(after < 0.25 * dt, 0.0, after)
    ends = speaks & (after <= 0)
    # One number of each receiver for each sender; senders are named by how many shirts they are
    # away, so that the draw does not depend on which team is called home.
    kept = []
    for sender in range(n):
        shirt = sender % (n // 2)
        away = upright([(k >= n // 2) != (sender >= n // 2) for k in range(n)], robots.x)
        own, theirs = (noise.uniform(key, FIRST_CHANNEL + shirt + m * (n // 2)) for m in (0, 1))
        kept.append(jnp.where(away, theirs, own) >= lost[sender])
    arrived = ends[:, None] & ~garbled & ~same & jnp.stack(kept)
    return Talk(low, high, after, garbled & speaks[:, None], arrived)


def heard(talk: Talk) -> tuple[Array, Array]:
    """What each robot has just heard of its own team: words [N, 2, R] by the sender's shirt, and
    whether they arrived whole, [N, R]."""
    n = talk.low.shape[0] // 2
    words, valid = [], []
    for shirt in range(n):
        mine = [talk.arrived[shirt, :n], talk.arrived[n + shirt, n:]]
        valid.append(jnp.concatenate(mine))
        pair = []
        for word in (talk.low, talk.high):
            pair.append(
                jnp.concatenate(
                    [
                        jnp.where(mine[0], word[shirt], jnp.uint32(0)),
                        jnp.where(mine[1], word[n + shirt], jnp.uint32(0)),
                    ]
                )
            )
        words.append(jnp.stack(pair))
    return jnp.stack(words), jnp.stack(valid)
