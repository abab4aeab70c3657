"""Task `team`: the planner's genes, evolved in whole matches against a field that moves.

A genome plays cerberus with its genes at home: against the shipped teams (cerberus by hand, and
chaser), against past champions of its own run (the hall of fame) and against genomes of its own
population, for which the match counts as well, away.  All genomes of a generation play the same
seeds; every seed is played with either kick-off.  The opponents by hand and the held-out seeds
judge.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Observation, Task
from fntg_jax import robot
from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import expand_scalars
from fntg_jax.learning import play
from fntg_jax.learning.mixture import mixture
from fntg_jax.learning.objective import AXIS
from fntg_jax.learning.play import Side
from fntg_jax.robot.genes import GENES, Genes
from fntg_jax.running import matches
from fntg_jax.running.provenance import version
from fntg_jax.teams import cerberus, team_file

# Of matches: training's are below, held-out ones from here on.
_HELD_OUT = 2**30
_JUDGED = 2048  # matches of a judgement, shared by its genomes
_SPREAD = 0.15  # of a gene's range: how far to either side of the default it may start
_BIOA_SPREAD = 0.5  # the same for a gene of BIOA, in genes
_GAP = 6  # generations from one champion in the hall to the next
SHIPPED = ("cerberus", "chaser")  # who judges, too


class Gene(NamedTuple):
    """As `envs.base.Gene`; partition: where it starts with `--initial partition`."""

    name: str
    unit: str
    low: float
    high: float
    partition: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the task, all numbers.

    Attributes:
        seconds: of a match, which is one half: exchanging ends and teams mirrors a match, so a
            second half would only be another one.
        shipped, hall, rivals: matches of a genome in a generation against the shipped teams, the
            hall of fame (0: none) and its own population; even.
        size: champions in the hall.
        dense: weight of the dense term in the first generation; it falls to 0 in the last.
        swap: 0: home always kicks off, and a match counts for home alone.
        bioa: 1: BIOA's genes evolve, too.
        players: robots a side.
        noise: factor on the camera's errors.
        hearing: m, distance at which half of the words are lost; 0: as measured.
    """

    seconds: float = 20.0
    shipped: float = 4
    hall: float = 2
    rivals: float = 2
    size: float = 16
    dense: float = 0.5
    swap: float = 1
    bioa: float = 0
    players: float = 3
    noise: float = 1.0
    hearing: float = 0.0


_ALLOWED = {
    "seconds": (1, 600),
    "shipped": (0, 64),
    "hall": (0, 64),
    "rivals": (0, 64),
    "size": (1, 64),
    "dense": (0, 1),
    "swap": (0, 1),
    "bioa": (0, 1),
    "players": (1, 5),
    "noise": (0, 10),
    "hearing": (0, 100),
}
_WHOLE = ("shipped", "hall", "rivals", "size", "swap", "bioa", "players")
_EVEN = ("shipped", "hall", "rivals")


def _checked(values: dict[str, float]) -> Options:
    for name, value in values.items():
        if name not in _ALLOWED:
            raise ValueError(f"task option {name!r}: known are {', '.join(_ALLOWED)}")
        low, high = _ALLOWED[name]
        kind = "even" if name in _EVEN else "whole" if name in _WHOLE else ""
        fits = low <= value <= high and (not kind or value % (2 if kind == "even" else 1) == 0)
        if not fits:
            words = f"{kind} numbers" if kind else "numbers"
            raise ValueError(f"task option {name} = {value}: allowed are {words} {low} to {high}")
    options = Options(**values)
    if options.shipped + options.hall + options.rivals == 0:
        raise ValueError("task option shipped = 0: with hall = 0 and rivals = 0 nobody plays")
    return options


def family(match: Any, home: bool, file: team_file.TeamFile, bioa: bool) -> Side:
    """Cerberus as a side whose parameters are genes alone: (Genes, BIOA's theta or ()), of which
    every match may have its own; the body's tables and the field are constants."""
    base = cerberus.of(file.genes, file.bioa, match, 0 if home else 1, file.goalkeeper)
    numbers: Any = base._replace(bioa=())  # type: ignore[arg-type]
    base = jax.tree.map(np.asarray, numbers)._replace(bioa=file.bioa)

    def own(team):
        genes, theta = team
        if not bioa:
            return base._replace(genes=genes)
        params = expand_scalars(file.bioa.layout, theta)
        return base._replace(genes=genes, bioa=partial(_command, file.bioa, params))

    return Side(
        file.name,
        (file.genes, np.asarray(file.bioa.theta, np.float32) if bioa else ()),
        lambda team, shirt, pose: robot.begin(own(team), shirt, pose),
        lambda team, memory, senses: robot.control(own(team), memory, senses),
    )


def _command(controller: Controller, params: Any, *seen: Any) -> tuple[Any, ...]:
    return network.command(params, Observation(*seen), controller.limits, controller.output)[:2]


def _fixed(side: Side) -> Side:
    """A side without parameters: they are constants of its functions."""
    return side._replace(
        team=(),
        begin=lambda team, shirt, pose: side.begin(side.team, shirt, pose),
        control=lambda team, memory, given: side.control(side.team, memory, given),
        believe=None,
    )


def genes_of(file: team_file.TeamFile, bioa: bool) -> tuple[Gene, ...]:
    """The planner's genes and, by option, BIOA's."""
    found = []
    for gene, value in zip(GENES, file.genes):
        about = _SPREAD * (gene.high - gene.low)
        start = max(gene.low, float(value) - about), min(gene.high, float(value) + about)
        found.append(Gene(gene.name, gene.unit, gene.low, gene.high, start))
    if bioa:
        for own, x in zip(file.bioa.layout.genes, map(float, file.bioa.theta)):
            start = max(own.low, x - _BIOA_SPREAD), min(own.high, x + _BIOA_SPREAD)
            found.append(Gene(f"bioa {own.name}", "1", own.low, own.high, start))
    return tuple(found)


def value_of(goals: Any) -> Any:
    """A match's worth to both teams [..., 2] from goals [..., 2]: (1 + tanh(0.7 x difference)) / 2,
    a draw 0.5, a goal more 0.80, two 0.94."""
    difference = (goals - goals[..., ::-1]).astype(jnp.float32)
    return 0.5 + 0.5 * jnp.tanh(0.7 * difference)


def dense_of(possession: Any, progress: Any, steps: int, half_length: float) -> Any:
    """The dense term of a match, for both teams [..., 2], from 0 to 1: half of it where the ball
    was, on average, from the own goal (0) to the opponents' (1); half of it the share of
    possession.  possession: steps [..., 2]; progress: sum of the ball's x over all steps, m [...],
    in home's frame."""
    x = 0.5 + 0.5 * progress / (steps * half_length)
    total = jnp.sum(possession, axis=-1, keepdims=True)
    share = jnp.where(total > 0, possession / jnp.maximum(total, 1), 0.5)
    return 0.5 * jnp.clip(jnp.stack([x, 1 - x], axis=-1), 0, 1) + 0.5 * share


def _ball_x(match: Any, state: Any) -> Any:
    """x of the ball in home's frame, [1, M]."""
    return match.truth_batch(state).ball[0, 0][None]


class Rules(NamedTuple):
    """What all functions of the task share.

    home: the family; away: a mixture whose first functions are the family's.  kinds: [shipped],
    index of its functions in `away`; by_hand: [genes] of the team that evolution begins from.
    """

    options: Options
    match: Any
    home: Side
    away: Side
    kinds: Any
    by_hand: np.ndarray


def task(**options: float) -> Task:
    """The task of these options.  Raises ValueError: option, value, what is allowed."""
    chosen = _checked(options)
    file = team_file.load(cerberus.SHIPPED)
    match = matches.get_match(
        "soccer", minutes=chosen.seconds / 60, players=int(chosen.players), **_senses(chosen)
    )
    bioa = bool(chosen.bioa)
    away, (kinds, _) = mixture(
        [
            family(match, False, file, bioa),
            *(_fixed(matches.get_team(name, match, 1)) for name in SHIPPED[1:]),
        ]
    )
    by_hand = np.asarray([*file.genes, *(file.bioa.theta if bioa else ())], np.float32)
    rules = Rules(chosen, match, family(match, True, file, bioa), away, np.asarray(kinds), by_hand)
    return Task(
        "team",
        genes_of(file, bioa),
        partial(_fitness, rules),
        partial(_init, rules),
        partial(_judge, rules),
        partial(_files, chosen, file),
        shares=lambda population: play.num_blocks(population * _per_genome(chosen)),
        relative=True,
    )


def _senses(options: Options) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if options.noise != 1:
        found["noise"] = options.noise
    if options.hearing:
        found["hearing"] = options.hearing
    return found


def _per_genome(options: Options) -> int:
    return int(options.shipped + options.hall + options.rivals)


def _as_team(theta: Any) -> Any:
    """Genes [M, genes] as parameters of the family's side, leaves [M, ...]."""
    num = len(GENES)
    rest = theta[:, num:]
    return Genes(*(theta[:, n] for n in range(num))), rest if rest.shape[1] else ()


def _init(rules: Rules, key: Any) -> Any:
    """The hall of fame, [size, genes], which begins as the team by hand, and the generation."""
    del key
    return jnp.tile(rules.by_hand, (int(rules.options.size), 1)), jnp.zeros((), jnp.int32)


def _seeds(rules: Rules, key: Any, num: int) -> Any:
    """Of `num` matches of one genome, [num]: pairs that differ in who kicks off."""
    draws = jax.random.randint(key, (num,), 0, _HELD_OUT // 2)
    if not rules.options.swap:
        return 2 * draws
    first = 2 * jnp.arange((num + 1) // 2)
    return (2 * jnp.repeat(draws[first], 2) + jnp.tile(jnp.arange(2), len(first)))[:num]


def _played(rules: Rules, home: Any, kinds: Any, theirs: Any, seeds: Any) -> Any:
    """Matches [M] of genes home [M, genes] against kind [M], where that is the family with genes
    theirs [M, genes]: statistics and the sum of the ball's x [M, 1]."""
    away = kinds, (_as_team(theirs), *[()] * (len(SHIPPED) - 1))
    return play.play(
        rules.match,
        rules.home._replace(team=_as_team(home)),
        rules.away._replace(team=away),
        seeds,
        # Over before the half is called off.
        num_steps=rules.match.half_steps - 1,
        each=(True, True),
        watch=_ball_x,
        axis=AXIS if _shared() else None,
    )


def _shared() -> bool:
    """Whether devices share the work along `AXIS` here."""
    try:
        jax.lax.axis_size(AXIS)
    except NameError:
        return False
    return True


def _worths(rules: Rules, statistics: Any, progress: Any) -> tuple[Any, Any]:
    half = rules.match.field.length / 2
    dense = dense_of(statistics.possession, progress[:, 0], rules.match.half_steps, half)
    return value_of(statistics.goals), dense


def _fitness(rules: Rules, key: Any, theta: Any, memory: Any, progress: Any) -> Any:
    """Mean worth of a genome's matches, with the dense term; see `value_of` and `dense_of`."""
    options, (hall, count) = rules.options, memory
    size = theta.shape[0]
    num = _per_genome(options)
    k_seeds, k_hall, k_rival = jax.random.split(key, 3)
    seeds = _seeds(rules, k_seeds, num)
    kinds, theirs = [], []
    for n in range(int(options.shipped)):
        kinds.append(jnp.full(size, rules.kinds[n // 2 % len(SHIPPED)]))
        theirs.append(jnp.broadcast_to(rules.by_hand, theta.shape))
    old = jax.random.randint(k_hall, (int(options.hall) // 2 or 1,), 0, hall.shape[0])
    for n in range(int(options.hall)):
        kinds.append(jnp.zeros(size, jnp.int32))
        theirs.append(jnp.broadcast_to(hall[old[n // 2]], theta.shape))
    # The same rival at both kick-offs.
    shifts = jax.random.randint(k_rival, (int(options.rivals) // 2 or 1,), 1, max(size, 2))
    for n in range(int(options.rivals)):
        kinds.append(jnp.zeros(size, jnp.int32))
        theirs.append(jnp.roll(theta, -shifts[n // 2], axis=0))
    statistics, watched = _played(
        rules,
        jnp.tile(theta, (num, 1)),
        jnp.concatenate(kinds),
        jnp.concatenate(theirs),
        jnp.repeat(seeds, size),
    )
    worth, dense = _worths(rules, statistics, watched)
    share = options.dense * (1 - progress)
    worth = ((1 - share) * worth + share * dense).reshape(num, size, 2)
    total, counted = jnp.sum(worth[..., 0], axis=0), num
    if options.swap:
        for n in range(int(options.rivals)):
            total += jnp.roll(worth[num - int(options.rivals) + n, :, 1], shifts[n // 2])
        counted += int(options.rivals)
    fitness = total / counted
    champion = theta[jnp.argmax(fitness)]
    slot = count // _GAP % hall.shape[0]
    hall = jnp.where((jnp.arange(hall.shape[0]) == slot)[:, None], champion, hall)
    return fitness, (hall, count + 1)


def _judge(rules: Rules, key: Any, theta: Any, memory: Any) -> dict[str, Any]:
    """Points (wins and half of the draws, as a share) against the shipped teams on held-out seeds,
    with either kick-off, and goals a match; `score` is the mean of the points."""
    del memory
    size, num = theta.shape[0], 2 * max(_JUDGED // (2 * len(SHIPPED) * theta.shape[0]), 1)
    # Every genome has draws of its own, so that equal ones are together a larger sample.
    draws = jax.random.randint(key, (num // 2, 1, size), 0, _HELD_OUT // 2)
    seeds = (_HELD_OUT + 2 * draws + jnp.arange(2)[:, None]).ravel()
    both = len(SHIPPED)
    home = jnp.tile(theta, (both * num, 1))
    statistics, _ = _played(
        rules,
        home,
        jnp.repeat(rules.kinds, num * size),
        jnp.broadcast_to(rules.by_hand, home.shape),
        jnp.tile(seeds, both),
    )
    goals = statistics.goals.reshape(both, num, size, 2)
    points = 0.5 + 0.5 * jnp.sign(goals[..., 0] - goals[..., 1]).astype(jnp.float32)
    points = jnp.mean(points, axis=1)
    mean = jnp.mean(goals.astype(jnp.float32), axis=(0, 1))
    return {
        "score": jnp.mean(points, axis=0),
        **{f"against_{name}": points[n] for n, name in enumerate(SHIPPED)},
        "goals": mean[:, 0],
        "goals_against": mean[:, 1],
    }


def _files(options: Options, file: team_file.TeamFile, values: dict[str, float]) -> dict[str, str]:
    """team.json, which `fntg match --home team.json` plays."""
    own = Genes(**{name: values[name] for name in Genes._fields})
    bioa = file.bioa
    if options.bioa:
        theta = [values[f"bioa {gene.name}"] for gene in bioa.layout.genes]
        bioa = dataclasses.replace(bioa, theta=np.asarray(theta, np.float64), bits=None)
    told = {f"option_{name}": value for name, value in dataclasses.asdict(options).items()}
    made = {"task": "team", "begun_from": file.name, "fntg_jax": version(), **told}
    team = team_file.TeamFile("evolved", own, bioa, file.goalkeeper, made)
    return {"team.json": team_file.dumps(team)}
