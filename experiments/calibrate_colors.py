"""Colour tables from labelled pictures.

    python -m experiments.calibrate_colors nao --photos FOLDER --pictures black1-2.jpg black1-5.jpg

`nao`: FOLDER has labels.csv (one row a landmark, pixel boxes of its two bands) and the pictures.
Every band's colours are taken relative to the white of the pole below it, so that sun, shade and
the camera's white balance cancel; what is left is a direction (hue) and a length (saturation) in
the plane of log colour differences, each class a Gaussian in hue and a threshold in saturation.
Prints the classes' numbers and writes a table of `fntg_jax.robot.colours`.
"""

import csv
import dataclasses
import io
import math
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from PIL import Image

from experiments import script
from fntg_jax.files import write_atomically
from fntg_jax.robot import colours, poles

# Names of the photographs' labels in the words of the league.
_NAMES = {"magenta": "pink", "blue": "skyblue", "yellow": "yellow", "green": "green"}
# No picture shows the green landmarks: half-way between yellow and skyblue (assumed, untested).
_ASSUMED = {"green": (155.0, 22.0)}
# Two pictures are not all light: hues spread by this much in addition (degrees, assumed).
_OTHER_LIGHT = 12.0
_LEAST_SATURATION = 0.25  # weaker colours are white, grey or black (assumed)


@dataclasses.dataclass(frozen=True)
class Options:
    """A colour table from labelled pictures."""

    kind: Annotated[str, tyro.conf.Positional] = "nao"
    """nao: real photographs."""
    photos: Path = Path("photos")
    """folder with labels.csv and the pictures."""
    pictures: tuple[str, ...] = ("black1-2.jpg", "black1-5.jpg")
    """the pictures to learn from."""
    out: Path = Path("fntg_jax/robot/data/colours_nao.npz")
    """the table."""


def hue_saturation(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hue (degrees) and saturation of colours relative to white, [..., 3] > 0."""
    r, g, b = np.moveaxis(np.log(rgb), -1, 0)
    u, v = (r - g) / math.sqrt(2), (r + g - 2 * b) / math.sqrt(6)
    return np.degrees(np.arctan2(v, u)), np.hypot(u, v)


def band_colours(folder: Path, pictures: tuple[str, ...]) -> dict[str, list[np.ndarray]]:
    """Colours of every labelled band relative to the white below, an array [pixels, 3] a band."""
    bands: dict[str, list[np.ndarray]] = {}
    with open(folder / "labels.csv") as file:
        rows = [r for r in csv.DictReader(file) if r["kind"] == "landmark"]
    for row in rows:
        if row["image"] not in pictures:
            continue
        image = poles.log_colours(np.asarray(Image.open(folder / row["image"]).convert("RGB")))
        x0, y0, x1, y1 = (int(row[f"lower_{k}"]) for k in ("x0", "y0", "x1", "y1"))
        height = y1 - y0
        white = image[y1 + height // 4 : y1 + height, x0 + 1 : x1 - 1].mean((0, 1))
        for band in ("lower", "upper"):
            x0, y0, x1, y1 = (int(row[f"{band}_{k}"]) for k in ("x0", "y0", "x1", "y1"))
            pixels = image[y0 + 1 : y1 - 1, x0 + 1 : x1 - 1].reshape(-1, 3) - white
            bands.setdefault(_NAMES[row[band]], []).append(np.exp(pixels))
    return bands


def hue_model(bands: dict[str, list[np.ndarray]]) -> dict[str, tuple[float, float]]:
    """Mean hue and its spread (degrees) of every class."""
    model = dict(_ASSUMED)
    for name, samples in bands.items():
        hue, saturation = hue_saturation(np.concatenate(samples))
        hue = np.radians(hue[saturation > _LEAST_SATURATION])
        mean = math.atan2(np.sin(hue).mean(), np.cos(hue).mean())
        spread = np.degrees(np.std((hue - mean + np.pi) % (2 * np.pi) - np.pi))
        model[name] = (math.degrees(mean), math.hypot(float(spread), _OTHER_LIGHT))
    return model


def hue_table(model: dict[str, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Label and confidence of every cell, for colours relative to a white of `poles.WHITE`."""
    levels = (np.arange(colours.CELLS) + 0.5) * (256 / colours.CELLS)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), -1).reshape(-1, 3)
    hue, saturation = hue_saturation(grid)
    label, best = np.zeros(len(grid), np.uint8), np.zeros(len(grid))
    for name, (mean, spread) in model.items():
        away = (hue - mean + 180) % 360 - 180
        here = np.exp(-0.5 * (away / spread) ** 2)
        here /= 1 + np.exp(-(saturation - _LEAST_SATURATION) / 0.05)
        label = np.where(here > best, colours.CLASSES.index(name), label).astype(np.uint8)
        best = np.maximum(best, here)
    label[best < 0.02] = colours.NONE
    return label, np.where(label == colours.NONE, 0, np.round(255 * best)).astype(np.uint8)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    with script.folder(options.out.parent):
        if options.kind != "nao":
            raise ValueError(f"kind = {options.kind!r}: allowed is nao")
        script.check_files(options, "out")
        bands = band_colours(options.photos, options.pictures)
        missing = {"pink", "yellow", "skyblue"} - bands.keys()
        if missing:
            raise ValueError(f"pictures = {options.pictures}: none of them shows {missing}")
        model = hue_model(bands)
        for name, (mean, spread) in model.items():
            pixels = sum(len(s) for s in bands.get(name, []))
            print(f"{name:8s} hue {mean:7.1f} +- {spread:4.1f} degrees, {pixels} pixels")
        label, confidence = hue_table(model)
        file = io.BytesIO()
        np.savez_compressed(file, label=label, confidence=confidence)
        write_atomically(options.out, file.getvalue())


if __name__ == "__main__":
    main()
