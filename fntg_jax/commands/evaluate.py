"""`fntg evaluate`: success on suites of unseen scenes."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import load_controller, parse, say
from fntg_jax.running import registry, xla
from fntg_jax.running.settings import MOST_SCENES


@dataclasses.dataclass(frozen=True)
class EvaluateOptions:
    """Success of a controller on suites of scenes: reach, safe, stop and all three, with Wilson
    95 % intervals."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json or a run folder."""
    suite: str = "all"
    """one suite (with its options: blocked/wall=0.1), or all."""
    scenes: int = 2000
    """scenes a suite."""
    seed: int = 0
    """seed of the scenes."""
    env: str = ""
    """world, by its entry point name; default: where the controller was trained."""
    env_options: dict[str, float] = dataclasses.field(default_factory=dict)
    """options of that world by name, over the controller's own limits and control step."""
    json: bool = False
    """print JSON instead of a table."""
    failures: Path | None = None
    """also draw trials that failed, up to 12 a suite, into this .png (and a .pdf beside it)."""


def main(argv: list[str]) -> None:
    options = parse(EvaluateOptions, argv, "evaluate")
    picture = options.failures
    if picture is not None and (picture.suffix != ".png" or not picture.parent.is_dir()):
        raise ValueError(f"failures = {picture}: allowed is a .png file in a folder that exists")
    xla.configure()
    from fntg_jax.running import evaluation

    controller = load_controller(options.controller)
    name = options.env or controller.env
    world = registry.get_world(name)
    if options.suite != "all":
        registry.get_suite(world, options.suite)
    env = evaluation.environment_for(controller, world, **options.env_options)
    suites = evaluation.held_out_suites(world) if options.suite == "all" else [options.suite]
    if 50_000 < options.scenes <= MOST_SCENES:
        say(f"drawing {options.scenes} scenes a suite ...")
    results = [
        evaluation.evaluate(controller, world, suite, options.scenes, options.seed, env)
        for suite in suites
    ]
    say(f"world {name}")
    if picture is not None:
        from fntg_jax.files import writing
        from fntg_jax.showing import failures

        with writing(picture, "failures"):
            say(f"failures {failures.picture(controller, world, env, results, picture)}")
    if options.json:
        document = {
            r.suite: {"scenes": r.num_scenes, **{k: v._asdict() for k, v in r.rates.items()}}
            for r in results
        }
        print(json.dumps(document, indent=1, allow_nan=False))
        return
    print(f"{'suite':18s}{'scenes':>7s}" + "".join(f"{p:>25s}" for p in evaluation.PARTS))
    for r in results:
        cells = "".join(f"{rate!s:>25s}" for rate in r.rates.values())
        print(f"{r.suite:18s}{r.num_scenes:7d}{cells}")
