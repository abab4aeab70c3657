"""Bodies that walk, kick and get up by tables, and push each other.

A body is a capsule along its heading for other bodies and walls, and a rounded box for the ball.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from envs.base import Action, Field, Head
from envs.field import distance
from envs.soccer import noise
from envs.soccer.ball import Boxes, keep_in
from envs.soccer.state import Robots, upright
from envs.soccer.tables import Body
from envs.soccer.trig import cos_sin, pick, turn

POSTURE = 100  # `Robots.doing` from here on: postures
SPIN = 112.0  # 1/m^2, mass over moment of inertia of a homogeneous box of the dog's size

# Channels of a robot's noise within a step; camera and senses use others.
SLIP_X, SLIP_Y, SLIP_TURN, KICK_SPEED, KICK_DIRECTION, KICK_MISS, GETTING_UP, FALLING = range(8)
ODOMETRY_X, ODOMETRY_Y, ODOMETRY_TURN = 8, 9, 10
SCALE, SCALE_TURN, DRIFT, BIAS = range(4)  # of the lane's own key (tick -1): constant in a match


class Bodies(NamedTuple):
    """The two teams' bodies."""

    home: Body
    away: Body

    def column(self, part: str, name: str, index: Any) -> Array:
        """Entries of a table's column ("styles", "kicks", "postures") for robots' indices [R]."""

        def of(body, index):
            return pick(getattr(getattr(body, part), name) or (0.0,), index)

        if self.home is self.away:
            return of(self.home, index)
        n = index.shape[0] // 2
        return jnp.concatenate([of(self.home, index[:n]), of(self.away, index[n:])])

    def zone(self, edge: int, index: Array) -> Array:
        """Edge 0-3 of the zone of kicks by index, [R]."""

        def of(body, index):
            return pick([z[edge] for z in body.kicks.zone] or (0.0,), index)

        if self.home is self.away:
            return of(self.home, index)
        n = index.shape[0] // 2
        return jnp.concatenate([of(self.home, index[:n]), of(self.away, index[n:])])

    def value(self, name: str, like: Array) -> Any:
        """A field of `Body`: a number where both teams have the same, else [R]."""
        home, away = getattr(self.home, name), getattr(self.away, name)
        if home == away:
            return home
        n = like.shape[0] // 2
        return upright([home] * n + [away] * n, like)


class Kicked(NamedTuple):
    """What kicks do to the ball in this step: by whom [R], and the velocity they give it."""

    by: Bool[Array, " R"]
    vx: Array
    vy: Array


def act(bodies: Bodies, robots: Robots, action: Action, may: Array, key: Array, dt: float):
    """Start what the action asks for and carry on what was started.

    may: [R], the robot is on the field and play goes on.  A kick or posture runs to its end before
    the next thing begins; a fallen robot can only take postures.  Returns robots and, for the ball,
    which kick ([R], index) hits now.
    """
    kicks: Any
    postures: Any
    kicks, postures = len(bodies.home.kicks.name), len(bodies.home.postures.name)
    if bodies.home is not bodies.away:
        n = robots.x.shape[0] // 2
        kicks = upright([kicks] * n + [len(bodies.away.kicks.name)] * n, robots.x)
        postures = upright([postures] * n + [len(bodies.away.postures.name)] * n, robots.x)
    free = may & (robots.busy <= 0)
    kick = free & ~robots.fallen & (action.kick > 0) & (action.kick <= kicks)
    pose = free & ~kick & (action.posture > 0) & (action.posture <= postures)
    doing = jnp.where(
        kick, action.kick, jnp.where(pose, POSTURE + action.posture - 1, robots.doing)
    )
    doing = jnp.where(free & ~kick & ~pose, 0, doing).astype(jnp.int32)
    time = jnp.where(
        kick,
        bodies.column("kicks", "duration", doing - 1),
        bodies.column("postures", "duration", doing - POSTURE),
    )
    busy = jnp.where(kick | pose, time, robots.busy)
    # Half a step of slack: sums of 0.1 s are not exact.
    kicking = may & (doing > 0) & (doing < POSTURE) & (busy > 0)
    left = bodies.column("kicks", "duration", doing - 1) - bodies.column(
        "kicks", "delay", doing - 1
    )
    strikes = kicking & (jnp.abs(busy - left - 0.25 * dt) < 0.5 * dt)
    after = jnp.where(may, jnp.maximum(busy - dt, 0), robots.busy)
    after = jnp.where(after < 0.25 * dt, 0.0, after)
    up = (doing >= POSTURE) & (busy > 0) & (after <= 0)
    up &= noise.uniform(key, GETTING_UP) < bodies.column("postures", "gets_up", doing - POSTURE)
    return (
        robots._replace(doing=doing, busy=after, fallen=robots.fallen & ~up),
        jnp.where(strikes, doing, 0),
        busy > 0,
    )


def strike(
    bodies: Bodies,
    robots: Robots,
    kick: Array,
    ball: Any,
    key: Array,
    hand: Array,
    max_speed: float,
) -> Kicked:
    """Kicks by the table of outcomes.  kick: [R], 0 or 1 + index of the kick that hits now."""
    dx, dy = ball.x - robots.x, ball.y - robots.y
    lx, ly = robots.cos * dx + robots.sin * dy, robots.cos * dy - robots.sin * dx
    index = kick - 1
    by = (kick > 0) & ~robots.fallen
    by &= (lx > bodies.zone(0, index)) & (lx < bodies.zone(1, index))
    by &= (ly > bodies.zone(2, index)) & (ly < bodies.zone(3, index))
    column = lambda name: bodies.column("kicks", name, index)  # noqa: E731
    by &= noise.uniform(key, KICK_MISS) >= column("miss")
    speed = column("speed") * (1 + column("speed_spread") * noise.normal(key, KICK_SPEED))
    speed = jnp.clip(speed, 0.0, max_speed)
    # A direction is 1.2 + 4.04 x 0.25 rad at most: within pi, where the polynomial holds.
    angle = column("direction") + column("direction_spread") * hand * noise.normal(
        key, KICK_DIRECTION
    )
    c, s = cos_sin(0.5 * angle)
    fx, fy = turn(1 - 2 * s * s, 2 * s * c, robots.cos, robots.sin)
    return Kicked(by, speed * fx, speed * fy)


def walk(
    bodies: Bodies,
    robots: Robots,
    action: Action,
    free: Array,
    key: Array,
    lane_key: Array,
    hand: Array,
    feelings: Any,
    dt: float,
) -> Robots:
    """One step of the gait: limits, lag, slip, and the displacement as odometry has it.

    free: [R], it may walk.  Limits of a style are the half axes of an ellipsoid of (v, v_y, omega);
    what lies outside is scaled down onto it.
    """
    walk = action.walk
    style = walk.style
    column = lambda name: bodies.column("styles", name, style)  # noqa: E731
    forward = jnp.where(walk.v >= 0, column("forward"), column("backward"))
    lateral, spin = column("lateral"), column("turn")
    sanitary = lambda x: jnp.where(jnp.abs(x) < 1e3, x, 0.0)  # noqa: E731  # no NaN gets in
    v, v_y, omega = sanitary(walk.v), sanitary(walk.v_y), sanitary(walk.omega)
    v_y = jnp.where(lateral > 0, v_y, 0.0)
    fx, fy, fw = v / forward, v_y / jnp.maximum(lateral, 1e-6), omega / spin
    scale = jnp.where(free, 1 / jnp.sqrt(jnp.maximum(fx * fx + fy * fy + fw * fw, 1.0)), 0.0)
    lag = column("lag")
    gain = dt / (dt + lag)
    v = robots.v + gain * (scale * v - robots.v)
    v_y = robots.v_y + gain * (scale * v_y - robots.v_y)
    omega = robots.omega + gain * (scale * omega - robots.omega)

    slip, slip_turn = column("slip"), column("slip_turn")
    mean_v, mean_v_y, mean_omega = (
        0.5 * (a + b) for a, b in ((v, robots.v), (v_y, robots.v_y), (omega, robots.omega))
    )
    # Slip in proportion to the motion, in all directions: a fast walk also goes astray.
    pace = distance(mean_v, mean_v_y) * dt
    turning = jnp.abs(mean_omega) * dt
    sx = mean_v * dt + slip * pace * noise.normal(key, SLIP_X)
    sy = mean_v_y * dt + hand * slip * pace * noise.normal(key, SLIP_Y)
    turned = mean_omega * dt + hand * (slip_turn * (turning + pace)) * noise.normal(key, SLIP_TURN)
    # Midpoint: the displacement points half of the turn ahead.
    ch, sh = cos_sin(0.5 * turned)
    mx, my = turn(sx, sy, *_product(robots.cos, robots.sin, ch, sh))
    cos, sin = _product(robots.cos, robots.sin, ch, sh)
    cos, sin = _product(cos, sin, ch, sh)

    odometry, odometry_turn = column("odometry"), column("odometry_turn")
    scale_walk = 1 + feelings.scale * noise.normal(lane_key, SCALE)
    scale_turn = 1 + feelings.scale_turn * noise.normal(lane_key, SCALE_TURN)
    drift = feelings.drift * noise.normal(lane_key, DRIFT) * pace * (1 / 0.15)
    return robots._replace(
        x=robots.x + mx,
        y=robots.y + my,
        cos=cos,
        sin=sin,
        v=v,
        v_y=v_y,
        omega=omega,
        turned=turned,
        odometry_x=scale_walk * sx + odometry * pace * noise.normal(key, ODOMETRY_X),
        odometry_y=scale_walk * sy + hand * odometry * pace * noise.normal(key, ODOMETRY_Y),
        odometry_turn=scale_turn * turned
        + hand * (drift + odometry_turn * (turning + pace) * noise.normal(key, ODOMETRY_TURN)),
        gained_x=v - robots.v,
        gained_y=v_y - robots.v_y,
    )


def _product(c1, s1, c2, s2):
    return c1 * c2 - s1 * s2, s1 * c2 + c1 * s2


def nod(robots: Robots, action: Action, head: Head, free: Array, dt: float) -> Robots:
    """Head joints towards where the action wants them, at their own speeds, within limits.

    action.head: [3, R], component first.  free: [R], the body stands and plays no motion."""

    def joint(now, wanted, n):
        wanted = jnp.where(free & (jnp.abs(wanted) < 1e3), wanted, now)
        reach = head.speed[n] * dt
        return now + jnp.clip(jnp.clip(wanted, head.low[n], head.high[n]) - now, -reach, reach)

    return robots._replace(
        tilt=joint(robots.tilt, action.head[0], 0),
        pan=joint(robots.pan, action.head[1], 1),
        roll=joint(robots.roll, action.head[2], 2),
    )


def push(bodies: Bodies, robots: Robots, field: Field) -> Robots:
    """Move overlapping capsules apart and out of the walls, turning where the contact has a lever.

    The nearest points of the two axes are the contact (C. Ericson, Real-Time Collision Detection,
    5.1.9); both bodies have equal mass and give way alike.  Pairs are taken by how many robots
    they are apart in the cycle of all: calling the other team home then changes no bit.
    """
    radius = 0.5 * bodies.value("width", robots.x)
    half = 0.5 * bodies.value("length", robots.x) - radius
    n = robots.x.shape[0]
    on = robots.out <= 0
    x, y, c, s = robots.x, robots.y, robots.cos, robots.sin
    px = py = spin = jnp.zeros_like(x)
    for apart in range(1, n // 2 + 1):
        other = lambda a, k=apart: a if isinstance(a, float) else _cycled(a, k)  # noqa: E731
        ax, ay, turn_first, turn_other = _contact(
            x - other(x),
            y - other(y),
            c,
            s,
            other(c),
            other(s),
            half,
            other(half),
            radius + other(radius),
            on & other(on),
        )
        px, py, spin = px + ax, py + ay, spin + turn_first
        if apart < n // 2:  # opposite ones meet twice, once from each end
            px, py = px - _cycled(ax, -apart), py - _cycled(ay, -apart)
            spin = spin + _cycled(turn_other, -apart)
    spin = jnp.clip(spin, -0.3, 0.3)
    ch, sh = cos_sin(spin)
    c, s = _product(c, s, ch, sh)
    x, y = x + px, y + py
    wx, wy, spin = _walls(x, y, c, s, half, bodies, field, on)
    ch, sh = cos_sin(jnp.clip(spin, -0.3, 0.3))
    c, s = _product(c, s, ch, sh)
    x, y = x + wx, y + wy
    # Whatever a lever has left in the wall.
    wx, wy = _clamp(x, y, half * c, half * s, radius, field)
    x, y = jnp.where(on, x + wx, x), jnp.where(on, y + wy, y)
    long = 1.5 - 0.5 * (c * c + s * s)  # one Newton step towards length 1
    return robots._replace(x=x, y=y, cos=c * long, sin=s * long)


def _contact(dx, dy, c1, s1, c2, s2, half1, half2, reach, on):
    """How far the first of two capsules moves (x, y; m) and how far each turns (rad)."""
    # d1 . d2, d1 . r, d2 . r with unit axes d1, d2 and r from the second's centre to the first's.
    b = c1 * c2 + s1 * s2
    p1, p2 = c1 * dx + s1 * dy, c2 * dx + s2 * dy
    den = jnp.maximum(1 - b * b, 1e-4)
    t1 = jnp.clip((b * p2 - p1) / den, -half1, half1)
    t2 = jnp.clip(b * t1 + p2, -half2, half2)
    t1 = jnp.clip(b * t2 - p1, -half1, half1)
    gx, gy = dx + t1 * c1 - t2 * c2, dy + t1 * s1 - t2 * s2
    gap2 = jnp.maximum(gx * gx + gy * gy, 1e-12)
    one = jax.lax.rsqrt(gap2)
    depth = jnp.where(on, jnp.maximum(reach - gap2 * one, 0), 0.0)
    nx, ny = gx * one, gy * one
    lever1, lever2 = t1 * (c1 * ny - s1 * nx), t2 * (c2 * ny - s2 * nx)
    share = 0.8 * depth / (2 + SPIN * (lever1 * lever1 + lever2 * lever2))
    return share * nx, share * ny, SPIN * share * lever1, -SPIN * share * lever2


def _cycled(a: Array, k: int) -> Array:
    """Row i + k of the cycle of all robots in row i."""
    return jnp.concatenate([a[k:], a[:k]])


def topple(bodies: Bodies, robots: Robots, style: Any, may: Array, key: Array, dt: float) -> Robots:
    """A push faster than the style stands fells a body: assumed, with a spread of +-25 %."""
    pushed = distance(robots.push_x, robots.push_y) * (1 / dt)
    spread = 0.75 + 0.5 * noise.uniform(key, FALLING)
    falls = may & (pushed > spread * bodies.column("styles", "stability", style))
    return robots._replace(
        fallen=robots.fallen | falls,
        doing=jnp.where(falls, 0, robots.doing),
        busy=jnp.where(falls, 0.0, robots.busy),
    )


def _walls(x, y, c, s, half, bodies, field, on):
    """How far walls move and turn bodies, front end first."""
    # One radius for all, the wider body's.
    radius = 0.5 * max(bodies.home.width, bodies.away.width)
    mx = my = spin = jnp.zeros_like(x)
    for sign in (1.0, -1.0):
        ex, ey = x + mx + sign * half * c, y + my + sign * half * s
        px, py = keep_in(ex, ey, radius, field)
        px, py = jnp.where(on, px, 0.0), jnp.where(on, py, 0.0)
        arm = sign * half * (c * py - s * px)  # (r x n) depth
        depth2 = px * px + py * py
        weight = depth2 / jnp.maximum(depth2 + SPIN * arm * arm, 1e-12)
        spin = spin + SPIN * arm * weight
        mx, my = mx + px * weight, my + py * weight
    return mx, my, spin


def _clamp(x, y, ex, ey, radius, field):
    """How far a capsule with ends (x, y) +- (ex, ey) must move to be on the field or in a goal."""
    ax, ay = jnp.abs(ex), jnp.abs(ey)
    top = jnp.abs(y) + ay
    end = 0.5 * field.length - radius
    # Both ends in the mouth: as deep as the goal.
    end = jnp.where(top < 0.5 * field.goal_width, end + field.goal_depth, end)
    wx = jnp.minimum(end - ax - jnp.abs(x), 0)
    wy = jnp.minimum(0.5 * field.width - radius - top, 0)
    return jnp.where(x < 0, -wx, wx), jnp.where(y < 0, -wy, wy)


def boxes(bodies: Bodies, robots: Robots, before: Robots, dt: float) -> Boxes:
    """Bodies as the ball meets them, with the velocities that lead from `before` to `robots`."""
    posture = (robots.doing >= POSTURE) & (robots.busy > 0)
    width = jnp.where(
        posture,
        bodies.column("postures", "width", robots.doing - POSTURE),
        bodies.value("width", robots.x),
    )
    rate = 1 / dt
    return Boxes(
        x=before.x,
        y=before.y,
        cos=before.cos,
        sin=before.sin,
        vx=(robots.x - before.x) * rate,
        vy=(robots.y - before.y) * rate,
        omega=(before.cos * robots.sin - before.sin * robots.cos) * rate,
        chest=bodies.value("chest", robots.x),
        rear=0.5 * bodies.value("length", robots.x),
        half_width=0.5 * width,
        grip=bodies.value("grip", robots.x),
        restitution=bodies.value("restitution", robots.x),
        on=robots.out <= 0,
    )
