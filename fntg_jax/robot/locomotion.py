"""Locomotion: a motion, the head's set-points and words -> what the body is asked for; and the
estimate of the displacement.

The lower half, set-points of joints and their servos, is the body's (`envs`), as in the paper.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from envs.base import Action, Senses, Walk
from fntg_jax.robot.messages import Displacement, Motion


def action(motion: Motion, head: Float[Array, "3"], say: UInt32[Array, "2"]) -> Action:
    """The whole command of a control step.  A kick or a posture goes before walking."""
    stands = (motion.kick > 0) | (motion.posture > 0)
    still = lambda x: jnp.where(stands, 0.0, x)  # noqa: E731
    walk = Walk(motion.style, still(motion.v), still(motion.v_y), still(motion.omega))
    return Action(walk, head, motion.kick, motion.posture, say)


_PUSHED = 0.25  # rad/s: what the gyroscope says beyond the odometry by more than that is a push


def displacement(senses: Senses, dt: float) -> Displacement:
    """The way since the last step, from the gait's odometry; the turn also by the gyroscope.

    The feet know the turn better over time, because the gyroscope's offset adds up; they do not
    know of a push, which shows as a difference of the two far beyond both errors.
    """
    way = senses.displacement
    push = senses.gyro[2] - way[2] / dt
    beyond = push - jnp.clip(push, -_PUSHED, _PUSHED)
    return Displacement(way[0], way[1], way[2] + beyond * dt)
