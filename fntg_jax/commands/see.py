"""`fntg see`: landmarks in photographs, with direction, distance and confidence."""

import dataclasses
import io
import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from fntg_jax.commands.cli import parse
from fntg_jax.files import read_bytes, write_atomically
from fntg_jax.running import xla

_SMALLEST_PICTURE, _LARGEST_PICTURE = 100, 4096  # pixels of a side


@dataclasses.dataclass(frozen=True)
class SeeOptions:
    """Two-coloured landmarks in photographs of a robot's camera: name, bearing, distance,
    confidence.  The camera's focal length, height and pitch must be known."""

    pictures: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """files of pictures."""
    focal: float
    """focal length of the camera, pixels."""
    height: float
    """height of the camera above the floor, m."""
    pitch: Annotated[tuple[float, ...], tyro.conf.UseAppendAction] = ()
    """degrees by which the camera looks down; once, or once for each picture."""
    colors: str = "nao"
    """colour table: one that ships, or a file of experiments/calibrate_colors.py."""
    band: float = 0.105
    """height of one of a landmark's two bands, m."""
    thickness: float = 0.10
    """thickness of a landmark's pole, m."""
    foot: float = 0.18
    """height above the floor where the bands begin, m; white below."""
    json: bool = False
    """print JSON."""
    draw: Path | None = None
    """a PNG of the pictures with boxes, names and distances."""


def main(argv: list[str]) -> None:
    options = parse(SeeOptions, argv, "see")
    pitches = _check(options)
    xla.configure()
    from fntg_jax.robot import colours

    table = colours.load(options.colors)
    pictures = [_read(path) for path in options.pictures]
    seen = [_objects(p, pitch, table, options) for p, pitch in zip(pictures, pitches)]
    if options.draw is not None:
        write_atomically(options.draw, _drawn(pictures, seen))
    if options.json:
        rows = [{"image": str(p), "objects": s} for p, s in zip(options.pictures, seen)]
        json.dump(rows, sys.stdout, allow_nan=False)
        print()
        return
    for path, objects in zip(options.pictures, seen):
        print(f"{path}: {len(objects) or 'no'} landmark{'s' * (len(objects) != 1)}")
        for o in objects:
            print(
                f"  {o['name']:14s} {math.degrees(o['bearing']):+6.1f} degrees"
                f" {o['distance']:5.2f} m  confidence {o['confidence']:.2f}"
            )


def _check(options: SeeOptions) -> list[float]:
    """The pitch of every picture, rad.  Raises ValueError: option, value, what is allowed."""
    ranges = {
        "focal": (10.0, 100000.0),
        "height": (0.01, 10.0),
        "band": (0.01, 2.0),
        "thickness": (0.01, 2.0),
        "foot": (0.0, 5.0),
    }
    for name, (low, high) in ranges.items():
        if not low <= getattr(options, name) <= high:
            raise ValueError(f"{name} = {getattr(options, name)}: allowed are {low} to {high}")
    if len(options.pitch) not in {1, len(options.pictures)}:
        raise ValueError(
            f"pitch: given {len(options.pitch)} times, allowed is once or once for each of"
            f" {len(options.pictures)} pictures"
        )
    for pitch in options.pitch:
        if not -60 <= pitch <= 60:
            raise ValueError(f"pitch = {pitch}: allowed are -60 to 60")
    draw = options.draw
    if draw is not None and (draw.suffix != ".png" or not draw.parent.is_dir() or draw.is_dir()):
        raise ValueError(f"draw = {draw}: allowed is a .png file in a folder that exists")
    pitches = options.pitch * (len(options.pictures) if len(options.pitch) == 1 else 1)
    return [math.radians(pitch) for pitch in pitches]


def _read(path: Path) -> Any:
    """A picture, uint8 [height, width, 3].  Raises ValueError: file and reason."""
    import numpy as np
    from PIL import Image

    data = read_bytes(path, "picture", most=100_000_000)
    try:
        with Image.open(io.BytesIO(data)) as image:
            picture = np.asarray(image.convert("RGB"))
    # Pillow's readers raise whatever their format's parser meets.
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or str(error).split(":")[0]
        raise ValueError(f"{path}: no picture that can be read ({reason})") from None
    for side in picture.shape[:2]:
        if not _SMALLEST_PICTURE <= side <= _LARGEST_PICTURE:
            raise ValueError(
                f"{path}: {picture.shape[1]} x {picture.shape[0]} pixels, allowed are"
                f" {_SMALLEST_PICTURE} to {_LARGEST_PICTURE}"
            )
    return picture


def _objects(picture: Any, pitch: float, table: Any, options: SeeOptions) -> list[dict[str, Any]]:
    from fntg_jax.robot import poles
    from fntg_jax.robot.colours import CLASSES

    view = poles.View(options.focal, options.height)
    pole = poles.Pole(options.band, options.thickness, options.foot)
    found = poles.find(picture, pitch, table, view, pole)
    objects = []
    for k in range(poles.NUM):
        if found.score[k] < poles.FOUND:
            continue
        lower, upper = (CLASSES[c] for c in poles.IDENTITIES[found.identity[k]])
        x, y, h = found.x[k], found.edge[k], found.band[k]
        half = 0.5 * h * options.thickness / options.band
        objects.append(
            {
                "kind": "landmark",
                "name": f"{lower}/{upper}",
                "lower": lower,
                "upper": upper,
                "bearing": round(float(found.bearing[k]), 5),
                "distance": round(float(found.distance[k]), 4),
                "box": [round(float(t), 2) for t in (x - half, y - h, x + half, y + h)],
                "confidence": round(float(found.score[k]), 4),
            }
        )
    return objects


def _drawn(pictures: list[Any], seen: list[list[dict[str, Any]]]) -> bytes:
    """The pictures one below the other, with what was seen, as PNG."""
    from PIL import Image, ImageDraw

    width = max(p.shape[1] for p in pictures)
    canvas = Image.new("RGB", (width, sum(p.shape[0] for p in pictures)))
    draw = ImageDraw.Draw(canvas)
    top = 0
    for picture, objects in zip(pictures, seen):
        canvas.paste(Image.fromarray(picture), (0, top))
        for o in objects:
            x0, y0, x1, y1 = o["box"]
            draw.rectangle((x0 - 2, top + y0 - 2, x1 + 2, top + y1 + 2), outline=(255, 0, 0))
            degrees = math.degrees(o["bearing"])
            text = f"{o['name']}\n{o['distance']:.2f} m {degrees:+.1f}° {o['confidence']:.2f}"
            box = draw.multiline_textbbox((0, 0), text)
            x = min(max(x0 - 20, 2), picture.shape[1] - box[2] - 4)
            y = top + (y0 - box[3] - 8 if y0 > box[3] + 8 else y1 + 6)
            draw.rectangle((x - 2, y - 1, x + box[2] + 2, y + box[3] + 2), fill=(0, 0, 0))
            draw.multiline_text((x, y), text, fill=(255, 255, 255))
        top += picture.shape[0]
    file = io.BytesIO()
    canvas.save(file, "PNG")
    return file.getvalue()
