"""How fast the paper's learning run is here: warm, with and without our XLA flags, and from a
cold start to a drawn Fig. 5.  Every number in the README's table of speed is printed by this."""

import dataclasses
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import tyro

from fntg_jax import xla


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    repeats: int = 5
    """counted runs of each measurement."""
    seeds: int = 30
    """seeds of the cold and the warm start."""
    only_run: bool = False
    """only time the learning run in this process (used for the comparison of XLA flags)."""


def learning_run(repeats: int) -> list[float]:
    """Seconds of the paper preset's learning run, one seed, compiled: roll-outs and the GA."""
    from fntg_jax import runner, settings

    run = runner.Run(settings.PRESETS["paper"])
    start = run.state
    run.compile()
    seconds = []
    for _ in range(repeats + 1):
        run.state, run.records = start, []
        begin = time.perf_counter()
        while not run.done:
            run.advance()  # returns NumPy: nothing is left in flight
        seconds.append(time.perf_counter() - begin)
    return seconds[1:]  # the first one warms up


def compare_flags(repeats: int) -> None:
    """The learning run with our XLA flags and without, in turn, in processes of their own."""
    times: dict[str, list[float]] = {"on": [], "off": []}
    for _ in range(3):
        for flags, found in times.items():
            environment = {**os.environ, "FNTG_XLA_FLAGS": flags}
            environment.pop("XLA_FLAGS", None)
            command = [sys.executable, __file__, "--only-run", "--repeats", str(repeats)]
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True
            )
            found += map(float, done.stdout.split())
    on, off = times["on"], times["off"]
    steps = 60 * 95 * 4 * 220
    print(f"learning run, 60 x 95 x 4 x 220 = {steps / 1e6:.1f} M control steps, one core:")
    for name, found in (("with our XLA flags", on), ("without", off)):
        print(
            f"  {name:20s} best {min(found):.3f} s  median {statistics.median(found):.3f} s  "
            f"{steps / min(found) / 1e6:.0f} M control steps/s"
        )
    print(f"  ratio of medians {statistics.median(off) / statistics.median(on):.2f}")


def first_figure(seeds: int) -> None:
    """Wall time of `fntg train` to a drawn Fig. 5: empty compile cache, then a filled one."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "XDG_CACHE_HOME": folder}
        for name in ("empty compile cache", "filled compile cache"):
            out = Path(folder) / name.replace(" ", "-")
            command = [sys.executable, "-m", "fntg_jax.cli", "train", "--seeds", str(seeds)]
            begin = time.perf_counter()
            subprocess.run(
                [*command, "--out", str(out)], env=environment, capture_output=True, check=True
            )
            seconds = time.perf_counter() - begin
            assert (out / "fig5.png").exists()
            print(f"fntg train --seeds {seeds} to a drawn Fig. 5, {name}: {seconds:.1f} s")


def main() -> None:
    options = tyro.cli(Options, description=__doc__, prog="experiments/benchmark.py")
    if options.only_run:
        xla.configure()
        print(*learning_run(options.repeats))
        return
    import jax

    print(f"jax {jax.__version__}, {os.cpu_count()} cores, {platform.machine()}")
    compare_flags(options.repeats)
    first_figure(options.seeds)


if __name__ == "__main__":
    main()
