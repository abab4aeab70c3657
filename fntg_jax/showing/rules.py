"""The rule base in plain words: what every rule commands and how often it fires."""

import json
import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Limits, World
from fntg_jax.controller import layout, network
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.labels import Label, describe_labels
from fntg_jax.files import csv_table
from fntg_jax.learning.rollout import trajectory
from fntg_jax.running.evaluation import environment_for, held_out_scenes

DEAD = 0.05  # a rule that never has more than this share of the firing
DOMINANT = 0.25  # a rule that has more than this share of the firing on average


class Rule(NamedTuple):
    """A rule: name (the paper's indices, "1121"), its labels, what it alone would command before
    clipping (m/s, rad/s), and over the control steps of a suite its mean share of the firing, the
    share of steps at which it is the strongest, and its peak."""

    name: str
    labels: tuple[Label, ...]
    v: float
    omega: float
    mean: float = math.nan
    strongest: float = math.nan
    peak: float = math.nan

    @property
    def flag(self) -> str:
        return "dead" if self.peak < DEAD else "dominant" if self.mean > DOMINANT else ""


class RuleBase(NamedTuple):
    """All labels by family and all rules, with the suite they were watched on."""

    labels: dict[str, tuple[Label, ...]]
    notes: list[str]
    rules: list[Rule]
    suite: str
    num_scenes: int
    limits: Limits


def rule_strengths(controller: Controller, observation: Any) -> jax.Array:
    """Share of every rule in the firing.

    Args:
        controller: whose rules.
        observation: d_B, d_O (m), theta_B, theta_O (rad), leaves [...].

    Returns:
        [..., rules], from 0 to 1, in the order of `layout.rules`.
    """
    params = layout.Params(*(jnp.asarray(x, jnp.float32) for x in controller.params))
    return _strengths(params, observation, tuple(_rules(controller)))


def _strengths(params, observation, indices):
    shape = jnp.shape(observation[0])
    flat = jax.tree.map(lambda x: jnp.ravel(jnp.asarray(x)), observation)
    mu = jax.vmap(partial(network.firing_strengths, params))(flat)
    # A rule without an obstacle's side has all three of them.
    columns = [jnp.sum(mu[(slice(None), *r)].reshape(len(mu), -1), axis=1) for r in indices]
    return jnp.stack(columns, axis=-1).reshape(*shape, -1)


@partial(jax.jit, static_argnames=("output", "indices"))
def _watch(params, scenes, env, output, indices):
    """Mean share, share of steps as the strongest, and peak of every rule."""
    seen = jax.vmap(lambda s: trajectory(params, s, env, output).observation)(scenes)
    # The last state is never acted on.
    mu = _strengths(params, jax.tree.map(lambda x: x[:, :-1], seen), indices)
    mu = mu.reshape(-1, len(indices))
    strongest = jax.nn.one_hot(jnp.argmax(mu, axis=1), len(indices))
    return jnp.mean(mu, axis=0), jnp.mean(strongest, axis=0), jnp.max(mu, axis=0)


def _rules(controller: Controller) -> list[tuple[int, ...]]:
    return layout.rules(controller.layout)


def rule_outputs(controller: Controller) -> np.ndarray:
    """What each rule alone would command before clipping.

    Args:
        controller: whose rules.

    Returns:
        [rules, 2]: m/s and rad/s.
    """
    p = controller.params
    gains = network.output_gains(controller.limits, controller.output)
    rows = [(r if len(r) == 4 else (*r, 0)) for r in _rules(controller)]
    tables = np.array([[p.V[r], p.Omega[r]] for r in rows])
    return (tables + p.bias) * np.asarray(gains, float)


def rules_of(controller: Controller, labels: dict[str, tuple[Label, ...]]) -> list[Rule]:
    """The rules with their labels and commands; their firing is not known yet (NaN).

    Args:
        controller: whose rules.
        labels: of `labels.describe_labels`, by family.
    """
    return [
        Rule(
            "".join(str(n + 1) for n in index),
            tuple(labels[family][n] for family, n in zip("ABCD", index)),
            float(v),
            float(omega),
        )
        for index, (v, omega) in zip(_rules(controller), rule_outputs(controller))
    ]


def rule_base(
    controller: Controller,
    world: World,
    suite: str = "blocked",
    num_scenes: int = 200,
    seed: int = 0,
) -> RuleBase:
    """Labels, commands, and firing over all control steps of a suite's held-out scenes.

    Args:
        controller: whose rules.
        world: `envs.base.World`.
        suite: of scenes.
        num_scenes: how many, from 1.
        seed: of the scenes.

    Raises ValueError on an unknown suite or fewer than one scene.
    """
    scenes = held_out_scenes(world, suite, num_scenes, seed)
    env = environment_for(controller, world)
    params = controller.params32

    watched = _watch(params, scenes, env, controller.output, tuple(_rules(controller)))
    mean, strongest, peak = (np.asarray(x, float) for x in watched)
    labels, notes = describe_labels(controller, world.field)
    plain = rules_of(controller, labels)
    rules = [
        rule._replace(mean=float(m), strongest=float(s), peak=float(p))
        for rule, m, s, p in zip(plain, mean, strongest, peak)
    ]
    return RuleBase(labels, notes, rules, suite, num_scenes, controller.limits)


def sentence(rule: Rule, limits: Limits) -> str:
    """The rule as one English sentence.

    Args:
        rule: with labels and command.
        limits: speeds that a command is clipped to, m/s and rad/s.
    """
    distance, near, direction = (_phrase(label.name) for label in rule.labels[:3])
    side = ""
    if len(rule.labels) == 4:
        name = rule.labels[3].name
        side = f" on the {name.upper()}" if name in ("left", "right") else f" but {name.upper()}"
    v = f"v = {rule.v:.2f} m/s"
    if rule.v <= limits.v_min:
        v = f"stop ({v})" if limits.v_min == 0 else f"slowest ({v})"
    elif rule.v >= limits.v_max:
        v = f"full speed ({v})"
    turn = f"turn {'left' if rule.omega > 0 else 'right'} {abs(rule.omega):.2f} rad/s"
    if abs(rule.omega) < 0.05:
        turn = f"go straight ({rule.omega:.2f} rad/s)"
    where = f"the ball is {distance} and {direction} and the obstacle is {near}{side}"
    return f"IF {where} THEN {v}, {turn}"


def _phrase(name: str) -> str:
    return f"at {name.upper()}" if name.startswith("any") else name.upper()


def as_text(base: RuleBase) -> str:
    """For a terminal: labels, notes, and one sentence a rule with its share of the firing.

    Args:
        base: of `rule_base`.
    """
    out = ["labels, and where each has over half of its family's weight on the field:"]
    for labels in base.labels.values():
        out += [f"  {x.symbol}  {x.name:18s} {x.where}" for x in labels]
    out += [f"note: {note}" for note in base.notes]
    out += [
        "",
        f"share of the firing over {base.num_scenes} scenes of suite {base.suite}; {LEGEND}",
    ]
    out += [
        f"{100 * r.mean:5.1f} %  {r.flag:9s} {r.name:5s} {sentence(r, base.limits)}"
        for r in base.rules
    ]
    return "\n".join([*out, "", clipping(base)]) + "\n"


def as_markdown(base: RuleBase) -> str:
    """Two tables.

    Args:
        base: of `rule_base`.
    """
    out = ["| label | means | where |", "|---|---|---|"]
    out += [f"| {x.symbol} | {x.name} | {x.where} |" for f in base.labels.values() for x in f]
    out += ["", *(f"Note: {note}.\n" for note in base.notes)]
    out += ["| rule | in words | firing | strongest | |", "|---|---|---:|---:|---|"]
    out += [
        f"| {r.name} | {sentence(r, base.limits)} | {100 * r.mean:.1f} % | "
        f"{100 * r.strongest:.1f} % | {r.flag} |"
        for r in base.rules
    ]
    out += [
        "",
        f"Firing: mean share over {base.num_scenes} scenes of suite {base.suite}; strongest:",
    ]
    out += [f"share of steps at which the rule is the strongest; {LEGEND}. {clipping(base)}"]
    return "\n".join(out) + "\n"


def as_json(base: RuleBase) -> str:
    """The same as an object; shares in [0, 1], speeds in m/s and rad/s.

    Args:
        base: of `rule_base`.
    """
    document = {
        "suite": base.suite,
        "scenes": base.num_scenes,
        "labels": {f: [x._asdict() for x in labels] for f, labels in base.labels.items()},
        "notes": base.notes,
        "rules": [
            {
                **r._asdict(),
                "labels": [x.symbol for x in r.labels],
                "flag": r.flag,
                "text": sentence(r, base.limits),
            }
            for r in base.rules
        ],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def as_csv(base: RuleBase) -> str:
    """One line a rule; shares in [0, 1].

    Args:
        base: of `rule_base`.
    """
    names = ("ball_distance", "obstacle_distance", "ball_direction", "obstacle_side")
    rows: list[Any] = []
    for r in base.rules:
        labels = [x.name for x in r.labels] + [""] * (4 - len(r.labels))
        numbers = (f"{x:.6g}" for x in (r.v, r.omega, r.mean, r.strongest, r.peak))
        rows.append([r.name, *labels, *numbers, r.flag])
    header = ("rule", *names, "v_m_s", "omega_rad_s", "mean", "strongest", "peak", "flag")
    return csv_table(header, rows).decode()


FORMATS = {"text": as_text, "md": as_markdown, "json": as_json, "csv": as_csv}
LEGEND = f"dead: never over {100 * DEAD:.0f} %, dominant: over {100 * DOMINANT:.0f} % on average"


def clipping(base: RuleBase) -> str:
    """How the rules' values become a command, in words.

    Args:
        base: of `rule_base`.
    """
    limits = base.limits
    return (
        "A command is the firing-weighted average of these values (biases included), then clipped "
        f"to v in [{limits.v_min:g}, {limits.v_max:g}] m/s and omega within "
        f"{limits.omega_max:g} rad/s."
    )
