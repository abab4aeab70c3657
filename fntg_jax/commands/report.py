"""`fntg report`: a run as one HTML page."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import parse, say
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class ReportOptions:
    """A completed run as one self-contained HTML page: figures 5 to 8, success on unseen scenes,
    rules, configuration, environment, and the data to download."""

    run: Annotated[Path, tyro.conf.Positional]
    """run folder."""
    out: Path | None = None
    """file to write; default report.html in the run folder."""
    scenes: int = 500
    """scenes a suite for the table of success."""
    suite: str = "blocked"
    """scenes to watch the rules on (200 of them)."""


def main(argv: list[str]) -> None:
    options = parse(ReportOptions, argv, "report")
    xla.configure()
    from fntg_jax.files import check_out, write_atomically
    from fntg_jax.showing import report

    out = options.out or options.run / "report.html"
    if options.out is not None:
        check_out(out)
    data = report.page(options.run, options.scenes, options.suite).encode()
    try:
        write_atomically(out, data)
    except OSError as error:
        raise ValueError(f"out = {out}: {error.strerror or error}") from None
    say(f"{len(data)} bytes")
    print(out)
