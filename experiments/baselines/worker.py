"""One contestant in a process of its own, confined to its cores, timed on request."""

import gc
import multiprocessing
import os
import sys
import time
from typing import Any

from experiments.baselines.job import Job
from experiments.baselines.jobs import Contestant

_LEAST = 0.02  # s; a timing is the mean of so many repetitions that it takes at least this long


class Worker:
    """The parent's end.  Only one of several should be asked at a time.  What fails in the process
    is raised here as RuntimeError."""

    def __init__(self, contestant: Contestant):
        self.contestant = contestant
        self.pipe, other = multiprocessing.Pipe()
        # A fresh interpreter: XLA reads its flags once, and must not be forked.
        context = multiprocessing.get_context("spawn")
        self.process = context.Process(target=_serve, args=(other, contestant), daemon=True)
        self.process.start()
        other.close()

    def prepare(self, job: Job) -> tuple[float, Any]:
        """Compile and run once: seconds until then, and the value."""
        return self._ask("prepare", job)

    def time(self) -> float:
        """Seconds of one repetition."""
        return self._ask("time", None)

    def peak(self) -> float:
        """The most memory that the process held so far, MiB."""
        return self._ask("peak", None)

    def close(self) -> None:
        self.pipe.close()
        self.process.join(10)

    def _ask(self, what, argument):
        try:
            self.pipe.send((what, argument))
            answer = self.pipe.recv()
        except (EOFError, OSError):
            raise RuntimeError(f"{self.contestant.name}: its process ended") from None
        if isinstance(answer, Exception):
            raise RuntimeError(f"{self.contestant.name}: {answer}")
        return answer


def _serve(pipe, contestant: Contestant) -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-contestant.cores :])
    # NumPy's and XLA's own threads follow the affinity.  No cache: compilation is timed.
    os.environ["FNTG_CACHE"] = "off"
    os.environ.pop("XLA_FLAGS", None)
    os.environ["FNTG_XLA_FLAGS"] = "on" if contestant.flags else "off"
    if contestant.flags or contestant.devices > 1:
        from fntg_jax.running import xla

        xla.configure(num_cpu_devices=contestant.devices)
    run: Any = None
    number, repeat = 0, 1
    while True:
        try:
            what, argument = pipe.recv()
        except EOFError:
            return
        try:
            if what == "prepare":
                begin = time.perf_counter()
                run = contestant.prepare(argument)
                value, number = run(0), 0
                seconds = time.perf_counter() - begin
                begin = time.perf_counter()
                run(0)
                repeat = max(1, round(_LEAST / (time.perf_counter() - begin)))
                pipe.send((seconds, value if argument.theta is not None else float(value)))
            elif what == "time":
                gc.collect()
                begin = time.perf_counter()
                for _ in range(repeat):
                    run(number := number + 1)
                pipe.send((time.perf_counter() - begin) / repeat)
            else:
                pipe.send(_peak())
        except Exception as error:
            pipe.send(RuntimeError(repr(error)))


def _peak() -> float:
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / 2 ** (20 if sys.platform == "darwin" else 10)
