"""A team's planner in plain words: its rules, and how often each decided in matches."""

import csv
import io
import json
from typing import Any, NamedTuple

import jax
import numpy as np

from fntg_jax.learning import play
from fntg_jax.robot.genes import GENES, Genes
from fntg_jax.running import matches

STEPS = 1200  # of a match that is watched: two minutes


class TeamRules(NamedTuple):
    """team: its name; against: the other team; matches: how many were watched, for two minutes
    each; roles, rules: words; counts: control steps [roles, rules]; source: name or file."""

    team: str
    against: str
    matches: int
    roles: tuple[str, ...]
    rules: tuple[str, ...]
    counts: np.ndarray
    source: str = ""

    @property
    def shares(self) -> np.ndarray:
        """Of each role's steps, [roles, rules]; 0 for a role that nobody had."""
        return self.counts / np.maximum(self.counts.sum(1, keepdims=True), 1)


def watch(name: str, against: str, num: int, seed: int) -> TeamRules:
    """The rules of a team (a name or a file) in `num` matches.  Raises ValueError in one line,
    also for a team that has none."""
    if not 1 <= num <= 10_000:
        raise ValueError(f"scenes = {num}: allowed are 1 to 10000 matches")
    match = matches.get_match("soccer", minutes=STEPS / 600)
    home, away = (matches.get_team(n, match, k) for k, n in enumerate((name, against)))
    if not home.words.rules or home.believe is None:
        raise ValueError(f"team = {name!r}: it names no rules")
    seeds = matches.match_seeds(num, seed)
    count = jax.jit(lambda s: play.applied(match, home, away, s, STEPS))
    return TeamRules(
        home.name,
        away.name,
        num,
        home.words.roles,
        home.words.rules,
        np.asarray(count(seeds)),
        name,
    )


def as_text(found: TeamRules) -> str:
    """The rules in order, with a column for each role."""
    lines = [
        f"Rules of {found.team}, from above: the first that holds decides.  Share of each role's "
        f"time,",
        f"in {found.matches} matches of two minutes against {found.against}.",
        "",
        "  ".join(f"{role:>10s}" for role in found.roles),
    ]
    for n, rule in enumerate(found.rules):
        cells = "  ".join(f"{100 * share:8.1f} %" for share in found.shares[:, n])
        lines.append(f"{cells}  {n + 1:2d}. {rule}")
    return "\n".join(lines) + "\n"


def as_markdown(found: TeamRules) -> str:
    out = [
        "| | rule | " + " | ".join(found.roles) + " |",
        "|---:|---|" + "---:|" * len(found.roles),
    ]
    for n, rule in enumerate(found.rules):
        cells = " | ".join(f"{100 * share:.1f} %" for share in found.shares[:, n])
        out.append(f"| {n + 1} | {rule} | {cells} |")
    return "\n".join(out) + "\n"


def as_json(found: TeamRules) -> str:
    rules: list[dict[str, Any]] = [
        {"rule": n + 1, "text": rule, "shares": dict(zip(found.roles, found.shares[:, n].tolist()))}
        for n, rule in enumerate(found.rules)
    ]
    document = {
        "team": found.team,
        "against": found.against,
        "matches": found.matches,
        "steps": dict(zip(found.roles, found.counts.sum(1).tolist())),
        "rules": rules,
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def as_csv(found: TeamRules) -> str:
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["rule", "text", *found.roles])
    for n, rule in enumerate(found.rules):
        rows.writerow([n + 1, rule, *(f"{share:.6g}" for share in found.shares[:, n])])
    return out.getvalue()


FORMATS = {"text": as_text, "md": as_markdown, "json": as_json, "csv": as_csv}


def beside(found: TeamRules, other: TeamRules) -> str:
    """What differs between two teams of the same planner: genes with the share of their range by
    which they moved, most first; then how often each rule decided, over all roles.  Raises
    ValueError where a team has no such genes."""
    match = matches.get_match("soccer", minutes=STEPS / 600)
    both = []
    for name in (found.source, other.source):
        genes = getattr(matches.get_team(name, match, 0).team, "genes", None)
        if not isinstance(genes, Genes):
            raise ValueError(f"team = {name!r}: it has no genes of the planner")
        both.append(genes)
    names = other.team[:18], found.team[:18]
    lines = [f"{'gene':18s}{names[0]:>20s}{names[1]:>20s}{'moved':>8s}"]
    rows = []
    for gene, new, old in zip(GENES, *both):
        moved = (float(new) - float(old)) / (gene.high - gene.low)
        rows.append((-abs(moved), moved, gene, float(old), float(new)))
    for _, moved, gene, old, new in sorted(rows, key=lambda row: row[0]):
        cells = "".join(f"{value:14.3g} {gene.unit:5s}" for value in (old, new))
        lines.append(f"{gene.name:18s}{cells}{100 * moved:+6.0f} %  {gene.meaning}")
    lines += ["", f"share of all time{names[0]:>21s}{names[1]:>20s}   rule of {found.team}"]
    shares = [rules.counts.sum(0) / max(rules.counts.sum(), 1) for rules in (other, found)]
    for n, rule in enumerate(found.rules):
        cells = "".join(f"{100 * share[n]:18.1f} %" for share in shares)
        lines.append(f"{'':18s}{cells}  {n + 1:2d}. {rule}")
    return "\n".join(lines) + "\n"
