"""Each of Table 1's nine behaviours alone, on scenes of its own, from the robot's own senses.

    python -m experiments.behaviors [--scenes 500] [--json]

A robot with its eyes, head, map and localization (`perceive` and `carry_out` of `fntg_jax.robot`)
is given one behaviour instead of the Planner's choice, in a match of `envs.soccer` at the objects
level whose other robot is away, or stands in the way.  Rows 3, 5 and 9 also as the paper's table
has them, without the ball's direction ("literal"); row 7 also from the truth instead of senses.
"ball at a wall" is the whole Planner.  Shares come with Wilson 95 % intervals.
"""

import dataclasses
import json
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from envs.soccer import Match
from experiments import script
from experiments.behaviors_scenes import CASES, LOOK, STEPS, Case, Scene, Trace
from fntg_jax import robot
from fntg_jax.robot import localization, locomotion, planner
from fntg_jax.robot.behaviors import BALL_AHEAD
from fntg_jax.robot.geometry import angle, length
from fntg_jax.robot.messages import Need, Order
from fntg_jax.running import xla
from fntg_jax.running.evaluation import wilson
from fntg_jax.teams import cerberus, team_file

CAPTURE = 0.145  # m, from the robot's centre to that of a ball at its chest
SEARCH = 0.6  # rad, how far to the left a lost ball is sought
OBSTACLE = 0.11  # m, radius of the disc that stands for the robot in the way


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute."""

    scenes: int = 500
    """of each behaviour."""
    seed: int = 0
    """of the scenes."""
    team: str = str(cerberus.SHIPPED)
    """team file whose genes and BIOA are taken."""
    only: str = ""
    """part of the names of the cases to run; all."""
    json: bool = False
    """print JSON instead of a table."""


class Told(NamedTuple):
    """What an order is made of.  facts: the Planner's; true: the same where ball and obstacle are
    those of the match; way: the last step's displacement; left: m of D; kick; near: distance and
    direction of the nearest obstacle on the map, in the Planner's way or not."""

    facts: planner.Facts
    true: planner.Facts
    way: Any
    left: Any
    kick: Any
    near: tuple[Any, Any]


def _need(f: planner.Facts, told: Told, **given) -> Need:
    plain = Need(told.left, f.d_ball, f.ball, f.aim, f.d_obstacle, f.obstacle, told.kick)
    return plain._replace(**given)


def _plain(number: int, told: Told, literal: bool = False):
    f = told.facts
    need = _need(f, told)
    if literal:
        need = need._replace(ball=jnp.zeros_like(f.ball))
    # Rows 2, 4, 5: what is left of D is kept up by the displacement.
    done = {2: -told.way.y, 4: told.way.x}.get(number, 0.0)
    if number == 5:
        done = jnp.where(f.d_ball < 0.2, told.way.x, 0.0)
    return number, need, told.left - done


def _bioa(told: Told, truth: bool = False):
    """To where the ball is at the chest; a ball that is lost is looked for as the Planner does."""
    f = told.true if truth else told.facts
    x, y = f.d_ball * jnp.cos(f.ball), f.d_ball * jnp.sin(f.ball)
    go = _need(f, told, d_ball=length(x - CAPTURE, y))
    if not truth:
        go = go._replace(d_obstacle=told.near[0], obstacle=told.near[1])
    zero = jnp.zeros_like(f.ball)
    seek = _need(f, told, d_ball=zero + BALL_AHEAD, ball=zero + SEARCH, goal=zero)
    need = Need(*(jnp.where(f.known, a, b) for a, b in zip(go, seek)))
    return jnp.where(f.known, 7, 3), need, told.left


def _anything_near(team, memory, f: planner.Facts, senses):
    x, y = f.d_ball * jnp.cos(f.ball), f.d_ball * jnp.sin(f.ball)
    genes = team.genes._replace(obstacle_side=jnp.float32(9.0))
    beam = jnp.asarray(senses.proximity), senses.head[1]
    pose = localization.pose(memory.belief)
    return planner.nearest(memory.map, pose, genes, team.ground, beam, f.d_ball, f.ball, (x, y))


def _keep(told: Told, genes):
    f = told.facts
    comes = f.known & (f.incoming > genes.save_speed)
    return 8, _need(f, told, distance=jnp.where(comes, f.crossing, 0.0)), told.left


def _whole(told: Told, genes):
    order, _ = planner.decide(told.facts, genes)
    return order.behavior, order.need, told.left


def _orders(genes) -> dict[str, Callable[[Told], Any]]:
    """By `Case.order`."""
    return {
        **{str(n): partial(_plain, n) for n in (1, 2, 3, 4, 5, 6, 9)},
        **{f"{n} literal": partial(_plain, n, literal=True) for n in (3, 5, 9)},
        "7": _bioa,
        "7 truth": partial(_bioa, truth=True),
        "8": partial(_keep, genes=genes),
        "planner": partial(_whole, genes=genes),
    }


ORDERS = tuple(_orders(None))


def _true(f: planner.Facts, truth, field, cap) -> planner.Facts:
    """Facts with ball and obstacle as they are.  truth: of one robot."""
    x, y, heading = truth.pose
    c, s = jnp.cos(heading), jnp.sin(heading)
    local = lambda dx, dy: (c * dx + s * dy, c * dy - s * dx)  # noqa: E731
    bx, by = local(truth.ball[0] - x, truth.ball[1] - y)
    ox, oy = local(truth.robots[1, 0] - x, truth.robots[1, 1] - y)
    gap = jnp.where(truth.on[1], length(ox, oy) - OBSTACLE, 9.0)
    to_x, to_y = 0.5 * field.length - jnp.abs(x), 0.5 * field.width - jnp.abs(y)
    wx, wy = local(
        jnp.where(to_x < to_y, jnp.sign(x), 0.0), jnp.where(to_x < to_y, 0.0, jnp.sign(y))
    )
    wall = jnp.minimum(to_x, to_y)
    near, way = jnp.minimum(gap, wall), jnp.where(gap < wall, angle(ox, oy), angle(wx, wy))
    return f._replace(
        known=jnp.ones_like(f.known),
        d_ball=length(bx, by),
        ball=angle(bx, by),
        d_obstacle=jnp.where(near < cap, near, 3.0),
        obstacle=way,
    )


def program(match: Match) -> Callable[..., Trace]:
    """(team, order [B], shirt [B], scene) -> what happened; compiled once for all behaviours."""

    def control(team, memory, order, left, kick, senses, truth, begun):
        way = locomotion.displacement(senses, robot.DT)
        memory, f = robot.perceive(team, memory, senses)
        true = _true(f, truth, match.field, team.genes.obstacle_cap)
        told = Told(f, true, way, left, kick, _anything_near(team, memory, f, senses))
        number, need, after = jnp.ones_like(order), _need(f, told), left
        for n, make in enumerate(_orders(team.genes).values()):
            behavior, wanted, rest = make(told)
            chosen = (order == n) & begun
            number = jnp.where(chosen, behavior, number)
            need = Need(*(jnp.where(chosen, a, b) for a, b in zip(wanted, need)))
            after = jnp.where(chosen, rest, after)
        memory, action = robot.carry_out(team, memory, senses, f, Order(number, need))
        return memory, after, action

    def run(team, order, shirt, referee, scene: Scene) -> Trace:
        num = order.shape[0]
        seeds = jnp.arange(num)
        # One match at a time has its robots put; then the batch goes last.
        start = jax.vmap(lambda s: match.reset(0, s))(seeds)
        robots = jnp.stack([scene.own, scene.other], axis=1)
        ball = jnp.concatenate([scene.ball, jnp.zeros_like(scene.ball)], axis=1)
        start = jax.vmap(match.place)(start, robots, ball)
        state = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), start)
        # Away: off the field for good.
        out = jnp.where(robots[..., 1].T > 2.0, 1e9, 0.0)
        state = state._replace(robots=state.robots._replace(out=out))
        memory = jax.vmap(robot.begin, in_axes=(None, 0, 0), out_axes=-1)(team, shirt, scene.own)

        def step(carry, n):
            state, memory, left = carry
            state = _unjudged(state, ~referee)
            seen = _trace(match, state)
            one = lambda tree: jax.tree.map(lambda a: a[..., 0, :], tree)  # noqa: E731
            memory, left, action = jax.vmap(
                control, in_axes=(None, -1, -1, -1, -1, -1, -1, None), out_axes=-1
            )(
                team,
                memory,
                order,
                left,
                scene.kick,
                one(match.sense_batch(state)),
                one(match.truth_batch(state)),
                n >= LOOK,
            )
            both = jax.tree.map(lambda a: jnp.stack([a, jnp.zeros_like(a)], axis=-2), action)
            shoots = n == LOOK
            ball = state.ball._replace(
                vx=jnp.where(shoots, state.ball.vx + scene.shot[:, 0], state.ball.vx),
                vy=jnp.where(shoots, state.ball.vy + scene.shot[:, 1], state.ball.vy),
            )
            state = match.step_batch(state._replace(ball=ball), both)
            return (state, memory, left), seen

        carry = (state, memory, scene.distance)
        return jax.lax.scan(step, carry, jnp.arange(STEPS))[1]

    return jax.jit(run)


def _unjudged(state, yes):
    """Without the referee's clock of stuck balls and, where `yes`, those of holding and of the
    penalty area: a behaviour alone may stay at a ball that lies."""
    zero = lambda a: jnp.where(yes, 0.0, a)  # noqa: E731
    robots, game = state.robots, state.game
    robots = robots._replace(holding=zero(robots.holding), trespassing=zero(robots.trespassing))
    return state._replace(robots=robots, game=game._replace(stuck=jnp.zeros_like(game.stuck)))


def _trace(match: Match, state) -> Trace:
    r, ball, field = state.robots, state.ball, match.field
    walls = jnp.minimum(0.5 * field.length - jnp.abs(r.x[0]), 0.5 * field.width - jnp.abs(r.y[0]))
    gap = length(r.x[1] - r.x[0], r.y[1] - r.y[0]) - OBSTACLE
    return Trace(
        x=r.x[0],
        y=r.y[0],
        cos=r.cos[0],
        sin=r.sin[0],
        v=r.v[0],
        ball_x=ball.x,
        ball_y=ball.y,
        clear=jnp.where(r.out[1] > 0, walls, jnp.minimum(walls, gap)),
        goals=state.statistics.goals[0] - state.statistics.goals[1],
        out=(r.out[0] > 0) & (r.out[0] < 1e6),
    )


def judge(run, team, case: Case, num: int, seed: int) -> dict[str, Any]:
    """One case: how many of its scenes it mastered."""
    scene = case.scenes(np.random.default_rng(seed), num)
    order = np.full(num, ORDERS.index(case.order), np.int32)
    shirt = np.full(num, 0 if case.keeper else 1, np.int32)
    whole = case.order == "planner"
    if whole:  # a field player that may go everywhere
        team, shirt = team._replace(goalkeeper=jnp.asarray(False)), np.zeros(num, np.int32)
    referee = np.full(num, whole)
    trace = jax.device_get(run(team, order, shirt, referee, scene))
    counts: Any = np.ones(num, bool)
    if case.undisturbed is not None:
        absent = scene._replace(own=np.broadcast_to(np.array([0, 3, 0], np.float32), (num, 3)))
        counts = case.undisturbed(jax.device_get(run(team, order, shirt, referee, absent)), scene)
    good = case.good(trace, scene)[counts]
    rate = wilson(int(good.sum()), len(good))
    return {
        "name": case.name,
        "target": case.target,
        "scenes": len(good),
        "share": rate.share,
        "low": rate.low,
        "high": rate.high,
        "measure": case.measure[0],
        "median": float(np.median(case.measure[1](trace, scene)[counts])),
    }


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    xla.configure()
    with script.lines():
        script.check_least(options, scenes=1, seed=0)
        cases = [case for case in CASES if options.only in case.name]
        if not cases:
            raise ValueError(f"only = {options.only!r}: known are {[c.name for c in CASES]}")
        file = team_file.load(options.team)
    match = Match(players=1, sound="none")
    team = cerberus.of(file.genes, file.bioa, match, 0)
    run = program(match)
    rows = []
    for case in cases:
        row = judge(run, team, case, options.scenes, options.seed)
        rows.append(row)
        if not options.json:
            wanted = "" if row["target"] is None else f"{100 * row['target']:.0f} %"
            share = f"{100 * row['share']:.1f} ({100 * row['low']:.1f}-{100 * row['high']:.1f})"
            print(
                f"{row['name']:44s} {row['scenes']:5d}  {share:>20s}  {wanted:>6s}   "
                f"{row['measure']} {row['median']:.3f}",
                flush=True,
            )
    if options.json:
        print(json.dumps({"seed": options.seed, "rows": rows}, indent=1, allow_nan=False))


if __name__ == "__main__":
    main()
