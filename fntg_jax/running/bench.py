"""The bench: frozen scenes, matches and opponents, and one score card that others can cite.

Version 1 is: for a controller 2000 held-out scenes of each suite of the kinematic world; for a team
400 matches of two one-minute halves, three a side on dogs, against each of `OPPONENTS`, seed 2001.
What the numbers rest on, tables and opponents, is named by a fingerprint; a card of another
fingerprint is not comparable and says so.
"""

import hashlib
import json
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from fntg_jax.controller.controller import Controller
from fntg_jax.running import evaluation, matches, registry, statistics
from fntg_jax.running.provenance import version
from fntg_jax.running.statistics import wilson

VERSION = 1
OPPONENTS = ("still", "random", "chaser", "cerberus")
SUITES = ("open", "blocked", "moving-ball")
SCENES, MATCHES, MINUTES, SEED = 2000, 400, 1.0, 2001
FROZEN = "bench.json"  # fingerprints of the versions, beside the shipped teams


def fingerprint(match: Any) -> dict[str, str]:
    """What a team's numbers rest on, by name: short hashes of the match's tables and of the
    opponents."""
    parts = {
        name: repr(getattr(match, name))
        for name in ("bodies", "field", "rules", "rolling", "feelings", "sights", "air")
    }
    data = resources.files("fntg_jax").joinpath("data")
    parts |= {
        name: data.joinpath(name).read_text("utf-8") for name in ("cerberus.json", "bioa.json")
    }
    return {name: hashlib.sha256(text.encode()).hexdigest()[:12] for name, text in parts.items()}


def differences(found: dict[str, str]) -> list[str]:
    """Names of what is not as when the version was frozen."""
    text = resources.files("fntg_jax").joinpath("data", FROZEN).read_text("utf-8")
    frozen = json.loads(text)[str(VERSION)]
    return sorted(n for n in {*found, *frozen} if found.get(n) != frozen.get(n))


def of_team(name: str, share: float = 1.0) -> dict[str, Any]:
    """The card of a team.  share: of the matches; what is not all of them is no score card."""
    match = matches.get_match("soccer", minutes=MINUTES)
    num = max(round(share * MATCHES), 2)
    side, against = matches.get_team(name, match, 0), {}
    for opponent in OPPONENTS:
        results = matches.play_matches(match, side, matches.get_team(opponent, match, 1), num, SEED)
        goals = results.statistics["goals"].astype(int)
        won, drawn = (int((np.sign(goals[:, 0] - goals[:, 1]) == k).sum()) for k in (1, 0))
        low, high = statistics.bootstrap_mean_of_counts(goals[:, 0] - goals[:, 1])
        points = 0.5 + 0.5 * np.sign(goals[:, 0] - goals[:, 1])
        p_low, p_high = statistics.bootstrap_mean_of_counts(points)
        against[opponent] = {
            "matches": num,
            "points": float(points.mean()),
            "points_interval": [p_low, p_high],
            "wins": won / num,
            "wins_interval": list(wilson(won, num)[1:]),
            "draws": drawn / num,
            "goals": float(goals[:, 0].mean()),
            "goals_against": float(goals[:, 1].mean()),
            "difference": float((goals[:, 0] - goals[:, 1]).mean()),
            "difference_interval": [low, high],
        }
    found = fingerprint(match)
    return {
        **_head("team", name, share),
        "score": float(np.mean([row["points"] for row in against.values()])),
        "against": against,
        "fingerprint": found,
        "differs_in": differences(found),
    }


def of_controller(controller: Controller, name: str, share: float = 1.0) -> dict[str, Any]:
    """The card of a controller.  share: as of `of_team`."""
    world, num, suites = registry.get_world("kinematic"), max(round(share * SCENES), 1), {}
    for suite in SUITES:
        rates = evaluation.evaluate(controller, world, suite, num, SEED).rates
        suites[suite] = {
            part: {"share": rate.share, "interval": [rate.low, rate.high]}
            for part, rate in rates.items()
        }
    score = float(np.mean([rows["success"]["share"] for rows in suites.values()]))
    return {
        **_head("controller", name, share),
        "scenes": num,
        "score": score,
        "suites": suites,
    }


def _head(kind: str, name: str, share: float) -> dict[str, Any]:
    return {
        "format": "fntg-bench",
        "version": VERSION,
        "kind": kind,
        "name": name,
        "complete": share == 1,
        "fntg_jax": version(),
    }


def is_team(name: str) -> bool:
    """Whether this names a team and not a controller.  Raises ValueError for an unreadable file."""
    path = Path(name)
    if name in matches.team_names() or path.suffix == ".py":
        return True
    if path.suffix != ".json" or not path.is_file():
        return False
    try:
        document = json.loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: not a readable JSON file ({error})") from None
    return isinstance(document, dict) and document.get("format") == "fntg-team"
