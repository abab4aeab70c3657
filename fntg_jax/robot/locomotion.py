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


def displacement(senses: Senses, dt: float, trust_gyro: float = 0.7) -> Displacement:
    """The way since the last step, from the gait's odometry; the turn also by the gyroscope.

    trust_gyro: weight of the gyroscope's turn, which slips less than the feet (assumed).
    """
    way = senses.displacement
    turn = (1 - trust_gyro) * way[2] + trust_gyro * senses.gyro[2] * dt
    return Displacement(way[0], way[1], turn)
