"""The plain C version (`rollout.c`), built on the fly and called without Python's lock."""

import ctypes
import platform
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

SOURCE = Path(__file__).with_name("rollout.c")
FLAGS: tuple[str, ...] = (
    "-O3",
    "-march=native",
    "-ffast-math",
    "-fopenmp-simd",
    "-fPIC",
)
if platform.machine() == "x86_64":
    FLAGS += ("-mprefer-vector-width=512",)  # 1.5 times as fast here as gcc's choice of 256


def library() -> ctypes.CDLL:
    """`rollout.c`, compiled and loaded."""
    with tempfile.TemporaryDirectory() as folder:
        made, path = Path(folder) / "rollout.o", Path(folder) / "rollout.so"
        subprocess.run(["gcc", *FLAGS, "-c", str(SOURCE), "-o", str(made)], check=True)
        # Linked without -ffast-math: with it, gcc before 13 adds start-up code that flushes
        # denormal numbers to zero in the whole process that loads the library.
        subprocess.run(["gcc", "-shared", str(made), "-o", str(path), "-lm"], check=True)
        return ctypes.CDLL(str(path))


class Rollout:
    """Fitness of genomes on scenes in C, by `threads` threads that each take their share."""

    def __init__(self, library: ctypes.CDLL, threads: int):
        self.library, self.threads = library, threads
        self.pool = ThreadPoolExecutor(threads)

    def fitness(self, theta: np.ndarray, scenes: np.ndarray) -> np.ndarray:
        """theta: [P, 31] float32; scenes: [T, 8], see `flat_scenes`; the result is [P]."""
        num, trials = len(theta), len(scenes)
        sums = np.empty((num * trials, 7), np.float32)
        out = np.empty(num, np.float32)
        edges = np.linspace(0, num * trials / 64, self.threads + 1).astype(int) * 64
        edges[-1] = num * trials

        def share(first, last):
            self.library.rollout(
                _pointer(theta),
                _pointer(scenes),
                trials,
                int(first),
                int(last),
                ctypes.c_float(0.1),
                _pointer(sums),
            )

        if self.threads == 1:
            share(0, num * trials)
        else:
            list(self.pool.map(share, edges[:-1], edges[1:]))
        self.library.fitness(_pointer(sums), num, trials, _pointer(out))
        return out


def flat_scenes(scenes: Any) -> np.ndarray:
    """Scenes with one obstacle as rows: start x, y, heading; ball x, y; obstacle x, y, radius."""
    parts = (scenes.start, scenes.ball, scenes.obstacles[:, 0])
    return np.ascontiguousarray(np.concatenate([np.asarray(p) for p in parts], 1), np.float32)


def _pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)
