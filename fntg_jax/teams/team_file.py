"""A team in a file: genes of the planner, BIOA's parameters, provenance ("fntg-team", version 1).

Checked as strictly as params.json; floats round-trip exactly.
"""

import json
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from fntg_jax.controller.controller import Controller
from fntg_jax.export import json_format
from fntg_jax.files import read_text, write_atomically
from fntg_jax.robot.genes import GENES, Genes, check

FORMAT, VERSION = "fntg-team", 1


class TeamFile(NamedTuple):
    """name: of the team; genes: of the planner; bioa: behaviour 7; goalkeeper: whether shirt 0 is
    one (else all play, as the paper allows); provenance: flat, JSON values."""

    name: str
    genes: Genes
    bioa: Controller
    goalkeeper: bool
    provenance: dict[str, Any]


def schema() -> dict[str, Any]:
    """The published JSON Schema of the format; BIOA's is that of params.json."""
    text = resources.files("fntg_jax.teams").joinpath("team.schema.json").read_text("utf-8")
    return json.loads(text)


def dumps(team: TeamFile) -> str:
    """The document as text."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "name": team.name,
        "goalkeeper": bool(team.goalkeeper),
        "genes": {name: float(value) for name, value in team.genes._asdict().items()},
        "units": {gene.name: gene.unit for gene in GENES},
        "bioa": json_format.to_dict(team.bioa),
        "provenance": team.provenance,
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def save(team: TeamFile, path: str | Path) -> None:
    """Write atomically.  Raises OSError when the path cannot be written."""
    write_atomically(path, dumps(team).encode())


def load(path: str | Path) -> TeamFile:
    """Read a team.  Raises ValueError (one line): file, field, value, what is allowed."""
    text = read_text(path, "team file")
    return from_dict(json_format.parse_json(text, str(path)), str(path))


def from_dict(document: Any, source: str) -> TeamFile:
    """The team of a parsed document.  Raises ValueError as `load`."""
    import jsonschema  # here: it costs start-up time that only loading needs

    validator = jsonschema.Draft202012Validator(schema())
    wrong = jsonschema.exceptions.best_match(validator.iter_errors(document))
    if wrong is not None:
        message = " ".join(wrong.message.split())
        raise ValueError(f"{source}: {wrong.json_path.removeprefix('$.')}: {message[:200]}")
    values, names = document["genes"], [gene.name for gene in GENES]
    if missing := [name for name in names if name not in values]:
        raise ValueError(f"{source}: genes: {missing[0]} is missing")
    if unknown := [name for name in values if name not in names]:
        raise ValueError(f"{source}: genes: {unknown[0]} is unknown; known are {', '.join(names)}")
    genes = Genes(**{name: float(values[name]) for name in names})
    try:
        check(genes)
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None
    return TeamFile(
        name=document["name"],
        genes=genes,
        bioa=json_format.from_dict(document["bioa"], f"{source}: bioa"),
        goalkeeper=document["goalkeeper"],
        provenance=document.get("provenance", {}),
    )
