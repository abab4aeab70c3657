"""Landmarks in photographs: a search for two-coloured poles by their whole structure.

A landmark is small (9 pixels wide from across a field) and the world is full of its colours, so a
pixel's colour alone decides nothing.  For every place, size and identity the search asks at once:
is the upper and the lower band of the right colour *relative to the white of the pole below*
(which cancels sun, shade and white balance); is that white light and colourless; do the bands end
where they should, to both sides and above; and is the pole as high above or below the horizon as
one that large must be.  The score is the product, so one strong "no" is enough.
"""

import dataclasses
import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, UInt8

from fntg_jax.robot import colours
from fntg_jax.robot.colours import Colours

# (lower, upper) in the order of the field of 2001.
IDENTITIES = tuple(
    pair
    for near in (colours.YELLOW, colours.GREEN, colours.SKYBLUE)
    for pair in ((near, colours.PINK), (colours.PINK, near))
)
NUM = 8  # candidates that are kept
FOUND = 0.45  # score of a landmark that is called found
WHITE = 200  # level at which a colour table for relative colours has white

_DARK = 8.0  # added before a logarithm: colours darker than this are noise
_SMALLEST, _GROWTH, _LARGEST = 4.5, 1.1, 90.0  # height of a band, pixels
# The camera's pitch is known to about half a degree, its roll (up to one degree) not at all.
_FREE, _STRICT, _ROLL = math.radians(0.7), math.radians(0.4), 0.012


@dataclasses.dataclass(frozen=True)
class View:
    """A camera: focal length in pixels, height above the floor in m."""

    focal: float
    height: float


@dataclasses.dataclass(frozen=True)
class Pole:
    """A landmark's measures, m: height of one band, thickness, height where the bands begin.

    Defaults: the photographs' landmarks.
    """

    band: float = 0.105
    thickness: float = 0.10
    foot: float = 0.18


class Found(NamedTuple):
    """The best candidates of a picture, best first, leaves [NUM].

    identity: index into `IDENTITIES`; score: 0 to 1; x: of the axis, edge: row of the border
    between the bands, band: height of one band, all in pixels from the picture's upper left
    corner; bearing: rad from the camera's axis in the horizontal plane, left positive; distance:
    m over the floor.
    """

    identity: Int[np.ndarray, " NUM"]
    score: Float[np.ndarray, " NUM"]
    x: Float[np.ndarray, " NUM"]
    edge: Float[np.ndarray, " NUM"]
    band: Float[np.ndarray, " NUM"]
    bearing: Float[np.ndarray, " NUM"]
    distance: Float[np.ndarray, " NUM"]


def log_colours(picture):
    """Logarithm of a picture's colours, in which light becomes a sum.  NumPy or JAX."""
    xp = np if isinstance(picture, np.ndarray) else jnp
    return xp.log(picture.astype(xp.float32) + _DARK)


def _soft(x, at, width):
    return jax.nn.sigmoid((x - at) / width)


def _chroma(log_rgb):
    r, g, b = log_rgb
    return jnp.hypot((r - g) / math.sqrt(2), (r + g - 2 * b) / math.sqrt(6))


def _gap(a, b):
    return jnp.sqrt(jnp.sum((a - b) ** 2, 0) + 1e-9)


def _parts(colours_: Colours, upper, lower, white, sides, above):
    """Score of every identity, [6, ...], from mean log colours [3, ...] of a pole's parts."""

    def looked_up(part):
        relative = jnp.clip(WHITE * jnp.exp(part - white), 0, 255).astype(jnp.uint8)
        return colours.classify(colours_, jnp.moveaxis(relative, 0, -1))

    (label_u, sure_u), (label_l, sure_l) = looked_up(upper), looked_up(lower)
    plain = _soft(-_chroma(white), -0.33, 0.05) * _soft(white.mean(0) - lower.mean(0), -0.1, 0.07)
    ends = _soft(_gap(upper, above), 0.25, 0.08)
    for band, side in zip((upper, upper, lower, lower), sides):
        ends = ends * _soft(_gap(band, side), 0.25, 0.08)
    fit = jnp.cbrt(sure_u * sure_l * plain) * ends**0.25
    return jnp.stack(
        [jnp.where((label_l == low) & (label_u == up), fit, 0.0) for low, up in IDENTITIES]
    )


def _boxes(mean, h, w):
    """Mean colours of a pole's parts, for bands h high and w wide; mean(y0, y1, x0, x1)."""
    inner, near, far = 0.4 * w, 0.65 * w, 1.15 * w
    up, low = (-0.9 * h, -0.1 * h), (0.1 * h, 0.9 * h)
    sides = [mean(*rows, *cols) for rows in (up, low) for cols in ((-far, -near), (near, far))]
    return (
        mean(*up, -inner, inner),
        mean(*low, -inner, inner),
        mean(1.25 * h, 2.2 * h, -inner, inner),
        sides,
        mean(-1.65 * h, -1.15 * h, -inner, inner),
    )


def find(
    picture: UInt8[np.ndarray, "H W 3"],
    pitch: float,
    colours_: Colours,
    view: View,
    pole: Pole = Pole(),
) -> Found:
    """The best candidates for landmarks in a picture (not jittable; the search itself is compiled).

    pitch: rad, of the camera, down positive.  colours_: a table for colours relative to white.
    """
    height, width, _ = picture.shape
    coarse = _search(jnp.asarray(picture), jnp.float32(pitch), colours_, view, pole)
    score, which, x, y, h = (np.asarray(leaf, np.float64) for leaf in coarse)
    mean = _box_means(log_colours(picture))
    x, y, h = _refine(mean, pole, x, y, h)
    # What stands there must look like a landmark at its final place and size, too.
    w = h * pole.thickness / pole.band
    parts = _boxes(lambda y0, y1, x0, x1: mean(y + y0, y + y1, x + x0, x + x1), h, w)
    again = np.asarray(_parts(colours_, *parts))[which.astype(int), np.arange(NUM)]
    score = np.sqrt(score * again) * (h > 0.8 * _SMALLEST)
    bearing, distance = _place(x, y, h, pitch, height, width, view, pole)
    order = np.argsort(-score, kind="stable")
    for n, k in enumerate(order):
        for better in order[:n]:
            # Every landmark stands once on a field, and none inside of another.
            over = abs(x[k] - x[better]) < w[k] + w[better]
            over &= abs(y[k] - y[better]) < 2 * (h[k] + h[better])
            if score[better] > 0 and (over or which[k] == which[better]):
                score[k] = 0.0
    order = np.argsort(-score, kind="stable")
    leaves = (which.astype(int), score, x, y, h, bearing, distance)
    return Found(*(leaf[order] for leaf in leaves))


@partial(jax.jit, static_argnames=("view", "pole"))
def _search(picture, pitch, colours_, view, pole):
    """Score, identity, place and size of the best candidates, to a pixel and a tenth in size."""
    height, width, _ = picture.shape
    largest = min(_LARGEST, height / 4.5)
    count = 1 + int(math.log(largest / _SMALLEST) / math.log(_GROWTH))
    scales = _SMALLEST * _GROWTH ** jnp.arange(count)
    pad = int(2.3 * largest) + 2
    # Only the rows where a pole of some size can be: the horizon, and by how much the border
    # between the bands of the largest is away from it.
    drop = (view.height - pole.foot - pole.band) / pole.band
    around = int(view.focal * math.tan(_FREE + 3 * _STRICT) + 1.5 * _ROLL * width) + 1
    high, low = min(0.0, drop * largest) - around, max(0.0, drop * largest) + around
    rows = min(height, int(low - high) + 1)
    horizon = 0.5 * height - view.focal * jnp.tan(pitch)
    start = jnp.clip(jnp.round(horizon + high).astype(jnp.int32), 0, height - rows)

    image = jnp.moveaxis(log_colours(picture), -1, 0)
    image = jnp.pad(image - 4, ((0, 0), (pad, pad), (pad, pad)), mode="edge")
    image = jax.lax.dynamic_slice(image, (0, start, 0), (3, rows + 2 * pad, width + 2 * pad))
    table = jnp.pad(jnp.cumsum(jnp.cumsum(image, 1), 2), ((0, 0), (1, 0), (1, 0)))
    ys = (start + jnp.arange(rows, dtype=jnp.float32))[:, None]
    xs = jnp.arange(width, dtype=jnp.float32)[None]

    def at_scale(best, h):
        def mean(y0, y1, x0, x1):
            y0, x0 = (jnp.round(t).astype(jnp.int32) for t in (y0, x0))
            y1 = jnp.maximum(jnp.round(y1).astype(jnp.int32), y0 + 1)
            x1 = jnp.maximum(jnp.round(x1).astype(jnp.int32), x0 + 1)
            corner = lambda y, x: jax.lax.dynamic_slice(  # noqa: E731
                table, (0, pad + y, pad + x), (3, rows, width)
            )
            total = corner(y1, x1) - corner(y0, x1) - corner(y1, x0) + corner(y0, x0)
            return total / ((y1 - y0) * (x1 - x0)) + 4

        w = h * pole.thickness / pole.band
        score = _parts(colours_, *_boxes(mean, h, w))
        # The row where the border of a pole this large belongs (small angles below the horizon).
        depression = jnp.arctan(drop * h * jnp.cos(pitch) ** 2 / view.focal)
        row = 0.5 * height + view.focal * jnp.tan(depression - pitch)
        off = jnp.abs(ys - row) - view.focal * _FREE - _ROLL * jnp.abs(xs - 0.5 * width)
        score = score * jnp.exp(-0.5 * (jnp.maximum(off, 0) / (view.focal * _STRICT)) ** 2)
        top, which = score.max(0), score.argmax(0)
        better = top > best[0]
        return tuple(jnp.where(better, new, old) for new, old in zip((top, which, h), best)), None

    none = jnp.zeros((rows, width))
    (score, which, scale), _ = jax.lax.scan(at_scale, (none, none.astype(jnp.int32), none), scales)

    def take(score, _):
        at = jnp.argmax(score)
        y, x = at // width, at % width
        h = scale[y, x]
        taken = (jnp.abs(ys - start - y) < 2 * h) & (jnp.abs(xs - x) < 1.2 * h)
        pick = (score[y, x], which[y, x], x.astype(jnp.float32), y.astype(jnp.float32), h)
        return jnp.where(taken, 0.0, score), pick

    _, (score, which, x, y, h) = jax.lax.scan(take, score, None, NUM)
    return score, which, x, y + start, h


def _box_means(image: Float[np.ndarray, "H W 3"]):
    """mean(y0, y1, x0, x1) of a picture, bounds to fractions of a pixel; leaves [3, ...]."""
    table = np.zeros((3, image.shape[0] + 1, image.shape[1] + 1))
    table[:, 1:, 1:] = np.moveaxis(image, -1, 0).cumsum(1, dtype=np.float64).cumsum(2)

    def corner(y, x):
        i = np.minimum(y.astype(int), image.shape[0] - 1)
        j = np.minimum(x.astype(int), image.shape[1] - 1)
        fy, fx = y - i, x - j
        top = table[:, i, j] * (1 - fx) + table[:, i, j + 1] * fx
        low = table[:, i + 1, j] * (1 - fx) + table[:, i + 1, j + 1] * fx
        return top * (1 - fy) + low * fy

    def mean(y0, y1, x0, x1):
        # What lies outside of the picture is left out of the mean, but for a tenth of a pixel.
        y0, x0 = np.clip(y0, 0, image.shape[0] - 0.1), np.clip(x0, 0, image.shape[1] - 0.1)
        y1, x1 = np.clip(y1, y0 + 0.1, image.shape[0]), np.clip(x1, x0 + 0.1, image.shape[1])
        y0, y1, x0, x1 = np.broadcast_arrays(y0, y1, x0, x1)
        total = corner(y1, x1) - corner(y0, x1) - corner(y1, x0) + corner(y0, x0)
        return total / ((y1 - y0) * (x1 - x0))

    return mean


def _refine(mean, pole, x, y, h):
    """Place and size to a fraction of a pixel: where the edges of the bands are strongest."""

    def edge(inside, outside):
        gap = np.sqrt(((inside - outside) ** 2).sum(0))
        return gap / (gap + 0.5)  # the edge of a shining streak must not outweigh the others

    def peak(strength, at):
        # The mean of the strongest: a border of two pixels' blur has no sharper place.
        share = (strength / strength.max((1, 2), keepdims=True)) ** 40
        return (share * at).sum((1, 2), keepdims=True) / share.sum((1, 2), keepdims=True)

    ratio = pole.thickness / pole.band
    x, y, h = (leaf[:, None, None] for leaf in (x, y, h))  # [candidates, sizes, places]
    for reach in (0.35, 0.1):
        step = np.linspace(-reach, reach, 21)
        t = np.maximum(0.2 * h, 1.0)
        hs, ys = h * np.exp(1.3 * step)[:, None], y + h * step
        half = 0.5 * ratio * h
        cols = (x - 0.6 * half, x + 0.6 * half)
        strength = sum(
            edge(mean(at, at + t, *cols), mean(at - t, at, *cols)) for at in (ys - hs, ys, ys + hs)
        )
        h, y = peak(strength, hs), peak(strength, ys)
        # Left and right edge each by itself: a streak of light beside one hides it (blurred poles
        # look up to a third wider than they are).
        t = np.maximum(0.2 * h, 1.0)
        edges = []
        for side in (-1, 1):
            at = x + side * half * np.linspace(0.75, 1.35, 25)
            strength = sum(
                edge(mean(*rows, at, at + t), mean(*rows, at - t, at))
                for rows in ((y - 0.9 * h, y - 0.1 * h), (y + 0.1 * h, y + 0.9 * h))
            )
            edges.append(peak(strength, at))
        x = 0.5 * (edges[0] + edges[1])
    return x.ravel(), y.ravel(), h.ravel()


def _place(x, y, h, pitch, height, width, view, pole):
    """Bearing and distance: by size and by height below the horizon, each as sure as it is."""
    left = (0.5 * width - x) / view.focal

    def ray(row):
        up = (0.5 * height - row) / view.focal
        ahead = np.cos(pitch) + up * np.sin(pitch)
        flat = np.hypot(ahead, left)
        return (up * np.cos(pitch) - np.sin(pitch)) / flat, ahead

    border, ahead = ray(y)
    by_size = 2 * pole.band / np.maximum(ray(y - h)[0] - ray(y + h)[0], 1e-6)
    drop = view.height - pole.foot - pole.band
    slope = np.maximum(-border * np.sign(drop), 1e-6)
    by_horizon = abs(drop) / slope
    # One standard deviation: 0.8 pixels of both bands; 0.35 degrees of pitch (assumed).
    sure_size = (2 * h / 0.8) ** 2
    sure_horizon = (slope / math.radians(0.35)) ** 2
    mixed = (sure_size * np.log(by_size) + sure_horizon * np.log(by_horizon)) / (
        sure_size + sure_horizon
    )
    return np.arctan2(left, ahead), np.exp(mixed)
