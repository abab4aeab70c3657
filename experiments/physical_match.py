"""Do the tables and the walking dogs agree?  All pairs of teams in both worlds.

    python -m experiments.physical_match [--teams still random chaser cerberus] [--matches 10]
        [--seconds 15] [--out physical.csv]

Every pair plays as many short matches by the body's tables and in MuJoCo (six dogs in one model),
on the same seeds.  Printed: the mean goal difference in both, with bootstrap 95 % intervals, and
where these lie on different sides of nought; the means of goals and touches over all matches; how
many times real time the dogs ran.
"""

import argparse
import time
from itertools import combinations
from pathlib import Path

import numpy as np

from experiments import script
from fntg_jax.running import xla

TEAMS = ("still", "random", "chaser", "cerberus")
COLUMNS = ("goals", "touches", "shots", "falls")


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--teams", nargs="+", default=list(TEAMS))
    parser.add_argument("--matches", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=15.0, help="of a half")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="all matches as CSV")
    options = parser.parse_args(argv)
    xla.configure()
    with script.lines():
        script.check_least(options, matches=1)
        rows, speed = play(options)
    report(rows, options.teams, speed)
    if options.out is not None:
        header = ["world", "home", "away", "seed"]
        header += [f"{c}_{side}" for c in COLUMNS for side in ("home", "away")]
        script.write_csv(options.out, header, rows)


def play(options) -> tuple[list[list], float]:
    """A row for each match in each world, and the dogs' speed in times of real time."""
    import jax

    from fntg_jax.learning import play as playing
    from fntg_jax.learning.mixture import mixture
    from fntg_jax.running import league, matches, physical

    match = matches.get_match("soccer", minutes=options.seconds / 60)
    sides = [[matches.get_team(n, match, k) for n in options.teams] for k in (0, 1)]
    (home, homes), (away, aways) = map(mixture, sides)
    pairs = list(combinations(range(len(options.teams)), 2))
    seeds = matches.match_seeds(options.matches, options.seed)
    names = [league.label(team) for team in options.teams]
    first, second = (np.repeat([pair[k] for pair in pairs], len(seeds)) for k in (0, 1))
    all_seeds = np.tile(seeds, len(pairs))
    pick = lambda stacked, row: jax.tree.map(lambda a: a[row], stacked)  # noqa: E731
    program = league._program(match, home, away, 1)
    tables = jax.device_get(program((homes, aways), first, second, all_seeds))._asdict()
    rows = [
        ["tables", names[a], names[b], seed, *(int(x) for c in COLUMNS for x in tables[c][n])]
        for n, (a, b, seed) in enumerate(zip(first, second, all_seeds))
    ]
    # One program steers all pairs: the teams are arguments.
    bodies = physical.get_bodies("quadruped", match)
    own = lambda teams: (home._replace(team=teams[0]), away._replace(team=teams[1]))  # noqa: E731
    begin = jax.jit(lambda teams, state: playing.begin(match, *own(teams), state))
    decide = jax.jit(lambda teams, carry: playing.decide(match, *own(teams), carry))
    seconds = 0.0
    for n, (a, b, seed) in enumerate(zip(first, second, all_seeds)):
        teams = pick(homes, a), pick(aways, b)
        state = bodies.reset(int(seed) % 2, int(seed))
        memories = begin(teams, state)
        started = time.perf_counter()
        for _ in range(match.steps):
            memories, action = decide(teams, (state, memories))
            state = bodies.step(state, action)
        seconds += time.perf_counter() - started if n else 0.0
        found = jax.tree.map(lambda x: np.asarray(x)[:, 0], state.statistics)._asdict()
        numbers = (int(x) for c in COLUMNS for x in found[c])
        rows.append(["MuJoCo", names[a], names[b], seed, *numbers])
    return rows, match.steps * match.dt * max(len(first) - 1, 1) / max(seconds, 1e-9)


def report(rows: list[list], teams: list[str], speed: float) -> None:
    from fntg_jax.running.statistics import bootstrap_mean_of_counts

    pairs = list(dict.fromkeys((row[1], row[2]) for row in rows))
    print(f"{'':28s}{'tables':>24s}{'MuJoCo':>24s}")
    apart = 0
    for pair in pairs:
        cells, spans = [], []
        for world in ("tables", "MuJoCo"):
            gaps = np.array([r[4] - r[5] for r in rows if r[0] == world and tuple(r[1:3]) == pair])
            low, high = bootstrap_mean_of_counts(gaps)
            spans.append((low, high))
            cells.append(f"{gaps.mean():+.2f} ({low:+.2f} to {high:+.2f})")
        (a, b), (c, d) = spans
        opposed = (a > 0 and d < 0) or (b < 0 and c > 0)
        apart += opposed
        print(f"{' - '.join(pair):28s}{cells[0]:>24s}{cells[1]:>24s}{'  !' if opposed else ''}")
    print(f"opposite signs beyond chance: {apart} of {len(pairs)} pairs")
    for n, column in enumerate(COLUMNS):
        means = [
            np.mean([r[4 + 2 * n] + r[5 + 2 * n] for r in rows if r[0] == w])
            for w in ("tables", "MuJoCo")
        ]
        ratio = f"{means[1] / means[0]:.2f}" if means[0] else "-"
        print(f"{column:12s}{means[0]:8.2f}{means[1]:8.2f}   MuJoCo / tables {ratio}")
    print(f"six dogs: {speed:.1f} x real time")


if __name__ == "__main__":
    main()
