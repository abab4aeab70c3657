"""The Planner's memory: objects around the robot in polar coordinates, kept up by displacement,
sight and teammates' words.

Every object's place is a Kalman filter of two coordinates with one common variance: displacement
and time add to it, a sighting or a message takes from it by its own uncertainty.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from envs.base import SEEN
from fntg_jax.robot.geometry import length, polar, unit
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
# Of the ball's velocity by an innovation, once a step, along and across the line of sight.
_VELOCITY_GAIN, _VELOCITY_GAIN_ACROSS = 0.15, 0.3
_BEARING_NOISE = 0.015  # rad, of a direction (assumed: two pixels, and the trunk's sway)
_GATE, _ALWAYS = 3.0, 0.15  # standard deviations and m, within which a sighting is no surprise
_BELIEVED = 3.0  # s, age from which any sighting is better than the map
_KICKED = 0.5  # m, standard deviation of the place of a ball that was just kicked
_SAME = 0.4  # m, within which a robot seen is taken for the one on the map
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
    """The map after a picture: what was found is moved towards where it was found.

    Robots have no numbers: each that is seen goes to the place on the map that is nearest to it, or
    to the one that was not seen for longest.  The ball's direction is known far better than its
    distance, so the two are corrected by gains of their own.
    """
    for group in (MATES, OPPONENTS):
        seen = _named(memory, seen, group)
    noise = jnp.maximum(seen.spread * seen.distance, 0.01)
    x, y = memory.distance * memory.cos, memory.distance * memory.sin
    dx, dy = seen.distance * seen.cos - x, seen.distance * seen.sin - y
    # A ball far from where it was is a false sighting, until more of them make the old one doubted;
    # a robot far from where one was is another.
    far = dx * dx + dy * dy > (_GATE * (memory.sd + noise)) ** 2 + _ALWAYS**2
    kind = jnp.arange(len(SEEN)).reshape(-1, *(1,) * (far.ndim - 1))
    doubted = far & seen.visible & (kind == BALL) & (memory.age < _BELIEVED)
    seen = seen._replace(visible=seen.visible & ~doubted)
    before = jnp.where(far & (kind >= MATES[0]), _UNKNOWN, memory.sd)
    gain = jnp.where(seen.visible, before**2 / (before**2 + noise**2), 0.0)
    # Along the line of sight, and across it.
    along = dx * seen.cos + dy * seen.sin
    across = dy * seen.cos - dx * seen.sin
    noise_across = _BEARING_NOISE * seen.distance + 0.005
    gain_across = before**2 / (before**2 + noise_across**2)
    gain_across = jnp.where(seen.visible, gain_across, 0.0)
    kx, ky = gain * along, gain_across * across
    distance, c, s = polar(x + kx * seen.cos - ky * seen.sin, y + kx * seen.sin + ky * seen.cos)
    # The ball's velocity follows its innovations, where the last sighting is fresh.
    fresh = seen.visible[BALL] & (memory.age[BALL] < 3.5 * dt)
    va = jnp.clip(_VELOCITY_GAIN / dt * along[BALL], -1.0, 1.0)
    vc = jnp.clip(_VELOCITY_GAIN_ACROSS / dt * across[BALL], -1.0, 1.0)
    cb, sb = seen.cos[BALL], seen.sin[BALL]
    changed = memory.velocity + jnp.stack([va * cb - vc * sb, va * sb + vc * cb])
    velocity = jnp.where(fresh, changed, memory.velocity)
    found_anew = seen.visible[BALL] & ~fresh
    return LocalMap(
        distance=distance,
        cos=c,
        sin=s,
        age=jnp.where(seen.visible, 0.0, memory.age),
        sd=jnp.where(
            seen.visible,
            jnp.sqrt(1 - gain) * before,
            jnp.minimum(jnp.where(doubted, 1.5 * memory.sd + 0.05, memory.sd), _UNKNOWN),
        ),
        velocity=jnp.where(found_anew, 0.0, velocity),
    )


def _named(memory: LocalMap, seen: Seen, group: tuple[int, ...]) -> Seen:
    """`seen` with the robots of a group in the order of their places on the map."""
    free = [jnp.ones_like(seen.visible[0]) for _ in group]
    rows = {n: [jnp.zeros_like(leaf[n]) for leaf in seen] for n in group}
    for one in group:
        x, y = seen.distance[one] * seen.cos[one], seen.distance[one] * seen.sin[one]
        costs = []
        for k, n in enumerate(group):
            dx = memory.distance[n] * memory.cos[n] - x
            dy = memory.distance[n] * memory.sin[n] - y
            # A place far off is taken only where none is near: the oldest first.
            near = dx * dx + dy * dy
            cost = jnp.where(near < _SAME**2, near, 10.0 + _FORGOTTEN - memory.age[n])
            costs.append(jnp.where(free[k], cost, 1e3 + k))
        least = costs[0]
        for cost in costs[1:]:
            least = jnp.minimum(least, cost)
        taken = jnp.zeros_like(seen.visible[0])
        for k, n in enumerate(group):
            here = seen.visible[one] & (costs[k] == least) & ~taken
            taken |= here
            free[k] &= ~here
            rows[n] = [jnp.where(here, leaf[one], row) for leaf, row in zip(seen, rows[n])]
    first, last = group[0], group[-1] + 1
    return Seen(
        *(
            jnp.concatenate([leaf[:first], jnp.stack([rows[n][i] for n in group]), leaf[last:]])
            for i, leaf in enumerate(seen)
        )
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


def kicked(memory: LocalMap, kick: Array, direction: Array, speed: Array) -> LocalMap:
    """The map when a kick begins: the ball rolls away as the body's table says, more or less.

    kick: 0 for none, else 1 + index; direction (rad) and speed (m/s): [kicks].
    """
    vx, vy = memory.velocity[0], memory.velocity[1]
    for n in range(direction.shape[0]):
        cos, sin = unit(direction[n])
        vx = jnp.where(kick == n + 1, speed[n] * cos, vx)
        vy = jnp.where(kick == n + 1, speed[n] * sin, vy)
    sd = jnp.where(kick > 0, _KICKED, memory.sd[BALL])
    return memory._replace(velocity=jnp.stack([vx, vy]), sd=memory.sd.at[BALL].set(sd))
