"""What the head's camera sees, as objects: bearing, elevation and apparent size of each, with
occlusion by robots, noise, misses and false sightings.

The noise is data (`data/camera.json`), so that it can be fitted to Vision on pictures.
"""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from envs.base import SEEN, Camera, Field, Frame, Head
from envs.field import bearing, distance
from envs.soccer import noise
from envs.soccer.referee import directions
from envs.soccer.state import State, upright
from envs.soccer.tables import Sight, Sights
from envs.soccer.trig import cos_sin, unturn

FIRST_CHANNEL = 16  # of a robot's noise in a step; four numbers an object from here on
ROBOT_WIDTH = 0.2  # m, of which a robot's apparent size is told: between side and front (assumed)
ROBOT_HEIGHT = 0.12  # m, of the middle of what one sees of a robot (assumed)
NUM_FIXED = 1 + 6 + 2
MIRROR = (0, 4, 5, 6, 1, 2, 3, 7, 8)  # rows of `fixed` in a mirror image, y to -y
NUM_MATES = sum(name.startswith("mate") for name in SEEN)
NUM_OPPONENTS = sum(name.startswith("opponent") for name in SEEN)


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


def fixed(state: State, field: Field) -> tuple[Array, Array]:
    """Ball, landmarks and goals, the first rows of SEEN: x, y (m, field's frame), [9, R].

    In the robot's team's frame: the away team's landmark 0 is the one at the opposite corner."""
    direction = directions(state.robots, state.game)
    far = 0.5 * field.length
    xs = [0.0, *(mark.x for mark in field.landmarks), -far, far]
    ys = [0.0, *(mark.y for mark in field.landmarks), 0.0, 0.0]
    is_ball = [1.0] + [0.0] * (len(xs) - 1)
    like = direction[None]
    # Sums of products, because a stack of rows would not become vector code.
    x = upright(xs, like) * direction + upright(is_ball, like) * state.ball.x
    y = upright(ys, like) * direction + upright(is_ball, like) * state.ball.y
    return x, y


def others(state: State) -> tuple[Array, Array, Array]:
    """Teammates, then opponents, by shirt: x, y (m, field's frame), on the field, [2 N - 1, R].

    The mate in row k is k + 1 shirts further on."""
    r = state.robots
    n = r.x.shape[0] // 2
    found = []
    for a in (r.x, r.y, r.out <= 0):
        mates = [jnp.concatenate([a[k:n], a[:k], a[n + k :], a[n : n + k]]) for k in range(1, n)]
        shape = a[:n].shape
        theirs = [
            jnp.concatenate([jnp.broadcast_to(a[n + k], shape), jnp.broadcast_to(a[k], shape)])
            for k in range(n)
        ]
        found.append(jnp.stack(mates + theirs))
    return found[0], found[1], found[2]


def occluded(state: State, eyes: Any, dx: Array, dy: Array, z: Any, far: Array, height: Any):
    """Whether a robot other than oneself stands in the line of sight, [K, R].

    eyes: x, y, height of the cameras, [R]; dx, dy: m from the eye to the object; z: its height;
    far: m.  A robot hides what is wholly behind its disc of 0.18 m, below its own height.
    """
    r = state.robots
    n = r.x.shape[0]
    on = r.out <= 0
    one = 1 / far
    ux, uy = dx * one, dy * one
    slope = (z - eyes[2]) * one
    hidden = jnp.zeros_like(dx, bool)
    for j in range(n):
        other = upright([k != j for k in range(n)], r.x)
        gx, gy = r.x[j] - eyes[0], r.y[j] - eyes[1]
        along = gx * ux + gy * uy
        aside = jnp.abs(gx * uy - gy * ux)
        between = (along > 0.12) & (along < far - 0.12) & (aside < 0.09)
        tall = height if isinstance(height, float) else height[j]
        hidden |= between & (eyes[2] + slope * along < tall) & (on[j] & other)
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
    as `sights` say.  Mates and opponents are sorted by apparent size, nearest first: a uniform has
    a colour but no number.
    """
    n = state.robots.x.shape[0] // 2
    eyes = eye(state, head)
    see = partial(_see, state, eyes, neck(state), camera, height, key, perfect)
    x, y = fixed(state, field)
    poles = field.landmark_foot + field.landmark_band, 2 * field.landmark_band, sights.landmark
    goals = 0.5 * field.goal_height, field.goal_height, sights.goal
    ball = field.ball_radius, 2 * field.ball_radius, sights.ball
    rows = see(x, y, jnp.ones_like(x, bool), [ball] + [poles] * 6 + [goals] * 2, FIRST_CHANNEL)
    robot = ROBOT_HEIGHT, ROBOT_WIDTH, sights.robot
    last = see(*others(state), [robot] * (2 * n - 1), FIRST_CHANNEL + 4 * NUM_FIXED)
    # Each group is computed once and then copied together.
    rows, last = jax.lax.optimization_barrier((rows, last))
    robots = [tuple(leaf[k] for leaf in last) for k in range(2 * n - 1)]
    nothing = [tuple(jnp.zeros_like(a) for a in robots[0])]
    mates = nearest(robots[: n - 1] + nothing * (NUM_MATES - n + 1), NUM_MATES)
    theirs = nearest(robots[n - 1 :] + nothing * (NUM_OPPONENTS - n), NUM_OPPONENTS)
    ranked = jax.lax.optimization_barrier(tuple(map(jnp.stack, zip(*mates, *theirs))))
    return Frame(*(jnp.concatenate([a, b]) for a, b in zip(rows, ranked)))


def _see(state, eyes, angles, camera, height, key, perfect, x, y, there, kinds, channel):
    """Some objects at x, y (m, field's frame; [k, R]) in the picture: leaves of `Frame`, [k, R].

    kinds: height of the centre (m), true size (m) and `Sight` of each."""
    r, hand = state.robots, state.game.hand
    each = lambda values: upright(values, x)  # noqa: E731  # a constant for each row
    z, size = each([kind[0] for kind in kinds]), each([kind[1] for kind in kinds])
    dx, dy, dz = x - eyes[0], y - eyes[1], z - eyes[2]
    flat2 = dx * dx + dy * dy
    flat, slant = jnp.sqrt(jnp.maximum(flat2, 1e-8)), jnp.sqrt(flat2 + dz * dz)
    bx, by = unturn(dx, dy, r.cos, r.sin)
    cx, cy, cz = to_camera(bx, by, dz, angles)
    angle, lift = bearing(cx, cy), bearing(distance(cx, cy), cz)
    # 2 atan(size / 2 slant) to the fifth order; 0.1 % off at a slant of two sizes.
    half = jnp.minimum(0.5 * size / slant, 0.5)
    apparent = 2 * half * (1 - half * half * (1 / 3 - 0.2 * half * half))
    awake = r.out <= 0
    if perfect:
        visible = there & awake
    else:
        # A robot that lies on its side sees nothing that it could name (assumed).
        awake &= ~r.fallen
        visible = there & awake & (cx > 0.02)
        visible &= jnp.abs(cy) < math.tan(camera.horizontal / 2) * cx
        visible &= jnp.abs(cz) < math.tan(camera.vertical / 2) * cx
        visible &= ~occluded(state, eyes, dx, dy, z, flat, height)
        sight = Sight(*(each([kind[2][k] for kind in kinds]) for k in range(len(Sight._fields))))
        num = len(kinds)
        # In a mirror image a landmark takes the noise of the one that it is the image of.
        image = MIRROR if num == NUM_FIXED else range(num)
        words = [
            noise.channels(
                key,
                [channel + num * k + row for row in range(num)],
                [channel + num * k + row for row in image],
                hand,
            )
            for k in range(4)
        ]
        chance = noise.to_uniform(words[0])
        missed = chance < sight.miss + sight.miss_small * jnp.exp(apparent * (-1 / 0.02))
        # What is not in the picture is seen in it now and then; rolled with the same number.
        false = awake & ~visible & (chance < sight.false)
        a, b, c = (noise.to_normal(word) for word in words[1:])
        place = noise.to_uniform(noise.mix(words[1])) - 0.5
        spread = jnp.sqrt((sight.size_relative * apparent) ** 2 + sight.size**2)
        angle = jnp.where(false, hand * place * camera.horizontal, angle + hand * sight.bearing * a)
        lift = jnp.where(false, b * (0.2 * camera.vertical), lift + sight.elevation * b)
        apparent = jnp.where(
            false, 0.02 + 0.01 * jnp.abs(c), jnp.maximum(apparent + spread * c, 0.002)
        )
        visible = (visible & ~missed) | false
    return *(jnp.where(visible, a, 0.0) for a in (angle, lift, apparent)), visible


def nearest(rows: list, count: int) -> list:
    """The `count` largest of some rows (bearing, elevation, size, visible), largest first: as a
    network of comparisons, without indices."""
    rows = list(rows)
    for place in range(min(count, len(rows) - 1)):
        for k in range(len(rows) - 1, place, -1):
            swap = rows[k][2] > rows[k - 1][2]
            rows[k - 1], rows[k] = (
                tuple(jnp.where(swap, b, a) for a, b in zip(rows[k - 1], rows[k])),
                tuple(jnp.where(swap, a, b) for a, b in zip(rows[k - 1], rows[k])),
            )
    return rows[:count]
