"""Files that are either the old or the new version, never half of one, and JSON that is safe
inside other languages."""

import contextlib
import csv
import errno
import io
import json
import math
import os
import re
import stat
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write a temporary file beside `path`, then rename.  A link stays one: the file that it
    points at is replaced.  Raises OSError, also for what is no regular file."""
    path = _target(path)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name[:40]}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        # mkstemp makes private files; these are results, with the user's usual permissions.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def writing(path: str | Path, option: str = "") -> Iterator[None]:
    """Raises ValueError in one line, which names the option, from an OSError inside."""
    try:
        yield
    except OSError as error:
        where = f"{option} = {path}" if option else str(path)
        raise ValueError(f"{where}: {error.strerror or error}") from error


def number_of(where: str, name: str, cell: str) -> float:
    """A cell of a CSV file as a number below 1e9.

    Args:
        where: "FILE row N", for the error.
        name: of the column.
        cell: its text.

    Raises ValueError naming all three.
    """
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e9:
        raise ValueError(f"{where}: {name} = {cell!r}: must be a number")
    return value


def csv_table(header: Iterable[Any], rows: Iterable[Iterable[Any]]) -> bytes:
    """A table as CSV, UTF-8: a header, then the rows; quoted where it must be."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()


def check_out(path: str | Path) -> None:
    """Before work begins: raises ValueError where `write_atomically` could not write."""
    try:
        target = _target(path)
    except OSError as error:
        raise ValueError(f"out = {path}: {error.strerror}") from error
    if not target.parent.is_dir():
        raise ValueError(f"out = {path}: {target.parent} is not a folder")


def _target(path: str | Path) -> Path:
    """The regular file, present or to be, that the path leads to."""
    target = Path(os.path.realpath(path))
    try:
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        return target
    if not stat.S_ISREG(mode):
        kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket"}
        kind = kinds.get(stat.S_IFMT(mode), "a device")
        raise OSError(errno.EEXIST, f"{kind}, which is not replaced by a file")
    return target


def inert_json(value: Any) -> str:
    """One line of ASCII JSON that stays data inside HTML, and inside comments of C, Python and
    FLL: the characters that could end a script block or a comment are escaped."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    # Outside strings JSON has none of these, so escaping them everywhere keeps it JSON.
    for character in "<>&/*#?":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def read_bytes(path: str | Path, what: str, most: int = 1_000_000) -> bytes:
    """What is in a regular file.

    what: "parameter file", "team file": what a larger file is not.  Raises ValueError in one line
    when it cannot be read, is over `most` bytes, or is a FIFO or device, which might have no end.
    """
    try:
        # Not waiting for the writer of a FIFO.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ValueError("not a regular file")
            data = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: also a NUL in the name
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > most:
        raise ValueError(f"{path}: over {most} bytes, not a {what}")
    return data


def read_text(path: str | Path, what: str, most: int = 1_000_000) -> str:
    """The text of a small file of ours: as `read_bytes`, in UTF-8."""
    try:
        return read_bytes(path, what, most).decode()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not UTF-8 text") from None


def read_arrays(data: bytes, most: int) -> dict[str, np.ndarray]:
    """The arrays of an .npz file.

    most: bytes that they may take unpacked, as the archive itself says and the reader holds it to.
    Raises ValueError in one line when there are more, or the archive is damaged.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > most:
            raise ValueError(f"{size} bytes unpacked: allowed are {most}")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return dict(file)
    except Exception as error:  # a damaged archive raises almost anything
        raise ValueError(str(error) or type(error).__name__) from error


def sweep(folder: Path, names: Iterable[str]) -> None:
    """Remove what a killed process left of `write_atomically` in a folder, for files of these
    names.  Only where nobody else is writing them."""
    ends = "[a-z0-9_]{8}"
    for path in folder.iterdir():
        if any(re.fullmatch(rf"\.{re.escape(name[:40])}\.{ends}", path.name) for name in names):
            path.unlink(missing_ok=True)
