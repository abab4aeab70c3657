"""How fast this is, and what others need for the same work, as ratios of medians.

In one run, repetitions of all contestants taken in turn so that a busy machine disturbs all alike:
the paper preset's generation (60 genomes x 4 starts x 220 controller steps), its learning run
(95 generations), growth with population, trials and seeds (CSV, PNG, PDF), and the wall time of
`fntg train` to a drawn Fig. 5.  The fitness values are compared before anything is timed.
evosax, DEAP and pygad are the optional extra `bench`; plain C needs gcc; what is missing is
left out with a word.  Every number in the README's section on speed is printed by this.
"""

import dataclasses
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from experiments import script
from experiments.baselines import jobs, plain_numpy
from experiments.baselines.job import POPULATION, TRIALS, Job, Scenes
from experiments.baselines.jobs import Contestant
from experiments.baselines.worker import Worker


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to measure, and where the table and the figure of growth go."""

    quick: bool = False
    """a first impression: fewer repetitions, small sizes, no cold start."""
    out: Path = Path("runs/benchmark")
    """folder for growth.csv, growth.png and growth.pdf."""


def scenes(num: int = TRIALS) -> Scenes:
    """The paper suite, its four starts repeated."""
    from envs import scenes as suites

    return Scenes(
        np.resize(np.asarray(suites.PAPER_STARTS, np.float32), (num, 3)),
        np.tile(np.asarray(suites.PAPER_BALL, np.float32), (num, 1)),
        np.tile(np.asarray([suites.PAPER_OBSTACLE], np.float32), (num, 1, 1)),
    )


def genomes(num: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-5, 5, (num, 31)).astype(np.float32)


def start(contestants: tuple[Contestant, ...]) -> list[Worker]:
    """Workers of those that have what they need."""
    return [Worker(contestant) for contestant in contestants if not contestant.missing]


def agree(workers: list[Worker], num: int) -> None:
    """Compare everyone's fitness with NumPy's in float64; exits when somebody computes something
    else.

    Some roll-outs are chaotic: there float32 cannot say what the fitness is.  Chaotic is a genome
    whose fitness changes by more than 1e-5 of it when the starts move by 1e-6 m or rad.
    """
    theta, where = genomes(num), scenes()
    right = plain_numpy.fitness(theta, where, np.float64)
    chaotic = np.zeros(num, bool)
    for nudge in 1e-6 * np.vstack([np.eye(3), -np.eye(3)]):
        moved = where._replace(start=where.start.astype(np.float64) + nudge)
        chaotic |= np.abs(plain_numpy.fitness(theta, moved, np.float64) / right - 1) > 1e-5
    print(
        f"\nfitness of {num} random genomes against NumPy in float64; in {chaotic.sum()} of them "
        f"moving\nthe starts by 1e-6 changes the fitness by more than 1e-5 of it:"
    )
    for worker in workers:
        _, found = worker.prepare(Job(where, theta))
        error = np.abs(found / right - 1)
        far = error > 1e-4
        print(
            f"  {label(worker.contestant):30s} median difference {np.median(error):.0e}, above "
            f"1e-4: {np.sum(far & chaotic)} of those, {np.sum(far & ~chaotic)} of the others"
        )
        if np.mean(far[~chaotic]) > 0.005:
            raise SystemExit(f"{worker.contestant.name} computes something else: nothing timed")


def label(contestant: Contestant) -> str:
    return f"{contestant.name}, {contestant.cores} core{'s' * (contestant.cores > 1)}"


def take_turns(workers: list[Worker], seconds: float, least: int = 3) -> list[list[float]]:
    """Timings of every worker, one after the other, again and again: at least `least` rounds, more
    while they fit into `seconds`, 30 at most."""
    found: list[list[float]] = [[] for _ in workers]
    begin = time.perf_counter()
    while len(found[0]) < least or (time.perf_counter() - begin < seconds and len(found[0]) < 30):
        for times, worker in zip(found, workers):
            times.append(worker.time())
    return found


def compare(title: str, workers: list[Worker], job: Job, seconds: float, ceilings: bool) -> None:
    """One table: median, spread, rate, ratio to ours on one core and to C on as many cores."""
    compiled = [worker.prepare(job)[0] for worker in workers]
    times = take_turns(workers, seconds)
    medians = {w.contestant: statistics.median(t) for w, t in zip(workers, times)}
    ceiling = {c.cores: medians[c] for c in (jobs.C_1, jobs.C_2) if c in medians}
    print(f"\n{title}, {job.steps / 1e6:.3g} M controller steps, {len(times[0])} rounds:")
    print(
        f"  {'':36s}    median       best   M steps/s  time/ours{'  speed/C' if ceilings else ''}"
        "  first call  peak memory"
    )
    for worker, taken, first in zip(workers, times, compiled):
        c = worker.contestant
        median = medians[c]
        share = f"  {ceiling[c.cores] / median:7.0%}" if c.cores in ceiling else " " * 9
        print(
            f"  {label(c):36s}{1e3 * median:7.4g} ms {1e3 * min(taken):7.4g} ms  "
            f"{job.steps / median / 1e6:10.3g}  {median / medians[jobs.OURS_1]:9.3g}"
            f"{share if ceilings else ''}  {first:8.2g} s  {worker.peak():8.0f} MB"
        )


def growth(options: Options) -> list[dict]:
    """Rows (axis, size, contestant, ...) of cost against population, trials and seeds."""
    quick = options.quick
    population = (60, 600, 6000) if quick else (60, 600, 6000, 60_000)
    trials = (4, 32, 256) if quick else (4, 32, 256, 1024)
    seeds = (1, 10, 30) if quick else (1, 10, 100, 1000)
    sizes = [("population", n, Job(scenes(), genomes(n))) for n in population]
    sizes += [("trials", n, Job(scenes(n), genomes(60))) for n in trials]
    sizes += [("seeds", n, Job(scenes(), None, generations=5, seeds=n)) for n in seeds]
    rows = []
    print("\ngrowth: median time of a generation (of 5 generations along seeds)")
    for axis, size, job in sizes:
        # Fresh processes, so that the peak is that of this size.
        workers = start((jobs.OURS_1, jobs.OURS_2))
        if job.theta is not None:
            workers += start((jobs.C_1, jobs.C_2))
            if job.steps < 10e6:  # enough to see the slope
                workers += start((jobs.NAIVE_2, jobs.NUMPY))
        for worker in workers:
            worker.prepare(job)
        times = take_turns(workers, 1 if quick else 3)
        for worker, taken in zip(workers, times):
            median = statistics.median(taken)
            rows.append(
                {
                    "axis": axis,
                    "size": size,
                    "contestant": worker.contestant.name,
                    "cores": worker.contestant.cores,
                    "seconds": f"{median:.5g}",
                    "controller_steps": job.steps,
                    "steps_per_second": f"{job.steps / median:.4g}",
                    "peak_memory_mb": f"{worker.peak():.0f}",
                }
            )
            worker.close()
        speeds = ", ".join(
            f"{label(w.contestant)} {job.steps / statistics.median(t) / 1e6:.3g}"
            for w, t in zip(workers, times)
        )
        print(f"  {axis} {size}: M steps/s: {speeds}", flush=True)
    return rows


def write_growth(rows: list[dict], folder: Path) -> Path:
    """growth.csv, growth.png and growth.pdf."""
    from fntg_jax.showing import plots

    script.write_csv(folder / "growth.csv", rows[0], [row.values() for row in rows])
    figure, panels = plots.new_grid(1, 3, 11, 3.8)
    names = list(dict.fromkeys((r["contestant"], r["cores"]) for r in rows))
    for panel, axis in zip(panels[0], ("population", "trials", "seeds")):
        for k, (name, cores) in enumerate(names):
            points = [
                (r["size"], float(r["seconds"]))
                for r in rows
                if (r["axis"], r["contestant"], r["cores"]) == (axis, name, cores)
            ]
            if points:
                style = {"marker": "os^vDX"[k], "markersize": 4, "color": plots.COLOURS[k]}
                panel.loglog(*zip(*points), label=f"{name} ({cores})", **style)
        panel.set_xlabel(
            {
                "population": "genomes (4 trials each)",
                "trials": "trials (60 genomes)",
                "seeds": "seeds (60 genomes, 4 trials)",
            }[axis]
        )
        panel.set_ylabel("seconds, 5 generations" if axis == "seeds" else "seconds, 1 generation")
    # In the panel with most room.
    handles = panels[0, 0].get_legend_handles_labels()
    panels[0, 2].legend(*handles, title="(cores)", fontsize=8, loc="lower right")
    return plots.save(figure, folder / "growth.png")


def first_figure(seeds: int = 30) -> None:
    """Wall time of `fntg train` to a drawn Fig. 5: empty compile cache, then a filled one."""
    print()
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "XDG_CACHE_HOME": folder}
        for name in ("empty compile cache", "filled compile cache"):
            out = Path(folder) / name.replace(" ", "-")
            command = [
                sys.executable,
                "-m",
                "fntg_jax.commands.cli",
                "train",
                "--seeds",
                str(seeds),
            ]
            begin = time.perf_counter()
            subprocess.run(
                [*command, "--out", str(out)], env=environment, capture_output=True, check=True
            )
            seconds = time.perf_counter() - begin
            assert (out / "fig5.png").exists()
            print(f"fntg train --seeds {seeds} to a drawn Fig. 5, {name}: {seconds:.1f} s")


def main() -> None:
    from fntg_jax.commands.cli import refuse

    options = script.options(Options, __doc__, "experiments/benchmark.py")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse(f"out = {options.out}: {error.strerror or error}")
    quick = options.quick
    import jax

    print(f"jax {jax.__version__}, {os.cpu_count()} cores, {platform.machine()}")
    for contestant in jobs.GENERATION + jobs.LEARNING:
        if contestant.missing:
            print(f"{label(contestant)}: left out, {contestant.needs} is not installed")
    workers = start(jobs.GENERATION)
    agree(workers, 200 if quick else 1000)
    where = scenes()
    small = Job(where, genomes(POPULATION))
    compare("the paper's generation, 60 x 4 trials", workers, small, 2 if quick else 10, True)
    large = Job(where, genomes(1000))
    compare("a batch of 1000 x 4 trials", workers, large, 2 if quick else 10, True)
    for worker in workers:
        worker.close()
    workers = start(jobs.LEARNING)
    compare("learning run, 60 x 95 x 4 trials", workers, Job(where), 2 if quick else 30, False)
    for worker in workers:
        worker.close()
    print(write_growth(growth(options), options.out))
    if not quick:
        first_figure()


if __name__ == "__main__":
    main()
