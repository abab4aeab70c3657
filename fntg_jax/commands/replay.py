"""`fntg replay`: watch trials."""

import dataclasses
import os
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax import xla
from fntg_jax.cli import load_controller, parse, say


@dataclasses.dataclass(frozen=True)
class ReplayOptions:
    """Trials from above, to scale, side by side: every controller on every scene.  An .html file
    is one page without any network, with memberships and rules over time and keys to step
    through it; .gif and .webp are pictures that run at four times the robot's speed."""

    controllers: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """params.json, exported .fll, or run folders."""
    out: Path = Path("replay.html")
    """file to write: .html (under 1 MB), .gif or .webp."""
    suite: str = "blocked"
    """scenes to draw from."""
    scene: tuple[int, ...] = (0,)
    """numbers of the scenes, from 0."""
    seed: int = 0
    """seed of the scenes."""
    generations: tuple[int, ...] = ()
    """of a run folder: the best controllers of these generations (e.g. 1 95) instead of the best
    of the run."""
    env: str = "kinematic"
    """world, by its entry point name."""


def main(argv: list[str]) -> None:
    options = parse(ReplayOptions, argv, "replay")
    suffix = options.out.suffix.lower()
    if suffix not in (".html", ".gif", ".webp"):
        raise ValueError(f"out = {options.out}: allowed are names ending in .html, .gif, .webp")
    if not options.controllers:
        raise ValueError("no controller given: name a params.json or a run folder")
    xla.configure()
    from fntg_jax import replay, runfolder, runner
    from fntg_jax.files import write_atomically

    world = runner.get_world(options.env)
    titled = []
    for path in options.controllers:
        folder = os.path.isdir(path)
        if options.generations and folder:
            titled += [
                (f"{path.name}, generation {g}", runfolder.controller_of_generation(path, g))
                for g in options.generations
            ]
        else:
            titled.append((path.name if folder else str(path), load_controller(path)))
    num = len(titled) * len(options.scene)
    if num > 24:
        raise ValueError(f"{num} trials: allowed are up to 24")
    recorded = [
        replay.record(title, controller, world, options.suite, options.scene, options.seed)
        for title, controller in titled
    ]
    # A scene's controllers stand side by side.
    panels = [panel for scene in zip(*recorded) for panel in scene]
    if suffix == ".html":
        data = replay.page(panels, f"Replay: {' | '.join(t for t, _ in titled)}").encode()
    else:
        data = replay.animation(panels, suffix[1:].upper())
    try:
        write_atomically(options.out, data)
    except OSError as error:
        raise ValueError(f"out = {options.out}: {error.strerror or error}") from None
    for panel in panels:
        say(f"{panel['title']}, {panel['scene']}: {panel['result']}")
    say(f"{len(data)} bytes")
    print(options.out)
