"""`fntg listen`: the messages in recorded sounds."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import parse
from fntg_jax.commands.say import as_json
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class ListenOptions:
    """Print the messages in WAV files: any rate from 8000 Hz, any number of channels, integers or
    floats.  Both teams' bands are searched."""

    wavs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """files to read."""
    json: bool = False
    """print JSON instead of lines."""


def main(argv: list[str]) -> None:
    options = parse(ListenOptions, argv, "listen")
    if not options.wavs:
        raise ValueError("wavs: none given (see fntg listen --help)")
    xla.configure()
    from fntg_jax.running import sounds

    # All are read before anything is printed: half an answer is none.
    heard = [sounds.read_wav(path) for path in options.wavs]
    answer = []
    for path, (rate, samples) in zip(options.wavs, heard):
        messages = [
            {
                "time": round(m.time, 3),
                **as_json(m.team, m.word),
                "bits": f"{m.bits:016x}",
                "quality": round(m.quality, 3),
                "confidence": round(m.confidence, 6),
            }
            for m in sounds.listen(rate, samples)
        ]
        seconds = round(samples.shape[-1] / rate, 3)
        answer.append(
            {
                "sound": str(path),
                "rate": rate,
                "channels": len(samples),
                "seconds": seconds,
                "messages": messages,
            }
        )
    if options.json:
        print(json.dumps(answer, allow_nan=False))
        return
    for sound in answer:
        print(f"{sound['sound']}: {len(sound['messages'])} messages in {sound['seconds']} s")
        for m in sound["messages"]:
            ball = m["ball"] and f"ball {m['ball']['x']:.2f} {m['ball']['y']:.2f}"
            age = m["ball"] and f" seen {m['ball']['age']:.1f} s ago"
            print(
                f"  {m['time']:8.3f} s  team {m['team']} robot {m['sender']} {m['role']:10s} "
                f"at {m['x']:.2f} {m['y']:.2f} heading {m['heading']:.2f}  "
                f"{(ball + age) if ball else 'no ball':34s} sure {m['confidence']:.4f}"
            )
