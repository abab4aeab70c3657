"""What a robot's camera sees, as pixels: a ray caster for planes, boxes, cylinders and spheres.

Every pixel's ray meets every part of the field in closed form; the nearest wins.  One picture is
one loop over pixels without memory traffic, so `jax.vmap` over scenes makes thousands a second.
`envs.soccer.image_mjcf` writes the same parts for MuJoCo, whose renderer is the judge.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from envs.base import Camera, Field, Head, Scalar
from envs.field import FIELD

# Colours without light, 0 to 1 (assumed; the rule book of 2001 was not found).
PAINT = {
    "room": (0.55, 0.54, 0.52),
    "carpet": (0.10, 0.42, 0.16),
    "line": (0.88, 0.88, 0.86),
    "ground": (0.36, 0.34, 0.33),
    "wall": (0.84, 0.84, 0.82),
    "white": (0.86, 0.86, 0.84),
    "pink": (0.92, 0.36, 0.60),
    "yellow": (0.92, 0.80, 0.10),
    "green": (0.05, 0.55, 0.25),
    "skyblue": (0.20, 0.62, 0.92),
    "ball": (0.95, 0.42, 0.08),
    "red": (0.78, 0.08, 0.10),
    "blue": (0.10, 0.14, 0.62),
    "silver": (0.62, 0.62, 0.66),
}
# A robot as boxes in its own frame: centre, half sizes (m), whether it wears the uniform.  The
# ERS-210's outer measures (289 x 152 x 266 mm with head up); the division is assumed.
ROBOT = (
    ((0.0, 0.0, 0.165), (0.085, 0.065, 0.055), True),  # trunk
    ((0.125, 0.0, 0.225), (0.045, 0.040, 0.040), False),  # head
    ((0.06, 0.0, 0.055), (0.020, 0.070, 0.055), False),  # fore legs
    ((-0.06, 0.0, 0.055), (0.020, 0.070, 0.055), False),  # hind legs
)
WALL = 0.03  # m, thickness of walls and goals (assumed)
HALL = 30.0  # m, half of the ground's length and width (assumed)
CIRCLE = 0.18  # m, radius of the centre circle (assumed)
AREA = (0.4, 1.0)  # m, depth and width of the penalty areas (assumed)
SUN = (0.36, 0.24, 0.90)  # direction of the light, unit length
AMBIENT = 0.55  # share of the light that comes from everywhere
NAMES = ("room", "floor", "wall", "goal-", "goal+", *(f"landmark{n}" for n in range(6)), "ball")
FIRST_ROBOT = len(NAMES)  # object number of robot 0


class Scene(NamedTuple):
    """What stands on the field, in its frame (m, rad).

    ball: x, y, z of the centre; robots: x, y, heading; team: 0 red, 1 blue; present: it is there.
    """

    ball: Float[Array, "3"]
    robots: Float[Array, "N 3"]
    team: Int[Array, " N"]
    present: Bool[Array, " N"]


class Eye(NamedTuple):
    """A camera: place (m) and the directions ahead, left and up of its picture, rows of `axes`."""

    place: Float[Array, "3"]
    axes: Float[Array, "3 3"]


class Light(NamedTuple):
    """What happens to the picture between the field and the program.

    light: brightness; shading: 0 flat, 1 by the surface's angle to the light; shadows: share of
    the light that ball and robots keep from the floor; balance: gain of red, green, blue; blur:
    share of a pixel's light that each of its neighbours in a row and in a column gets; noise:
    standard deviation, levels of 255; seed: of the noise.
    """

    light: Scalar = 1.0
    shading: Scalar = 1.0
    shadows: Scalar = 0.35
    balance: Float[Array, "3"] | tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur: Scalar = 0.0
    noise: Scalar = 0.0
    seed: Int[Array, ""] | int = 0


def eye(pose: Float[Array, "3"], head: Float[Array, "3"], neck: Head = Head()) -> Eye:
    """The camera of a robot at pose (x, y, heading) with neck joints tilt, pan, roll (rad)."""
    (cb, ct, cp, cr), (sb, st, sp, sr) = (f(jnp.append(pose[2], head)) for f in (jnp.cos, jnp.sin))
    zero, one = jnp.zeros_like(cb), jnp.ones_like(cb)
    rows = lambda *m: jnp.stack([jnp.stack(r) for r in m])  # noqa: E731
    body = rows((cb, -sb, zero), (sb, cb, zero), (zero, zero, one))
    tilt = rows((ct, zero, -st), (zero, one, zero), (st, zero, ct))  # positive looks up
    pan = rows((cp, -sp, zero), (sp, cp, zero), (zero, zero, one))
    roll = rows((one, zero, zero), (zero, cr, -sr), (zero, sr, cr))
    high = jax.lax.Precision.HIGHEST
    mul = lambda a, b: jnp.matmul(a, b, precision=high)  # noqa: E731
    turned = mul(mul(body, tilt), pan)
    up, nose = jnp.array([0.0, 0.0, neck.neck]), jnp.array([neck.nose, 0.0, 0.0])
    place = jnp.array([0.0, 0.0, 0.0]).at[:2].set(pose[:2]) + mul(body, jnp.array(neck.base))
    place = place + mul(mul(body, tilt), up) + mul(turned, nose)
    return Eye(place, mul(turned, roll).T)


def boxes(field: Field = FIELD) -> list[tuple[str, tuple, tuple]]:
    """Walls and goals: name of the object, lowest and highest corner (m)."""
    x, y, g = 0.5 * field.length, 0.5 * field.width, 0.5 * field.goal_width
    deep, w, tall = field.goal_depth, WALL, field.goal_height
    found: list[tuple[str, tuple, tuple]] = []
    for s in (-1, 1):
        low, high = sorted((s * y, s * (y + w)))
        found.append(("wall", (-x - w, low, 0.0), (x + w, high, field.wall_height)))
        for t in (-1, 1):
            left, right = sorted((t * g, t * y))
            near, far = sorted((s * x, s * (x + w)))
            found.append(("wall", (near, left, 0.0), (far, right, field.wall_height)))
    for s, name in ((-1, "goal-"), (1, "goal+")):
        near, far = sorted((s * (x + deep), s * (x + deep + w)))
        found.append((name, (near, -g - w, 0.0), (far, g + w, tall)))
        for t in (-1, 1):
            # Outside of the end wall, which they meet.
            left, right = sorted((t * g, t * (g + w)))
            near, far = sorted((s * (x + w), s * (x + deep)))
            found.append((name, (near, left, 0.0), (far, right, tall)))
    return found


def lines(field: Field = FIELD) -> list[tuple[tuple, tuple]]:
    """Straight lines of the floor: centre and half sizes (x, y), m."""
    x, y, half = 0.5 * field.length, 0.5 * field.width, 0.5 * field.line_width
    found: list[tuple[tuple, tuple]] = [((0.0, 0.0), (half, y))]
    for s in (-1, 1):
        edge = s * (x - AREA[0])
        found.append(((edge, 0.0), (half, 0.5 * AREA[1])))
        for t in (-1, 1):
            middle = s * (x - 0.5 * AREA[0])
            found.append(((middle, t * 0.5 * AREA[1]), (0.5 * AREA[0] + half, half)))
    return found


def _surfaces(field: Field, num_robots: int) -> list[tuple[str, str]]:
    """Object and paint of every surface number."""
    surfaces = [("room", "room"), ("floor", "carpet"), ("floor", "line"), ("floor", "ground")]
    surfaces += [("wall", "wall")]
    surfaces += [("goal-", field.goal_colours[0]), ("goal+", field.goal_colours[1])]
    surfaces += [("ball", "ball")]
    for n, mark in enumerate(field.landmarks):
        surfaces += [(f"landmark{n}", paint) for paint in ("white", mark.lower, mark.upper)]
    for n in range(num_robots):
        surfaces += [(f"robot{n}", "silver"), (f"robot{n}", "red")]
    return surfaces


def _cast(scene: Scene, view: Eye, values: Sequence, shading, shadows, camera, field: Field):
    """The value (int32) of the surface that every pixel shows and the share of the light that it
    gets, both [height * width].  values: by surface, in the order of `_surfaces`."""
    num = scene.robots.shape[0]
    surfaces = _surfaces(field, num)
    of = dict(reversed(list(zip(surfaces, values))))
    left, up = (np.float32(a) for a in _plane(camera))
    ox, oy, oz = view.place
    (ax, ay, az), (lx, ly, lz), (ux, uy, uz) = view.axes
    dx, dy, dz = ax + left * lx + up * ux, ay + left * ly + up * uy, az + left * lz + up * uz
    nonzero = lambda d: jnp.where(jnp.abs(d) < 1e-7, 1e-7, d)  # noqa: E731
    dx, dy, dz = nonzero(dx), nonzero(dy), nonzero(dz)
    ix, iy, iz = 1 / dx, 1 / dy, 1 / dz
    lit = lambda cosine: 1 - shading * (1 - AMBIENT) * (1 - jnp.maximum(cosine, 0))  # noqa: E731
    sx, sy, sz = (lit(-jnp.sign(d) * s) for d, s in zip((dx, dy, dz), SUN))

    # Room and floor.
    t = -oz * iz
    x, y = ox + t * dx, oy + t * dy
    below = (dz < 0) & (jnp.maximum(jnp.abs(x), jnp.abs(y)) < HALL)
    inside = (jnp.abs(x) < 0.5 * field.length) & (jnp.abs(y) < 0.5 * field.width)
    in_goal = (jnp.abs(x) < 0.5 * field.length + field.goal_depth) & (
        jnp.abs(y) < 0.5 * field.goal_width
    )
    painted = jnp.abs(jnp.sqrt(x * x + y * y) - CIRCLE) < 0.5 * field.line_width
    for (cx, cy), (hx, hy) in lines(field):
        painted |= (jnp.abs(x - cx) < hx) & (jnp.abs(y - cy) < hy)
    carpet, line, ground = (of["floor", paint] for paint in ("carpet", "line", "ground"))
    value = jnp.where(inside & painted, line, jnp.where(inside | in_goal, carpet, ground))
    shade = lit(jnp.float32(SUN[2]))
    bx, by, bz = scene.ball
    kx, ky = SUN[0] / SUN[2], SUN[1] / SUN[2]
    # The shadow of a ball is an ellipse, here a disc; that of a robot one of its trunk's size.
    dark = (x - bx + kx * bz) ** 2 + (y - by + ky * bz) ** 2 < field.ball_radius**2
    for n in range(num):
        rx, ry, _ = scene.robots[n]
        gap = (x - rx + 0.1 * kx) ** 2 + (y - ry + 0.1 * ky) ** 2
        dark |= (gap < 0.11**2) & scene.present[n]
    shade = jnp.where(dark, shade * (1 - shadows), shade)
    best = jnp.where(below, t, 1e6)
    value = jnp.where(below, value, of["room", "room"])
    shade = jnp.where(below, shade, 0.9)

    def nearer(hit, t, new_value, new_shade):
        nonlocal best, value, shade
        hit = hit & (t > 1e-3) & (t < best)
        best = jnp.where(hit, t, best)
        value = jnp.where(hit, new_value, value)
        shade = jnp.where(hit, new_shade, shade)

    def box(low, high, inverse, light, new_value, there=True):
        """low, high: corners relative to the camera; a camera inside sees nothing of it."""
        near, far = [], []
        for a, b, i in zip(low, high, inverse):
            near.append(jnp.minimum(a * i, b * i))
            far.append(jnp.maximum(a * i, b * i))
        first = jnp.maximum(jnp.maximum(near[0], near[1]), near[2])
        last = jnp.minimum(jnp.minimum(far[0], far[1]), far[2])
        side = jnp.where(
            near[0] == first, light[0], jnp.where(near[1] == first, light[1], light[2])
        )
        nearer((first < last) & there, first, new_value, side)

    for name, low, high in boxes(field):
        new_value = next(v for (owner, _), v in zip(surfaces, values) if owner == name)
        nearest, farthest = (
            tuple(c - o for c, o in zip(corner, (ox, oy, oz))) for corner in (low, high)
        )
        box(nearest, farthest, (ix, iy, iz), (sx, sy, sz), new_value)

    for n in range(num):
        rx, ry, heading = scene.robots[n]
        c, s = jnp.cos(heading), jnp.sin(heading)
        ex, ey = nonzero(c * dx + s * dy), nonzero(c * dy - s * dx)
        px, py = c * (ox - rx) + s * (oy - ry), c * (oy - ry) - s * (ox - rx)
        qx, qy = c * SUN[0] + s * SUN[1], c * SUN[1] - s * SUN[0]
        light = (lit(-jnp.sign(ex) * qx), lit(-jnp.sign(ey) * qy), sz)
        inverse = (1 / ex, 1 / ey, iz)
        for centre, half, uniform in ROBOT:
            low = tuple(m - h - p for m, h, p in zip(centre, half, (px, py, oz)))
            high = tuple(m + h - p for m, h, p in zip(centre, half, (px, py, oz)))
            new_value = of[f"robot{n}", "red" if uniform else "silver"]
            box(low, high, inverse, light, new_value, scene.present[n])

    # Poles: cylinders whose top no camera of a dog looks down on.
    flat = dx * dx + dy * dy
    over = 1 / flat
    radius, foot, band = field.landmark_radius, field.landmark_foot, field.landmark_band
    for n, mark in enumerate(field.landmarks):
        gx, gy = ox - mark.x, oy - mark.y
        half_b = gx * dx + gy * dy
        root = half_b * half_b - flat * (gx * gx + gy * gy - radius**2)
        t = (-half_b - jnp.sqrt(jnp.maximum(root, 0))) * over
        z = oz + t * dz
        white, lower, upper = (of[f"landmark{n}", p] for p in ("white", mark.lower, mark.upper))
        part = jnp.where(z < foot, white, jnp.where(z < foot + band, lower, upper))
        cosine = ((gx + t * dx) * SUN[0] + (gy + t * dy) * SUN[1]) * (1 / radius)
        nearer((root > 0) & (z > 0) & (z < foot + 2 * band), t, part, lit(cosine))

    gx, gy, gz = ox - bx, oy - by, oz - bz
    square = flat + dz * dz
    half_b = gx * dx + gy * dy + gz * dz
    root = half_b * half_b - square * (gx * gx + gy * gy + gz * gz - field.ball_radius**2)
    t = (-half_b - jnp.sqrt(jnp.maximum(root, 0))) / square
    cosine = sum((g + t * d) * s for g, d, s in zip((gx, gy, gz), (dx, dy, dz), SUN)) * (
        1 / field.ball_radius
    )
    nearer(root > 0, t, of["ball", "ball"], lit(cosine))
    return value, shade


def _plane(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Where pixels' rays meet the plane one ahead of the camera: left, up, [height * width]."""
    across, down = math.tan(camera.horizontal / 2), math.tan(camera.vertical / 2)
    left = -across * (2 * (np.arange(camera.width) + 0.5) / camera.width - 1)
    up = -down * (2 * (np.arange(camera.height) + 0.5) / camera.height - 1)
    shape = (camera.height, camera.width)
    return np.broadcast_to(left, shape).ravel(), np.broadcast_to(up[:, None], shape).ravel()


def segment(
    scene: Scene, view: Eye, camera: Camera = Camera(), field: Field = FIELD
) -> Int[Array, "height width"]:
    """Which object every pixel shows: index into `NAMES`, robot n as FIRST_ROBOT + n."""
    numbers = [
        NAMES.index(name) if name in NAMES else FIRST_ROBOT + int(name.removeprefix("robot"))
        for name, _ in _surfaces(field, scene.robots.shape[0])
    ]
    return _numbered(scene, view, numbers, camera, field)


def paints(
    scene: Scene, view: Eye, camera: Camera = Camera(), field: Field = FIELD
) -> Int[Array, "height width"]:
    """Which paint every pixel shows, an index into `list(PAINT)`: labels to calibrate by."""
    order = list(PAINT)
    surfaces = _surfaces(field, scene.robots.shape[0])
    numbers: list = [order.index(paint) for _, paint in surfaces]
    for n in range(scene.robots.shape[0]):
        worn = jnp.where(scene.team[n] == 0, order.index("red"), order.index("blue"))
        numbers[2 * n - 2 * scene.robots.shape[0] + 1] = worn
    return _numbered(scene, view, numbers, camera, field)


def _numbered(scene, view, numbers: list, camera: Camera, field: Field):
    values = [jnp.asarray(n, jnp.int32) for n in numbers]
    value, _ = _cast(scene, view, values, 0.0, 0.0, camera, field)
    return value.reshape(camera.height, camera.width)


def render(
    scene: Scene,
    view: Eye,
    light: Light = Light(),
    camera: Camera = Camera(),
    field: Field = FIELD,
) -> UInt8[Array, "height width 3"]:
    """The camera's picture of a scene.  Options that are the number 0 cost nothing."""
    num = scene.robots.shape[0]
    packed = {name: jnp.int32(_pack(rgb)) for name, rgb in PAINT.items()}
    values = [packed[paint] for _, paint in _surfaces(field, num)]
    for n in range(num):  # the last of a robot's two surfaces is its uniform
        values[2 * n - 2 * num + 1] = jnp.where(scene.team[n] == 0, packed["red"], packed["blue"])
    value, shade = _cast(scene, view, values, light.shading, light.shadows, camera, field)
    gain = 255 / 1023 * light.light * jnp.asarray(light.balance)
    planes = [((value >> 10 * k) & 1023).astype(jnp.float32) * shade * gain[k] for k in range(3)]
    noisy = isinstance(light.noise, jax.Array) or light.noise != 0
    noise = partial(_noise, light.seed, camera.height * camera.width)
    if isinstance(light.blur, jax.Array) or light.blur != 0:
        # One word a pixel between the two loops: writing it is what a loop waits for.
        word = _word(planes)
        planes = [((word >> 8 * k) & 255).astype(jnp.float32) for k in range(3)]
        shape = (camera.height, camera.width)
        planes = [_blurred(p.reshape(shape), light.blur).ravel() for p in planes]
    if noisy:
        planes = [p + light.noise * noise(k) for k, p in enumerate(planes)]
    word = _word(planes)
    # Written into an array of zeros: else XLA casts every ray three times, once for each byte.
    start = jnp.minimum(word[0], 0)
    word = jax.lax.dynamic_update_slice(jnp.zeros_like(word), word, (start,))
    picture = jax.lax.bitcast_convert_type(word, jnp.uint8)[:, :3]
    return picture.reshape(camera.height, camera.width, 3)


def _pack(rgb: tuple[float, float, float]) -> int:
    return sum(round(1023 * c) << 10 * k for k, c in enumerate(rgb))


def _word(planes: list[Float[Array, " n"]]) -> Int[Array, " n"]:
    """Red, green and blue (0 to 255) as bytes of one word."""
    levels = [jnp.clip(p + 0.5, 0, 255).astype(jnp.int32) for p in planes]
    return levels[0] | (levels[1] << 8) | (levels[2] << 16)


def _blurred(plane: Float[Array, "h w"], share) -> Float[Array, "h w"]:
    for axis in (0, 1):
        padded = jnp.pad(plane, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        before = jax.lax.slice_in_dim(padded, 0, plane.shape[axis], axis=axis)
        after = jax.lax.slice_in_dim(padded, 2, plane.shape[axis] + 2, axis=axis)
        plane = plane + share * (before + after - 2 * plane)
    return plane


def _noise(seed, size: int, channel: int) -> Float[Array, " size"]:
    """Numbers of standard deviation 1, near enough to normal: the sum of four bytes of a hash."""
    word = jnp.arange(size, dtype=jnp.uint32) * jnp.uint32(3) + jnp.uint32(channel)
    word = word ^ (jnp.asarray(seed).astype(jnp.uint32) * jnp.uint32(0x9E3779B9))
    for multiplier in (0x21F0AAAD, 0x735A2D97):  # the mixer lowbias32
        word = (word ^ (word >> 16)) * jnp.uint32(multiplier)
    word = word ^ (word >> 15)
    pair = (word & jnp.uint32(0x00FF00FF)) + ((word >> 8) & jnp.uint32(0x00FF00FF))
    total = ((pair & jnp.uint32(0xFFFF)) + (pair >> 16)).astype(jnp.int32).astype(jnp.float32)
    return (total - 510.0) * jnp.float32(1 / 147.80054)
