"""Sweeps: many settings x seeds; those that differ in traced floats run in one compiled program.

A setting is a dict from axis ("ga.mutation_rate", "env.dt", "generations") to value, over a base
configuration.  A setting's result is bit for bit that of `fntg train` with its values.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import rollout_pairs
from fntg_jax.running import memory
from fntg_jax.running.evaluation import held_out_scenes
from fntg_jax.running.parallel import over_seeds
from fntg_jax.running.problem import Problem, program_key, resolve
from fntg_jax.running.runner import Run
from fntg_jax.running.settings import TrainConfig, validate

Setting = dict[str, Any]

_GROUPS = ("ga", "fitness", "smooth")
_FIXED = ("seeds", "first_seed", "env_options")  # of TrainConfig, that are no axes
_BATCH_BYTES = 1 << 28  # of populations that are bred side by side


class Table(NamedTuple):
    """What a sweep found, NumPy, leading axes (setting, seed).

    best: fitness of the seed's controller, as `runner.Result` chooses it; mean: of the last
    population; success: by suite the share of unseen scenes; theta: by setting [seed, genes].
    """

    settings: list[Setting]
    best: np.ndarray
    mean: np.ndarray
    success: dict[str, np.ndarray]
    theta: list[np.ndarray]


def parse_axis(text: str) -> tuple[str, list[Any]]:
    """An axis out of text: its name and values.

    Args:
        text: "ga.mutation_rate=0.001,0.01".

    Raises ValueError (one line) on an unknown axis, an empty list, or a value that is of another
    type or comes twice.
    """
    name, equals, rest = text.partition("=")
    name = name.strip().replace("-", "_")
    words = [word.strip() for word in rest.split(",")]
    if not equals or not all(words):
        raise ValueError(f"axis = {text!r}: allowed is NAME=VALUE,VALUE,...")
    kind = _kind(name)
    values = []
    for word in words:
        try:
            values.append({"True": True, "False": False}[word] if kind is bool else kind(word))
        except (KeyError, ValueError):
            allowed = {bool: "True and False", int: "whole numbers", float: "numbers"}[kind]
            raise ValueError(f"axis {name} = {word!r}: allowed are {allowed}") from None
    if len(set(values)) < len(values):
        raise ValueError(f"axis {name} = {rest}: has a value twice")
    return name, values


def _kind(name: str) -> type:
    """Type of an axis's values; an option of the world is a float, whatever its name."""
    group, _, field = name.rpartition(".")
    if group == "env" and field:
        return float
    base = TrainConfig()
    known = [f.name for f in dataclasses.fields(TrainConfig) if f.name not in (*_FIXED, *_GROUPS)]
    known += [f"{g}.{f.name}" for g in _GROUPS for f in dataclasses.fields(getattr(base, g))]
    if name not in known:
        near = [n for n in known if n.rpartition(".")[2] == field] or [*known, "env.OPTION"]
        raise ValueError(f"axis {name!r}: known are {', '.join(near)}")
    return type(getattr(getattr(base, group) if group else base, field))


def grid(axes: dict[str, list[Any]]) -> list[Setting]:
    """All combinations, the last axis fastest.

    Args:
        axes: name to values.
    """
    return [dict(zip(axes, values)) for values in itertools.product(*axes.values())]


def apply(base: TrainConfig, setting: Setting) -> TrainConfig:
    """The configuration of a setting.

    Args:
        base: what the setting leaves as it is.
        setting: axis to value.

    Raises ValueError where its values are not allowed.
    """
    config = base
    for name, value in setting.items():
        group, _, field = name.rpartition(".")
        if group == "env":
            changes: dict[str, Any] = {"env_options": {**config.env_options, field: value}}
        elif group:
            changes = {group: dataclasses.replace(getattr(config, group), **{field: value})}
        else:
            changes = {name: value}
        config = dataclasses.replace(config, **changes)
    validate(config)
    return config


def problems(
    base: TrainConfig, settings: Sequence[Setting], suites: Sequence[str] = ()
) -> list[Problem]:
    """`apply` for all, resolved.

    Args:
        base: configuration.
        settings: to compare.
        suites: of unseen scenes, which every world must have.

    Raises ValueError on one that cannot run, or an unknown suite.
    """
    found = [resolve(apply(base, s)) for s in settings]
    for problem in found:
        known = problem.world.suites
        for suite in suites:
            if suite not in known:
                raise ValueError(f"suites = {suite!r}: known are {', '.join(known)}")
    return found


def programs(problems: Sequence[Problem]) -> list[list[int]]:
    """Which settings share a compiled program: their indices, in order.

    Args:
        problems: of the settings.
    """
    keys: list[Any] = []
    found: list[list[int]] = []
    for n, problem in enumerate(problems):
        key = program_key(problem)
        if key not in keys:
            keys.append(key)
            found.append([])
        found[keys.index(key)].append(n)
    return found


def run(
    base: TrainConfig,
    settings: Sequence[Setting],
    suites: Sequence[str] = (),
    num_scenes: int = 2000,
    say: Callable[[str], None] = lambda line: None,
    progress: Callable[[Run], Any] = lambda run: contextlib.nullcontext(lambda newest: None),
) -> Table:
    """Learn every setting with all of base's seeds, and judge the controllers on unseen scenes.

    Args:
        base: configuration, and the seeds.
        settings: to compare.
        suites: of unseen scenes to judge on.
        num_scenes: of each.
        say: is told what happens, in lines.
        progress: of a `Run`, a context manager that gives a function to call with each new
            `runner.Progress`.

    Raises ValueError (one line) before anything is computed.
    """
    found = problems(base, settings, suites)
    groups = programs(found)
    say(
        f"{len(settings)} settings x {base.seeds} seeds in {len(groups)} compiled "
        f"program{'s' if len(groups) > 1 else ''}" + _split(settings, groups)
    )
    shape = (len(settings), base.seeds)
    table = Table(
        list(settings),
        np.zeros(shape),
        np.zeros(shape),
        {suite: np.zeros(shape) for suite in suites},
        [np.zeros(0)] * len(settings),
    )
    for number, group in enumerate(groups):
        word = ", ".join(f"{k} {v}" for k, v in _common(settings, group).items())
        say(f"program {number + 1} of {len(groups)}{word and ': '}{word}: compiling ...")
        _run_group(found, group, table, num_scenes, say, progress)
    return table


def _common(settings: Sequence[Setting], group: list[int]) -> Setting:
    """What the settings of a program share, and not all settings do."""
    names = settings[0]
    return {
        name: settings[group[0]][name]
        for name in names
        if len({s[name] for s in settings}) > 1 and len({settings[n][name] for n in group}) == 1
    }


def _split(settings: Sequence[Setting], groups: list[list[int]]) -> str:
    """Why it takes several programs."""
    names = [n for n in settings[0] if all(n in _common(settings, g) for g in groups)]
    return f": one is compiled for each {' x '.join(names)}" if len(groups) > 1 and names else ""


def _run_group(
    problems: Sequence[Problem],
    group: list[int],
    table: Table,
    num_scenes: int,
    say: Callable[[str], None],
    progress: Callable[[Run], Any],
) -> None:
    problem = problems[group[0]]
    first = problem.config
    # Populations are held for all rows of a batch; the rest of a program's memory is a few rows'.
    genome = problem.layout.num_genes * first.ga.num_bits
    row_bytes = 2 * (first.ga.population + first.generations) * genome
    size = max(1, min(len(group), _BATCH_BYTES // (row_bytes * first.seeds)))
    if size < len(group):
        say(f"{-(-len(group) // size)} batches of {size} settings, to bound memory")
    learner: Run | None = None
    for start in range(0, len(group), size):
        batch = group[start : start + size]
        # One shape for all batches: the last is filled up, and the surplus dropped.
        variants = [problems[n].config for n in (batch + batch[-1:] * size)[:size]]
        if learner is None:
            learner = Run(problem, variants)
            learner.compile()
            memory.announce(learner.memory_bytes, say)
        else:
            learner.restart(variants)
        with progress(learner) as show:
            while not learner.done:
                show(learner.advance())
        result, mean = learner.conclude(), learner.history().mean[:, -1]
        theta = result.theta.reshape(size, first.seeds, -1)
        judged = {
            suite: _success(learner, variants, theta, suite, num_scenes) for suite in table.success
        }
        for k, n in enumerate(batch):
            table.best[n] = result.fitness.reshape(size, -1)[k]
            table.mean[n] = mean.reshape(size, -1)[k]
            table.theta[n] = theta[k]
            for suite, share in judged.items():
                table.success[suite][n] = share[k]


@partial(jax.jit, static_argnames=("layout", "output", "mesh"))
def _judge(scenes, rows, *, layout, output, mesh):
    """Share of successes of each row (theta, env).  Suites of equal shape share a compilation."""

    def one(some, t, e):
        outcome = rollout_pairs(layout, t[None], some, e, output=output)
        return jnp.mean(fitness.success(outcome).success[0])

    return over_seeds(one, mesh)(scenes, rows)


def _success(
    learner: Run, variants: Sequence[TrainConfig], theta: np.ndarray, suite: str, num_scenes: int
) -> np.ndarray:
    """Share of successes [setting, seed], in the world that `fntg evaluate` uses: that of the
    controller's limits and control step, and no other option."""
    config, problem, rows = learner.config, learner.problem, learner.rows
    scenes = held_out_scenes(problem.world, suite, num_scenes)
    worlds = [_plain_world(problem.variant(v)) for v in variants]
    env = jax.tree.map(lambda *x: np.repeat(np.stack(x), config.seeds, axis=0), *worlds)
    share = _judge(
        rows.share(scenes),
        rows.place((theta.reshape(-1, theta.shape[-1]), env)),
        layout=problem.layout,
        output=config.output,
        mesh=rows.mesh,
    )
    return rows.gather(share).reshape(len(variants), config.seeds)


def _plain_world(problem: Problem) -> Any:
    env = problem.env
    limits = {k: float(v) for k, v in env.limits._asdict().items()}
    return jax.tree.map(np.asarray, problem.world.make(dt=float(env.dt), **limits))
