"""Checkpoints: a run as named arrays.  They hold the state and the records; everything else
follows from the configuration."""

import dataclasses
import json

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
    state = run.rows.gather(run.state._replace(key=jax.random.key_data(run.state.key)))
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
    }


def from_arrays(run: Run, arrays: dict[str, np.ndarray]) -> None:
    """Let a new run of the same configuration take over a checkpoint.  Raises ValueError when it
    lacks something."""
    missing = [name for name in _ARRAYS if name not in arrays]
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
    }

    def to_state(x):
        return ga.State(**{**x, "key": jax.random.wrap_key_data(x["key"])})

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
