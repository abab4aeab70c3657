"""Mixtures of suites, and several batches of scenes as one."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from envs.base import Scene
from envs.scenes import get_suite


@dataclasses.dataclass(frozen=True)
class Mix:
    """Training scenes: the named suites in the given proportions, freshly drawn from a key.

    A name may carry options (`scenes.get_suite`).  Counts are rounded to the nearest scene, the
    first suite takes what is left over.  Raises ValueError on an unknown suite or option, or a
    share that is not positive.
    """

    shares: tuple[tuple[str, float], ...]

    def __post_init__(self):
        for name, share in self.shares:
            get_suite(name)
            if not 0 < share <= 1e6:
                raise ValueError(
                    f"share of suite {name} = {share}: allowed are numbers above 0, up to 1e6"
                )

    def __call__(self, key: Key[Array, ""], num_scenes: int) -> Scene:
        total = sum(share for _, share in self.shares)
        counts = [round(num_scenes * share / total) for _, share in self.shares]
        counts[0] += num_scenes - sum(counts)
        keys = jax.random.split(key, len(counts))
        parts = [
            get_suite(name)(k, n) for (name, _), k, n in zip(self.shares, keys, counts) if n > 0
        ]
        return concatenate(parts)


def concatenate(parts: list[Scene]) -> Scene:
    """One batch of scenes out of several.

    Where one part moves and another doesn't, the still one gets velocities of zero; where one has
    fewer obstacles (at least one), it gets copies of its first.

    Args:
        parts: batched scenes, at least one.
    """
    most = max(p.obstacles.shape[-2] for p in parts)
    parts = [_filled_up(p, most - p.obstacles.shape[-2]) for p in parts]
    moving_ball = any(p.ball_velocity is not None for p in parts)
    moving_obstacle = any(p.obstacle_velocity is not None for p in parts)
    full = [
        p._replace(
            ball_velocity=_velocity(p.ball_velocity, p.ball, moving_ball),
            obstacle_velocity=_velocity(p.obstacle_velocity, p.obstacles[..., :2], moving_obstacle),
        )
        for p in parts
    ]
    return jax.tree.map(lambda *xs: jnp.concatenate(xs), *full)


def _filled_up(scene: Scene, num: int) -> Scene:
    """`num` obstacles more: copies of the first, which change nothing."""

    def more(rows):
        return jnp.concatenate([rows, *[rows[:, :1]] * num], axis=1)

    velocity = scene.obstacle_velocity
    return scene._replace(
        obstacles=more(scene.obstacles),
        obstacle_velocity=None if velocity is None else more(velocity),
    )


def _velocity(velocity, like, wanted: bool):
    if not wanted:
        return None
    return jnp.zeros_like(like) if velocity is None else velocity
