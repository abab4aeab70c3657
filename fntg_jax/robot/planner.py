"""Planner: from the local map, the pose and teammates' words to a role and a behaviour of Table 1.

`facts` says what the decision rests on, `RULES` is the decision: from above, the first rule whose
condition holds chooses the behaviour and its data.  Everything is elementwise on batches.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from fntg_jax.robot.genes import Genes
from fntg_jax.robot.geometry import angle, length, wrap
from fntg_jax.robot.local_map import BALL, MATES, OPPONENTS
from fntg_jax.robot.messages import Heard, LocalMap, Need, Order, Pose, Scalar

ROLES = ("goalkeeper", "attacker", "supporter")
GOALKEEPER, ATTACKER, SUPPORTER = range(3)

_ROBOT = 0.11  # m, radius of the disc that another robot is taken for (body 0.289 x 0.152 m)
_HALF_LENGTH = 0.145  # m, of the robot's body


class Kicks(NamedTuple):
    """The body's table of kicks, leaves [kicks], in the robot's frame.

    direction: rad, of the ball afterwards; low_x .. high_x, low_y .. high_y: m, where the ball has
    to lie for it.
    """

    direction: Float[Array, " kicks"]
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
    kick: the best kick; kickable: the ball lies in its zone and would go where it is wanted;
    to_goal, to_own: distance of the ball from both goals; target, d_target:
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
    kickable: Bool[Array, ""]
    to_goal: Scalar
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
    search: Scalar
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
) -> Facts:
    """What the decision rests on.

    role: of the last step; shirt: 0, 1, ...; proximity: the head's infrared distance (m) and the
    direction it was measured in (rad); goalkeeper: whether shirt 0 keeps the goal.
    """
    d_ball = memory.distance[BALL]
    bx, by = d_ball * memory.cos[BALL], d_ball * memory.sin[BALL]
    ball = angle(bx, by)
    known = memory.age[BALL] < genes.ball_forgotten
    # The ball in the team's frame, and where it is to go: the middle of the opponents' goal.
    east = pose.x + pose.cos * bx - pose.sin * by
    north = pose.y + pose.sin * bx + pose.cos * by
    east = jnp.clip(east, -ground.half_length, ground.half_length)
    north = jnp.clip(north, -ground.half_width, ground.half_width)
    gx, gy = ground.half_length + 0.1 - east, -north
    to_goal = length(gx, gy)
    to_own = length(east + ground.half_length, north)
    # The place behind the ball, kept off the walls: beside a wall the ball is pushed along it.
    px, py = _inside(
        east - genes.behind * gx / to_goal, north - genes.behind * gy / to_goal, genes.wall, ground
    )
    ax, ay = east - px, north - py
    aim = _relative(ax, ay, pose)
    misaligned = wrap(aim - ball)
    # Far off and misaligned: to the place behind the ball; else to the ball.
    share = jnp.clip(jnp.abs(misaligned) / genes.straight_on - 1.0, 0.0, 1.0)
    tx, ty = east + share * (px - east), north + share * (py - north)
    approach_x, approach_y = _local(tx, ty, pose)

    kick, kickable = _best_kick(bx, by, aim, genes, kicks)
    keeps = (shirt == 0) & goalkeeper
    role = _role(d_ball, misaligned, east, north, known, heard, role, shirt, keeps, genes)
    # Places: goalkeeper before its line on the ball's side; supporter behind the ball, to the side
    # that has more room.
    keeper_y = jnp.clip(genes.keeper_side * north, -0.8 * ground.half_goal, 0.8 * ground.half_goal)
    keeper_y = jnp.where(known, keeper_y, 0.0)
    home = jnp.where(known, north, jnp.where(shirt % 2 == 1, 0.5, -0.5))
    place_x = jnp.where(known, east - genes.support_behind, -0.4)
    place_y = jnp.where(known, north - jnp.where(home >= 0, 1, -1) * genes.support_aside, home)
    place_x, place_y = _inside(place_x, place_y, genes.wall + 0.05, ground)
    keeper = role == GOALKEEPER
    place_x = jnp.where(keeper, -ground.half_length + genes.keeper_line, place_x)
    place_y = jnp.where(keeper, keeper_y, place_y)
    target_x, target_y = _local(place_x, place_y, pose)

    # Where the rolling ball will cross the robot's lateral axis.
    vx, vy = memory.velocity[0], memory.velocity[1]
    incoming = -vx
    arrival = jnp.clip(bx / jnp.maximum(incoming, 0.02), 0.0, 9.0)
    crossing = -(by + vy * jnp.minimum(arrival, 3.0))
    d_obstacle, obstacle = _nearest(memory, pose, genes, ground, proximity, d_ball, ball)
    side = jnp.where(by >= 0, 1.0, -1.0)
    return Facts(
        known=known,
        d_ball=d_ball,
        ball=ball,
        aim=aim,
        misaligned=misaligned,
        kick=kick,
        kickable=kickable & known,
        to_goal=to_goal,
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
        search=side * genes.search_turn,
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


def _best_kick(bx, by, aim, genes, kicks):
    """The kick with the least error of direction among those whose zone holds the ball."""
    best = jnp.zeros(jnp.shape(bx), jnp.int32)
    least = jnp.full(jnp.shape(bx), 9.0)
    for n in range(len(kicks.direction)):
        there = (bx >= kicks.low_x[n]) & (bx <= kicks.high_x[n])
        there &= (by >= kicks.low_y[n]) & (by <= kicks.high_y[n])
        error = jnp.where(there, jnp.abs(wrap(aim - kicks.direction[n])), 9.0)
        best, least = jnp.where(error < least, n, best), jnp.minimum(error, least)
    return best, least < genes.kick_angle


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


def _nearest(memory, pose, genes, ground, proximity, d_ball, ball):
    """Distance (m, to the surface) and direction of the nearest of walls, robots on the map and
    what the infrared sensor meets, the ball apart."""
    to_x = ground.half_length - jnp.abs(pose.x)
    to_y = ground.half_width - jnp.abs(pose.y)
    zero = jnp.zeros_like(to_x)
    east = jnp.where(to_x < to_y, jnp.sign(pose.x), zero)
    north = jnp.where(to_x < to_y, zero, jnp.sign(pose.y))
    distance = jnp.minimum(to_x, to_y)
    c, s = pose.cos * east + pose.sin * north, pose.cos * north - pose.sin * east
    for n in MATES + OPPONENTS:
        gap = memory.distance[n] - _ROBOT
        nearer = (memory.age[n] < genes.obstacle_trust) & (gap < distance)
        distance = jnp.where(nearer, gap, distance)
        c, s = jnp.where(nearer, memory.cos[n], c), jnp.where(nearer, memory.sin[n], s)
    found = angle(c, s)
    # The beam ends at the ball, too: that is no obstacle.
    reading, direction = proximity
    gap = reading + 0.1
    is_ball = (jnp.abs(wrap(direction - ball)) < 0.3) & (jnp.abs(gap - d_ball) < 0.15)
    nearer = (reading < 0.6) & ~is_ball & (gap < distance)
    distance = jnp.where(nearer, gap, distance)
    found = jnp.where(nearer, direction, found)
    # Far obstacles are no obstacles: BIOA was trained with one that is near.
    return jnp.where(distance < genes.obstacle_cap, distance, 3.0), found


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
        "the ball lies where a kick would send it to the goal, within {kick_range} m of it, or "
        "within {kick_pass} m of the own goal",
        lambda f, g: f.kickable & ((f.to_goal < g.kick_range) | (f.to_own < g.kick_pass)),
        6,
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
        "the ball is lost: turn and look for it",
        lambda f, g: ~f.known,
        3,
        lambda f, g: {
            "d_ball": jnp.full_like(f.d_ball, 0.165),
            "ball": f.search,
            "goal": jnp.zeros_like(f.aim),
        },
    ),
    Rule(
        "attacker: the ball is within {near} m and ahead, misaligned by less than {aligned} rad: "
        "dribble",
        lambda f, g: (
            (f.role == ATTACKER)
            & (f.d_ball < g.near)
            & (jnp.abs(f.misaligned) < g.aligned)
            & (jnp.abs(f.ball) < 2 * g.aligned)
        ),
        5,
        lambda f, g: {"distance": g.dribble + 0 * f.d_ball},
    ),
    Rule(
        "attacker: the ball is within {near} m: align with the ball and the goal",
        lambda f, g: (f.role == ATTACKER) & (f.d_ball < g.near),
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
