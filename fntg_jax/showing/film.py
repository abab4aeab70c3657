"""Trials of a world that draws itself (`film` of the world object), as an animated picture.

What is shown and judged is what that world films: the quadruped's full model, in which the ball
can be pushed, not the lean one that controllers are trained and evaluated in.
"""

import io
import math
import subprocess
import tempfile
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from envs.base import World
from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller
from fntg_jax.learning import rollout
from fntg_jax.running.evaluation import environment_for, held_out_scenes
from fntg_jax.showing.replay import check_scenes, describe_result, encode

NUM_KEY_FRAMES = 6


class Shot(NamedTuple):
    """One trial: title, scene and result in words; s between pictures; draw: (width, height) ->
    pictures uint8 [height, width, 3]; view: plays it in a window."""

    title: str
    scene: str
    result: str
    dt: float
    draw: Callable[[int, int], list[np.ndarray]]
    view: Callable[[], None]


def shoot(
    title: str,
    controller: Controller,
    world: World,
    suite: str,
    indices: tuple[int, ...],
    seed: int = 0,
    window: bool = False,
) -> list[Shot]:
    """One shot for each held-out scene, numbered as `replay.record` does.

    Args:
        title: of the shots.
        controller: who drives.
        world: `envs.base.World` that can draw itself.
        suite: of scenes.
        indices: numbers of the scenes.
        seed: of the scenes.
        window: they will be viewed, not drawn.

    Raises ValueError on an unknown suite or a negative scene, and where the world cannot draw.
    """
    check_scenes(indices)
    scenes = held_out_scenes(world, suite, max(indices) + 1, seed)
    scenes = jax.tree.map(lambda x: x[np.asarray(indices)], scenes)
    env = environment_for(controller, world)
    params = controller.params32

    def control(seen):
        return network.command(params, seen, env.limits, controller.output)

    assert world.film is not None
    film = world.film(env, scenes, control, window)
    judge = jax.vmap(rollout.outcome_of, in_axes=(1, 1, 0))
    outcomes = jax.tree.map(np.asarray, judge(film.measured, film.command, film.failed))
    return [
        Shot(
            title,
            f"{suite} scene {index}",
            describe_result(jax.tree.map(lambda x, n=n: x[n], outcomes)),
            film.dt,
            lambda width, height, n=n: film.pictures(n, width, height),  # type: ignore[misc]
            lambda n=n: film.view(n),  # type: ignore[misc]
        )
        for n, index in enumerate(indices)
    ]


def animation(shots: list[Shot], image_format: str, width: int = 0) -> tuple[bytes, list[bytes]]:
    """The shots side by side in real time, at their end how they went.

    Args:
        shots: of `shoot`.
        image_format: GIF or WEBP.
        width: of the whole picture, pixels; 0 for 400 of one shot and 320 of each of several.

    Returns:
        The animation, and key frames as PNG.
    """
    from PIL import Image, ImageDraw

    columns = math.ceil(math.sqrt(len(shots)))
    width = width // columns or (400 if columns == 1 else 320)
    height = 3 * width // 4
    reels = [shot.draw(width, height) for shot in shots]
    length = max(map(len, reels))
    rows = math.ceil(len(shots) / columns)
    frames: list[Any] = []
    for n in [*range(length), length - 1]:
        last = len(frames) == length
        frame = Image.new("RGB", (columns * width, rows * height))
        for k, (shot, reel) in enumerate(zip(shots, reels)):
            corner = (k % columns * width, k // columns * height)
            frame.paste(Image.fromarray(reel[min(n, len(reel) - 1)]), corner)
            words = f"{shot.title[-30:]}  {shot.scene}  {n * shot.dt:.1f} s"
            if last:
                words += "\n" + textwrap.fill(shot.result, width // 7)
            place = (corner[0] + 6, corner[1] + 4)
            ImageDraw.Draw(frame).text(
                place, words, fill="white", font_size=12, stroke_width=1, stroke_fill="black"
            )
        frames.append(frame)
    keys = []
    for n in np.linspace(0, length - 1, NUM_KEY_FRAMES).round().astype(int):
        out = io.BytesIO()
        frames[n].save(out, format="PNG")
        keys.append(out.getvalue())
    return encode(frames, shots[0].dt, image_format), keys


def encoded(pictures: list[np.ndarray], dt: float, path: Path) -> bytes:
    """Pictures uint8 [height, width, 3], dt seconds each, in the format of the path's name: .webp,
    .gif, or .mp4 by ffmpeg.  Raises ValueError where that fails."""
    suffix = path.suffix.lower()
    if suffix != ".mp4":
        from PIL import Image

        return encode([Image.fromarray(p) for p in pictures], dt, suffix[1:].upper())
    height, width = pictures[0].shape[:2]
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch, "film.mp4")
        command = ["ffmpeg", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", f"{1 / dt:g}", "-i", "-"]
        command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)]
        done = subprocess.run(command, input=b"".join(map(bytes, pictures)), capture_output=True)
        if done.returncode:
            words = " ".join(done.stderr.decode(errors="replace").split())
            raise ValueError(f"film = {path}: ffmpeg failed: {words[-200:]}")
        return target.read_bytes()
