"""Checkpoints: a run as named arrays.  They hold the state and the records; everything else
follows from the configuration."""

import dataclasses
import json
import math
from typing import Any

import jax
import numpy as np

from fntg_jax.learning import ga
from fntg_jax.running import config_file
from fntg_jax.running.problem import Problem
from fntg_jax.running.runner import History, Run, RunState

_ARRAYS = (
    "config",
    "bits",
    "key",
    "generation",
    "best_bits",
    "best_fitness",
    "seconds",
    "history_best",
    "history_mean",
    "history_num_nonfinite",
    "history_best_bits",
)


def to_arrays(run: Run) -> dict[str, np.ndarray]:
    """The run as named arrays, to be written; `from_arrays` continues bit for bit.

    Args:
        run: between two chunks.
    """
    history = run.history()
    plain = jax.tree.map(_plain, run.now.population)
    state = run.rows.gather(plain)
    memory = {f"memory_{n}": x for n, x in enumerate(jax.tree.leaves(state.memory))}
    return {
        "config": np.asarray(json.dumps(dataclasses.asdict(run.config), sort_keys=True)),
        "bits": np.packbits(state.bits, axis=-1),
        "key": state.key,
        "generation": state.generation,
        "best_bits": np.packbits(state.best_bits, axis=-1),
        "best_fitness": state.best_fitness,
        "seconds": np.asarray([run.now.compile_seconds, run.now.run_seconds]),
        "history_best": history.best,
        "history_mean": history.mean,
        "history_num_nonfinite": history.num_nonfinite,
        "history_best_bits": np.packbits(history.best_bits, axis=-1),
        **memory,
    }


def most_bytes(problem: Problem) -> int:
    """What the arrays of a checkpoint may take unpacked."""
    memory, task = (), problem.task
    if task is not None:
        memory = jax.eval_shape(lambda: task.init(jax.random.key(0)))
    each = sum(_size(x) for x in jax.tree.leaves(memory))
    config = problem.config
    return config_file.most_bytes(config, len(problem.genes), config.seeds * each)


def _size(x: Any) -> int:
    x = jax.eval_shape(_plain, x)
    return math.prod(x.shape) * x.dtype.itemsize


def _is_key(x: Any) -> bool:
    return jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key)


def _plain(x: Any) -> Any:
    """Random keys as numbers."""
    return jax.random.key_data(x) if _is_key(x) else x


def from_arrays(run: Run, arrays: dict[str, np.ndarray]) -> None:
    """Let a new run take over a checkpoint.

    Args:
        run: of the same configuration.
        arrays: of `to_arrays`.

    Raises ValueError when something is missing or has another shape.
    """
    like, structure = jax.tree.flatten(run.now.population.memory)
    memory = [f"memory_{n}" for n in range(len(like))]
    missing = [name for name in (*_ARRAYS, *memory) if name not in arrays]
    if missing:
        raise ValueError(f"no {missing[0]} in it")
    # What this run would write now, after as many generations.
    expected, num = to_arrays(run), np.shape(arrays["history_best"])[1:2]
    for name, like_it in expected.items():
        shape = like_it.shape
        if name.startswith("history_"):
            shape = (shape[0], *num, *shape[2:])
        found = arrays[name]
        kind = "U" if name == "config" else like_it.dtype
        if found.shape != shape or (found.dtype != kind and found.dtype.kind != kind):
            raise ValueError(f"{name} is {found.dtype} {found.shape}, not {like_it.dtype} {shape}")
    if not (arrays["generation"] == num).all():
        raise ValueError(f"its history has {num[0]} generations, its state another number")
    length = run.now.population.bits.shape[-1]

    def unpack(name):
        return np.unpackbits(arrays[name], axis=-1, count=length).astype(bool)

    saved = {
        "bits": unpack("bits"),
        "key": arrays["key"],
        "generation": arrays["generation"],
        "best_bits": unpack("best_bits"),
        "best_fitness": arrays["best_fitness"],
        "memory": [arrays[name] for name in memory],
    }

    def to_state(x):
        kept = [jax.random.wrap_key_data(v) if _is_key(w) else v for v, w in zip(x["memory"], like)]
        own = {"key": jax.random.wrap_key_data(x["key"]), "memory": structure.unflatten(kept)}
        return ga.State(**{**x, **own})

    record = History(
        arrays["history_best"],
        arrays["history_mean"],
        arrays["history_num_nonfinite"],
        unpack("history_best_bits"),
    )
    compile_seconds, run_seconds = map(float, arrays["seconds"])
    population = run.rows.place(saved, to_state)
    run.now = RunState(
        population, (record,), compile_seconds=compile_seconds, run_seconds=run_seconds
    )
