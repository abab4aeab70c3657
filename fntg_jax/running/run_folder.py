"""The run folder: what a learning run leaves on disk, and how it is continued.

config.json, metrics.csv, history.npz, params.json (best controller of all seeds),
provenance.json, checkpoint.npz.  Every file is written atomically.
"""

import contextlib
import dataclasses
import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from envs.base import Task
from fntg_jax import export
from fntg_jax.files import (
    csv_table,
    read_arrays,
    read_bytes,
    sweep,
    write_atomically,
    writing,
)
from fntg_jax.running import checkpoint, config_file, controllers, genes, hosts, settings
from fntg_jax.running.problem import resolve
from fntg_jax.running.provenance import provenance
from fntg_jax.running.runner import History, Result, Run, check_finite, decode_history, start
from fntg_jax.running.settings import TrainConfig

FILES = (
    "config.json",
    "checkpoint.npz",
    "metrics.csv",
    "history.npz",
    "params.json",
    "provenance.json",
    "fig5.pdf",
    "fig5.png",
)


def create(out: Path, config: TrainConfig) -> Path | None:
    """Make the folder and write config.json.

    Args:
        out: folder, which must not exist or be empty.
        config: of the run.

    Raises ValueError where it cannot be made.
    """
    with writing(out, "out"):
        if out.is_dir():
            sweep(out, FILES)
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise ValueError(f"out = {out}: exists already; choose a new folder, or --resume it")
        made = next((p for p in reversed([out, *out.parents]) if not p.exists()), None)
        out.mkdir(parents=True, exist_ok=True)
        _write_json(out / "config.json", dataclasses.asdict(config))
    return made


def discard(folder: Path, made: Path | None) -> None:
    """Take back what `create` made, where a run did not come to its first checkpoint.

    Args:
        folder: of the run.
        made: the outermost folder that was not there before; None where all were.
    """
    if hosts.is_first() and not (folder / "checkpoint.npz").exists():
        (folder / "config.json").unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # somebody else's files in it
            while made is not None and folder.is_relative_to(made):
                folder.rmdir()
                folder = folder.parent


def save_checkpoint(folder: Path, run: Run) -> None:
    """Write checkpoint.npz atomically.

    Args:
        folder: of the run.
        run: between two chunks.

    Raises OSError.
    """
    arrays = checkpoint.to_arrays(run)
    if hosts.is_first():
        _write_npz(folder / "checkpoint.npz", arrays)


def restore(folder: Path, task: Task | None = None) -> Run:
    """The run of a folder, at its last checkpoint.

    Args:
        folder: of the run.
        task: what it learns, where that is not a registered one.

    Raises ValueError (one line) where a file is missing or damaged.
    """
    text = hosts.from_first(
        lambda: json.dumps(dataclasses.asdict(config_file.load(folder))).encode()
    )
    problem = resolve(settings.from_dict(json.loads(text)), task)
    path = folder / "checkpoint.npz"

    def read() -> bytes:
        try:
            # The "+" tells an empty file from none.
            most = checkpoint.most_bytes(problem)
            return b"+" + read_bytes(path, "checkpoint", most) if os.path.lexists(path) else b""
        except ValueError as error:
            why = str(error).removeprefix(f"{path}: ")
            raise ValueError(f"{path}: not a checkpoint of this run ({why})") from error

    data = hosts.from_first(read)
    if not data:
        return start(problem)
    run = Run(problem)
    try:
        arrays = read_arrays(data[1:], checkpoint.most_bytes(problem))
        checkpoint.from_arrays(run, arrays)
        # Compared as configurations: options that came later have their defaults.
        if settings.from_dict(json.loads(str(arrays["config"]))) != problem.config:
            raise ValueError("it was written by a run of another configuration")
    except (ValueError, TypeError) as error:  # TypeError: arrays of another kind
        raise ValueError(f"{path}: not a checkpoint of this run ({error})") from error
    return run


def finish(
    folder: Path, run: Run, show: Callable[[int, int, float], None] = lambda *_: None
) -> Result:
    """Write the results of a completed run; returns what the seeds came to.

    Args:
        folder: of the run.
        run: completed.
        show: see `final_choice.conclude`.

    Raises ValueError where nothing was learnt (`runner.check_finite`), OSError where a file cannot
    be written.
    """
    check_finite(run)
    history, result = run.history(), run.conclude(show)
    if not hosts.is_first():
        return result
    first, header = run.config.first_seed, ("seed", "generation", *History._fields[:3])
    rows = [
        (first + s, g + 1, f"{history.best[s, g]:.9g}", f"{history.mean[s, g]:.9g}", num)
        for (s, g), num in np.ndenumerate(history.num_nonfinite)
    ]
    write_atomically(folder / "metrics.csv", csv_table(header, rows))
    _write_npz(
        folder / "history.npz",
        {
            "best": history.best,
            "mean": history.mean,
            "num_nonfinite": history.num_nonfinite,
            "best_theta": run.problem.in_units(decode_history(history, run.config)),
            "theta": result.theta,
            "fitness": result.fitness,
            **({} if result.refined is None else {"refined": result.refined}),
            **_strength(result),
            **{f"judged_{name}": x for name, x in (result.judgement or {}).items()},
        },
    )
    if run.problem.task is None:
        export.save(controllers.of_run(run, result=result), folder / "params.json")
    else:
        document = genes.document(run, result)
        _write_json(folder / "params.json", document)
        if run.problem.task.files is not None:
            values = {gene["name"]: gene["value"] for gene in document["genes"]}
            for name, text in run.problem.task.files(values).items():
                write_atomically(folder / name, text.encode())
    took = {
        "num_devices": run.rows.mesh.size,
        "compile_seconds": round(run.now.compile_seconds, 3),
        "run_seconds": round(run.now.run_seconds, 3),
        "control_steps": run.control_steps,
    }
    _write_json(folder / "provenance.json", provenance() | took)
    return result


def _strength(result: Result) -> dict[str, np.ndarray]:
    if result.strength is None:
        return {}
    return dict(zip(("strength_generation", "strength"), result.strength))


def load_history(folder: Path) -> History:
    """The history of a completed or interrupted run.

    Args:
        folder: of the run.

    Raises ValueError as `restore`.
    """
    run = restore(folder)
    if run.generation == 0:
        raise ValueError(f"{folder}: nothing recorded yet; continue it with --resume")
    return run.history()


def _write_json(path: Path, value: Any) -> None:
    write_atomically(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def _write_npz(path: Path, arrays: dict[str, Any]) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomically(path, buffer.getvalue())
