"""Files that are either the old or the new version, never half of one, and JSON that is safe
inside other languages."""

import json
import os
import tempfile
from pathlib import Path
from typing import Any


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write a temporary file beside `path`, then rename.  Raises OSError."""
    path = Path(path)
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


def inert_json(value: Any) -> str:
    """One line of ASCII JSON that stays data inside HTML, and inside comments of C, Python and
    FLL: the characters that could end a script block or a comment are escaped."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    # Outside strings JSON has none of these, so escaping them everywhere keeps it JSON.
    for character in "<>&/*#?":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
