"""Which localization?  Gutmann and Fox's questions: noise, sparse sight, kidnapping, cost.

    python -m experiments.localization

A robot tours their five points (0,0), (0.5,0), (0.5,-0.5), (-1,0.5), (-1,0) m and stands three
seconds at each, among the six landmarks of 2001.  Three filters read the same simulated logs, whose
odometry is off by 8 % and 0.02 rad/s and 15 % at random: the match's extended Kalman filter, Monte
Carlo with resetting (two sizes), and the weighted Kalman filters of `fntg localize`.  The first two
are told how noisy the landmarks are, the last finds out.  Prints tables (means over logs with
bootstrap 95 % intervals), writes localization.csv, localization.png and .pdf.
"""

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.field import FIELD
from experiments import localization_logs as logs
from experiments import script
from fntg_jax.robot import hypotheses, monte_carlo
from fntg_jax.robot import localization as kalman
from fntg_jax.robot.messages import Displacement, Seen
from fntg_jax.running import localize, statistics, xla
from fntg_jax.showing import plots

LANDMARKS = {mark.name: (mark.x, mark.y) for mark in FIELD.landmarks}
MARKS = np.array(list(LANDMARKS.values()), np.float32)
SIZES = (100, 1000)  # of Monte Carlo
NOISE = (0.5, 1.0, 2.0, 3.0)  # times 7 % and 2 degrees
SIGHTINGS = (1.3, 0.65, 0.13, 0.0325)  # landmarks a step
MISNAMED = (0.0, 0.05, 0.1, 0.2)
LIFT = 60.0  # s, when the robot is kidnapped
FOUND = 0.25  # m
COVERAGE = (0.5, 0.68, 0.9, 0.95)


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute and where the results go."""

    out: Path = Path("runs/localization")
    """folder of the CSV and the figure."""
    logs: int = 10
    """simulated logs for each level."""
    seconds: float = 120.0
    """length of a log."""
    seed: int = 0
    """of the first log."""
    drive: str = "points"
    """how the robot drives, one of experiments.localization_logs.DRIVES."""
    cost: int = 200
    """steps over which the cost is timed."""


class Batch(NamedTuple):
    """Logs of one length.  truth: [N, T, 3]; way: leaves [T, N]; seen: leaves [T, 6, N]; noise:
    what the match's filters are told."""

    logs: list[Any]
    truth: np.ndarray
    way: Displacement
    seen: Seen
    noise: kalman.Noise


class Poses(NamedTuple):
    """Estimates: pose [N, T, 3] (m, rad) and covariance [N, T, 3, 3]."""

    pose: np.ndarray
    covariance: np.ndarray


def batch(settings: logs.Settings, num: int, seed: int) -> Batch:
    """Logs, and the same as arrays; signs of systematic errors and ways to be random alternate."""
    kinds, signs = ("component", "length"), (1, -1)
    made = [
        logs.make(
            dataclasses.replace(
                settings,
                scale=signs[n % 2] * settings.scale,
                drift=signs[n // 2 % 2] * settings.drift,
                random_kind=kinds[n // 4 % 2],
            ),
            LANDMARKS,
            seed + n,
        )
        for n in range(num)
    ]
    steps = len(made[0].truth) - 1
    way = np.zeros((3, steps, num), np.float32)
    seen = np.zeros((2, steps, 6, num), np.float32)
    visible = np.zeros((steps, 6, num), bool)
    names = list(LANDMARKS)
    for n, log in enumerate(made):
        step = -1
        for _, kind, name, *cells in log.rows:
            if kind == "odometry":
                step += 1
                way[:, step, n] = [float(c) for c in cells]
            elif kind == "landmark":
                place = step, names.index(name), n
                seen[(slice(None), *place)] = [float(c) for c in cells[:2]]
                visible[place] = True
    distance, bearing = seen
    return Batch(
        made,
        np.stack([log.truth[1:, 1:] for log in made]),
        Displacement(*jnp.asarray(way)),
        Seen(
            jnp.asarray(distance),
            jnp.cos(bearing),
            jnp.sin(bearing),
            jnp.asarray(visible),
            jnp.full(distance.shape, settings.range_noise),
        ),
        kalman.Noise(bearing=settings.bearing_noise),
    )


def _starts(b: Batch):
    """True first poses [3, N], or None where the logs begin anywhere."""
    if not any(row[1] == "start" for row in b.logs[0].rows):
        return None
    return jnp.asarray(np.stack([log.truth[0, 1:] for log in b.logs]).T, jnp.float32)


@jax.jit
def _run_kalman(belief, way, seen, noise):
    def step(belief, inputs):
        belief = kalman.update(belief, *inputs, MARKS, noise)
        return belief, (kalman.pose(belief), belief)

    return jax.lax.scan(step, belief, (way, seen))[1]


def by_kalman(b: Batch, seed: int) -> Poses:
    """The match's filter."""
    num, start = b.truth.shape[0], _starts(b)
    if start is None:
        belief = kalman.unknown((num,))
    else:
        belief = kalman.begin(start, 0.03, 0.05)
    pose, state = _run_kalman(belief, b.way, b.seen, b.noise)
    rows = [[state.xx, state.xy, state.xh], [state.xy, state.yy, state.yh]]
    rows.append([state.xh, state.yh, state.hh])
    covariance = np.transpose(np.array(rows), (3, 2, 0, 1))
    heading = np.arctan2(pose.sin, pose.cos)
    return Poses(np.transpose(np.array([pose.x, pose.y, heading]), (2, 1, 0)), covariance)


@jax.jit
def _run_monte_carlo(keys, particles, way, seen, noise):
    def one(key, particles, way, seen):
        def step(p, inputs):
            n, way, seen = inputs
            key_n = jax.random.fold_in(key, n)
            p = monte_carlo.update(key_n, p, way, seen, jnp.asarray(MARKS), noise)
            pose = monte_carlo.pose(p)
            heading = jnp.arctan2(pose.sin, pose.cos)
            off = jnp.stack([p.x - pose.x, p.y - pose.y, hypotheses.wrap(p.heading - heading)])
            return p, (jnp.stack([pose.x, pose.y, heading]), off @ off.T / p.x.size)

        return jax.lax.scan(step, particles, (jnp.arange(way.x.shape[0]), way, seen))[1]

    return jax.vmap(one, in_axes=(0, 0, -1, -1))(keys, particles, way, seen)


def by_monte_carlo(size: int) -> Callable[[Batch, int], Poses]:
    """Monte Carlo with resetting, of `size` particles."""

    def run(b: Batch, seed: int) -> Poses:
        num, start = b.truth.shape[0], _starts(b)
        keys = jax.random.split(jax.random.key(seed), num)
        if start is None:
            first = jax.vmap(lambda k: monte_carlo.unknown(k, size, FIELD.length, FIELD.width))(
                keys
            )
        else:
            first = jax.vmap(lambda k, s: monte_carlo.known(k, size, s, 0.03, 0.05))(keys, start.T)
        pose, covariance = _run_monte_carlo(keys, first, b.way, b.seen, b.noise)
        return Poses(np.asarray(pose), np.asarray(covariance))

    return run


def by_hypotheses(b: Batch, seed: int) -> Poses:
    """What `fntg localize` does, log after log."""
    found = [localize.localize([_row(row) for row in log.rows], LANDMARKS) for log in b.logs]
    return Poses(np.stack([p.pose for p in found]), np.stack([p.covariance for p in found]))


def _row(row) -> localize.Row:
    t, kind, name, *cells = row
    a, b, c = (float(cell or 0) for cell in cells)
    return localize.Row(t, kind, name, (a, b, c))


METHODS: dict[str, Callable[[Batch, int], Poses]] = {
    "Kalman (match)": by_kalman,
    **{f"Monte Carlo {size}": by_monte_carlo(size) for size in SIZES},
    "Kalman, weighted": by_hypotheses,
}


def distances(b: Batch, path: Poses) -> np.ndarray:
    """[N, T] m between estimate and truth."""
    return np.hypot(*np.moveaxis(path.pose[..., :2] - b.truth[..., :2], -1, 0))


def _mean(values: np.ndarray, digits: int = 2) -> str:
    """Mean over logs and its bootstrap 95 % interval."""
    low, mean, high = statistics.bootstrap_mean(values, 1000)
    return f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def levels(options: Options, settings: logs.Settings):
    """(question, level, settings of its logs) of the questions about errors."""
    for factor in NOISE:
        d, a = settings.range_noise * factor, settings.bearing_noise * factor
        changed = dataclasses.replace(settings, range_noise=d, bearing_noise=a)
        yield "noise, times 7 % and 2 degrees", factor, changed
    for sightings in SIGHTINGS:
        changed = dataclasses.replace(settings, sightings=sightings, head="any")
        yield "landmarks a step", sightings, changed
    for share in MISNAMED:
        yield "share of wrong names", share, dataclasses.replace(settings, misnamed=share)


def accuracy(options: Options, settings: logs.Settings) -> list[tuple[str, float, str, np.ndarray]]:
    """(question, level, method, mean errors [logs], m), printed on the way."""
    rows = []
    before = ""
    for question, level, changed in levels(options, settings):
        if question != before:
            print(f"\nmean error, cm\n{question:32s}" + "".join(f"{m:>22s}" for m in METHODS))
            before = question
        b = batch(changed, options.logs, options.seed)
        cells = []
        for name, method in METHODS.items():
            errors = distances(b, method(b, options.seed)).mean(axis=1)
            rows.append((question, level, name, errors))
            cells.append(f"{_mean(100 * errors):>22s}")
        print(f"{level:<32g}" + "".join(cells), flush=True)
    return rows


def recovery(options: Options, settings: logs.Settings) -> dict[str, np.ndarray]:
    """[2, logs] s until the error is below 25 cm: begun anywhere, and kidnapped; inf for never."""
    seconds = min(30.0, options.seconds)
    anywhere = dataclasses.replace(settings, started=False, seconds=seconds)
    lifted = dataclasses.replace(settings, kidnapped=(LIFT,), seconds=LIFT + seconds)
    found = {}
    print(f"\n{'s until below 25 cm':22s}{'begun anywhere':>34s}{'kidnapped':>34s}")
    print(f"{'':22s}" + f"{'median':>12s}{'90 %':>11s}{'within 5 s':>11s}" * 2)
    batches = [batch(s, options.logs, options.seed) for s in (anywhere, lifted)]
    for name, method in METHODS.items():
        rows, cells = [], []
        for b, since in zip(batches, (0.0, LIFT)):
            first = round(since / settings.dt)
            near = distances(b, method(b, options.seed))[:, max(first - 1, 0) :] < FOUND
            taken = np.where(near.any(axis=1), near.argmax(axis=1) * settings.dt, np.inf)
            rows.append(taken)
            quantiles = np.quantile(taken, [0.5, 0.9], method="higher")
            share = f"{np.sum(taken <= 5)}/{len(taken)}"
            cells.append(f"{quantiles[0]:12.1f}{quantiles[1]:11.1f}{share:>11s}")
        found[name] = np.array(rows)
        print(f"{name:22s}" + "".join(cells), flush=True)
    return found


def reliability(options: Options, settings: logs.Settings) -> dict[str, list[float]]:
    """Shares of the poses within the ellipse that should hold a share of them (`COVERAGE`)."""
    b = batch(settings, options.logs, options.seed)
    found = {}
    print(f"\n{'within the ellipse of':22s}" + "".join(f"{100 * c:>9.0f} %" for c in COVERAGE))
    for name, method in METHODS.items():
        path = method(b, options.seed)
        off = path.pose[..., :2] - b.truth[..., :2]
        weighed = np.linalg.solve(path.covariance[..., :2, :2], off[..., None])[..., 0]
        square = np.sum(off * weighed, axis=-1)
        # An ellipse of squared radius r holds 1 - exp(-r/2) of a Gaussian.
        found[name] = [float(np.mean(square <= -2 * np.log(1 - c))) for c in COVERAGE]
        print(f"{name:22s}" + "".join(f"{100 * c:>9.1f} %" for c in found[name]), flush=True)
    return found


def cost(options: Options, settings: logs.Settings) -> dict[str, float]:
    """Updates a second, best of five, methods in turn; the match's filter for 128 robots."""
    b = batch(dataclasses.replace(settings, seconds=options.cost * settings.dt), 1, 0)
    robots = 128
    wide = jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], robots)), (b.way, b.seen))

    @jax.jit
    def many(belief, way, seen):
        return jax.lax.scan(lambda z, i: (kalman.update(z, *i, MARKS), None), belief, (way, seen))[
            0
        ]

    belief = kalman.unknown((robots,))
    runs: dict[str, tuple[Callable[[], Any], int]] = {
        name: (partial(method, b, 0), options.cost) for name, method in METHODS.items()
    }
    runs["Kalman (match)"] = partial(many, belief, *wide), robots * options.cost
    best = dict.fromkeys(runs, np.inf)
    for round_ in range(6):
        for name, (run, _) in runs.items():
            begin = time.perf_counter()
            jax.block_until_ready(run())
            if round_:  # the first one compiles
                best[name] = min(best[name], time.perf_counter() - begin)
    speed = {name: num / best[name] for name, (_, num) in runs.items()}
    print(f"\n{'updates a second':22s}{'':>12s}")
    for name, value in speed.items():
        print(f"{name:22s}{value:12,.0f}")
    return speed


def plot(rows, found, coverage, path: Path) -> Path:
    """PNG and PDF: errors over three levels, recovery, reliability."""
    figure, axes = plots.new_grid(2, 3, 10.5, 6)
    questions = list(dict.fromkeys(row[0] for row in rows))
    for axis, question in zip(axes.flat, questions):
        for name, colour in zip(METHODS, plots.COLOURS):
            chosen = [row for row in rows if row[0] == question and row[2] == name]
            means = 100 * np.array([row[3].mean() for row in chosen])
            axis.plot([row[1] for row in chosen], means, "o-", color=colour, ms=3, label=name)
        axis.set_xlabel(question)
        axis.set_yscale("log")
        axis.set_yticks((1, 2, 3, 5, 10, 20), labels=("1", "2", "3", "5", "10", "20"))
        axis.minorticks_off()
    axes[0, 1].set_xscale("log")
    axes[0, 1].set_xticks(SIGHTINGS, labels=[f"{s:g}" for s in SIGHTINGS])
    axes[0, 1].minorticks_off()
    axes[0, 1].invert_xaxis()
    axes[0, 0].set_ylabel("mean error, cm")
    for n, (axis, title) in enumerate(zip(axes[1, :2], ("begun anywhere", "kidnapped"))):
        for (_, taken), colour in zip(found.items(), plots.COLOURS):
            x = np.sort(taken[n])
            share = (np.arange(len(x)) + 1) / len(x)
            axis.step(np.append(0, x), np.append(0, share), where="post", color=colour)
        axis.set_xlim(0, 10)
        axis.set_ylim(0, 1.02)
        axis.set_xlabel(f"s until below 25 cm, {title}")
    axes[1, 0].set_ylabel("share of the logs")
    axis = axes[1, 2]
    for (_, shares), colour in zip(coverage.items(), plots.COLOURS):
        axis.plot(COVERAGE, shares, "o-", color=colour, ms=3)
    axis.plot([0.4, 1], [0.4, 1], color="0.6", lw=0.8)
    axis.set_xlabel("ellipse that should hold this share")
    axis.set_ylabel("holds")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncol=4)
    return plots.save(figure, path)


def run(options: Options) -> Path:
    """All tables, the CSV and the figure.  Raises ValueError."""
    script.check_least(options, logs=1, cost=1)
    if options.drive not in logs.DRIVES:
        raise ValueError(f"drive = {options.drive!r}: known are {', '.join(logs.DRIVES)}")
    if not options.seconds >= 1:
        raise ValueError(f"seconds = {options.seconds}: allowed are numbers from 1")
    settings = logs.Settings(drive=options.drive, seconds=options.seconds)
    rows = accuracy(options, settings)
    found = recovery(options, settings)
    coverage = reliability(options, settings)
    speed = cost(options, settings)
    path = plot(rows, found, coverage, options.out / "localization.png")
    lines: list[Any] = [
        (question, f"{level:g}", name, n, f"{error:.6g}")
        for question, level, name, errors in rows
        for n, error in enumerate(errors)
    ]
    titles = ("s to 25 cm begun anywhere", "s to 25 cm kidnapped")
    lines += [
        (title, 0, name, n, f"{value:.6g}")
        for name, both in found.items()
        for title, taken in zip(titles, both)
        for n, value in enumerate(taken)
    ]
    lines += [
        ("within the ellipse", f"{level:g}", name, "", f"{share:.6g}")
        for name, shares in coverage.items()
        for level, share in zip(COVERAGE, shares)
    ]
    lines += [("updates a second", 0, name, "", f"{value:.6g}") for name, value in speed.items()]
    header = ("question", "level", "method", "log", "value")
    script.write_csv(path.with_suffix(".csv"), header, lines)
    return path


def main() -> None:
    options = script.options(Options, __doc__, "experiments/localization.py")
    xla.configure()
    with script.folder(options.out):
        print(run(options))


if __name__ == "__main__":
    main()
