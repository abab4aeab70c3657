"""A stretch of a match in pictures: the field from above, clock, score, calls."""

import math
from typing import Any

import numpy as np

from fntg_jax.showing.match_page import Recording

WIDTH = 480  # pixels
_SMOOTH = 2  # drawn so many times larger
_HEAD = 26  # pixels, of the line with score and clock
_TRAIL = 15  # steps of the ball's trail
_LAST = 2.0  # s that the score stays at the end
_TEAMS = ("#c62828", "#1f5fbf")
_GRASS, _WHITE, _ORANGE, _DARK = "#3f8f55", "#f4f4f4", "#ff7a00", "#20242a"


def pictures(match: Recording, start: float, seconds: float) -> list[np.ndarray]:
    """`seconds` from `start` (s of play, breaks included), every second step, then the score for
    two seconds: uint8 [height, width, 3], 2 dt apart.

    Raises ValueError where nothing of the match lies there.
    """
    length = len(match.robots)
    first = round(start / match.dt)
    if not 0 <= first < length - 1:
        raise ValueError(f"film_from = {start}: allowed are 0 to {(length - 2) * match.dt:.1f} s")
    steps = range(first, min(first + round(seconds / match.dt) + 1, length), 2)
    last = [_frame(match, steps[-1], final=True)] * round(_LAST / (2 * match.dt))
    return [np.asarray(frame) for frame in [*(_frame(match, n) for n in steps), *last]]


def _frame(match: Recording, n: int, final: bool = False) -> Any:
    from PIL import Image, ImageDraw

    field = match.field
    span = field.length + 2 * field.goal_depth + 0.1
    scale = WIDTH * _SMOOTH / span
    size = WIDTH * _SMOOTH, round((field.width + 0.3) * scale / 4) * 4
    picture = Image.new("RGB", size, _GRASS)
    draw = ImageDraw.Draw(picture)

    def at(x, y):
        return size[0] / 2 + scale * x, size[1] / 2 - scale * y

    def disc(x, y, radius, colour):
        (u, v), r = at(x, y), scale * radius
        draw.ellipse((u - r, v - r, u + r, v + r), fill=colour)

    def box(x0, y0, x1, y1, **style):
        draw.rectangle((*at(x0, y1), *at(x1, y0)), **style)

    half, side, mouth = field.length / 2, field.width / 2, field.goal_width / 2
    pen = max(round(0.012 * scale), 1)
    box(-half - field.goal_depth, -mouth, -half, mouth, fill="#5bb8e8")
    box(half, -mouth, half + field.goal_depth, mouth, fill="#e8c83a")
    box(-half, -side, half, side, outline=_WHITE, width=pen)
    draw.line((*at(0, -side), *at(0, side)), fill=_WHITE, width=pen)
    (u, v), r = at(0, 0), 0.18 * scale
    draw.ellipse((u - r, v - r, u + r, v + r), outline=_WHITE, width=pen)
    for k in range(max(n - _TRAIL, 0), n):
        if np.abs(match.ball[k + 1] - match.ball[k]).sum() < 0.4:  # not where it was placed anew
            ends = (*at(*match.ball[k]), *at(*match.ball[k + 1]))
            draw.line(ends, fill="#e8a860", width=2 * pen)
    num = match.robots.shape[1]
    for k in range(num):
        if not match.on[n][k]:
            continue
        x, y, heading, pan = match.robots[n, k]
        _robot(draw, at, scale, match.size, (x, y, heading, pan), _TEAMS[int(2 * k >= num)])
        draw.text(at(x, y), str(k % (num // 2) + 1), fill=_WHITE, anchor="mm", font_size=26)
    disc(float(match.ball[n, 0]), float(match.ball[n, 1]), field.ball_radius, _ORANGE)
    picture = picture.resize((size[0] // _SMOOTH, size[1] // _SMOOTH), Image.Resampling.LANCZOS)
    whole = Image.new("RGB", (picture.width, picture.height + _HEAD), _DARK)
    whole.paste(picture, (0, _HEAD))
    _line(ImageDraw.Draw(whole), match, n, picture.width)
    if final:
        _final(ImageDraw.Draw(whole), match, n, whole.size)
    return whole


def _robot(draw, at, scale, size, pose, colour):
    """A body with its head turned to where it looks."""
    x, y, heading, pan = pose

    def corners(x, y, angle, front, rear, wide):
        c, s = math.cos(angle), math.sin(angle)
        around = ((front, wide), (front, -wide), (-rear, -wide), (-rear, wide))
        return [at(x + c * a - s * b, y + s * a + c * b) for a, b in around]

    half, wide = size[0] / 2, size[1] / 2
    body = corners(x, y, heading, half, half, wide)
    draw.polygon(body, fill=colour, outline=_WHITE, width=max(round(0.008 * scale), 1))
    c, s = math.cos(heading), math.sin(heading)
    neck = x + (half - 0.02) * c, y + (half - 0.02) * s
    draw.polygon(corners(*neck, heading + pan, 0.07, 0.03, 0.035), fill="#222")


def _line(draw, match, n, width):
    """Teams, score, clock and the call of the last two seconds."""
    time = n * match.dt
    home, away = match.score[n]
    draw.text((8, _HEAD / 2), match.teams[0][-14:], fill="#ff8a80", anchor="lm", font_size=14)
    right = width - 8, _HEAD / 2
    draw.text(right, match.teams[1][-14:], fill="#90b8ff", anchor="rm", font_size=14)
    middle = f"{home} : {away}   {int(time) // 60}:{int(time) % 60:02d}"
    calls = [call.text for call in match.calls if call.time <= time < call.time + 2]
    words = f"{middle}   {calls[-1]}" if calls else middle
    draw.text((width / 2, _HEAD / 2), words[:44], fill=_WHITE, anchor="mm", font_size=14)


def _final(draw, match, n, size):
    home, away = match.score[n]
    centre = size[0] / 2, size[1] / 2 + _HEAD / 2
    draw.rectangle((centre[0] - 80, centre[1] - 34, centre[0] + 80, centre[1] + 34), fill=_DARK)
    draw.text(centre, f"{home} : {away}", fill=_WHITE, anchor="mm", font_size=46)
