"""One robot's control system, the paper's Figure 3: one file a box, one message type an arrow.

    senses -> Vision, Localization, Communication -> Planner -> Behaviors -> Locomotion -> action

`control` is a pure function of one robot; batches of robots and matches are made with `jax.vmap`.
It knows no world: the body's tables and the field's map come with `Team`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from envs.base import SIGNALS, Action, Senses
from fntg_jax.robot import (
    behaviors,
    communication,
    ear,
    gaze,
    local_map,
    localization,
    locomotion,
    planner,
    sight,
    vision,
)
from fntg_jax.robot.colours import Colours
from fntg_jax.robot.genes import Genes
from fntg_jax.robot.geometry import angle, unit
from fntg_jax.robot.messages import Heard, LocalMap, Order

__all__ = ["Memory", "Team", "begin", "carry_out", "control", "perceive"]

DT = 0.1  # s, a control step
_SCAN = 0.7  # s without a sight of the ball after which the head scans for it (assumed)
_OWN_KICKOFF, _THEIR_KICKOFF = SIGNALS.index("kick-off own"), SIGNALS.index("kick-off theirs")
_PENALISED = SIGNALS.index("penalised")
_FALLEN = 5.0  # m/s^2, acceleration along the body's z below which it does not stand (g is 9.8)


class Team(NamedTuple):
    """What makes a team, the same for its robots.

    genes: of the planner.  bioa: behaviour 7, (d_ball, d_obstacle, theta_ball, theta_obstacle) ->
    (v, omega); under jit a pytree such as `jax.tree_util.Partial`.  speeds, kicks, get_up: the
    body's tables (get_up, spread: postures, 1 + index).  map: of the landmarks, in the team's frame
    (x from the own goal).  sizes: what Vision knows of the objects.  goalkeeper: whether
    shirt 0 is one.  table, bands: of Vision, where the camera gives pictures; else None.  voice:
    the band that it speaks and listens in, where sounds are samples; else None.
    """

    genes: Genes
    bioa: Callable[..., Any]
    speeds: behaviors.Speeds
    kicks: planner.Kicks
    get_up: Int[Array, ""]
    spread: Int[Array, ""]
    map: Float[Array, "6 2"]
    ground: planner.Ground
    sizes: sight.Sizes
    goalkeeper: Bool[Array, ""]
    places: Float[Array, "2 N 2"]
    table: Colours | None = None
    bands: Int[Array, "6 2"] | None = None
    voice: Int[Array, ""] | None = None


class Memory(NamedTuple):
    """What a robot carries from one control step to the next.

    shirt: 0, 1, ...; step: control steps since it began; signal: the referee's last; role: index
    into `planner.ROLES`; rule: index into `planner.RULES` of the one that chose the last order;
    held: s since when the ball has lain at the chest.
    """

    shirt: Int[Array, ""]
    step: Int[Array, ""]
    signal: Int[Array, ""]
    role: Int[Array, ""]
    rule: Int[Array, ""]
    held: Float[Array, ""]
    order: Order
    belief: localization.Belief
    map: LocalMap
    heard: Heard
    gaze: gaze.Gaze
    head: Float[Array, "3"]
    hearing: ear.Ear | None = None


def begin(team: Team, shirt: Int[Array, ""], pose: Float[Array, "3"]) -> Memory:
    """The memory of a robot that was put on its place.  pose: x, y (m), heading (rad) in its team's
    frame."""
    zero = jnp.zeros((), jnp.float32)
    index = jnp.zeros((), jnp.int32)
    need = planner.Need(zero, zero, zero, zero, zero, zero, index)
    return Memory(
        shirt=jnp.asarray(shirt, jnp.int32),
        step=index,
        signal=index,
        role=jnp.where(shirt == 0, planner.GOALKEEPER, planner.SUPPORTER).astype(jnp.int32),
        rule=index,
        held=zero,
        order=Order(index + 1, need),
        belief=localization.begin(pose),
        map=local_map.empty(),
        heard=communication.nothing_heard(),
        gaze=gaze.begin(),
        head=jnp.zeros(3, jnp.float32),
        hearing=None if team.voice is None else ear.silent(),
    )


def _pick(table: Array, index: Array) -> Array:
    """table[index] as selections: XLA's CPU compiler does not vectorise a gather."""
    found = table[0]
    for n in range(1, table.shape[0]):
        found = jnp.where(index == n, table[n], found)
    return found


def control(team: Team, memory: Memory, senses: Senses) -> tuple[Memory, Action]:
    """One control step of one robot: the boxes in the figure's order."""
    memory, facts = perceive(team, memory, senses)
    order, rule = planner.decide(facts, team.genes)
    return carry_out(team, memory._replace(rule=rule), senses, facts, order)


def perceive(team: Team, memory: Memory, senses: Senses) -> tuple[Memory, planner.Facts]:
    """Vision, Localization, Communication, and what the Planner's decision rests on."""
    # Vision: what is seen, in the robot's frame.
    frame = senses.frame
    if team.table is not None and team.bands is not None:
        frame = vision.see(frame, team.table, vision.Team(), team.bands).frame
    seen = sight.locate(frame, senses.head, team.sizes)
    # Locomotion's estimate of the way since the last step.
    way = locomotion.displacement(senses, DT)
    turn = unit(way.turn)
    # Localization: landmarks and displacement -> pose.
    marks = slice(local_map.LANDMARKS[0], local_map.LANDMARKS[-1] + 1)
    landmarks = jax.tree.map(lambda leaf: leaf[marks], seen)
    belief = localization.lifted(memory.belief, senses.signal == _PENALISED)
    belief = localization.update(belief, way, landmarks, team.map, dt=DT)
    # A robot that is put on its place for a kick-off knows where that is, and where the ball lies.
    kicks_off = (senses.signal == _OWN_KICKOFF) | (senses.signal == _THEIR_KICKOFF)
    begins = kicks_off & (senses.signal != memory.signal)
    which = jnp.where(senses.signal == _THEIR_KICKOFF, 1, 0)
    place = _pick(_pick(team.places, which), memory.shirt)
    put = localization.begin(jnp.stack([place[0], place[1], 0 * place[0]]))
    belief = jax.tree.map(lambda a, b: jnp.where(begins, a, b), put, belief)
    pose = localization.pose(belief)
    # Communication: words of the teammates.
    words, whole, listening = senses.heard, senses.heard_valid, memory.hearing
    if listening is not None and team.voice is not None:
        # The samples are those of the step before.
        listening, words, whole = ear.listen(listening, words, team.voice, memory.step - 1)
    heard = communication.merge(memory.heard, words, whole, memory.shirt, DT)
    # Planner: local map and facts.
    around = local_map.moved(memory.map, way, turn, DT)
    around = local_map.placed(around, pose, begins)
    around = local_map.sighted(around, seen, DT)
    around = local_map.told(around, heard, pose, team.genes.word_trusted)
    facts = planner.facts(
        around,
        pose,
        heard,
        memory.role,
        memory.shirt,
        team.genes,
        team.kicks,
        team.ground,
        (jnp.asarray(senses.proximity), senses.head[1]),
        team.goalkeeper,
        senses.signal == _THEIR_KICKOFF,
        memory.held,
        DT,
    )
    return memory._replace(
        signal=senses.signal,
        role=facts.role,
        held=facts.held,
        belief=belief,
        map=around,
        heard=heard,
        hearing=listening,
    ), facts


def carry_out(
    team: Team, memory: Memory, senses: Senses, facts: planner.Facts, order: Order
) -> tuple[Memory, Action]:
    """Behaviors, the head, a word when it is our turn, and Locomotion's command."""
    motion = behaviors.act(order.behavior, order.need, team.speeds, team.bioa)
    spreads = (order.behavior == 8) & facts.known & (facts.incoming > team.genes.save_speed)
    spreads &= (facts.arrival < team.genes.spread_time) & (jnp.abs(facts.crossing) < 0.3)
    posture = jnp.where(spreads, team.spread, motion.posture)
    fallen = senses.acceleration[2] < _FALLEN
    posture = jnp.where(fallen, team.get_up, posture)
    motion = motion._replace(posture=posture, kick=jnp.where(fallen, 0, motion.kick))
    # Vision moves the head.
    around, pose = memory.map, localization.pose(memory.belief)
    ball = around.distance[0] * around.cos[0], around.distance[0] * around.sin[0]
    look, head = gaze.look(
        memory.gaze, around.age[0] < _SCAN, ball, pose, team.map, jnp.asarray(team.genes.glance), DT
    )
    # Communication.
    word = communication.Word(
        sender=memory.shirt,
        role=memory.role,
        x=pose.x,
        y=pose.y,
        heading=angle(pose.cos, pose.sin),
        sd=pose.sd,
        ball_x=pose.x + pose.cos * ball[0] - pose.sin * ball[1],
        ball_y=pose.y + pose.sin * ball[0] + pose.cos * ball[1],
        ball_age=jnp.where(facts.known, around.age[0], jnp.inf),
    )
    speaks = communication.turn(memory.shirt, memory.step)
    say = jnp.where(speaks, communication.pack(word), jnp.uint32(0))
    if team.voice is not None:
        say = ear.say(say, team.voice)
    # The ball will have gone before the head, which a kick holds still, sees it again.
    around = local_map.kicked(around, motion.kick, team.kicks.direction, team.kicks.speed)
    return memory._replace(
        step=memory.step + 1, order=order, map=around, gaze=look, head=head
    ), locomotion.action(motion, head, say)
