"""`fntg say`: a robot's message as sound."""

import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from fntg_jax.commands.cli import parse
from fntg_jax.running import xla

ROLES = ("goalkeeper", "attacker", "supporter", "defender")


@dataclasses.dataclass(frozen=True)
class SayOptions:
    """Write a robot's message to a WAV file as the sound its speaker makes, and print what is in it
    after rounding.  Places in m and rad, in the team's frame."""

    wav: Annotated[Path, tyro.conf.Positional]
    """file to write: one channel, 16 bits."""
    sender: int = 0
    """shirt of the robot, 0 to 3."""
    team: Literal[0, 1] = 0
    """which of the two bands: 500-2000 or 2200-3700 Hz."""
    role: Literal["goalkeeper", "attacker", "supporter", "defender"] = "attacker"
    """what the robot plays."""
    x: float = 0.0
    """own place, -1.7 to 1.7."""
    y: float = 0.0
    """own place, -1.1 to 1.1."""
    heading: float = 0.0
    """own heading."""
    sd: float = 0.03
    """how far the own place may be off: 0.03, 0.1, 0.3 or 1."""
    ball_x: float | None = None
    """the ball's place, -1.7 to 1.7; without it the robot knows of no ball."""
    ball_y: float | None = None
    """the ball's place, -1.1 to 1.1."""
    ball_age: float = 0.0
    """s since it saw the ball, 0 to 11."""
    rate: int = 16000
    """samples a second, 8000 to 192000."""
    silence: float = 0.1
    """s of silence before and after."""
    volume: float = 0.5
    """amplitude, 0 to 1."""


def main(argv: list[str]) -> None:
    options = parse(SayOptions, argv, "say")
    if (options.ball_x is None) != (options.ball_y is None):
        raise ValueError("ball-x, ball-y: give both or none")
    allowed = {
        "sender": (0, 3),
        "x": (-1.7, 1.7),
        "y": (-1.1, 1.1),
        "heading": (-math.tau, math.tau),
        "sd": (0, 10),
        "ball_x": (-1.7, 1.7),
        "ball_y": (-1.1, 1.1),
        "ball_age": (0, 11),
        "rate": (8000, 192000),
        "silence": (0, 60),
        "volume": (0, 1),
    }
    for name, (low, high) in allowed.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            name = name.replace("_", "-")
            raise ValueError(f"{name} = {value}: allowed are {low} to {high}")
    if options.wav.is_dir() or not options.wav.parent.is_dir():
        raise ValueError(f"{options.wav}: allowed is a file in a folder that exists")
    xla.configure()
    import jax.numpy as jnp
    import numpy as np

    from fntg_jax.robot import acoustics, communication
    from fntg_jax.running import sounds

    known = options.ball_x is not None
    words = communication.pack(
        communication.Word(
            sender=jnp.asarray(options.sender),
            role=jnp.asarray(ROLES.index(options.role)),
            x=jnp.asarray(options.x),
            y=jnp.asarray(options.y),
            heading=jnp.asarray(options.heading),
            sd=jnp.asarray(options.sd),
            ball_x=jnp.asarray(options.ball_x or 0.0),
            ball_y=jnp.asarray(options.ball_y or 0.0),
            ball_age=jnp.asarray(options.ball_age if known else jnp.inf),
        )
    )
    frame = np.asarray(acoustics.encode(words, options.team))[None]
    gap = np.zeros((1, round(options.silence * acoustics.RATE)), np.float32)
    sound = np.concatenate([gap, frame, gap], 1) * options.volume
    sounds.write_wav(
        options.wav, options.rate, sounds.resample(sound, acoustics.RATE, options.rate)[0]
    )
    word, _ = communication.unpack(words)
    print(json.dumps(as_json(options.team, word), allow_nan=False), file=sys.stdout)


def as_json(team: int, word: object) -> dict:
    """A word as JSON has it: m, rad, s."""
    sender, role, x, y, heading, sd, ball_x, ball_y, age = (float(v) for v in word)  # type: ignore[attr-defined]
    ball = {"x": round(ball_x, 4), "y": round(ball_y, 4), "age": round(age, 2)}
    return {
        "team": team,
        "sender": int(sender),
        "role": ROLES[int(role)],
        "x": round(x, 4),
        "y": round(y, 4),
        "heading": round(heading, 4),
        "sd": round(sd, 2),
        "ball": ball if math.isfinite(age) else None,
    }
