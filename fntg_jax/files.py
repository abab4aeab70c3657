"""Files that are either the old or the new version, never half of one, and JSON that is safe
inside other languages."""

import contextlib
import csv
import errno
import io
import json
import os
import stat
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any


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


def read_text(path: str | Path, what: str) -> str:
    """The text of a small file of ours.

    what: "parameter file", "team file": what a larger file is not.  Raises ValueError in one line
    when it cannot be read, is over 1 MB (a real one has about 10 kB) or is not UTF-8.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ValueError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    if len(data) > _MAX_BYTES:
        raise ValueError(f"{path}: over {_MAX_BYTES} bytes, not a {what}")
    try:
        return data.decode()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not UTF-8 text") from None


_MAX_BYTES = 1_000_000
