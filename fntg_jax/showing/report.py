"""A learning run as one self-contained HTML page: what one would send to a colleague.

This module gathers what `report.html` lays out; the template escapes all of it.
"""

import base64
import dataclasses
import json
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jinja2

from fntg_jax import export
from fntg_jax.files import read_arrays, read_bytes, read_text
from fntg_jax.learning.rollout import trajectory
from fntg_jax.running import config_file, evaluation, run_folder
from fntg_jax.running.runner import Run
from fntg_jax.running.settings import TrainConfig
from fntg_jax.showing import failures, plot_controller, plots, replay, rules

_FILES = (
    ("params.json", "the controller"),
    ("config.json", "the configuration"),
    ("metrics.csv", "fitness by seed and generation"),
    ("provenance.json", "what it ran on"),
)
_RULE_SCENES = 200
_FAILURES = 4  # drawn of a suite


def page(folder: Path, num_scenes: int = 500, suite: str = "blocked") -> str:
    """The page for a completed run folder; num_scenes held-out scenes a suite are evaluated, the
    rules are watched and the replay starts on `suite`.  Raises ValueError (one line) when the
    folder is not one."""
    evaluation.check_scenes(num_scenes)
    run = run_folder.restore(folder)
    if run.problem.task is not None:
        raise ValueError(f"{folder}: a run of task {run.config.task!r}: a report is of task bioa")
    if not run.done:
        raise ValueError(f"{folder}: not finished; continue it with fntg train --resume {folder}")
    controller = export.load(folder / "params.json")
    data = {name: read_text(folder / name, "file of a run", 100_000_000) for name, _ in _FILES}
    try:
        origin = dict(json.loads(data["provenance.json"]))
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{folder / 'provenance.json'}: not JSON ({error})") from None
    world, env = run.problem.world, run.problem.env
    assert world is not None and env is not None  # as in every run of bioa
    panels = replay.record("this controller", controller, world, suite, (0, 1))
    results = [
        evaluation.evaluate(controller, world, name, num_scenes, env=env)
        for name in evaluation.held_out_suites(world)
    ]
    files = [
        {"name": name, "words": words, "data": _base64(data[name].encode())}
        for name, words in _FILES
    ]
    return _template().render(
        title=_clean(f"Learning run {folder.resolve().name}"),
        facts=_facts(run, controller),
        replay=replay.page(panels, "Replay", replay.choice(world, suite, num=12)),
        playable="play" in panels[0],
        rules=_rules(controller, world, suite),
        num_scenes=num_scenes,
        success=_success(results),
        configuration=_flat(_changed(dataclasses.asdict(run.config))),
        environment=[(name, _clean(value)) for name, value in _flat(origin)],
        files=files,
        **_pictures(folder, run, controller, results),
    )


def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = resources.files("fntg_jax.showing").joinpath("report.html").read_text("utf-8")
    return environment.from_string(text)


def _clean(value: Any) -> str:
    """As text that UTF-8 can hold."""
    return str(value).encode("utf-8", "replace").decode()


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _facts(run: Run, controller: export.Controller) -> str:
    config, about = run.config, controller.provenance
    several = f"{config.seeds} runs" if config.seeds > 1 else "1 run"
    of_seeds = f", the best of {config.seeds} seeds" if config.seeds > 1 else ""
    fitness = about.get("fitness")
    fitness = f"{fitness:.4g}" if isinstance(fitness, int | float) else "unknown"
    return _clean(
        f"{several} of {config.generations} generations, {config.ga.population} genomes, "
        f"{config.num_scenes} trials each. The controller shown is that of seed "
        f"{about.get('seed')}{of_seeds}: fitness {fitness}, layout {controller.layout.name}."
    )


def _rules(controller: export.Controller, world: Any, suite: str) -> dict[str, Any]:
    base = rules.rule_base(controller, world, suite, _RULE_SCENES)
    limits = base.limits
    rows = [
        {
            "name": rule.name,
            "words": rules.sentence(rule, limits),
            "share": f"{100 * rule.mean:.1f}",
            "flag": rule.flag,
        }
        for rule in base.rules
    ]
    return {
        "rows": rows,
        "labels": [label for family in base.labels.values() for label in family],
        "notes": base.notes,
        "limits": f"The speed is {limits.v_min:g} to {limits.v_max:g} m/s, the turn at most "
        f"{limits.omega_max:g} rad/s.",
        "clipping": rules.clipping(base),
        "legend": rules.LEGEND,
        "suite": base.suite,
        "num_scenes": base.num_scenes,
    }


def _success(results: list[evaluation.Evaluation]) -> dict[str, Any]:
    rows = []
    for result in results:
        rates = (str(rate).partition(" (") for rate in result.rates.values())
        rows.append((result.suite, [(share, low.rstrip(")")) for share, _, low in rates]))
    return {"heads": ("suite", *evaluation.PARTS), "rows": rows}


def _pictures(
    folder: Path, run: Run, controller: export.Controller, results: list[evaluation.Evaluation]
) -> dict[str, Any]:
    """All pictures of the page, by their names in the template."""
    world, env = run.problem.world, run.problem.env
    assert world is not None and env is not None  # as in every run of bioa
    params = controller.params32
    scenes = world.suites["paper"](jax.random.key(0), 4)
    record = jax.jit(jax.vmap(lambda s: trajectory(params, s, env, output=controller.output)))
    trials = record(scenes)
    first = jax.tree.map(lambda x: x[:1], trials)
    one = jax.tree.map(lambda x: x[0], first)
    titled = [("this controller", controller)]
    most = config_file.most_bytes(run.config, controller.layout.num_genes)
    stored = read_arrays(read_bytes(folder / "history.npz", "history", most), most)
    failed = any(not result.success.all() for result in results)
    with tempfile.TemporaryDirectory() as scratch:
        to = Path(scratch)

        def picture(path: Path, words: str, kind: str = "half") -> dict[str, str]:
            return {"data": _base64(path.read_bytes()), "words": words, "kind": kind}

        return {
            "fitness": picture(
                plots.fitness_curves(run.history(), to / "fig5", stored.get("refined")),
                "Best and average fitness by generation (the paper's Fig. 5).",
                "wide" if "refined" in stored else "half",
            ),
            "memberships": picture(
                plot_controller.memberships(titled, world.field, to / "m"),
                "Membership functions of the labels.",
            ),
            "surfaces": picture(
                plot_controller.surfaces(titled, world.field, to / "s"),
                "Linear and angular velocity over distance and direction of the ball.",
            ),
            "failures": failed
            and picture(
                failures.picture(controller, world, env, results, to / "f", _FAILURES),
                f"The first failed trials of each suite, up to {_FAILURES}.",
                "wide",
            ),
            "trials": [
                picture(
                    plots.trajectories(trials, world.field, to / "fig6"),
                    "Four starts of the suite paper (Fig. 6).",
                ),
                picture(
                    plots.trajectories(first, world.field, to / "fig7"),
                    "The first of them (Fig. 7).",
                ),
                picture(
                    plots.velocities(one, env.limits, float(env.dt), to / "fig8"),
                    "Its linear and angular velocity (Fig. 8).",
                ),
            ],
        }


def _changed(config: dict[str, Any]) -> dict[str, Any]:
    """Without what is at its default."""
    usual = dataclasses.asdict(TrainConfig())

    def rest(values: dict[str, Any], usual: dict[str, Any]) -> dict[str, Any]:
        found = {}
        for name, value in values.items():
            if value == usual.get(name):
                continue
            nested = isinstance(value, dict) and isinstance(usual.get(name), dict)
            found[name] = rest(value, usual[name]) if nested else value
        return found

    return rest(config, usual)


def _flat(value: dict, prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, x in value.items():
        nested = isinstance(x, dict) and x
        rows += _flat(x, f"{prefix}{name}.") if nested else [(f"{prefix}{name}", x)]
    return rows
