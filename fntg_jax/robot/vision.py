"""Vision at the pixel level: a picture of the head's camera -> the objects in it.

Colour classes by a table, connected components, and then by kind: the ball is orange, a landmark
two bands of which one is pink, a goal what is left of its colour, a robot its uniform.  Shapes are
fixed, `jax.vmap` makes batches.  `sight.locate` turns the `Frame` into distances and directions.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt8

from envs.base import SEEN, Camera, Field, Frame
from fntg_jax.robot import colours
from fntg_jax.robot.colours import Colours
from fntg_jax.robot.components import Runs, runs

_RUNS = 1024  # of a picture; rendered ones had up to 340, and what has more is no field
_PINK, _BALLS, _GOALS, _ROBOTS = 6, 2, 3, 3  # components of a colour that are looked at
_SURE = 0.5  # mean share of pixels of their colours that are of this class
_SMALLEST = 9  # pixels of a component; a ball at 2 m has about 30
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
    """Components, leaves [N]: name (index of the first run), class, number of pixels (0: none),
    mean of their confidences, centre and box (pixels, edges)."""

    name: Int[Array, " N"]
    colour: Int[Array, " N"]
    size: Float[Array, " N"]
    sure: Float[Array, " N"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    x0: Float[Array, " N"]
    x1: Float[Array, " N"]
    y0: Float[Array, " N"]
    y1: Float[Array, " N"]


def blobs(found: Runs) -> Blobs:
    """The components of a picture's runs, each at the index of its first run."""
    length, row, start, sure = (
        a.astype(jnp.float32) for a in (found.length, found.row, found.start, found.sure)
    )
    parts = jnp.stack([length, sure, length * (start + 0.5 * length), length * (row + 0.5)], -1)
    size, sure, x, y = jnp.zeros_like(parts).at[found.label].add(parts).T
    # A loop of its own: XLA (jax 0.10.2, CPU) dies of making one loop of both.
    far = jnp.full(length.shape, 1e4)
    least = lambda a: far.at[found.label].min(jnp.where(length > 0, a, 1e4))  # noqa: E731
    ends = jnp.stack([start, -start - length, row, -row - 1])
    x0, x1, y0, y1 = jax.lax.map(least, ends)
    over = 1 / jnp.maximum(size, 1)
    name = jnp.arange(size.shape[0])
    return Blobs(name, found.colour, size, sure * over / 255, x * over, y * over, x0, -x1, y0, -y1)


def largest(b: Blobs, colour: Int[Array, ""] | int, number: int) -> list[Blobs]:
    """The largest components of a class, largest first; of size 0 where there are no more."""
    own = jnp.where((b.colour == colour) & (b.size >= _SMALLEST), b.size, 0.0)
    found = []
    for _ in range(number):
        n = jnp.argmax(own)
        found.append(Blobs(*(leaf[n] for leaf in b))._replace(size=own[n]))
        own = jnp.where(b.name == n, 0.0, own)
    return found


def bands(field: Field) -> Int[Array, "6 2"]:
    """Classes of the lower and the upper band of a map's landmarks."""
    index = colours.CLASSES.index
    return jnp.asarray([(index(mark.lower), index(mark.upper)) for mark in field.landmarks])


def see(
    picture: UInt8[Array, "H W 3"],
    table: Colours,
    team: Team,
    marks: Int[Array, "6 2"],
    camera: Camera = Camera(),
) -> Sight:
    """All objects of a picture.

    table: see `colours.load`; marks: see `bands`.  A picture of more
    patches than a field can have shows nothing.
    """

    def one(picture: Array, table: Colours, team: Team, marks: Array) -> Sight:
        return _see(picture, table, team, marks, camera)

    if jax.default_backend() == "cpu":
        # One picture after the other under `vmap`: each then stays in the cache.
        one = jax.custom_batching.sequential_vmap(one)
    return one(picture, table, team, marks)


def _see(picture, table: Colours, team: Team, marks: Array, camera: Camera) -> Sight:
    height, width, _ = picture.shape
    at = colours.cell(picture)
    # Looked up once, and not anew wherever a class is asked for.
    classes, sure = jax.lax.optimization_barrier((table.label[at], table.confidence[at]))
    kept = (classes != colours.NONE) & (classes != colours.WHITE)
    found = runs(classes, kept, sure, _RUNS)
    readable = found.number <= _RUNS
    b = blobs(found)
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

    rows: list[Any] = []

    # Ball: as wide as its box or, where that is cut or frayed, as its area says.
    balls = []
    for k in largest(b, colours.ORANGE, _BALLS):
        wide, tall = k.x1 - k.x0, k.y1 - k.y0
        cut = (k.x0 < 1) | (k.y0 < 1) | (k.x1 > width - 1) | (k.y1 > height - 1)
        whole = k.size > 0.68 * wide * tall
        round_ = 2 * jnp.sqrt(k.size / math.pi)
        broad = jnp.where(whole & ~cut, round_, jnp.maximum(wide, tall))
        seen = (k.size > 0.35 * wide * tall) & (wide < 3 * tall) & (tall < 3 * wide)
        seen &= (k.size > 0) & (k.sure > _SURE)
        x, y = 0.5 * (k.x0 + k.x1), 0.5 * (k.y0 + k.y1)
        broad = span(x - 0.5 * broad, y, x + 0.5 * broad, y)
        balls.append((*angles(x, y), broad, seen, k.sure))
    first = balls[0][3]
    rows.append(tuple(jnp.where(first, *pair) for pair in zip(*balls)))

    # Landmarks: a pink band and another, one above the other and of a size.
    pinks = largest(b, colours.PINK, _PINK)
    p = Blobs(*(jnp.stack(leaf)[:, None] for leaf in zip(*pinks)))
    gap = jnp.sqrt((p.x - b.x) ** 2 + (p.y - b.y) ** 2)
    # The bands are as far apart as each is high, and that is as high as wide (0.1 m).
    side = jnp.sqrt(jnp.minimum(p.size, b.size))
    fit = (p.size > 0) & (b.size >= _SMALLEST) & (gap > 0.6 * side) & (gap < 1.6 * side)
    fit &= jnp.maximum(p.size, b.size) < 2.2 * jnp.minimum(p.size, b.size)
    quality = jnp.where(fit, jnp.minimum(p.sure, b.sure), 0.0)
    band = jnp.zeros(b.size.shape, bool)
    for lower, upper in marks:
        other = jnp.where(upper == colours.PINK, lower, upper)
        above = jnp.where(upper == colours.PINK, b.y - p.y, p.y - b.y)
        good = jnp.where((b.colour == other) & (above > 0.75 * gap), quality, 0.0)
        best = jnp.argmax(good)
        i, j = best // good.shape[1], best % good.shape[1]
        sure = good.max()
        seen = sure > _SURE
        px, py, qx, qy = p.x[i, 0], p.y[i, 0], b.x[j], b.y[j]
        band |= seen & (b.name == b.name[j])
        x, y = 0.5 * (px + qx), 0.5 * (py + qy)
        rows.append((*angles(x, y), 2 * span(px, py, qx, qy), seen, sure))

    # Goals: the largest of their colour that is no band; the free part is the widest run of it.
    rest = b._replace(size=jnp.where(band, 0.0, b.size))
    free = []
    for colour in (team.own_goal, team.their_goal):
        (g,) = largest(rest, colour, 1)
        seen = (g.size > 60) & (g.sure > _SURE)
        x, y = 0.5 * (g.x0 + g.x1), 0.5 * (g.y0 + g.y1)
        tall = g.y1 - g.y0
        rows.append((*angles(x, y), span(x, y - 0.5 * tall, x, y + 0.5 * tall), seen, g.sure))
        own = (found.length > 0) & (found.label == g.name)
        after = jnp.arange(width) - found.start[:, None]
        covers = (own[:, None] & (after >= 0) & (after < found.length[:, None])).any(0)
        first, last = _widest(covers)
        ends = jnp.arctan(jnp.stack([ray(last, y)[0], ray(first, y)[0]]))
        free.append(jnp.where(seen, ends, 0.0))

    # Robots: uniforms, largest first.
    for colour, number in ((team.mates, 2), (team.opponents, 3)):
        for u in largest(b, colour, number):
            seen = (u.size >= 2 * _SMALLEST) & (u.sure > _SURE)
            wide = u.x1 - u.x0
            # The uniform is 0.17 x 0.13 m, a robot about 0.22 m.
            size = 1.4 * span(u.x - 0.5 * wide, u.y, u.x + 0.5 * wide, u.y)
            rows.append((*angles(u.x, u.y), size, seen, u.sure))

    bearing, elevation, size, visible, confidence = (jnp.stack(leaf) for leaf in zip(*rows))
    assert len(rows) == len(SEEN)
    visible &= readable
    bearing, elevation, size = (jnp.where(visible, v, 0.0) for v in (bearing, elevation, size))
    frame = Frame(bearing, elevation, size, visible)
    obstacle = _obstacles(classes, down)
    return Sight(
        frame,
        jnp.where(visible, confidence, 0.0),
        jnp.where(readable, jnp.stack(free), 0.0),
        jnp.where(readable, obstacle, 0.0),
    )


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
    white = classes == colours.WHITE
    # White and so are the eight above it: two, four, eight, nine in a column.
    long = white
    for rows in (1, 2, 4, _LINE - 8):
        long &= jnp.pad(long[:-rows], ((rows, 0), (0, 0)))
    blocked = ~floor & (~white | long)
    row = jnp.where(blocked, jnp.arange(height)[:, None] + 1, 0).max(0)
    row = row.reshape(_SECTORS, width // _SECTORS).max(1)
    up = down * (1 - 2 * row.astype(jnp.float32) / height)
    return jnp.where(row > 0, jnp.arctan(up), 0.0)
