"""Checkpoints: a run as named arrays.  They hold the state and the records; everything else
follows from the configuration."""

import dataclasses
import json
from typing import Any

import jax
import numpy as np

from fntg_jax.learning import ga
from fntg_jax.running.runner import History, Run

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
    """The run as named arrays, to be written; `from_arrays` continues bit for bit."""
    history = run.history()
    plain = jax.tree.map(_plain, run.state)
    state = run.rows.gather(plain)
    memory = {f"memory_{n}": x for n, x in enumerate(jax.tree.leaves(state.memory))}
    return {
        "config": np.asarray(json.dumps(dataclasses.asdict(run.config), sort_keys=True)),
        "bits": np.packbits(state.bits, axis=-1),
        "key": state.key,
        "generation": state.generation,
        "best_bits": np.packbits(state.best_bits, axis=-1),
        "best_fitness": state.best_fitness,
        "seconds": np.asarray([run.compile_seconds, run.run_seconds]),
        "history_best": history.best,
        "history_mean": history.mean,
        "history_num_nonfinite": history.num_nonfinite,
        "history_best_bits": np.packbits(history.best_bits, axis=-1),
        **memory,
    }


def _is_key(x: Any) -> bool:
    return jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key)


def _plain(x: Any) -> Any:
    """Random keys as numbers."""
    return jax.random.key_data(x) if _is_key(x) else x


def from_arrays(run: Run, arrays: dict[str, np.ndarray]) -> None:
    """Let a new run of the same configuration take over a checkpoint.  Raises ValueError when it
    lacks something."""
    like, structure = jax.tree.flatten(run.state.memory)
    memory = [f"memory_{n}" for n in range(len(like))]
    missing = [name for name in (*_ARRAYS, *memory) if name not in arrays]
    if missing:
        raise ValueError(f"no {missing[0]} in it")
    length = run.state.bits.shape[-1]

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
    for name, x in zip(memory, like):
        shape = (run.rows.num, *_plain(x).shape[1:])
        if arrays[name].shape != shape or arrays[name].dtype != _plain(x).dtype:
            raise ValueError(f"{name} is {arrays[name].dtype} {arrays[name].shape}")

    def to_state(x):
        kept = [jax.random.wrap_key_data(v) if _is_key(w) else v for v, w in zip(x["memory"], like)]
        own = {"key": jax.random.wrap_key_data(x["key"]), "memory": structure.unflatten(kept)}
        return ga.State(**{**x, **own})

    run.state = run.rows.place(saved, to_state)
    run.compile_seconds, run.run_seconds = map(float, arrays["seconds"])
    run.records = [
        History(
            arrays["history_best"],
            arrays["history_mean"],
            arrays["history_num_nonfinite"],
            unpack("history_best_bits"),
        )
    ]
