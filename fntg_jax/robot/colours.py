"""Colour classification by a table: a pixel's colour in, a class and its confidence out.

A table has one cell for 8 x 8 x 8 of the 256^3 colours.  `experiments/calibrate_colors.py` makes
tables from labelled pictures; two ship in `fntg_jax/robot/data`: `ers210` (the simulated camera)
and `nao` (real photographs, for colours relative to the pole's own white).
"""

import zipfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

# Index 0 is "nothing of interest".  red and blue are uniforms; green is landmarks and carpet.
CLASSES = ("none", "pink", "yellow", "green", "skyblue", "orange", "red", "blue", "white")
NONE, PINK, YELLOW, GREEN, SKYBLUE, ORANGE, RED, BLUE, WHITE = range(len(CLASSES))

BITS = 5  # of each channel that the table looks at
CELLS = 1 << BITS


class Colours(NamedTuple):
    """A colour table.  label: index into `CLASSES`; confidence: 0 to 255, the share of pictures'
    pixels of this cell that are of this class, as calibration has it; cells in the order
    (red, green, blue) with blue fastest."""

    label: UInt8[Array, " cells"]
    confidence: UInt8[Array, " cells"]


def cell(rgb: UInt8[Array, "... 3"]) -> Int[Array, " ..."]:
    """Index of a colour's cell in a table."""
    parts = (rgb >> (8 - BITS)).astype(jnp.int32)
    return (parts[..., 0] << 2 * BITS) + (parts[..., 1] << BITS) + parts[..., 2]


def classify(
    colours: Colours, rgb: UInt8[Array, "... 3"]
) -> tuple[UInt8[Array, " ..."], Float[Array, " ..."]]:
    """Class and confidence (0 to 1) of every colour."""
    at = cell(rgb)
    return colours.label[at], colours.confidence[at].astype(jnp.float32) / 255


def load(name: str) -> Colours:
    """A table that ships, by its name, or one from a file.

    Raises ValueError where there is none or it is no colour table.
    """
    shipped = Path(__file__).parent / "data"
    known = sorted(path.stem.removeprefix("colours_") for path in shipped.glob("colours_*.npz"))
    path = shipped / f"colours_{name}.npz" if name in known else Path(name)
    if not path.is_file():
        raise ValueError(f"colors {name!r}: allowed are {', '.join(known)} or a table's file")
    return _read(path)


_MOST_BYTES = 10 * CELLS**3  # a table has two for each cell


@cache
def _read(path: Path) -> Colours:
    try:
        with zipfile.ZipFile(path) as archive:
            if (size := sum(member.file_size for member in archive.infolist())) > _MOST_BYTES:
                raise ValueError(f"{size} bytes unpacked")
        with np.load(path) as file:
            label, confidence = file["label"], file["confidence"]
    # An array instead of an archive has no `with`.
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise ValueError(f"colors {path}: no colour table ({error})") from None
    for array in (label, confidence):
        if array.shape != (CELLS**3,) or array.dtype != np.uint8:
            raise ValueError(
                f"colors {path}: {array.dtype}{list(array.shape)}, allowed is uint8[{CELLS**3}]"
            )
    if label.max() >= len(CLASSES):
        raise ValueError(f"colors {path}: class {label.max()}, allowed are 0 to {len(CLASSES) - 1}")
    return Colours(jnp.asarray(label), jnp.asarray(confidence))
