"""The pixel level of the camera in a match: every robot's picture, drawn by `envs.soccer.image`.

Each robot's picture is drawn in its team's frame and colours: its own goal is the skyblue one, its
mates wear red.  So no robot need be told on which half it plays, as at the objects level.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt8

from envs.base import Camera, Field, Head
from envs.field import bearing
from envs.soccer import image, noise
from envs.soccer.referee import directions
from envs.soccer.state import State

# The hall's light differs from match to match; the camera's blur and noise (assumed, all of it).
DARKEST, BRIGHTEST = 0.6, 1.4
BLUR, NOISE = 0.12, 4.0


def look(
    state: State, field: Field, camera: Camera, head: Head, key: Array, lane_key: Array
) -> UInt8[Array, "height width 3 R ..."]:
    """What every robot's camera shows.  One that has fallen or is sent off sees nothing.

    key, lane_key: noise's keys of each robot, of this step and of the match, [R, ...].
    """
    r, count = state.robots, state.robots.x.shape[0]
    batch = r.x.shape[1:]
    own = directions(r, state.game)
    rest = np.array([[(k + n) % count for n in range(1, count)] for k in range(count)])
    mates = rest // (count // 2) == np.arange(count)[:, None] // (count // 2)

    def flat(a: Array) -> Array:  # [R, ..., n] to one row a robot
        return a.reshape(-1, *a.shape[1 + len(batch) :])

    def seen(a: Array) -> Array:  # [R, ...] to each robot's others, one row a robot
        return flat(jnp.moveaxis(a[rest], 1, -1))

    turned = lambda a: seen(a) * flat(own)[:, None]  # noqa: E731
    others = jnp.stack([turned(r.x), turned(r.y), bearing(turned(r.cos), turned(r.sin))], -1)
    pose = jnp.stack([own * r.x, own * r.y, bearing(own * r.cos, own * r.sin)], -1)
    ball = jnp.stack([own * state.ball.x, own * state.ball.y], -1)
    # Seeds of one match are alike for all its robots: lane 0's.
    light = DARKEST + (BRIGHTEST - DARKEST) * noise.uniform(lane_key[:1], 900)
    light = jnp.where((r.out > 0) | r.fallen, 0.0, light)
    team = jnp.broadcast_to(
        jnp.asarray(~mates).astype(jnp.int32).reshape(count, *(1,) * len(batch), count - 1),
        (*r.x.shape, count - 1),
    )

    def one(args) -> Array:
        pose, neck, ball, others, team, present, light, seed = args
        ball = jnp.append(ball, field.ball_radius)
        scene = image.Scene(ball, others, team, present)
        shown = image.Light(light, blur=BLUR, noise=NOISE, seed=seed)
        return image.render(scene, image.eye(pose, neck, head), shown, camera, field)

    neck = jnp.stack([r.tilt, r.pan, r.roll], -1)
    rows = (
        flat(pose),
        flat(neck),
        flat(ball),
        others,
        flat(team),
        seen(r.out) <= 0,
        flat(light),
        flat(noise.bits(key, 901).astype(jnp.int32)),
    )
    # On a CPU one after the other: a picture then stays in the cache.
    draw = (lambda rows: jax.lax.map(one, rows)) if _on_cpu() else jax.vmap(one)
    pictures = draw(rows)
    pictures = pictures.reshape(*r.x.shape, *pictures.shape[1:])
    return jnp.moveaxis(pictures, (-3, -2, -1), (0, 1, 2))


def _on_cpu() -> bool:
    return jax.default_backend() == "cpu"
