"""`fntg rules`: the rule base of a controller, or the planner of a team, in plain words."""

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from fntg_jax.commands.cli import load_controller, parse
from fntg_jax.running import registry, xla


@dataclasses.dataclass(frozen=True)
class RulesOptions:
    """The rules of a controller in plain words, with how often each fires on a suite; labels
    are named after what learning made of them.  Of a team: its planner's rules, with how often each
    decided in matches."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json, an exported .fll, a run folder; or a team: cerberus, or a team file."""
    suite: str = "blocked"
    """scenes to watch the rules on."""
    scenes: int | None = None
    """number of scenes, default 200; of a team: of matches, two minutes each, default 32."""
    seed: int = 0
    """seed of the scenes."""
    env: str = ""
    """world, by its entry point name; default: where the controller was trained."""
    against: str = "chaser"
    """of a team: the team it plays against."""
    beside: str = ""
    """of a team: another of the same planner; what differs: genes, and how often each rule
    decided."""
    format: Literal["text", "md", "json", "csv"] = "text"
    """what to print."""


def main(argv: list[str]) -> None:
    options = parse(RulesOptions, argv, "rules")
    xla.configure()
    if _is_team(options.controller):
        from fntg_jax.showing import team_rules

        num = 32 if options.scenes is None else options.scenes
        found = team_rules.watch(str(options.controller), options.against, num, options.seed)
        if options.beside:
            if options.format != "text":
                raise ValueError(f"format = {options.format!r}: with --beside allowed is text")
            other = team_rules.watch(options.beside, options.against, num, options.seed)
            sys.stdout.write(team_rules.beside(found, other))
            return
        sys.stdout.write(team_rules.FORMATS[options.format](found))
        return
    from fntg_jax.showing import rules

    controller = load_controller(options.controller)
    world = registry.get_world(options.env or controller.env)
    num = 200 if options.scenes is None else options.scenes
    base = rules.rule_base(controller, world, options.suite, num, options.seed)
    sys.stdout.write(rules.FORMATS[options.format](base))


def _is_team(path: Path) -> bool:
    """Whether a team is meant: the name of an installed one, or a team file."""
    from fntg_jax.running import matches

    if not os.path.exists(path):  # a name that is too long does not exist
        return path.name == str(path) and str(path) in matches.team_names()
    if path.suffix != ".json" or not path.is_file():
        return False
    try:
        document = json.loads(path.read_bytes())
    except ValueError:
        return False  # the reader of controllers says what is wrong with it
    return isinstance(document, dict) and document.get("format") == "fntg-team"
