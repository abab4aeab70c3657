"""`fntg rules`: the rule base in plain words."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from fntg_jax.commands.cli import load_controller, parse
from fntg_jax.running import registry, xla


@dataclasses.dataclass(frozen=True)
class RulesOptions:
    """The rules of a controller in plain words, with how often each fires on a suite; labels
    are named after what learning made of them."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json, an exported .fll, or a run folder."""
    suite: str = "blocked"
    """scenes to watch the rules on."""
    scenes: int = 200
    """number of scenes."""
    seed: int = 0
    """seed of the scenes."""
    env: str = ""
    """world, by its entry point name; default: where the controller was trained."""
    format: Literal["text", "md", "json", "csv"] = "text"
    """what to print."""


def main(argv: list[str]) -> None:
    options = parse(RulesOptions, argv, "rules")
    xla.configure()
    from fntg_jax.showing import rules

    controller = load_controller(options.controller)
    world = registry.get_world(options.env or controller.env)
    base = rules.rule_base(controller, world, options.suite, options.scenes, options.seed)
    sys.stdout.write(rules.FORMATS[options.format](base))
