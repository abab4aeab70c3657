"""From the kinematic world into physics: train in one, judge in both, fine-tune in physics.

    python -m experiments.transfer --out runs/transfer
    python -m experiments.transfer --controller kinematic.json --out runs/transfer

Writes transfer.csv (success on the suites, every stage in every world, with Wilson 95 %
intervals), the two controllers, and failures.png: the trials in the full model that each stage
failed.  A controller of your own must know the capture point (`fntg train --env-options capture
0.145`).  Each controller learns on freshly drawn scenes, half of
them with an obstacle in the way; fitness is the geometric mean of the trials' F, so that one
perfect trial does not outweigh many bad ones.
"""

import dataclasses
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import fntg_jax
from experiments import script
from fntg_jax import export
from fntg_jax.controller import genome, network
from fntg_jax.controller.layout import get_layout
from fntg_jax.learning import fitness, ga
from fntg_jax.learning.rollout import Outcome, outcome_of, rollout_pairs
from fntg_jax.running import evaluation, statistics, warmstart, xla
from fntg_jax.running.registry import get_world
from fntg_jax.showing import failures, plots

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
        controller: parameter file or run folder to start from, instead of training in the
            kinematic world.
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


class Failure(NamedTuple):
    """A failed trial: what it was and why, its course [steps + 1, 2 or 3], and the obstacles."""

    title: str
    robot: np.ndarray
    ball: np.ndarray
    obstacles: np.ndarray


def evolve(
    env, world, layout, bits, config: ga.GAConfig, generations, num_scenes, seed, name, output
):
    """The best of the last generations' champions, compared on eight more draws of scenes."""
    mix = world.mix(MIX)

    def fitness_fn(key, theta, *, env):
        return geometric_fitness(
            rollout_pairs(layout, theta, mix(key, num_scenes), env, output=output)
        )

    @jax.jit
    def advance(state, env):
        return ga.generation(state, partial(fitness_fn, env=env), config, generations)

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


def judge_full(stage, controller, config: Config) -> tuple[list[Row], list[Failure]]:
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
        rows.append(Row(stage, "full", suite, config.full_scenes, *rate, *shares))
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
        f"{row.stage:12s} {row.world:10s} {row.suite:8s} success {100 * row.success:5.1f} %"
        f" [{100 * row.low:.1f}, {100 * row.high:.1f}]  reach {100 * row.reach:.1f} safe"
        f" {100 * row.safe:.1f} stop {100 * row.stop:.1f}  ({row.num_scenes} scenes)",
        flush=True,
    )


def run(config: Config) -> tuple[list[Row], list[Failure]]:
    """Train (or load), judge, fine-tune in physics, judge again."""
    script.check_least(
        config,
        **dict.fromkeys(("population", "fine_population"), 2),
        **dict.fromkeys(("generations", "fine_generations", "num_scenes", "fine_scenes"), 1),
        **dict.fromkeys(("eval_scenes", "full_scenes"), 1),
    )
    first = None if config.controller is None else fntg_jax.load(config.controller)
    kinematic, physics = get_world("kinematic"), get_world("quadruped")
    settings = ga.GAConfig(population=config.population, selection="rank", mutation_rate=0.004)
    if first is None:
        layout = get_layout(config.layout)
        best = evolve(
            kinematic.make(capture=CAPTURE), kinematic, layout, None, settings,
            config.generations, config.num_scenes, config.seed, "kinematic", "scale",
        )  # fmt: skip
        first = export.from_bits(layout, np.asarray(best), provenance={"env": "kinematic"})
        export.save(first, config.out / "kinematic.json")
    rows = judge("kinematic", first, config)
    full, failed = judge_full("kinematic", first, config)
    settings = dataclasses.replace(settings, population=config.fine_population)
    start = warmstart.neighbours(
        jax.random.key(config.seed), jnp.asarray(first.theta, jnp.float32), config.fine_population
    )
    best = evolve(
        evaluation.environment_for(first, physics), physics, first.layout, start, settings,
        config.fine_generations, config.fine_scenes, config.seed + 10, "physics", first.output,
    )  # fmt: skip
    tuned = export.from_bits(
        first.layout,
        np.asarray(best),
        limits=first.limits,
        output=first.output,
        control_dt=first.control_dt,
        provenance={"env": "quadruped"},
    )
    export.save(tuned, config.out / "fine-tuned.json")
    rows += full + judge("fine-tuned", tuned, config)
    full, more = judge_full("fine-tuned", tuned, config)
    return rows + full, failed + more


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(Config, args=argv)
    xla.configure()
    with script.folder(config.out):
        rows, failed = run(config)
        script.write_csv(config.out / "transfer.csv", Row._fields, rows)
        if failed:
            draw_failures(failed, config.out / "failures.png")
            print(config.out / "failures.png")


if __name__ == "__main__":
    main()
