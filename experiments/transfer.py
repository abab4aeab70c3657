"""What fine-tuning in physics is worth: controllers of the kinematic world, seed by seed.

    fntg train --preset robust --env-options capture 0.145 --seeds 10 --out runs/captured
    python -m experiments.transfer --controller runs/captured --out runs/transfer

Every seed of the run (or one parameter file) is judged in the kinematic world, on the lean model
and on the full one, goes on learning on the lean one, and is judged again.  It must know the
capture point, as above.  Scenes are drawn freshly in each generation, half of them with an
obstacle in the way; fitness is the geometric mean of the trials' F, so that one perfect trial does
not outweigh many bad ones.

Prints, by world and suite, medians over the seeds and of their differences, with 95 % bootstrap
intervals.  Writes transfer.csv (a row a seed, stage, world and suite, as each seed ends; seeds that
are in it are not repeated), the fine-tuned controllers, and failures-SEED.png: the trials in the
full model that each stage failed.
"""

import csv
import dataclasses
import sys
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import fntg_jax
from experiments import script
from fntg_jax import export
from fntg_jax.controller import genome, network
from fntg_jax.controller.controller import Controller
from fntg_jax.learning import fitness, ga
from fntg_jax.learning.rollout import Outcome, outcome_of, rollout_pairs
from fntg_jax.running import config_file, controllers, evaluation, statistics, warmstart, xla
from fntg_jax.running.registry import get_world
from fntg_jax.showing import failures, plots

MIX = (("open", 0.5), ("blocked", 0.5))
CAPTURE = 0.145  # m, where the quadruped brings the ball to; the kinematic world learns with it
# A trial counts as unsafe from the first millimetre on; the paper's weight of 20 hardly sees one.
WEIGHTS = fitness.PaperWeights(clearance=200.0)
F_MOST = 100.0  # a trial's F counts up to here: about 0.05 m from the ball, standing


@dataclasses.dataclass(frozen=True)
class Config:
    """What to start from, and how much to learn and to judge.

    Attributes:
        controller: run folder, of which every seed counts, or a parameter file.
        out: folder of the results.
        population, generations, num_scenes: of the learning in physics.
        eval_scenes: unseen scenes a suite; full_scenes: of those in the full model.
        seed: of the learning in physics, with each controller's own added.
    """

    controller: Path
    out: Path = Path("runs/transfer")
    population: int = 60
    generations: int = 30
    num_scenes: int = 16
    eval_scenes: int = 500
    full_scenes: int = 100
    seed: int = 10


class Row(NamedTuple):
    """One seed at one stage: success on a suite in a world, and its parts; the Wilson 95 % interval
    is that of the scenes."""

    seed: int
    stage: str
    world: str
    suite: str
    num_scenes: int
    success: float
    low: float
    high: float
    reach: float
    safe: float
    stop: float


def geometric_fitness(outcome: Outcome) -> Any:
    """exp(mean over trials of log min(F, 100)); outcome [P, T] gives [P]."""
    single = jax.tree.map(lambda x: x[:, :, None], outcome)
    per_trial = jnp.minimum(fitness.paper_fitness(single, WEIGHTS), F_MOST)
    return jnp.exp(jnp.mean(jnp.log(per_trial), axis=1))


class Failure(NamedTuple):
    """A failed trial: what it was and why, its course [steps + 1, 2 or 3], and the obstacles."""

    title: str
    robot: np.ndarray
    ball: np.ndarray
    obstacles: np.ndarray


def fine_tune(first: Controller, config: Config, seed: int) -> Any:
    """Genes, as bits: the best of the last generations' champions on eight more draws of scenes."""
    world = get_world("quadruped")
    env, mix = evaluation.environment_for(first, world), world.mix(MIX)
    settings = ga.GAConfig(population=config.population, selection="rank", mutation_rate=0.004)
    k_start, k_search, k_last = jax.random.split(jax.random.key(config.seed + seed), 3)
    theta = jnp.asarray(first.theta, jnp.float32)
    start = warmstart.neighbours(k_start, theta, config.population)
    state = ga.init(k_search, first.layout.num_genes, settings)._replace(bits=start)
    advance, trial = _programs(first.layout, first.output, settings, mix, config)
    champions = []
    for n in range(config.generations):
        state, record = advance(state, env)
        champions.append(record.best_bits)
        if (n + 1) % 10 == 0:
            print(f"{n + 1}: best {record.best:.2f} mean {record.mean:.2f}", file=sys.stderr)
    # One generation's scenes are few: the last champions meet on many.  As many candidates as
    # genomes, so that nothing else is compiled.
    last = jnp.stack(champions[-config.population :])
    last = last[jnp.arange(config.population) % len(last)]
    theta = genome.decode(last, settings.num_bits, settings.gray)
    scores = sum(np.log(trial(k, theta, env)) for k in jax.random.split(k_last, 8))
    return last[int(np.argmax(scores))]


@cache
def _programs(layout, output, settings: ga.GAConfig, mix, config: Config):
    """A generation, and the fitness of genes: compiled once for all seeds."""

    def fitness_fn(key, theta, env):
        scenes = mix(key, config.num_scenes)
        return geometric_fitness(rollout_pairs(layout, theta, scenes, env, output=output))

    def advance(state, env):
        return ga.generation(state, partial(fitness_fn, env=env), settings, config.generations)

    return jax.jit(advance), jax.jit(fitness_fn)


def judge(seed: int, stage: str, controller: Controller, config: Config) -> list[Row]:
    """In the kinematic world and on the lean model."""
    rows = []
    for name in ("kinematic", "quadruped"):
        for suite in ("open", "blocked"):
            world = get_world(name)
            options = {"capture": CAPTURE} if name == "kinematic" else {}
            env = evaluation.environment_for(controller, world, **options)
            result = evaluation.evaluate(controller, world, suite, config.eval_scenes, env=env)
            r = result.rates
            shares = [r[part].share for part in ("reach", "safe", "stop")]
            rows.append(Row(seed, stage, name, suite, config.eval_scenes, *r["success"], *shares))
            _say(rows[-1])
    return rows


def judge_full(
    seed: int, stage: str, controller: Controller, config: Config
) -> tuple[list[Row], list[Failure]]:
    """The full model in MuJoCo's C code: the ball can be pushed, everything touches."""
    from envs.quadruped import native
    from envs.quadruped.environment import heading

    world = get_world("quadruped")
    env = evaluation.environment_for(controller, world)
    params = controller.params32
    control = jax.vmap(lambda seen: network.command(params, seen, env.limits, controller.output))
    rows, failed = [], []
    for suite in ("open", "blocked"):
        scenes = evaluation.held_out_scenes(world, suite, config.full_scenes)
        run = native.run(env, scenes, lambda seen, _: control(seen), "full")
        judged = jax.vmap(outcome_of, in_axes=(1, 1, 0))
        outcome = jax.tree.map(np.asarray, judged(run.observation, run.command, run.fallen[-1]))
        parts = fitness.success(outcome)
        good = np.asarray(parts.success)
        rate = statistics.wilson(int(good.sum()), config.full_scenes)
        shares = [float(np.mean(getattr(parts, p))) for p in ("reach", "safe", "stop")]
        rows.append(Row(seed, stage, "full", suite, config.full_scenes, *rate, *shares))
        _say(rows[-1])
        for n in np.flatnonzero(~good):
            why = failures.reasons(jax.tree.map(lambda x, n=n: x[n], outcome))
            qpos = run.qpos[:, n]
            course = np.arctan2(*np.stack(jax.vmap(heading)(jnp.asarray(qpos)))[::-1])
            failed.append(
                Failure(
                    f"{stage}, {suite} {n}\n{chr(10).join(why)}",
                    np.column_stack([qpos[:, :2], course]),
                    run.ball[:, n],
                    run.obstacles[0, n],
                )
            )
    return rows, failed


def draw_failures(failed: list[Failure], path: Path, most: int = 24) -> None:
    """The failed trials from above: start (dot and arrow), path of the dog's centre to its end
    (square), obstacles with the ring it must stay out of, and the ball's way to its end (star)."""
    shown = failed[:most]
    columns = min(len(shown), 4)
    num_rows = -(-len(shown) // columns)
    figure, axes = plots.new_grid(num_rows, columns, 3.2 * columns, 2.6 * num_rows)
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, trial in zip(axes.flat, shown):
        plots.draw_field(axis, get_world("quadruped").field)
        plots.draw_discs(axis, trial.obstacles)
        plots.draw_path(axis, trial.robot, plots.BLUE)
        plots.draw_ball(axis, trial.ball)
        axis.set_title(trial.title, fontsize=7, loc="left")
    more = f", {most} of them shown" if len(failed) > most else ""
    figure.suptitle(f"{len(failed)} failed trials in the full model{more}", fontsize=9)
    plots.save(figure, path)


def _say(row: Row) -> None:
    print(
        f"{row.seed:3d} {row.stage:12s} {row.world:10s} {row.suite:8s} {100 * row.success:5.1f} %"
        f" [{100 * row.low:.1f}, {100 * row.high:.1f}]  reach {100 * row.reach:.1f} safe"
        f" {100 * row.safe:.1f} stop {100 * row.stop:.1f}  ({row.num_scenes} scenes)",
        flush=True,
    )


def starts(path: Path) -> dict[int, Controller]:
    """seed -> its controller, of a run folder or a parameter file.  Raises ValueError (one line)
    where it cannot be read."""
    if not path.is_dir():
        return {0: fntg_jax.load(path)}
    config = config_file.load(path)
    seeds = range(config.first_seed, config.first_seed + config.seeds)
    return {seed: controllers.of_seed(path, seed) for seed in seeds}


def one_seed(seed: int, first: Controller, config: Config) -> list[Row]:
    """Judge, fine-tune in physics, judge again."""
    rows = judge(seed, "kinematic", first, config)
    full, failed = judge_full(seed, "kinematic", first, config)
    tuned = export.from_bits(
        first.layout,
        np.asarray(fine_tune(first, config, seed)),
        limits=first.limits,
        output=first.output,
        control_dt=first.control_dt,
        provenance={"env": "quadruped"},
    )
    export.save(tuned, config.out / f"fine-tuned-{seed}.json")
    rows += full + judge(seed, "fine-tuned", tuned, config)
    full, more = judge_full(seed, "fine-tuned", tuned, config)
    if failed + more:
        draw_failures(failed + more, config.out / f"failures-{seed}.png")
    return rows + full


def run(config: Config) -> list[Row]:
    """All rows, those that transfer.csv has and new ones."""
    least = {f.name: 1 for f in dataclasses.fields(config) if f.type is int}
    script.check_least(config, **{**least, "population": 2, "seed": 0})
    path = config.out / "transfer.csv"
    first = starts(config.controller)
    rows = read(path) if path.exists() else []
    for seed, controller in first.items():
        if all(row.seed != seed for row in rows):
            rows += one_seed(seed, controller, config)
            script.write_csv(path, Row._fields, rows)
    return rows


def read(path: Path) -> list[Row]:
    """Rows of the CSV.  Raises ValueError when it is not one of ours."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
    kinds = Row.__annotations__.values()
    try:
        if lines[0] != list(Row._fields):
            raise ValueError
        return [Row(*(k(x) for k, x in zip(kinds, line, strict=True))) for line in lines[1:]]
    except (ValueError, IndexError):
        raise ValueError(f"{path}: not written by this script") from None


def table(rows: list[Row]) -> str:
    """Markdown: by world and suite, medians over seeds of success before and after, and of the
    difference; 95 % bootstrap intervals, percent and percentage points."""
    lines = [
        f"{len({row.seed for row in rows})} seeds: median [95 % interval]",
        "",
        "| world | suite | kinematic, % | fine-tuned, % | difference, points | better, worse |",
        "|---|---|---|---|---|---|",
    ]
    for world, suite in dict.fromkeys((row.world, row.suite) for row in rows):
        before, after = (
            np.asarray([100 * r.success for r in rows if r[1:4] == (stage, world, suite)])
            for stage in ("kinematic", "fine-tuned")
        )
        change = after - before
        cells = [_interval(before, ""), _interval(after, ""), _interval(change, "+")]
        told = f"{(change > 0).sum()}, {(change < 0).sum()}"
        lines.append(f"| {world} | {suite} | {' | '.join(cells)} | {told} |")
    return "\n".join(lines)


def _interval(values: np.ndarray, sign: str) -> str:
    low, middle, high = statistics.bootstrap_median(values)
    return f"{middle:{sign}.1f} [{low:{sign}.1f}, {high:{sign}.1f}]"


def main(argv: list[str] | None = None) -> None:
    config = script.options(Config, Config.__doc__, "experiments/transfer.py", argv)
    xla.configure()
    with script.folder(config.out):
        print(table(run(config)))


if __name__ == "__main__":
    main()
