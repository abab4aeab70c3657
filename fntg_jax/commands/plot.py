"""`fntg plot`: membership functions and control surfaces."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import load_controller, parse
from fntg_jax.running import registry, xla


@dataclasses.dataclass(frozen=True)
class PlotOptions:
    """Membership functions, and v and omega over the ball's distance and direction with and
    without an obstacle.  Writes OUT-memberships and OUT-surfaces, each as .png and .pdf, and
    prints the paths of the .png files."""

    controllers: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """one or two files or run folders; two stand side by side on the same scales."""
    out: Path = Path("fntg")
    """beginning of the files' names."""
    env: str = "kinematic"
    """world whose field gives the ranges, by its entry point name."""


def main(argv: list[str]) -> None:
    options = parse(PlotOptions, argv, "plot")
    if not 1 <= len(options.controllers) <= 2:
        raise ValueError(f"{len(options.controllers)} controllers: allowed are one or two")
    xla.configure()
    from fntg_jax.files import writing
    from fntg_jax.showing import plot_controller

    controllers = [(str(path), load_controller(path)) for path in options.controllers]
    field = registry.get_world(options.env).field
    for name in ("memberships", "surfaces"):
        path = options.out.with_name(f"{options.out.name}-{name}.png")
        with writing(path, "out"):
            print(getattr(plot_controller, name)(controllers, field, path))
