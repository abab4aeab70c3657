"""What the head's camera sees, as objects: bearing, elevation and apparent size of each, with
occlusion by robots, noise, misses and false sightings.

The noise is data (`data/camera.json`), so that it can be fitted to Vision on pictures.
"""

import math
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from envs.base import SEEN, Camera, Field, Frame, Head
from envs.field import bearing, distance
from envs.soccer import noise
from envs.soccer.referee import directions
from envs.soccer.state import State, upright
from envs.soccer.tables import Sight, Sights
from envs.soccer.trig import cos_sin, unturn

FIRST_CHANNEL = 16  # of a robot's noise in a step; five numbers an object from here on
ROBOT_WIDTH = 0.2  # m, of which a robot's apparent size is told: between side and front (assumed)
NUM_MATES, NUM_OPPONENTS = SEEN.count("mate0") + SEEN.count("mate1"), 3
KINDS = tuple(
    "landmark" if n.startswith("landmark") else n[:4] for n in SEEN
)  # ball goal mate oppo


def neck(state: State) -> tuple[tuple[Any, Any], tuple[Any, Any], tuple[Any, Any]]:
    """Cosine and sine of tilt, pan and roll, each [R]."""
    r = state.robots
    return cos_sin(r.tilt), cos_sin(r.pan), cos_sin(r.roll)


def eye(state: State, head: Head) -> tuple[Array, Array, Array]:
    """Where the camera is: x, y (m, field's frame) and height (m), each [R]."""
    (ct, st), (cp, sp), _ = neck(state)
    # Tilt up turns x towards z: neck (0, 0, n) goes to (-n sin, 0, n cos).
    ahead = head.base[0] - head.neck * st + head.nose * ct * cp
    left = head.nose * sp
    height = head.base[2] + head.neck * ct + head.nose * st * cp
    r = state.robots
    return r.x + r.cos * ahead - r.sin * left, r.y + r.sin * ahead + r.cos * left, height


def to_camera(x: Any, y: Any, z: Any, angles: Any) -> tuple[Array, Array, Array]:
    """A vector of the body's frame in the camera's: undo tilt (about -y), pan (z) and roll (x)."""
    (ct, st), (cp, sp), (cr, sr) = angles
    x, z = ct * x + st * z, ct * z - st * x
    x, y = cp * x + sp * y, cp * y - sp * x
    y, z = cr * y + sr * z, cr * z - sr * y
    return x, y, z


def targets(state: State, field: Field):
    """Centres of what can be seen, for each robot in the order of SEEN, teammates and opponents by
    shirt: name, x, y [R] or scalar (m, field's frame), height (m), true size (m), on the field."""
    r, game = state.robots, state.game
    direction = directions(r, game)
    n = r.x.shape[0] // 2
    every = jnp.ones_like(r.out, bool)
    found = [("ball", state.ball.x, state.ball.y, field.ball_radius, 2 * field.ball_radius, every)]
    middle = field.landmark_foot + field.landmark_band
    for mark in field.landmarks:
        # In the team's frame: the away team's landmark 0 is the one at the opposite corner.
        found.append(
            (
                "landmark",
                direction * mark.x,
                direction * mark.y,
                middle,
                2 * field.landmark_band,
                every,
            )
        )
    for sign in (-1, 1):
        found.append(
            (
                "goal",
                sign * direction * 0.5 * field.length,
                jnp.zeros_like(r.x),
                0.5 * field.goal_height,
                field.goal_height,
                every,
            )
        )
    on = r.out <= 0
    mates = lambda a, k: jnp.concatenate([jnp.roll(a[:n], -k, 0), jnp.roll(a[n:], -k, 0)])  # noqa: E731
    for k in range(1, n):  # the mate k shirts further on
        found.append(("mate", mates(r.x, k), mates(r.y, k), 0.12, ROBOT_WIDTH, mates(on, k)))
    for k in range(n):
        x, y, there = (
            jnp.concatenate(
                [jnp.broadcast_to(a[n + k], a[:n].shape), jnp.broadcast_to(a[k], a[n:].shape)]
            )
            for a in (r.x, r.y, on)
        )
        found.append(("oppo", x, y, 0.12, ROBOT_WIDTH, there))
    return found


def occluded(state: State, eye_x, eye_y, eye_z, dx, dy, z, far, height: Any) -> Array:
    """Whether a robot other than oneself stands in the line of sight, [R].

    dx, dy: m from the eye to the object; z: its height; far: m.  A robot hides what its disc of
    0.18 m covers below its own height; the object itself, if a robot, hides nothing.
    """
    r = state.robots
    n = r.x.shape[0]
    on = r.out <= 0
    hidden = jnp.zeros_like(on)
    ux, uy = dx / far, dy / far
    for j in range(n):
        gx, gy = r.x[j] - eye_x, r.y[j] - eye_y
        along = gx * ux + gy * uy
        aside = jnp.abs(gx * uy - gy * ux)
        # A robot must be wholly in front of the object, and is not oneself.
        between = (along > 0.12) & (along < far - 0.12) & (aside < 0.09)
        sight = eye_z + (z - eye_z) * along / far
        mine = upright([k == j for k in range(n)], r.x)
        hidden |= between & on[j] & ~mine & (sight < height)
    return hidden


def look(
    state: State,
    field: Field,
    camera: Camera,
    head: Head,
    sights: Sights,
    height: Any,
    key: Array,
    perfect: bool,
) -> Frame:
    """The picture of every robot: a `Frame` with leaves [K, R].

    perfect: everything on the field is there, exactly, in view or not.  Else an object is seen when
    its centre is inside of the picture and not behind a robot, and then missed, moved or invented
    as `sights` say.  What is told of mates and opponents is sorted by apparent size, nearest first:
    a uniform has a colour but no number.
    """
    r, hand = state.robots, state.game.hand
    angles = neck(state)
    eye_x, eye_y, eye_z = eye(state, head)
    wide, high = math.tan(camera.horizontal / 2), math.tan(camera.vertical / 2)
    rows: dict[str, list] = {"mate": [], "oppo": []}
    fixed = []
    # A robot that lies on its side sees nothing that it could name (assumed).
    clear = ~r.fallen & (r.out <= 0)
    for index, (kind, x, y, z, size, there) in enumerate(targets(state, field)):
        dx, dy = x - eye_x, y - eye_y
        flat = distance(dx, dy)
        bx, by = unturn(dx, dy, r.cos, r.sin)
        cx, cy, cz = to_camera(bx, by, z - eye_z, angles)
        slant = distance(flat, z - eye_z)
        angle, lift = bearing(cx, cy), bearing(distance(cx, cy), cz)
        apparent = size / slant  # below 0.3 % from the true angle beyond 2.5 sizes
        if kind == "ball":
            apparent = 2 * bearing(slant, 0.5 * size + 0 * slant)
        if perfect:
            row = (angle, lift, apparent, there & (r.out <= 0))
        else:
            sight: Sight = getattr(sights, "robot" if kind in rows else kind)
            first = FIRST_CHANNEL + 5 * index
            visible = there & clear & (cx > 0.02)
            visible &= (jnp.abs(cy) < wide * cx) & (jnp.abs(cz) < high * cx)
            visible &= ~occluded(state, eye_x, eye_y, eye_z, dx, dy, z, flat, height)
            chance = noise.uniform(key, first)
            missed = chance < sight.miss + sight.miss_small * jnp.exp(apparent * (-1 / 0.02))
            # What is not in the picture is seen in it now and then; rolled with the same number.
            false = clear & ~visible & (chance < sight.false)
            a, b, c = (noise.normal(key, first + k) for k in (1, 2, 3))
            d = noise.uniform(key, first + 4)
            angle = angle + hand * sight.bearing * a
            lift = lift + sight.elevation * b
            apparent = apparent * (1 + sight.size_relative * c) + sight.size * (2 * d - 1) * 1.732
            apparent = jnp.maximum(apparent, 0.002)
            angle = jnp.where(false, hand * (d - 0.5) * camera.horizontal, angle)
            lift = jnp.where(false, b * (0.2 * camera.vertical), lift)
            apparent = jnp.where(false, 0.02 + 0.01 * jnp.abs(c), apparent)
            row = (angle, lift, apparent, (visible & ~missed) | false)
        row = (*(jnp.where(row[3], v, 0.0) for v in row[:3]), row[3])
        rows[kind].append(row) if kind in rows else fixed.append(row)
    mates = nearest(rows["mate"], NUM_MATES)
    opponents = nearest(rows["oppo"], NUM_OPPONENTS)
    return Frame(*(jnp.stack(leaf) for leaf in zip(*fixed, *mates, *opponents)))


def nearest(rows: list, count: int) -> list:
    """The `count` largest of some rows (bearing, elevation, size, visible), largest first, filled
    up with rows of nothing: as a network of comparisons, without indices."""
    rows = list(rows)
    for place in range(min(count, len(rows) - 1)):
        for k in range(len(rows) - 1, place, -1):
            swap = rows[k][2] > rows[k - 1][2]
            rows[k - 1], rows[k] = (
                tuple(jnp.where(swap, b, a) for a, b in zip(rows[k - 1], rows[k])),
                tuple(jnp.where(swap, a, b) for a, b in zip(rows[k - 1], rows[k])),
            )
    return rows[:count]
