"""Planner: from the local map, the pose and teammates' words to a role and a behaviour of Table 1.

`facts` says what the decision rests on, `RULES` is the decision: from above, the first rule whose
condition holds chooses the behaviour and its data.  Everything is elementwise on batches.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from fntg_jax.robot.behaviors import BALL_AHEAD
from fntg_jax.robot.genes import Genes
from fntg_jax.robot.geometry import angle, length, unit, wrap
from fntg_jax.robot.local_map import BALL, MATES, OPPONENTS
from fntg_jax.robot.messages import Heard, LocalMap, Need, Order, Pose, Scalar

ROLES = ("goalkeeper", "attacker", "supporter")
GOALKEEPER, ATTACKER, SUPPORTER = range(3)

_ROBOT = 0.11  # m, radius of the disc that another robot is taken for (body 0.289 x 0.152 m)
_AREA_DEPTH, _AREA_SIDE = 0.40, 0.55  # m, of the own penalty area, with a margin for a body
_HELD_AHEAD = 0.175  # m, from the centre, within which it lies at the chest
_DIAGONAL = 0.70711
_CORNER = 0.68  # of half the mouth, where a shot beside a post is aimed
_BODY = 0.15  # m, from a robot's centre, within which it stops a ball
_ROUND = 1.2  # rad, around the ball at a time: a straight way to there does not touch it
_MIDDLE = 0.3  # m, from the long axis, within which the ball lies in the middle
_NO_OBSTACLE = 3.0  # m, the distance that BIOA is told where there is none


class Kicks(NamedTuple):
    """The body's table of kicks, leaves [kicks], in the robot's frame.

    direction: rad, of the ball afterwards; speed: m/s; reach: m, how far it rolls; low_x .. high_x,
    low_y .. high_y: m, where the ball has to lie for it.
    """

    direction: Float[Array, " kicks"]
    speed: Float[Array, " kicks"]
    reach: Float[Array, " kicks"]
    low_x: Float[Array, " kicks"]
    high_x: Float[Array, " kicks"]
    low_y: Float[Array, " kicks"]
    high_y: Float[Array, " kicks"]


class Ground(NamedTuple):
    """What the Planner knows of the field, m: half its length and width, half the goal's mouth."""

    half_length: float = 1.4
    half_width: float = 0.9
    half_goal: float = 0.3


class Facts(NamedTuple):
    """What the rules ask about.  Distances m, angles rad in the robot's frame, times s.

    known: the ball is on the map; d_ball, ball: its distance and direction; aim: direction in which
    it is to be pushed, seen from the ball; misaligned: by how much the robot is off from behind it;
    kick: the best kick for a ball in its zone; shot: it would roll into the goal past everybody;
    gain: by how much it would bring the ball nearer to the goal, m (-9: no kick's zone has the
    ball); at_wall: the ball lies at a wall; barred: it lies in the own penalty area, where field
    players have to keep out; waits: the others kick off; held: how long the ball has been at the
    chest;
    to_own: distance of the ball from the own goal; target, d_target:
    the place of the role; approach, d_approach: the place behind the ball; arrival: time until the
    ball passes the robot; crossing: how far to the right it will, m; incoming: speed towards it;
    d_obstacle, obstacle: the nearest; role: index into `ROLES`.
    """

    known: Bool[Array, ""]
    d_ball: Scalar
    ball: Scalar
    aim: Scalar
    misaligned: Scalar
    kick: Int[Array, ""]
    shot: Bool[Array, ""]
    gain: Scalar
    at_wall: Bool[Array, ""]
    barred: Bool[Array, ""]
    waits: Bool[Array, ""]
    held: Scalar
    to_own: Scalar
    target: Scalar
    d_target: Scalar
    approach: Scalar
    d_approach: Scalar
    arrival: Scalar
    crossing: Scalar
    incoming: Scalar
    d_obstacle: Scalar
    obstacle: Scalar
    role: Int[Array, ""]


def facts(
    memory: LocalMap,
    pose: Pose,
    heard: Heard,
    role: Array,
    shirt: Array,
    genes: Genes,
    kicks: Kicks,
    ground: Ground,
    proximity: tuple[Scalar, Scalar],
    goalkeeper: Array,
    waits: Array,
    held: Scalar,
    dt: float,
) -> Facts:
    """What the decision rests on.

    role, held: of the last step; shirt: 0, 1, ...; proximity: the head's infrared distance (m) and
    the direction it was measured in (rad); goalkeeper: whether shirt 0 keeps the goal;
    waits: whether the others kick off; dt: s.
    """
    d_ball = memory.distance[BALL]
    bx, by = d_ball * memory.cos[BALL], d_ball * memory.sin[BALL]
    ball = angle(bx, by)
    known = memory.age[BALL] < genes.ball_forgotten
    # The ball in the team's frame, and where it is to go.
    east = pose.x + pose.cos * bx - pose.sin * by
    north = pose.y + pose.sin * bx + pose.cos * by
    east = jnp.clip(east, -ground.half_length, ground.half_length)
    north = jnp.clip(north, -ground.half_width, ground.half_width)
    to_own = length(east + ground.half_length, north)
    lanes = _lanes(memory, pose, bx, by, genes)
    gx, gy = _opening(east, north, lanes, genes, ground)
    gx, gy, at_wall = _off_wall(gx, gy, east, north, genes, ground)
    keeps = (shirt == 0) & goalkeeper
    barred = (east < _AREA_DEPTH - ground.half_length) & (jnp.abs(north) < _AREA_SIDE)
    barred &= shirt != 0
    aim = _relative(gx, gy, pose)
    misaligned = wrap(aim - ball)
    # The place behind the ball, or on the way round it: no farther round than `_ROUND`.
    c, s = unit(ball + jnp.clip(misaligned, -_ROUND, _ROUND))
    px, py = bx - genes.behind * c, by - genes.behind * s
    px, py = pose.x + pose.cos * px - pose.sin * py, pose.y + pose.sin * px + pose.cos * py
    px, py = _inside(px, py, genes.wall, ground)
    px = _out_of_area(px, py, shirt, ground)
    # Far off and misaligned: to the place behind the ball; else to the ball.
    share = jnp.clip(jnp.abs(misaligned) / genes.straight_on - 1.0, 0.0, 1.0)
    tx, ty = east + share * (px - east), north + share * (py - north)
    tx = _out_of_area(tx, ty, shirt, ground)
    approach_x, approach_y = _local(tx, ty, pose)

    kick, shot, gain = _best_kick(bx, by, east, north, pose, lanes, genes, kicks, ground)
    # How long the ball has been at the chest: who pushes on the spot feels his feet walk.
    at_chest = (bx > 0.0) & (bx < _HELD_AHEAD) & (jnp.abs(by) < 0.12) & known
    held = jnp.where(at_chest, held + dt, 0.0)
    role = _role(d_ball, misaligned, east, north, known, heard, role, shirt, keeps, genes)
    # Places: goalkeeper before its line on the ball's side; supporter behind and beside the ball.
    keeper_y = jnp.clip(genes.keeper_side * north, -0.8 * ground.half_goal, 0.8 * ground.half_goal)
    keeper_y = jnp.where(known, keeper_y, 0.0)
    home = jnp.where(shirt % 2 == 1, 0.5, -0.5)
    # Across the ball from the nearer wall; in the middle on the side where it is already.
    aside = jnp.where(jnp.abs(north) > _MIDDLE, -north, pose.y - north)
    place_x = jnp.where(known, east - genes.support_behind, -0.4)
    place_y = jnp.where(known, north + jnp.where(aside >= 0, 1, -1) * genes.support_aside, home)
    place_x, place_y = _inside(place_x, place_y, genes.wall + 0.05, ground)
    keeper = role == GOALKEEPER
    place_x = _out_of_area(place_x, place_y, shirt, ground)
    place_x = jnp.where(keeper, -ground.half_length + genes.keeper_line, place_x)
    place_y = jnp.where(keeper, keeper_y, place_y)
    target_x, target_y = _local(place_x, place_y, pose)

    # Where the rolling ball will cross the robot's lateral axis.
    vx, vy = memory.velocity[0], memory.velocity[1]
    incoming = -vx
    arrival = jnp.clip(bx / jnp.maximum(incoming, 0.02), 0.0, 9.0)
    crossing = -(by + vy * jnp.minimum(arrival, 3.0))
    to_ball = (role == ATTACKER) | (keeper & (d_ball < genes.keeper_out))
    wx, wy = jnp.where(to_ball, approach_x, target_x), jnp.where(to_ball, approach_y, target_y)
    d_obstacle, obstacle = nearest(memory, pose, genes, ground, proximity, d_ball, ball, (wx, wy))
    return Facts(
        known=known,
        d_ball=d_ball,
        ball=ball,
        aim=aim,
        misaligned=misaligned,
        kick=kick,
        shot=shot & known,
        gain=jnp.where(known, gain, -9.0),
        at_wall=at_wall,
        barred=barred,
        waits=waits,
        held=held,
        to_own=to_own,
        target=angle(target_x, target_y),
        d_target=length(target_x, target_y),
        approach=angle(approach_x, approach_y),
        d_approach=length(approach_x, approach_y),
        arrival=arrival,
        crossing=crossing,
        incoming=incoming,
        d_obstacle=d_obstacle,
        obstacle=obstacle,
        role=role,
    )


def _local(x, y, pose):
    """A place of the team's frame in the robot's."""
    dx, dy = x - pose.x, y - pose.y
    return pose.cos * dx + pose.sin * dy, pose.cos * dy - pose.sin * dx


def _relative(dx, dy, pose):
    """A direction of the team's frame in the robot's, rad."""
    return angle(pose.cos * dx + pose.sin * dy, pose.cos * dy - pose.sin * dx)


def _inside(x, y, margin, ground):
    """The place of the field nearest to (x, y) that keeps a margin from the walls."""
    half_x, half_y = ground.half_length - margin, ground.half_width - margin
    return jnp.clip(x, -half_x, half_x), jnp.clip(y, -half_y, half_y)


def _out_of_area(x, y, shirt, ground):
    """x of a place, moved out of the own penalty area, which only shirt 0 may be in."""
    edge = jnp.where(jnp.abs(y) < _AREA_SIDE + 0.1, _AREA_DEPTH + 0.1 - ground.half_length, -9.0)
    return jnp.where(shirt == 0, x, jnp.maximum(x, edge))


def _lanes(memory, pose, bx, by, genes):
    """Where opponents stand, seen from the ball, in the team's frame: x, y (m), and whether they
    count."""
    found = []
    for n in OPPONENTS:
        x, y = memory.distance[n] * memory.cos[n] - bx, memory.distance[n] * memory.sin[n] - by
        counts = memory.age[n] < genes.obstacle_trust
        found.append((pose.cos * x - pose.sin * y, pose.sin * x + pose.cos * y, counts))
    return found


def _room(ux, uy, reach, lanes):
    """The least distance of an opponent from a ball's way of length `reach` along (ux, uy), m."""
    room = jnp.full_like(ux, 9.0)
    for x, y, counts in lanes:
        along, aside = x * ux + y * uy, jnp.abs(x * uy - y * ux)
        room = jnp.where(counts & (along > 0.05) & (along < reach), jnp.minimum(room, aside), room)
    return room


def _opening(east, north, lanes, genes, ground):
    """Direction (x, y) from the ball to where the opponents' goal is most open."""
    best, gx, gy = jnp.full_like(east, -9.0), jnp.ones_like(east), jnp.zeros_like(east)
    for share in (0.0, 1.0, -1.0):
        # Beside the posts, or the middle where all is open.
        dx, dy = ground.half_length + 0.1 - east, share * _CORNER * ground.half_goal - north
        far = length(dx, dy)
        ux, uy = dx / far, dy / far
        room = jnp.minimum(_room(ux, uy, far, lanes), genes.lane) + (0.03 if share == 0 else 0.0)
        gx, gy = jnp.where(room > best, ux, gx), jnp.where(room > best, uy, gy)
        best = jnp.maximum(room, best)
    return gx, gy


def _off_wall(gx, gy, east, north, genes, ground):
    """Direction (x, y) in which a ball is to be pushed, (gx, gy) or, at a wall, along and into it,
    so that there is room behind the ball: the kick bounces off.  And whether it is at a wall."""
    side = jnp.abs(north) > ground.half_width - genes.at_wall
    end = (jnp.abs(east) > ground.half_length - genes.at_wall) & (jnp.abs(north) > ground.half_goal)
    up, ahead = jnp.where(north > 0, 1.0, -1.0), jnp.where(east > 0, 1.0, -1.0)
    along, into = unit(genes.wall_angle)
    # Along a side wall ahead; along an end wall towards the opponents' mouth, away from the own.
    x = jnp.where(side, along, ahead * into)
    y = jnp.where(side, up * into, -ahead * up * along)
    corner = side & end
    x, y = jnp.where(corner, ahead * _DIAGONAL, x), jnp.where(corner, up * _DIAGONAL, y)
    at_wall = side | end
    return jnp.where(at_wall, x, gx), jnp.where(at_wall, y, gy), at_wall


def _best_kick(bx, by, east, north, pose, lanes, genes, kicks, ground):
    """The kick, of those whose zone holds the ball, that brings it nearest to the goal; whether it
    would go in; and how much nearer it would come, m (-9: no zone holds the ball)."""
    best = jnp.zeros(jnp.shape(bx), jnp.int32)
    most = jnp.full(jnp.shape(bx), -9.0)
    goes_in = jnp.zeros(jnp.shape(bx), bool)
    goal_x = ground.half_length + 0.1
    now = length(goal_x - east, north)
    for n in range(len(kicks.direction)):
        there = (bx >= kicks.low_x[n]) & (bx <= kicks.high_x[n])
        there &= (by >= kicks.low_y[n]) & (by <= kicks.high_y[n])
        c, s = unit(kicks.direction[n])
        ux, uy = pose.cos * c - pose.sin * s, pose.sin * c + pose.cos * s
        reach = kicks.reach[n]
        to_line = (ground.half_length - east) / jnp.maximum(ux, 0.05)
        at_line = jnp.abs(north + uy * to_line)
        shot = (at_line < ground.half_goal - genes.post) & (ux > 0.05) & (to_line < 0.8 * reach)
        shot &= _room(ux, uy, to_line, lanes) > 0.8 * genes.lane
        # Where it ends: at the first opponent; walls throw it back half as far.
        for ox, oy, counts in lanes:
            along, beside = ox * ux + oy * uy, jnp.abs(ox * uy - oy * ux)
            stops = counts & (along > 0.05) & (beside < _BODY)
            reach = jnp.where(stops, jnp.minimum(reach, along - _BODY), reach)
        x, y = east + reach * ux, north + reach * uy
        x = x - 1.5 * (x - jnp.clip(x, -ground.half_length, ground.half_length))
        y = y - 1.5 * (y - jnp.clip(y, -ground.half_width, ground.half_width))
        gain = now - length(goal_x - x, y)
        # Never at the own goal.
        to_own = (ground.half_length + east) / jnp.maximum(-ux, 0.05)
        danger = (ux < 0) & (jnp.abs(north + uy * to_own) < ground.half_goal + 0.1)
        gain = jnp.where(danger & (to_own < reach), -5.0, gain) + jnp.where(shot, 3.0, 0.0)
        better = there & (gain > most)
        best, goes_in = jnp.where(better, n, best), jnp.where(better, shot, goes_in)
        most = jnp.where(better, gain, most)
    return best, goes_in, most


def _role(d_ball, misaligned, east, north, known, heard, last, shirt, keeper, genes):
    """Attacker is who is nearest to the ball, by its own reckoning; who hears nothing goes."""
    own = d_ball + genes.turn_cost * jnp.abs(misaligned)
    own = jnp.where(known, own, 9.0)
    first = jnp.ones(jnp.shape(own), bool)
    for mate in range(heard.x.shape[0]):
        counts = (heard.age[mate] < genes.mate_forgotten) & (heard.role[mate] != GOALKEEPER)
        bx = jnp.where(known, east, heard.ball_x[mate])
        by = jnp.where(known, north, heard.ball_y[mate])
        ax, ay = bx - heard.x[mate], by - heard.y[mate]
        theirs = length(ax, ay)
        # Its misalignment, as one's own: between its way to the ball and the ball's to the goal.
        gx, gy = 1.5 - bx, -by
        theirs = theirs + genes.turn_cost * jnp.abs(angle(ax * gx + ay * gy, ax * gy - ay * gx))
        # Who attacks goes on, unless both do; between equals the lower shirt.
        mine, its = last == ATTACKER, heard.role[mate] == ATTACKER
        lead = jnp.where(mine & ~its, genes.commit, jnp.where(its & ~mine, -genes.commit, 0.0))
        number = mate + (mate >= shirt)
        first &= ~counts | (own - lead < theirs) | ((own - lead == theirs) & (shirt < number))
    role = jnp.where(first, ATTACKER, SUPPORTER)
    return jnp.where(keeper, GOALKEEPER, role)


def nearest(
    memory: LocalMap,
    pose: Pose,
    genes: Genes,
    ground: Ground,
    proximity: tuple[Scalar, Scalar],
    d_ball: Scalar,
    ball: Scalar,
    way: tuple[Scalar, Scalar],
) -> tuple[Scalar, Scalar]:
    """Distance (m, to the surface) and direction of the nearest of walls, robots on the map and
    what the infrared sensor meets, the ball apart, that is in the way to a place (x, y; m)."""
    far = length(*way)
    ux, uy = way[0] / far, way[1] / far
    distance, found = jnp.full_like(far, _NO_OBSTACLE), jnp.zeros_like(far)

    def add(gap, c, s, there, radius):
        nonlocal distance, found
        middle = gap + radius
        along, aside = middle * (c * ux + s * uy), middle * jnp.abs(c * uy - s * ux)
        there &= (along > 0) & (along < far - 0.05) & (aside < genes.obstacle_side)
        nearer = there & (gap < distance) & (gap < genes.obstacle_cap)
        distance = jnp.where(nearer, gap, distance)
        found = jnp.where(nearer, angle(c, s), found)

    for is_x in (True, False):
        position, half = (pose.x, ground.half_length) if is_x else (pose.y, ground.half_width)
        sign = jnp.where(position > 0, 1.0, -1.0)
        c, s = (pose.cos, -pose.sin) if is_x else (pose.sin, pose.cos)
        add(half - jnp.abs(position), sign * c, sign * s, position == position, 0.0)
    for n in MATES + OPPONENTS:
        gap = memory.distance[n] - _ROBOT
        add(gap, memory.cos[n], memory.sin[n], memory.age[n] < genes.obstacle_trust, _ROBOT)
    # The beam ends at the ball, too: that is no obstacle.
    reading, direction = proximity
    gap = reading + 0.1
    is_ball = (jnp.abs(wrap(direction - ball)) < 0.3) & (jnp.abs(gap - d_ball) < 0.15)
    add(gap, *unit(direction), (reading < 0.6) & ~is_ball, 0.0)
    return distance, found


class Rule(NamedTuple):
    """One line of the decision.

    text: in words, with genes in braces; holds: (facts, genes) -> condition; behavior: 1 to 9;
    need: (facts, genes) -> the fields of `Need` that are not the ball's and the obstacle's own.
    """

    text: str
    holds: Callable[[Facts, Genes], Bool[Array, ""]]
    behavior: int
    need: Callable[[Facts, Genes], dict[str, Scalar]] = lambda f, g: {}


def _to(distance, direction):
    """BIOA towards a place instead of the ball."""
    return {"d_ball": distance, "ball": direction}


def _is(role):
    return lambda f, g: f.role == role


RULES = (
    Rule(
        "a kick would roll into the goal, {post} m from the posts and past all opponents: kick",
        lambda f, g: f.shot,
        6,
    ),
    Rule(
        "a kick would bring the ball {kick_gain} m nearer to the goal: kick",
        lambda f, g: f.gain > g.kick_gain,
        6,
    ),
    Rule(
        "the ball lies at a wall, and a kick would not lose {wall_loss} m: kick",
        lambda f, g: f.at_wall & (f.gain > -g.wall_loss),
        6,
    ),
    Rule(
        "the others kick off, and the ball is within {kickoff} m: stand and watch",
        lambda f, g: f.waits & (f.role != GOALKEEPER) & (f.d_ball < g.kickoff),
        1,
    ),
    Rule(
        "the ball has been at the chest for {hold} s: step back",
        lambda f, g: f.held > g.hold,
        4,
        lambda f, g: {"distance": jnp.full_like(f.d_ball, -0.1)},
    ),
    Rule(
        "goalkeeper: the ball comes faster than {save_speed} m/s: save",
        lambda f, g: (f.role == GOALKEEPER) & f.known & (f.incoming > g.save_speed),
        8,
        lambda f, g: {"distance": f.crossing},
    ),
    Rule(
        "goalkeeper: the ball is within {keeper_out} m, and {keeper_home} m of the goal, and "
        "within reach: rotate around it",
        lambda f, g: (
            (f.role == GOALKEEPER) & f.known & (f.d_ball < g.near) & (f.to_own < g.keeper_home)
        ),
        9,
    ),
    Rule(
        "goalkeeper: the ball is within {keeper_out} m, and {keeper_home} m of the goal: go to it",
        lambda f, g: (
            (f.role == GOALKEEPER)
            & f.known
            & (f.d_ball < g.keeper_out)
            & (f.to_own < g.keeper_home)
        ),
        7,
        lambda f, g: _to(f.d_approach, f.approach),
    ),
    Rule(
        "goalkeeper: farther than {keeper_near} m from its place: go there",
        lambda f, g: (f.role == GOALKEEPER) & (f.d_target > g.keeper_near),
        7,
        lambda f, g: _to(f.d_target, f.target),
    ),
    Rule(
        "goalkeeper: stand in the goal and face the ball",
        _is(GOALKEEPER),
        8,
        lambda f, g: {
            "distance": jnp.zeros_like(f.d_ball),
            "ball": jnp.where(f.known, f.ball, -f.aim * 0),
        },
    ),
    Rule(
        "the ball is lost: turn to the left and look for it",
        lambda f, g: ~f.known,
        3,
        lambda f, g: {
            "d_ball": jnp.full_like(f.d_ball, BALL_AHEAD),
            "ball": jnp.full_like(f.ball, g.search_turn),
            "goal": jnp.zeros_like(f.aim),
        },
    ),
    Rule(
        "attacker: the ball is within {near} m and ahead, misaligned by less than {aligned} rad "
        "(twice that at a wall): dribble",
        lambda f, g: (
            (f.role == ATTACKER)
            & ~f.barred
            & (f.d_ball < g.near)
            & (jnp.abs(f.misaligned) < jnp.where(f.at_wall, 2 * g.aligned, g.aligned))
            & (jnp.abs(f.ball) < 2 * g.aligned)
        ),
        5,
        lambda f, g: {"distance": g.dribble + 0 * f.d_ball},
    ),
    Rule(
        "attacker: the ball is within {near} m: align with the ball and the goal",
        lambda f, g: (f.role == ATTACKER) & ~f.barred & (f.d_ball < g.near),
        3,
    ),
    Rule(
        "attacker: go for the ball, from behind where misaligned by more than {straight_on} rad",
        _is(ATTACKER),
        7,
        lambda f, g: _to(f.d_approach, f.approach),
    ),
    Rule(
        "supporter: farther than {support_near} m from its place: go there",
        lambda f, g: f.d_target > g.support_near,
        7,
        lambda f, g: _to(f.d_target, f.target),
    ),
    Rule("supporter: stand and watch", lambda f, g: f.role == SUPPORTER, 1),
)


def decide(f: Facts, genes: Genes) -> tuple[Order, Int[Array, ""]]:
    """The order, and the index of the rule that gave it."""
    like = f.d_ball
    need = Need(
        distance=jnp.zeros_like(like),
        d_ball=f.d_ball,
        ball=f.ball,
        goal=f.aim,
        d_obstacle=f.d_obstacle,
        obstacle=f.obstacle,
        kick=f.kick,
    )
    # From below: what stands further up overrides.
    behavior = jnp.full(jnp.shape(like), 1, jnp.int32)
    index = jnp.full(jnp.shape(like), len(RULES) - 1, jnp.int32)
    chosen = need
    for n, rule in reversed(list(enumerate(RULES))):
        holds = rule.holds(f, genes)
        wanted = need._replace(**rule.need(f, genes))
        behavior = jnp.where(holds, rule.behavior, behavior)
        index = jnp.where(holds, n, index)
        chosen = Need(*(jnp.where(holds, new, old) for new, old in zip(wanted, chosen)))
    return Order(behavior, chosen), index


def in_words(genes: Genes) -> list[str]:
    """The rules with the genes' values, first to last."""
    values = {name: f"{float(value):.3g}" for name, value in genes._asdict().items()}
    return [rule.text.format(**values) for rule in RULES]
