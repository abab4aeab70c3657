"""Colour tables from labelled pictures.

    python -m experiments.calibrate_colors nao --photos FOLDER --pictures black1-2.jpg black1-5.jpg
    python -m experiments.calibrate_colors ers210

`nao`: FOLDER has labels.csv (one row a landmark, pixel boxes of its two bands) and the pictures.
Every band's colours are taken relative to the white of the pole below it, so that sun, shade and
the camera's white balance cancel; what is left is a direction (hue) and a length (saturation) in
the plane of log colour differences, each class a Gaussian in hue and a threshold in saturation.

`ers210`: pictures of `envs.soccer.image` under light of 0.5 to 1.5, with blur and noise, every
pixel labelled with its paint; a cell's class is the commonest of its pixels, its confidence that
class's share of them.

Prints the classes' numbers and writes a table of `fntg_jax.robot.colours`.
"""

import csv
import dataclasses
import io
import math
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from PIL import Image

from envs.soccer import image
from experiments import script, vision
from fntg_jax.files import write_atomically
from fntg_jax.robot import colours, poles
from fntg_jax.running import xla

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
    """nao: real photographs; ers210: the simulated camera's."""
    photos: Path = Path("photos")
    """folder with labels.csv and the pictures."""
    pictures: tuple[str, ...] = ("black1-2.jpg", "black1-5.jpg")
    """the pictures to learn from."""
    frames: int = 640
    """pictures to render (ers210)."""
    seed: int = 0
    """of their scenes (ers210)."""
    out: Path | None = None
    """the table; default: where the shipped one is."""


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
        logs = poles.log_colours(np.asarray(Image.open(folder / row["image"]).convert("RGB")))
        x0, y0, x1, y1 = (int(row[f"lower_{k}"]) for k in ("x0", "y0", "x1", "y1"))
        height = y1 - y0
        white = logs[y1 + height // 4 : y1 + height, x0 + 1 : x1 - 1].mean((0, 1))
        for band in ("lower", "upper"):
            x0, y0, x1, y1 = (int(row[f"{band}_{k}"]) for k in ("x0", "y0", "x1", "y1"))
            pixels = logs[y0 + 1 : y1 - 1, x0 + 1 : x1 - 1].reshape(-1, 3) - white
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


def rendered(frames: int, seed: int) -> np.ndarray:
    """How many pixels of every cell have every class, [cells, classes]."""
    same = {"carpet": "green", "line": "white", "wall": "white", "ball": "orange"}
    names = [same.get(paint, paint) for paint in image.PAINT]
    classes = [colours.CLASSES.index(n) if n in colours.CLASSES else colours.NONE for n in names]

    @jax.jit
    def draw(scene, pose, head, light):
        def one(scene, pose, head, light):
            eye = image.eye(pose, head)
            picture = image.render(scene, eye, light)
            return colours.cell(picture), jnp.asarray(classes)[image.paints(scene, eye)]

        return jax.vmap(one)(scene, pose, head, light)

    rng = np.random.default_rng(seed)
    counts = np.zeros(colours.CELLS**3 * len(colours.CLASSES), np.int64)
    for _ in range(-(-frames // vision.BATCH)):
        scene, pose, head = vision.scenes(rng, vision.BATCH)
        some = lambda low, high: jnp.asarray(rng.uniform(low, high, vision.BATCH))  # noqa: E731
        light = image.Light(
            light=some(0.5, 1.5),
            shading=jnp.ones(vision.BATCH),
            shadows=some(0.0, 0.5),
            balance=jnp.asarray(rng.uniform(0.95, 1.05, (vision.BATCH, 3))),
            blur=some(0.0, 0.2),
            noise=some(0.0, 8.0),
            seed=jnp.asarray(rng.integers(1 << 30, size=vision.BATCH)),
        )
        cells, labels = draw(scene, *(jax.tree.map(jnp.float32, (pose, head))), light)
        index = np.asarray(cells).ravel() * len(colours.CLASSES) + np.asarray(labels).ravel()
        counts += np.bincount(index, minlength=len(counts))
    return counts.reshape(-1, len(colours.CLASSES))


def counted_table(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Label and confidence of every cell; rare colours ask their neighbours."""
    cube = counts.reshape((colours.CELLS,) * 3 + (-1,)).astype(float)
    for axis in range(3):
        padded = np.pad(cube, [(1, 1) if a == axis else (0, 0) for a in range(4)])
        n = colours.CELLS
        cube = cube + 0.05 * (padded.take(range(n), axis) + padded.take(range(2, n + 2), axis))
    cube = cube.reshape(len(counts), -1)
    total = cube.sum(1)
    label = np.where(total > 1, cube.argmax(1), colours.NONE).astype(np.uint8)
    return label, np.round(255 * cube.max(1) / np.maximum(total, 1)).astype(np.uint8)


def photographed(options: Options) -> tuple[np.ndarray, np.ndarray]:
    bands = band_colours(options.photos, options.pictures)
    missing = {"pink", "yellow", "skyblue"} - bands.keys()
    if missing:
        raise ValueError(f"pictures = {options.pictures}: none of them shows {missing}")
    model = hue_model(bands)
    for name, (mean, spread) in model.items():
        pixels = sum(len(s) for s in bands.get(name, []))
        print(f"{name:8s} hue {mean:7.1f} +- {spread:4.1f} degrees, {pixels} pixels")
    return hue_table(model)


def main() -> None:
    options = script.options(Options, __doc__, "experiments/calibrate_colors.py")
    xla.configure()
    out = options.out or Path(f"fntg_jax/robot/data/colours_{options.kind}.npz")
    with script.folder(out.parent):
        if options.kind == "nao":
            label, confidence = photographed(options)
        elif options.kind == "ers210":
            script.check_least(options, frames=1)
            counts = rendered(options.frames, options.seed)
            label, confidence = counted_table(counts)
            for n, name in enumerate(colours.CLASSES):
                right = counts[label == n, n].sum() / max(counts[:, n].sum(), 1)
                print(
                    f"{name:8s} {counts[:, n].sum():10d} pixels, {right:.4f} of them so classified"
                )
        else:
            raise ValueError(f"kind = {options.kind!r}: allowed are nao, ers210")
        file = io.BytesIO()
        np.savez_compressed(file, label=label, confidence=confidence)
        write_atomically(out, file.getvalue())


if __name__ == "__main__":
    main()
