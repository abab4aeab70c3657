"""What the scripts share: a folder for results, and one line where something is off."""

import contextlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from fntg_jax.commands.cli import read_options, refuse
from fntg_jax.files import csv_table, write_atomically


def options(cls: type, about: str | None, program: str, argv: list[str] | None = None) -> Any:
    """The options of a script: one line and status 2 where they are wrong."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        return read_options(cls, argv, program, {"description": about})
    except ValueError as error:
        refuse(str(error))


@contextlib.contextmanager
def folder(out: Path) -> Iterator[None]:
    """Make the folder; a ValueError or an unwritable folder ends the script with one line and
    status 2, and leaves no new empty folder behind."""
    new = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        yield
    except ValueError as error:
        if new:
            with contextlib.suppress(OSError):  # what is not empty stays
                out.rmdir()
        refuse(str(error))
    except OSError as error:
        refuse(f"out = {out}: {error.strerror or error}")


def write_csv(path: Path, header: Iterable[Any], rows: Iterable[Iterable[Any]]) -> None:
    """The numbers of a figure or table, whole or not at all."""
    write_atomically(path, csv_table(header, rows))


def check_least(options: Any, **least: int) -> None:
    """Raises ValueError (option, value, what is allowed) where one is below its least value."""
    for name, allowed in least.items():
        if (value := getattr(options, name)) < allowed:
            raise ValueError(f"{name} = {value}: allowed are numbers from {allowed}")


def check_files(options: Any, *names: str) -> None:
    """Raises ValueError (option, value, what is allowed) where one is no place for a file."""
    for name in names:
        path = getattr(options, name)
        if path is not None and (path.is_dir() or not path.parent.is_dir()):
            raise ValueError(f"{name} = {path}: allowed is a file in a folder that exists")


@contextlib.contextmanager
def lines() -> Iterator[None]:
    """A ValueError ends the script with one line and status 2."""
    try:
        yield
    except ValueError as error:
        refuse(str(error))
