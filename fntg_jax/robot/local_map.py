"""The Planner's memory: objects around the robot in polar coordinates, kept up by displacement,
sight and teammates' words.

Every object's place is a Kalman filter of two coordinates with one common variance: displacement
and time add to it, a sighting or a message takes from it by its own uncertainty.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from envs.base import SEEN
from fntg_jax.robot.geometry import length, polar
from fntg_jax.robot.messages import Displacement, Heard, LocalMap, Pose, Scalar, Seen

BALL = SEEN.index("ball")
LANDMARKS = tuple(SEEN.index(f"landmark{n}") for n in range(6))
MATES = tuple(n for n, name in enumerate(SEEN) if name.startswith("mate"))
OPPONENTS = tuple(n for n, name in enumerate(SEEN) if name.startswith("opponent"))

# How fast things move, when nobody looks, m/s (assumed): standard deviation a second.
_DRIFT = tuple(
    0.3 if n == BALL else 0.1 if n in MATES + OPPONENTS else 0.0 for n in range(len(SEEN))
)
_WALK_NOISE = 0.15  # of the displacement's length and turn: odometry (SOCCER facts: 10-20 %)
_FORGOTTEN = 30.0  # s, the greatest age that is told apart
_UNKNOWN = 3.0  # m, standard deviation of what was never seen
_HEARD = 0.12  # m, error of a teammate's word about the ball besides the poses' (quantised, old)
_VELOCITY_GAIN = 0.12  # of the ball's velocity by an innovation, once a step
_BALL_FRICTION = 0.3  # 1/s, by which a remembered ball's velocity fades (assumed)


def empty(shape: tuple[int, ...] = ()) -> LocalMap:
    """A map of nothing: all at 1 m ahead, never seen.  shape: of the batch, trailing."""
    ones = jnp.ones((len(SEEN), *shape), jnp.float32)
    return LocalMap(
        distance=ones,
        cos=ones,
        sin=0 * ones,
        age=_FORGOTTEN * ones,
        sd=_UNKNOWN * ones,
        velocity=jnp.zeros((2, *shape), jnp.float32),
    )


def moved(memory: LocalMap, way: Displacement, turn: tuple, dt: float) -> LocalMap:
    """The map after the robot's own displacement.

    way: m and rad; turn: cosine and sine of way.turn; dt: s since the last step.  The ball rolls on
    with its velocity.
    """
    cos, sin = turn
    x, y = memory.distance * memory.cos - way.x, memory.distance * memory.sin - way.y
    vx, vy = memory.velocity[0], memory.velocity[1]
    x = x.at[BALL].add(vx * dt)
    y = y.at[BALL].add(vy * dt)
    distance, c, s = polar(cos * x + sin * y, cos * y - sin * x)
    drift = jnp.asarray(_DRIFT, jnp.float32).reshape(-1, *(1,) * (distance.ndim - 1))
    walked = _WALK_NOISE * (length(way.x, way.y) + jnp.abs(way.turn) * memory.distance)
    sd = jnp.sqrt(memory.sd**2 + drift**2 * dt + walked**2)
    fade = 1 - _BALL_FRICTION * dt
    return LocalMap(
        distance=distance,
        cos=c,
        sin=s,
        age=jnp.minimum(memory.age + dt, _FORGOTTEN),
        sd=jnp.minimum(sd, _UNKNOWN),
        velocity=fade * jnp.stack([cos * vx + sin * vy, cos * vy - sin * vx]),
    )


def sighted(memory: LocalMap, seen: Seen, dt: float) -> LocalMap:
    """The map after a picture: what was found is moved towards where it was found."""
    noise = jnp.maximum(seen.spread * seen.distance, 0.01)
    gain = jnp.where(seen.visible, memory.sd**2 / (memory.sd**2 + noise**2), 0.0)
    x, y = memory.distance * memory.cos, memory.distance * memory.sin
    dx, dy = seen.distance * seen.cos - x, seen.distance * seen.sin - y
    distance, c, s = polar(x + gain * dx, y + gain * dy)
    # The ball's velocity follows its innovations, where the last sighting is fresh; a jump is
    # another ball, or a kick whose direction the next pictures tell.
    fresh = seen.visible[BALL] & (memory.age[BALL] < 3.5 * dt)
    jump = jnp.stack([dx[BALL], dy[BALL]]) / dt
    jump = jnp.clip(jump, -8.0, 8.0)
    velocity = jnp.where(fresh, memory.velocity + _VELOCITY_GAIN * jump, memory.velocity)
    found_anew = seen.visible[BALL] & ~fresh
    return LocalMap(
        distance=distance,
        cos=c,
        sin=s,
        age=jnp.where(seen.visible, 0.0, memory.age),
        sd=jnp.sqrt(1 - gain) * memory.sd,
        velocity=jnp.where(found_anew, 0.0, velocity),
    )


def told(memory: LocalMap, heard: Heard, pose: Pose, trust: Scalar | float) -> LocalMap:
    """The map after teammates' words about the ball, weighted by their uncertainty.

    trust: s, how old a sighting of a teammate may be, its message's age included.
    """
    age = heard.age + heard.ball_age
    usable = (age < trust) & (memory.age[BALL] > age)
    noise = jnp.sqrt(_HEARD**2 + pose.sd**2 + (0.3 * age) ** 2)
    x, y = memory.distance[BALL] * memory.cos[BALL], memory.distance[BALL] * memory.sin[BALL]
    sd, newest = memory.sd[BALL], memory.age[BALL]
    for mate in range(heard.x.shape[0]):
        east, north = heard.ball_x[mate] - pose.x, heard.ball_y[mate] - pose.y
        bx, by = pose.cos * east + pose.sin * north, pose.cos * north - pose.sin * east
        gain = jnp.where(usable[mate], sd**2 / (sd**2 + noise[mate] ** 2), 0.0)
        x, y, sd = x + gain * (bx - x), y + gain * (by - y), jnp.sqrt(1 - gain) * sd
        newest = jnp.where(usable[mate], jnp.minimum(newest, age[mate]), newest)
    distance, c, s = polar(x, y)
    return memory._replace(
        distance=memory.distance.at[BALL].set(distance),
        cos=memory.cos.at[BALL].set(c),
        sin=memory.sin.at[BALL].set(s),
        sd=memory.sd.at[BALL].set(sd),
        age=memory.age.at[BALL].set(newest),
    )


def placed(memory: LocalMap, pose: Pose, yes: Bool[Array, ""]) -> LocalMap:
    """The map at a kick-off, where `yes`: the ball lies in the middle of the field."""
    x, y = -pose.x, -pose.y
    distance, c, s = polar(pose.cos * x + pose.sin * y, pose.cos * y - pose.sin * x)
    put = lambda old, new: old.at[BALL].set(jnp.where(yes, new, old[BALL]))  # noqa: E731
    return LocalMap(
        distance=put(memory.distance, distance),
        cos=put(memory.cos, c),
        sin=put(memory.sin, s),
        age=put(memory.age, 0.5),
        sd=put(memory.sd, 0.1),
        velocity=jnp.where(yes, 0.0, memory.velocity),
    )
