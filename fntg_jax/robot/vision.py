"""Vision at the pixel level: a picture of the head's camera -> the objects in it.

Colour classes by a table, connected components, and then by kind: the ball is orange, a landmark
two bands of which one is pink, a goal what is left of its colour, a robot its uniform.  Shapes are
fixed, `jax.vmap` makes batches.  `sight.locate` turns the `Frame` into distances and directions.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from envs.base import SEEN, Camera, Field, Frame
from fntg_jax.robot import colours
from fntg_jax.robot.colours import Colours
from fntg_jax.robot.components import components

# How many components of a class are looked at, largest first; 0 of those that mean nothing.
_LOOKED_AT = {
    colours.PINK: 4,
    colours.YELLOW: 3,
    colours.GREEN: 4,
    colours.SKYBLUE: 3,
    colours.ORANGE: 1,
    colours.RED: 3,
    colours.BLUE: 3,
}
_FIRST = dict(zip(_LOOKED_AT, np.cumsum([0, *_LOOKED_AT.values()])))
_SMALLEST = 9  # pixels of a component; a ball at 2 m has about 30
_NAME = 15  # bits of a pixel's index; its component's size has as many
_SECTORS = 11  # directions for which the nearest obstacle is told
_LINE = 9  # rows: what is white for longer is no line of the floor


class Sight(NamedTuple):
    """What a picture shows.

    frame: see `envs.base.Frame`; goals and robots by what of them is in view.  confidence: 0 to 1,
    in the order of `SEEN`.  free: bearings (rad) of the right and left end of the widest part of
    each goal's mouth that nothing hides (own, theirs).  obstacle: elevation (rad) of the foot of
    the nearest obstacle in each of eleven sectors from left to right, 0 where there is none.
    """

    frame: Frame
    confidence: Float[Array, " K"]
    free: Float[Array, "2 2"]
    obstacle: Float[Array, "11"]


class Team(NamedTuple):
    """Classes of the own goal and theirs, and of mates' and opponents' uniforms."""

    own_goal: Int[Array, ""] | int = colours.SKYBLUE
    their_goal: Int[Array, ""] | int = colours.YELLOW
    mates: Int[Array, ""] | int = colours.RED
    opponents: Int[Array, ""] | int = colours.BLUE


class Blobs(NamedTuple):
    """Components, leaves [N] in the order of `_LOOKED_AT`: number of pixels, sum of their
    confidences, centre and box (pixels, edges), and which columns they cover, [N, W]."""

    size: Float[Array, " N"]
    sure: Float[Array, " N"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    x0: Float[Array, " N"]
    x1: Float[Array, " N"]
    y0: Float[Array, " N"]
    y1: Float[Array, " N"]
    columns: Bool[Array, "N W"]


def blobs(classes: Int[Array, "H W"], sure: Float[Array, "H W"]) -> Blobs:
    """The largest components of every class that means something."""
    height, width = classes.shape
    label = components(classes)
    flat = classes.ravel()
    count = jnp.zeros(height * width, jnp.int32).at[label.ravel()].add(1)
    # Size and name in one number: the largest, the next, ... are plain maxima.
    ranked = (count << _NAME) + jnp.arange(height * width)
    names = []
    for colour, number in _LOOKED_AT.items():
        own = jnp.where((flat == colour) & (count >= _SMALLEST), ranked, -1)
        best = jnp.int32(2**31 - 1)
        for _ in range(number):
            best = jnp.where(own < best, own, -1).max()
            names.append(jnp.where(best < 0, -1, best & ((1 << _NAME) - 1)))
    mask = label[None] == jnp.stack(names)[:, None, None]
    weight = mask.astype(jnp.float32)
    in_row, in_column = weight.sum(2), weight.sum(1)
    size = in_row.sum(1)
    rows, cols = jnp.arange(height) + 0.5, jnp.arange(width) + 0.5
    over = 1 / jnp.maximum(size, 1)

    def ends(counts, at):
        some = counts > 0
        return (
            jnp.where(some, at - 0.5, 1e4).min(1),
            jnp.where(some, at + 0.5, -1e4).max(1),
        )

    (y0, y1), (x0, x1) = ends(in_row, rows), ends(in_column, cols)
    x0, x1, y0, y1 = (jnp.where(size > 0, v, 0.0) for v in (x0, x1, y0, y1))
    return Blobs(
        size=size,
        sure=(weight * sure).sum((1, 2)) * over,
        x=(in_column * cols).sum(1) * over,
        y=(in_row * rows).sum(1) * over,
        x0=x0,
        x1=x1,
        y0=y0,
        y1=y1,
        columns=in_column > 0,
    )


def see(
    picture: UInt8[Array, "H W 3"],
    table: Colours,
    team: Team,
    field: Field,
    camera: Camera = Camera(),
) -> Sight:
    """All objects of a picture.

    field: the map, for the colours of the landmarks; table: see `colours.load`.
    """
    height, width, _ = picture.shape
    classes, sure = colours.classify(table, picture)
    classes = classes.astype(jnp.int32)
    b = blobs(classes, sure)
    across, down = math.tan(camera.horizontal / 2), math.tan(camera.vertical / 2)

    def ray(x, y):
        return across * (1 - 2 * x / width), down * (1 - 2 * y / height)

    def angles(x, y):
        left, up = ray(x, y)
        return jnp.arctan(left), jnp.arctan(up / jnp.sqrt(1 + left * left))

    def span(ax, ay, bx, by):
        """Angle between two pixels, small enough for a chord."""
        (la, ua), (lb, ub) = ray(ax, ay), ray(bx, by)
        na, nb = (1 / jnp.sqrt(1 + p * p + q * q) for p, q in ((la, ua), (lb, ub)))
        return jnp.sqrt((la * na - lb * nb) ** 2 + (ua * na - ub * nb) ** 2 + (na - nb) ** 2)

    rows = []

    # Ball: as wide as its box or, where that is cut or frayed, as its area says.
    k = int(_FIRST[colours.ORANGE])
    wide, tall = b.x1[k] - b.x0[k], b.y1[k] - b.y0[k]
    round_ = 2 * jnp.sqrt(b.size[k] / math.pi)
    cut = (b.x0[k] < 1) | (b.y0[k] < 1) | (b.x1[k] > width - 1) | (b.y1[k] > height - 1)
    whole = b.size[k] > 0.68 * wide * tall
    broad = jnp.where(whole & ~cut, round_, jnp.maximum(wide, tall))
    shape = (b.size[k] > 0.35 * wide * tall) & (wide < 3 * tall) & (tall < 3 * wide)
    seen = (b.size[k] >= _SMALLEST) & shape & (b.sure[k] > 0.5)
    x, y = 0.5 * (b.x0[k] + b.x1[k]), 0.5 * (b.y0[k] + b.y1[k])
    rows.append((*angles(x, y), span(x - 0.5 * broad, y, x + 0.5 * broad, y), seen, b.sure[k]))

    # Landmarks: pairs of a pink band and another, one above the other and of a size.
    pink = slice(int(_FIRST[colours.PINK]), int(_FIRST[colours.PINK]) + _LOOKED_AT[colours.PINK])
    used = jnp.zeros(b.size.shape, bool)
    for mark in field.landmarks:
        upper = colours.CLASSES.index(mark.upper) == colours.PINK
        other = colours.CLASSES.index(mark.lower if upper else mark.upper)
        second = slice(int(_FIRST[other]), int(_FIRST[other]) + _LOOKED_AT[other])
        p, q = (Blobs(*(leaf[part] for leaf in b)) for part in (pink, second))
        p = Blobs(*(leaf[:, None] for leaf in p))
        gap = jnp.hypot(p.x - q.x, p.y - q.y)
        above = (q.y - p.y) if upper else (p.y - q.y)
        # The bands are as far apart as each is high, and that is as high as wide (0.1 m).
        side = jnp.sqrt(jnp.minimum(p.size, q.size))
        fit = (p.size > 0) & (q.size > 0) & (above > 0.75 * gap)
        fit &= (gap > 0.6 * side) & (gap < 1.6 * side)
        fit &= jnp.maximum(p.size, q.size) < 2.2 * jnp.minimum(p.size, q.size)
        quality = jnp.where(fit, jnp.minimum(p.sure, q.sure), 0.0)
        best = jnp.argmax(quality)
        i, j = best // quality.shape[1], best % quality.shape[1]
        good = quality.ravel()[best]
        seen = good > 0.5
        px, py, qx, qy = p.x[i, 0], p.y[i, 0], q.x[j], q.y[j]
        used = used.at[second.start + j].set(used[second.start + j] | seen)
        x, y = 0.5 * (px + qx), 0.5 * (py + qy)
        rows.append((*angles(x, y), 2 * span(px, py, qx, qy), seen, good))

    # Goals: the largest of their colour that is no band; the free part is the widest run of it.
    free = []
    for colour in (team.own_goal, team.their_goal):
        ends = []
        for own in (colours.YELLOW, colours.SKYBLUE):
            part = slice(int(_FIRST[own]), int(_FIRST[own]) + _LOOKED_AT[own])
            size = jnp.where(used[part], 0.0, b.size[part])
            g = part.start + jnp.argmax(size)
            tall = b.y1[g] - b.y0[g]
            seen = (size.max() > 60) & (b.sure[g] > 0.5)
            x, y = 0.5 * (b.x0[g] + b.x1[g]), 0.5 * (b.y0[g] + b.y1[g])
            first, last = _widest(b.columns[g])
            bearings = jnp.arctan(jnp.stack([ray(last, y)[0], ray(first, y)[0]]))
            row = (*angles(x, y), span(x, y - 0.5 * tall, x, y + 0.5 * tall), seen, b.sure[g])
            ends.append((row, jnp.where(seen, bearings, 0.0)))
        yellow = jnp.asarray(colour) == colours.YELLOW
        row, bearings = jax.tree.map(partial(jnp.where, yellow), *ends)
        rows.append(row)
        free.append(bearings)

    # Robots: uniforms, largest first.
    for colour, number in ((team.mates, 2), (team.opponents, 3)):
        red = jnp.asarray(colour) == colours.RED
        for n in range(number):
            u = jnp.where(red, _FIRST[colours.RED], _FIRST[colours.BLUE]) + n
            seen = (b.size[u] >= 2 * _SMALLEST) & (b.sure[u] > 0.5)
            x, y, wide = b.x[u], b.y[u], b.x1[u] - b.x0[u]
            # The uniform is 0.17 x 0.13 m, a robot about 0.22 m.
            size = 1.4 * span(x - 0.5 * wide, y, x + 0.5 * wide, y)
            rows.append((*angles(x, y), size, seen, b.sure[u]))

    bearing, elevation, size, visible, confidence = (jnp.stack(leaf) for leaf in zip(*rows))
    assert len(rows) == len(SEEN)
    bearing, elevation, size = (jnp.where(visible, v, 0.0) for v in (bearing, elevation, size))
    frame = Frame(bearing, elevation, size, visible)
    obstacle = _obstacles(classes, down)
    return Sight(frame, jnp.where(visible, confidence, 0.0), jnp.stack(free), obstacle)


def _widest(columns: Bool[Array, " W"]) -> tuple[Array, Array]:
    """First and last edge of the longest run of columns."""
    at = jnp.arange(columns.shape[0])
    start = jax.lax.cummax(jnp.where(columns, -1, at))  # the last gap before each column
    run = jnp.where(columns, at - start, 0)
    end = jnp.argmax(run)
    return (end - run[end] + 1).astype(jnp.float32), (end + 1).astype(jnp.float32)


def _obstacles(classes: Int[Array, "H W"], down: float) -> Float[Array, "11"]:
    """Elevation of the nearest obstacle's foot by sector: from below, the first row of a column
    that is neither carpet nor line."""
    height, width = classes.shape
    floor = (classes == colours.GREEN) | (classes == colours.ORANGE)
    white = (classes == colours.WHITE).astype(jnp.int32)
    total = jnp.cumsum(jnp.pad(white, ((1 + _LINE, 0), (0, 0))), 0)
    long = total[1 + _LINE :] - total[: -1 - _LINE] >= _LINE  # white and so all above it
    blocked = ~floor & ((white == 0) | long)
    row = jnp.where(blocked, jnp.arange(height)[:, None] + 1, 0).max(0)
    row = row.reshape(_SECTORS, width // _SECTORS).max(1)
    up = down * (1 - 2 * row.astype(jnp.float32) / height)
    return jnp.where(row > 0, jnp.arctan(up), 0.0)
