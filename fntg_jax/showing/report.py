"""A learning run as one self-contained HTML page: what one would send to a colleague."""

import base64
import dataclasses
import html
import json
import re
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import jax

from fntg_jax import export
from fntg_jax.learning.rollout import trajectory
from fntg_jax.running import evaluation, run_folder
from fntg_jax.running.runner import Run
from fntg_jax.showing import plots, rules

_FILES = (
    ("params.json", "the controller"),
    ("config.json", "the configuration"),
    ("metrics.csv", "fitness by seed and generation"),
    ("provenance.json", "what it ran on"),
)


def page(folder: Path, num_scenes: int = 500, suite: str = "blocked") -> str:
    """The page for a completed run folder; num_scenes held-out scenes a suite are evaluated, the
    rules are watched on `suite`.  Raises ValueError (one line) when the folder is not one."""
    run = run_folder.restore(folder)
    if not run.done:
        raise ValueError(f"{folder}: not finished; continue it with fntg train --resume {folder}")
    controller = export.load(folder / "params.json")
    data = {name: _read(folder / name) for name, _ in _FILES}
    try:
        origin = dict(json.loads(data["provenance.json"]))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{folder / 'provenance.json'}: not JSON ({error})") from None
    about = controller.provenance
    of_seeds = f", the best of {run.config.seeds} seeds" if run.config.seeds > 1 else ""
    sections = [
        ("Fitness", _figure_of_fitness(run)),
        ("Trials of the learning set-up", _figures_of_trials(run, controller)),
        (
            f"Success on {num_scenes} unseen scenes a suite",
            _evaluation(run, controller, num_scenes),
        ),
        ("Rules", _rules(run, controller, suite)),
        ("Configuration", _table(_flat(dataclasses.asdict(run.config)))),
        ("Environment", _table(_flat(origin))),
        ("Data", _downloads(data)),
    ]
    facts = (
        f"{run.config.seeds} run{'s' if run.config.seeds > 1 else ''} of {run.config.generations} "
        f"generations, {run.config.ga.population} genomes, {run.config.num_scenes} trials each. "
        f"The controller shown is that of seed {about.get('seed')}{of_seeds}: "
        f"fitness {_number(about.get('fitness'))}, layout {controller.layout.name}."
    )
    body = "\n".join(f"<h2>{_text(title)}</h2>\n{content}" for title, content in sections)
    template = resources.files("fntg_jax.showing").joinpath("report.html").read_text("utf-8")
    parts = {
        "@TITLE@": _text(f"Learning run {folder.resolve().name}"),
        "@FACTS@": _text(facts),
        "@BODY@": body,
    }
    # In one pass: a name that looks like a mark stays a name.
    return re.sub("@(TITLE|FACTS|BODY)@", lambda mark: parts[mark[0]], template)


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


def _text(value: Any) -> str:
    return html.escape(str(value).encode("utf-8", "replace").decode())


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else "unknown"


def _image(path: Path, words: str) -> str:
    picture = base64.b64encode(path.read_bytes()).decode()
    return (
        f'<figure><img alt="{_text(words)}" src="data:image/png;base64,{picture}">'
        f"<figcaption>{_text(words)}</figcaption></figure>"
    )


def _figure_of_fitness(run: Run) -> str:
    with tempfile.TemporaryDirectory() as scratch:
        path = plots.fitness_curves(run.history(), Path(scratch, "fig5"))
        return _image(path, "Best and average fitness by generation (the paper's Fig. 5).")


def _figures_of_trials(run: Run, controller: export.Controller) -> str:
    """Fig. 6 to 8, by the run's controller in the run's own world."""
    params = controller.params32
    world, env = run.problem.world, run.problem.env
    scenes = world.suites["paper"](jax.random.key(0), 4)
    record = jax.jit(jax.vmap(lambda s: trajectory(params, s, env, output=controller.output)))
    trials = record(scenes)
    first = jax.tree.map(lambda x: x[:1], trials)
    limits, dt, field = env.limits, float(env.dt), world.field
    with tempfile.TemporaryDirectory() as scratch:
        return "\n".join(
            [
                _image(
                    plots.trajectories(trials, field, Path(scratch, "fig6")),
                    "Four starts of the suite paper (Fig. 6): arrow start, square end, star ball.",
                ),
                _image(
                    plots.trajectories(first, field, Path(scratch, "fig7")),
                    "The first of them (Fig. 7).",
                ),
                _image(
                    plots.velocities(
                        jax.tree.map(lambda x: x[0], first), limits, dt, Path(scratch, "fig8")
                    ),
                    "Its linear and angular velocity (Fig. 8).",
                ),
            ]
        )


def _evaluation(run: Run, controller: export.Controller, num_scenes: int) -> str:
    rows = []
    for suite in (name for name in run.problem.world.suites if name != "paper"):
        result = evaluation.evaluate(
            controller, run.problem.world, suite, num_scenes, env=run.problem.env
        )
        cells = "".join(
            f"<td>{100 * r.share:.1f} % <small>({100 * r.low:.1f}&ndash;{100 * r.high:.1f})</small>"
            for r in result.rates.values()
        )
        rows.append(f"<tr><th>{_text(suite)}{cells}")
    heads = "".join(f"<th>{_text(p)}" for p in ("suite", *evaluation.PARTS))
    note = (
        "reach: within 0.10 m after step 200; safe: never nearer than 0.145 m to an obstacle; "
        "stop: slower than 0.03 m/s over steps 170, 200, 220; success: all three. "
        "In brackets Wilson 95 % intervals."
    )
    return f"<div><table><tr>{heads}{''.join(rows)}</table></div><p>{note}</p>"


def _rules(run: Run, controller: export.Controller, suite: str) -> str:
    base = rules.rule_base(controller, run.problem.world, suite, 200)
    names = "".join(
        f"<tr><th>{_text(x.symbol)}<td>{_text(x.name)}<td>{_text(x.where)}"
        for labels in base.labels.values()
        for x in labels
    )
    rows = "".join(
        f"<tr><th>{_text(r.name)}<td>{_text(rules.sentence(r, base.limits))}"
        f"<td>{100 * r.mean:.1f} %<td>{_text(r.flag)}"
        for r in base.rules
    )
    notes = "".join(f"<p>Note: {_text(note)}.</p>" for note in base.notes)
    return (
        f"<div><table><tr><th>label<th>means<th>where{names}</table></div>{notes}"
        f"<div><table><tr><th>rule<th>in words<th>firing<th>{rows}</table></div>"
        f"<p>Firing: mean share over 200 scenes of suite {_text(suite)}; {_text(rules.LEGEND)}. "
        f"{_text(rules.clipping(base))}</p>"
    )


def _flat(value: dict, prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, x in value.items():
        nested = isinstance(x, dict) and x
        rows += _flat(x, f"{prefix}{name}.") if nested else [(f"{prefix}{name}", x)]
    return rows


def _table(rows: list[tuple[str, Any]]) -> str:
    lines = "".join(f"<tr><th>{_text(name)}<td>{_text(value)}" for name, value in rows)
    return f"<div><table>{lines}</table></div>"


def _downloads(data: dict[str, str]) -> str:
    items = []
    for name, what in _FILES:
        content = base64.b64encode(data[name].encode()).decode()
        link = f'<a download="{name}" href="data:application/octet-stream;base64,{content}">'
        items.append(f"<li>{link}{name}</a>, {what}")
    items.append('<li><a href="history.npz">history.npz</a>, every generation: beside this page')
    return f"<p>Kept inside this page:</p><ul>{''.join(items)}</ul>"
