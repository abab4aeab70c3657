"""From the kinematic world into physics: train in one, judge in both, fine-tune in physics.

    python -m experiments.transfer --out runs/transfer

Writes transfer.csv (success on the suites, every stage in every world, with Wilson 95 %
intervals) and the two controllers.  Each controller learns on freshly drawn scenes, half of
them with an obstacle in the way; fitness is the geometric mean of the trials' F, so that one
perfect trial does not outweigh many bad ones.
"""

import csv
import dataclasses
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from fntg_jax import evaluation, export, fitness, fntg, ga, genome, warmstart, xla
from fntg_jax.layout import expand, get_layout
from fntg_jax.rollout import Outcome, rollout_pairs
from fntg_jax.settings import get_world

MIX = (("open", 0.5), ("blocked", 0.5))
CAPTURE = 0.145  # m, where the quadruped brings the ball to; the kinematic world learns with it
# A trial counts as unsafe from the first millimetre on; the paper's weight of 20 hardly sees one.
WEIGHTS = fitness.PaperWeights(clearance=200.0)
F_MOST = 100.0  # a trial's F counts up to here: about 0.05 m from the ball, standing


@dataclasses.dataclass(frozen=True)
class Config:
    """Training in the kinematic world, then in physics.

    Attributes:
        out: folder of the results.
        controller: parameter file to start from instead of training in the kinematic world.
        layout: gene table of the controller that is trained.
        population, generations, num_scenes: of the kinematic stage.
        fine_population, fine_generations, fine_scenes: of the stage in physics.
        eval_scenes: unseen scenes a suite; full_scenes: of those in the full model.
        seed: of everything.
    """

    out: Path = Path("runs/transfer")
    controller: Path | None = None
    layout: str = "paper-31"
    population: int = 120
    generations: int = 400
    num_scenes: int = 32
    fine_population: int = 60
    fine_generations: int = 30
    fine_scenes: int = 16
    eval_scenes: int = 500
    full_scenes: int = 100
    seed: int = 0


class Row(NamedTuple):
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


def evolve(env, world, layout, bits, config: ga.GAConfig, generations, num_scenes, seed, name):
    """The best of the last generations' champions, compared on eight more draws of scenes."""
    mix = world.mix(MIX)

    def fitness_fn(key, theta, progress=0.0, *, env):
        return geometric_fitness(rollout_pairs(layout, theta, mix(key, num_scenes), env))

    @jax.jit
    def advance(state, env):
        return ga.generation(state, partial(fitness_fn, env=env), config)

    state = ga.init(jax.random.key(seed), layout.num_genes, config)
    if bits is not None:
        state = state._replace(bits=bits)
    champions = []
    for n in range(generations):
        state, record = advance(state, env)
        champions.append(record.best_bits)
        if (n + 1) % 10 == 0 or n == 0:
            print(f"{name} {n + 1}: best {record.best:.2f} mean {record.mean:.2f}", file=sys.stderr)
    # One generation's scenes are few: the last champions meet on many.
    last = jnp.stack(champions[-config.population :])
    theta = genome.decode(last, config.num_bits, config.gray)
    trial = jax.jit(fitness_fn)
    keys = jax.random.split(jax.random.key(seed + 1), 8)
    scores = sum(np.log(trial(k, theta, env=env)) for k in keys)
    return last[int(np.argmax(scores))]


def judge(stage, controller, config: Config, worlds=("kinematic", "quadruped")) -> list[Row]:
    rows = []
    for name in worlds:
        for suite in ("open", "blocked"):
            world = get_world(name)
            options = {"capture": CAPTURE} if name == "kinematic" else {}
            env = evaluation.environment_for(controller, world, **options)
            result = evaluation.evaluate(controller, world, suite, config.eval_scenes, env=env)
            r = result.rates
            shares = [r[part].share for part in ("reach", "safe", "stop")]
            rows.append(Row(stage, name, suite, config.eval_scenes, *r["success"], *shares))
            _say(rows[-1])
    return rows


def judge_full(stage, controller, config: Config) -> list[Row]:
    """The full model in MuJoCo's C code: the ball can be pushed, everything touches."""
    from envs.quadruped import native

    world = get_world("quadruped")
    env = evaluation.environment_for(controller, world)
    params = expand(controller.layout, jnp.asarray(controller.theta, jnp.float32))
    control = jax.vmap(lambda seen: fntg.command(params, seen, env.limits, controller.output))
    rows = []
    for suite in ("open", "blocked"):
        scenes = evaluation.held_out_scenes(world, suite, config.full_scenes)
        run = native.run(env, scenes, control, "full")
        steps = [169, 199, 219]
        d_ball, d_obstacle = map(np.asarray, (run.observation.d_ball, run.observation.d_obstacle))
        parts = fitness.success(
            Outcome(
                distance=d_ball[[s + 1 for s in steps]].T,  # type: ignore[arg-type]
                v=run.command.v[steps].T,
                omega=run.command.omega[steps].T,
                clearance=d_obstacle.min(0),
                v_peak=run.command.v.max(0),
                failed=run.fallen[-1],
            )
        )
        rate = evaluation.wilson(int(np.sum(parts.success)), config.full_scenes)
        shares = [float(np.mean(getattr(parts, p))) for p in ("reach", "safe", "stop")]
        rows.append(Row(stage, "full", suite, config.full_scenes, *rate, *shares))
        _say(rows[-1])
    return rows


def _say(row: Row) -> None:
    print(
        f"{row.stage:12s} {row.world:10s} {row.suite:8s} success {100 * row.success:5.1f} %"
        f" [{100 * row.low:.1f}, {100 * row.high:.1f}]  reach {100 * row.reach:.1f} safe"
        f" {100 * row.safe:.1f} stop {100 * row.stop:.1f}  ({row.num_scenes} scenes)",
        flush=True,
    )


def run(config: Config) -> list[Row]:
    """Train (or load), judge, fine-tune in physics, judge again."""
    config.out.mkdir(parents=True, exist_ok=True)
    kinematic, physics = get_world("kinematic"), get_world("quadruped")
    settings = ga.GAConfig(population=config.population, selection="rank", mutation_rate=0.004)
    if config.controller is not None:
        first = export.load(config.controller)
        layout = first.layout
    else:
        layout = get_layout(config.layout)
        best = evolve(
            kinematic.make(capture=CAPTURE), kinematic, layout, None, settings,
            config.generations, config.num_scenes, config.seed, "kinematic",
        )  # fmt: skip
        first = export.from_bits(layout, np.asarray(best))
        export.save(first, config.out / "kinematic.json")
    rows = judge("kinematic", first, config) + judge_full("kinematic", first, config)
    settings = dataclasses.replace(settings, population=config.fine_population)
    start = warmstart.neighbours(
        jax.random.key(config.seed), jnp.asarray(first.theta, jnp.float32), config.fine_population
    )
    best = evolve(
        evaluation.environment_for(first, physics), physics, layout, start, settings,
        config.fine_generations, config.fine_scenes, config.seed + 10, "physics",
    )  # fmt: skip
    tuned = export.from_bits(layout, np.asarray(best), limits=first.limits, output=first.output)
    export.save(tuned, config.out / "fine-tuned.json")
    rows += judge("fine-tuned", tuned, config) + judge_full("fine-tuned", tuned, config)
    with (config.out / "transfer.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        writer.writerows(rows)
    return rows


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(Config, args=argv)
    xla.configure()
    run(config)


if __name__ == "__main__":
    main()
