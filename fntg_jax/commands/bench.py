"""`fntg bench`: a score card on frozen scenes and matches."""

import dataclasses
import json
import os
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import load_controller, parse, say
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class BenchOptions:
    """Score a team or a controller on a frozen, versioned set of matches and opponents, or of
    scenes: one JSON score card with intervals, on stdout."""

    member: Annotated[str, tyro.conf.Positional]
    """a team as `fntg match` takes it, or a controller: params.json, an .fll, a run folder."""
    share: float = 1.0
    """of the matches or scenes, 0.01 to 1; only 1 gives a score card."""
    out: Path | None = None
    """also write it to this file."""


def main(argv: list[str]) -> None:
    options = parse(BenchOptions, argv, "bench")
    if not 0.01 <= options.share <= 1:
        raise ValueError(f"share = {options.share}: allowed are 0.01 to 1")
    if options.out is not None and (options.out.is_dir() or not options.out.parent.is_dir()):
        raise ValueError(f"out = {options.out}: allowed is a file in a folder that exists")
    xla.configure(num_cpu_devices=len(os.sched_getaffinity(0)))
    from fntg_jax.files import write_atomically, writing
    from fntg_jax.running import bench

    if bench.is_team(options.member):
        card = bench.of_team(options.member, options.share)
    else:
        controller = load_controller(Path(options.member))
        card = bench.of_controller(controller, options.member, options.share)
    if differs := card.get("differs_in"):
        say(
            f"note: not as when version {bench.VERSION} was frozen: {', '.join(differs)}; cards "
            "are comparable only where the fingerprints are equal"
        )
    if not card["complete"]:
        say(f"note: share {options.share:g} of version {bench.VERSION}: no score card to cite")
    text = json.dumps(card, indent=1, allow_nan=False) + "\n"
    if options.out is not None:
        with writing(options.out, "out"):
            write_atomically(options.out, text.encode())
    print(text, end="")
