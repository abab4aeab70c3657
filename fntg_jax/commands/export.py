"""`fntg export`: a controller in another format."""

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import tyro

from fntg_jax.cli import load_controller, parse, say


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """Write a controller in another format."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json or a run folder."""
    out: Annotated[Path, tyro.conf.Positional]
    """file to write; - for stdout."""
    to: Literal["json"] = "json"
    """format."""
    seed: int | None = None
    """of a run folder: this seed's best controller instead of the best of all."""


def main(argv: list[str]) -> None:
    options = parse(ExportOptions, argv, "export")
    from fntg_jax import export
    from fntg_jax.files import write_atomically

    text = _FORMATS[options.to](export)(load_controller(options.controller, options.seed))
    if str(options.out) == "-":
        sys.stdout.write(text)
        return
    try:
        write_atomically(options.out, text.encode())
    except OSError as error:
        raise ValueError(f"out = {options.out}: {error.strerror or error}") from None
    say(f"wrote {options.out}")


_FORMATS: dict[str, Callable] = {"json": lambda export: export.dumps}
