"""`fntg replay`: watch trials."""

import dataclasses
import os
from pathlib import Path
from typing import Annotated, Any

import tyro

from fntg_jax.commands.cli import load_controller, parse, say
from fntg_jax.files import check_out
from fntg_jax.running import controllers, registry, xla


@dataclasses.dataclass(frozen=True)
class ReplayOptions:
    """Trials side by side: every controller on every scene.  An .html file is one page without any
    network: the field from above, with memberships and rules over time and keys to step through
    it.  .gif and .webp are pictures: from above, at four times the robot's speed, or of a walking
    robot, drawn by MuJoCo in real time with six key frames as PNG."""

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
    env: str = ""
    """world, by its entry point name; without it each controller's own."""
    width: int = 0
    """of a .gif or .webp: pixels; 0 for about 400 a trial beside another.  None is over 3 MB."""
    view: bool = False
    """play one trial of a walking robot in MuJoCo's viewer instead, which needs a display."""


def main(argv: list[str]) -> None:
    options = parse(ReplayOptions, argv, "replay")
    suffix = options.out.suffix.lower()
    if suffix not in (".html", ".gif", ".webp"):
        raise ValueError(f"out = {options.out}: allowed are names ending in .html, .gif, .webp")
    if not options.controllers:
        raise ValueError("no controller given: name a params.json or a run folder")
    if options.width and not 100 <= options.width <= 1280:
        raise ValueError(f"width = {options.width}: allowed are 100 to 1280 pixels")
    if not options.view:
        check_out(options.out)
    if options.generations and not any(os.path.isdir(path) for path in options.controllers):
        raise ValueError("generations: only a run folder has them")
    xla.configure()

    titled = []
    for path in options.controllers:
        folder = os.path.isdir(path)
        if options.generations and folder:
            titled += [
                (f"{path.name}, generation {g}", controllers.of_generation(path, g))
                for g in options.generations
            ]
        else:
            titled.append((path.name if folder else str(path), load_controller(path)))
    trials = [
        (title, controller, registry.get_world(options.env or controller.env))
        for title, controller in titled
    ]
    num = len(trials) * len(options.scene)
    if num > 24:
        raise ValueError(f"{num} trials: allowed are up to 24")
    # A world need not be able to draw itself.
    films = all(getattr(world, "film", None) for _, _, world in trials)
    if options.view:
        _view(trials, options, films)
    elif films and suffix != ".html":
        _film(trials, options)
    else:
        _draw(trials, options)


def _recorded(record: Any, trials: Any, options: ReplayOptions, **more: Any) -> list:
    """Of every scene all controllers, so that they stand side by side."""
    each = [record(*trial, options.suite, options.scene, options.seed, **more) for trial in trials]
    return [one for scene in zip(*each) for one in scene]


def _draw(trials: Any, options: ReplayOptions) -> None:
    """From above: a page, or a picture."""
    from fntg_jax.showing import replay

    panels = _recorded(replay.record, trials, options)
    suffix = options.out.suffix.lower()
    if suffix == ".html":
        title = f"Replay: {' | '.join(title for title, _, _ in trials)}"
        scenes = replay.choice(trials[0][2], options.suite, options.seed)
        data = replay.page(panels, title, scenes).encode()
    else:
        data = replay.animation(panels, suffix[1:].upper(), options.width)
    for panel in panels:
        say(f"{panel['title']}, {panel['scene']}: {panel['result']}")
    _write({options.out: data})


def _film(trials: Any, options: ReplayOptions) -> None:
    """By the world itself: a picture and its key frames."""
    from fntg_jax.showing import film

    say("simulating and drawing ...")
    shots = _recorded(film.shoot, trials, options)
    data, keys = film.animation(shots, options.out.suffix[1:].upper(), options.width)
    for shot in shots:
        say(f"{shot.title}, {shot.scene}: {shot.result}")
    stem = options.out.with_suffix("")
    _write({options.out: data} | {Path(f"{stem}-key-{n}.png"): k for n, k in enumerate(keys)})


def _view(trials: Any, options: ReplayOptions, films: bool) -> None:
    if not films:
        raise ValueError("view: only worlds with a walking robot have a viewer (env = quadruped)")
    if len(trials) * len(options.scene) > 1:
        raise ValueError("view: name one controller and one scene")
    from fntg_jax.showing import film

    (shot,) = _recorded(film.shoot, trials, options, window=True)
    say(f"{shot.title}, {shot.scene}: {shot.result}")
    shot.view()


def _write(files: dict[Path, bytes]) -> None:
    from fntg_jax.files import write_atomically, writing

    for path, data in files.items():
        with writing(path, "out"):
            write_atomically(path, data)
        say(f"{len(data)} bytes: {path}")
    print(next(iter(files)))
