"""What the paper leaves open, read one way or another: the paper's run for every reading.

    python -m experiments.interpretations

Each reading differs from the default in one thing and learns with 30 seeds: 60 genomes, 95
generations, four starts.  Columns: F is the fitness *by the default reading* of the best genome of
each seed, driven as its own reading says; own is what its own reading gave it: medians over seeds.
Success is on scenes never seen in learning: means over seeds, because most seeds of the paper's run
have none.  All with 95 % bootstrap intervals.  Writes
readings.csv (one row a seed), readings.png and .pdf, and prints the table and what goes wrong with
the forms as they are printed.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Observation
from experiments import script
from fntg_jax.controller import genome, network
from fntg_jax.controller.layout import expand, get_layout
from fntg_jax.learning import fitness, ga
from fntg_jax.learning.fitness import PaperWeights, paper_fitness
from fntg_jax.learning.ga import GAConfig
from fntg_jax.learning.rollout import rollout_pairs
from fntg_jax.running import evaluation, statistics, xla
from fntg_jax.running.registry import get_world
from fntg_jax.showing import plots

SUITES = ("open", "blocked")


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute and where the results go."""

    out: Path = Path("runs/readings")
    """folder of the CSV and the figure."""
    seeds: int = 30
    """learning runs of each reading."""
    generations: int = 95
    """populations evaluated."""
    eval_scenes: int = 500
    """unseen scenes a suite."""
    only: tuple[str, ...] = ()
    """names of readings to run, besides the default; all when empty."""


# The literal forms.  They stay here: nobody should train with them.


class BlindToTheBall:
    """A world that shows the controller d_O where theta_B belongs: C_k(d_O), as printed."""

    def __init__(self, env: Any):
        self._env = env

    def __getattr__(self, name):
        return getattr(self._env, name)

    def observe(self, state: Any) -> Any:
        seen = self._env.observe(state)
        return seen._replace(theta_ball=seen.d_obstacle)


def signed_v_fitness(outcome: Any) -> Any:
    """F with v_fit the mean of v without bars, as printed."""
    weights = PaperWeights()
    speed = jnp.mean(jnp.abs(outcome.v), axis=(-2, -1))
    signed = jnp.mean(outcome.v, axis=(-2, -1))
    cost = fitness.to_cost(paper_fitness(outcome, weights), 0)
    return fitness.from_cost(cost + weights.v * (signed - speed), 0)


def at_once_fitness(outcome: Any) -> Any:
    """F with delta and phi taken once, from the means over the trials of h and of the largest v:
    "the average data were taken as representative"."""
    means = outcome._replace(
        clearance=jnp.mean(outcome.clearance, axis=-1, keepdims=True),
        v_peak=jnp.mean(outcome.v_peak, axis=-1, keepdims=True),
        failed=jnp.any(outcome.failed, axis=-1, keepdims=True),
    )
    return paper_fitness(means)


def worst_trial_fitness(outcome: Any) -> Any:
    """F with delta and phi taken once, from the worst of the trials."""
    worst = outcome._replace(
        clearance=jnp.min(outcome.clearance, axis=-1, keepdims=True),
        v_peak=jnp.min(outcome.v_peak, axis=-1, keepdims=True),
        failed=jnp.any(outcome.failed, axis=-1, keepdims=True),
    )
    return paper_fitness(worst)


class Reading(NamedTuple):
    """One way to read the paper: what differs from the default."""

    name: str
    layout: str = "paper-31"
    output: network.Output = "scale"
    env: tuple[tuple[str, float], ...] = ()  # options of the world
    wrap: Callable[[Any], Any] = lambda env: env
    ga: GAConfig = GAConfig()
    fitness_fn: Callable[[Any], Any] = paper_fitness


BACKWARD = (("v_min", -0.2),)
READINGS = (
    Reading("default"),
    *(
        Reading(f"layout-{name}", layout=name)
        for name in ("three-sigma-31", "two-sigma-31", "mirror-28", "reduced-47", "full-63")
    ),
    Reading("output-clip", output="clip"),
    Reading("backward-abs-v", env=BACKWARD),
    Reading("backward-signed-v", env=BACKWARD, fitness_fn=signed_v_fitness),
    Reading("delta-phi-of-means", fitness_fn=at_once_fitness),
    Reading("delta-phi-of-worst", fitness_fn=worst_trial_fitness),
    Reading(
        "phi-at-0.01-m/s", fitness_fn=partial(paper_fitness, weights=PaperWeights(v_moved=0.01))
    ),
    Reading("C_k-sees-d_O", wrap=BlindToTheBall),
    *(
        Reading(f"selection-{name}", ga=GAConfig(selection=name))  # type: ignore[arg-type]
        for name in ("sus", "rank", "tournament", "truncation")
    ),
    Reading("crossover-0.8", ga=GAConfig(crossover_rate=0.8)),
    Reading("crossover-0.6", ga=GAConfig(crossover_rate=0.6)),
    Reading("dt-0.05-s", env=(("dt", 0.05),)),
    Reading("dt-0.2-s", env=(("dt", 0.2),)),
)


class Result(NamedTuple):
    """Of one reading, leading axis seed.  own: best fitness by its own reading; default: its
    fitness by the default reading; least: smallest denominator of F that any genome of any
    generation had; lost: how many had one of zero or less; v_end: mean v of the best genome at
    steps 170, 200, 220 (m/s); success: [S, suite]."""

    reading: Reading
    theta: np.ndarray
    own: np.ndarray
    default: np.ndarray
    least: np.ndarray
    lost: np.ndarray
    v_end: np.ndarray
    success: np.ndarray


def learn(reading: Reading, options: Options, world: Any) -> Result:
    """The paper's learning run of every seed, then the best genome of each on unseen scenes."""
    layout = get_layout(reading.layout)
    env = reading.wrap(world.make(**dict(reading.env)))
    starts = world.suites["paper"](jax.random.key(0), 4)
    held_out = [evaluation.held_out_scenes(world, s, options.eval_scenes) for s in SUITES]
    config = reading.ga

    def drive(theta, scenes):
        return rollout_pairs(layout, theta, scenes, env, output=reading.output)

    def one_seed(seed):
        state = ga.init(jax.random.key(seed), layout.num_genes, config)

        def step(state, _):
            theta = genome.decode(state.bits, config.num_bits)
            value = reading.fitness_fn(drive(theta, starts))
            state, _ = ga.generation(state, lambda key, theta: value, config, options.generations)
            return state, (jnp.min(fitness.to_cost(value, 0)), jnp.sum(value <= 0))

        state, (least, lost) = jax.lax.scan(step, state, None, length=options.generations)
        theta = genome.decode(state.best_bits, config.num_bits)
        outcome = drive(theta[None], starts)
        success = [
            jnp.mean(fitness.success(drive(theta[None], scenes)).success) for scenes in held_out
        ]
        return (
            theta, state.best_fitness, paper_fitness(outcome)[0], jnp.min(least), jnp.sum(lost),
            jnp.mean(outcome.v), jnp.stack(success),
        )  # fmt: skip

    found = jax.jit(partial(jax.lax.map, one_seed))(jnp.arange(options.seeds))
    return Result(reading, *map(np.asarray, found))


def run(options: Options) -> list[Result]:
    """All readings, the default first.  Raises ValueError: option, value, what is allowed."""
    script.check_least(options, seeds=1, generations=1, eval_scenes=1)
    known = [r.name for r in READINGS]
    for name in options.only:
        if name not in known:
            raise ValueError(f"only = {name!r}: known are {', '.join(known)}")
    world = get_world("kinematic")
    wanted = [r for r in READINGS if not options.only or r.name in ("default", *options.only)]
    results: list[Result] = []
    print(HEADER, flush=True)
    for reading in wanted:
        results.append(learn(reading, options, world))
        print(_row(results[-1], results[0]), flush=True)
    return results


HEADER = (
    "| reading | genes | F by the default reading | own F | success open % | success blocked % |"
    " difference from default % |\n|---|---|---|---|---|---|---|"
)


def _row(result: Result, default: Result) -> str:
    def interval(values):
        low, middle, high = statistics.bootstrap_median(values)
        return f"{middle:.3g} [{low:.3g}, {high:.3g}]"

    cells = [
        result.reading.name,
        str(result.theta.shape[1]),
        interval(result.default),
        interval(result.own),
        *(_mean(100 * result.success[:, n]) for n in range(len(SUITES))),
        _difference(result.success.mean(axis=1), default.success.mean(axis=1)),
    ]
    return "| " + " | ".join(cells) + " |"


def _mean(values: np.ndarray) -> str:
    low, middle, high = statistics.bootstrap_mean(values)
    return f"{middle:.1f} [{low:.1f}, {high:.1f}]"


def _difference(values: np.ndarray, default: np.ndarray) -> str:
    """Of mean success over the suites: means over seeds, percentile bootstrap, percent."""
    if values is default or len(values) < 2 or np.array_equal(values, default):
        return "-"
    draws = statistics.bootstrap_means(values) - statistics.bootstrap_means(default, seed=1)
    low, high = 100 * np.percentile(draws, [2.5, 97.5])
    return f"{100 * (values.mean() - default.mean()):+.1f} [{low:+.1f}, {high:+.1f}]"


def warnings(results: list[Result]) -> list[str]:
    """What goes wrong with the forms as they are printed, in sentences with numbers."""
    by_name = {r.reading.name: r for r in results}
    found = []
    signed = by_name.get("backward-signed-v")
    if signed is not None:
        default = by_name["default"]
        away = [int(np.sum(r.v_end < -0.03)) for r in (signed, default)]
        found.append(
            f"v_fit without bars, backward motion allowed: {int(np.sum(signed.lost))} genomes had a"
            f" denominator of zero or less, the smallest was {np.min(signed.least):.3g} (default:"
            f" {np.min(default.least):.3g}); best F of a seed up to {np.max(signed.own):.3g};"
            f" {away[0]} of {len(signed.own)} best genomes end by backing away (default: {away[1]})"
        )
    blind = by_name.get("C_k-sees-d_O")
    if blind is not None:
        found.append(
            "C_k(d_O): turning the ball once around the robot changes omega by"
            f" {np.max(turning(blind)):.3g} rad/s at most (default: median of seeds"
            f" {np.median(turning(by_name['default'])):.3g})"
        )
    return found


def turning(result: Result) -> np.ndarray:
    """[S] range of omega (rad/s) over the ball's direction, at 1 m from ball and obstacle."""
    angle = jnp.linspace(-3.1, 3.1, 63)
    one = jnp.ones_like(angle)
    seen = Observation(one, one, angle, 0 * one)
    if result.reading.wrap is BlindToTheBall:
        seen = seen._replace(theta_ball=seen.d_obstacle)
    params = expand(get_layout(result.reading.layout), jnp.asarray(result.theta))

    def omega(p):
        return jax.vmap(lambda s: network.command(p, s, output=result.reading.output).omega)(seen)

    return np.ptp(np.asarray(jax.vmap(omega)(params)), axis=1)


def plot(results: list[Result], path: Path) -> Path:
    """PNG, PDF and CSV: F and success of every reading, seeds as dots, medians with interval."""
    names = [r.reading.name for r in results]
    figure, axes = plots.new_grid(1, 2, 9.5, 0.32 * len(names) + 1.2)
    columns = [
        [(r.default, "o", plots.BLUE) for r in results],
        [(100 * r.success.mean(axis=1), "o", plots.GREEN) for r in results],
    ]
    labels = ("F by the default reading (median)", "success on unseen scenes, % (mean)")
    rng = np.random.default_rng(0)
    for axis, column, label in zip(axes[0], columns, labels):
        for row, (values, marker, colour) in enumerate(column):
            jitter = rng.uniform(-0.25, 0.25, len(values))
            axis.plot(values, row + jitter, marker, color=colour, ms=2.5, alpha=0.4, lw=0)
            if axis is axes[0, 0]:
                low, middle, high = statistics.bootstrap_median(values)
            else:
                low, middle, high = statistics.bootstrap_mean(values)
            axis.plot([low, high], [row, row], color="k", lw=2)
            axis.plot(middle, row, "|", color="k", ms=10, mew=2)
        axis.set_yticks(range(len(names)), names)
        axis.invert_yaxis()
        axis.set_xlabel(label)
    axes[0, 0].set_xscale("log")
    axes[0, 1].set_yticklabels([])
    path = plots.save(figure, path)
    header = (
        "reading,seed,fitness_default,fitness_own,least_denominator,num_lost,v_end,open,blocked"
    )
    rows = [
        [r.reading.name, seed, *(f"{x:.9g}" for x in numbers)]
        for r in results
        for seed, numbers in enumerate(
            zip(r.default, r.own, r.least, r.lost, r.v_end, *r.success.T)
        )
    ]
    script.write_csv(path.with_suffix(".csv"), header.split(), rows)
    return path


def main() -> None:
    xla.configure()
    options = script.options(Options, __doc__, "experiments/readings.py")
    with script.folder(options.out):
        results = run(options)
        print("\n" + "\n".join(warnings(results)))
        print(plot(results, options.out / "readings.png"))


if __name__ == "__main__":
    main()
