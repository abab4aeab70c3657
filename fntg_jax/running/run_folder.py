"""The run folder: what a learning run leaves on disk, and how it is continued.

config.json, metrics.csv, history.npz, params.json (best controller of all seeds),
environment.json, checkpoint.npz, fig5.png and .pdf.  Every file is written atomically.
"""

import contextlib
import dataclasses
import io
import json
import math
import platform
import subprocess
import zipfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

import fntg_jax
from envs.base import Limits
from fntg_jax import export
from fntg_jax.files import write_atomically
from fntg_jax.learning import fitness, ga
from fntg_jax.running import checkpoint, hosts
from fntg_jax.running.runner import History, Result, Run, decode_history, start
from fntg_jax.running.settings import TrainConfig, validate
from fntg_jax.showing import plots

_PACKAGES = ("fntg-jax", "jax", "jaxlib", "numpy", "optax", "mujoco", "mujoco-mjx", "brax")


def create(out: Path, config: TrainConfig) -> None:
    """Make the folder and write config.json.  Raises ValueError where it cannot be made."""
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise ValueError(f"out = {out}: exists already; choose a new folder, or --resume it")
        out.mkdir(parents=True, exist_ok=True)
        _write_json(out / "config.json", dataclasses.asdict(config))
    except OSError as error:
        raise ValueError(f"out = {out}: {error.strerror or error}") from None


def discard(folder: Path) -> None:
    """Take back what `create` made, where a run did not come to its first checkpoint."""
    if hosts.is_first() and not (folder / "checkpoint.npz").exists():
        (folder / "config.json").unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # somebody else's files in it
            folder.rmdir()


def load_config(folder: Path) -> TrainConfig:
    """The configuration of a run folder.  Raises ValueError when it is none or is damaged."""
    path = folder / "config.json"
    try:
        data = json.loads(path.read_text())
    except OSError:
        raise ValueError(f"{folder}: not a run folder (no readable config.json)") from None
    except ValueError as error:
        raise ValueError(f"{path}: not JSON ({error})") from None
    except RecursionError:
        raise ValueError(f"{path}: not a configuration: nested too deeply") from None
    try:
        return config_from_dict(data)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def config_from_dict(data: Any) -> TrainConfig:
    """A checked configuration from plain values.  Raises ValueError: field, value, what is
    allowed."""
    config = _from_dict(TrainConfig, data)
    validate(config)
    return config


def _from_dict(cls: type, data: Any) -> Any:
    if not isinstance(data, dict):
        raise ValueError(f"{cls.__name__} is {type(data).__name__}: allowed is an object")
    fields = {f.name: f for f in dataclasses.fields(cls)}
    unknown = sorted(set(data) - set(fields))
    if unknown:
        raise ValueError(f"{unknown[0]!r}: unknown; known are {', '.join(fields)}")
    nested = {
        "ga": ga.GAConfig,
        "fitness": fitness.PaperWeights,
        "smooth": fitness.SmoothWeights,
    }
    values = {}
    for name, value in data.items():
        default = getattr(cls(), name)
        if name in nested:
            value = _from_dict(nested[name], value)
        elif type(value) is not type(default) and not (
            isinstance(default, float) and type(value) is int
        ):
            raise ValueError(f"{name} = {value!r}: allowed is {type(default).__name__}")
        values[name] = value
    return cls(**values)


def save_checkpoint(folder: Path, run: Run) -> None:
    """Write checkpoint.npz atomically."""
    arrays = checkpoint.to_arrays(run)
    if hosts.is_first():
        _write_npz(folder / "checkpoint.npz", arrays)


def restore(folder: Path) -> Run:
    """The run of a folder, at its last checkpoint.  Raises ValueError as `load_config`."""
    text = hosts.from_first(lambda: json.dumps(dataclasses.asdict(load_config(folder))).encode())
    config = config_from_dict(json.loads(text))
    path = folder / "checkpoint.npz"

    def read() -> bytes:
        try:
            # The "+" tells an empty file from none.
            return b"+" + path.read_bytes() if path.exists() else b""
        except OSError as error:
            why = error.strerror or error
            raise ValueError(f"{path}: not a checkpoint of this run ({why})") from None

    data = hosts.from_first(read)
    if not data:
        return start(config)
    run = Run(config)
    try:
        with np.load(io.BytesIO(data[1:]), allow_pickle=False) as file:
            arrays = dict(file)
        checkpoint.from_arrays(run, arrays)
        # Compared as configurations: options that came later have their defaults.
        if config_from_dict(json.loads(str(arrays["config"]))) != config:
            raise ValueError("it was written by a run of another configuration")
    except Exception as error:
        raise ValueError(f"{path}: not a checkpoint of this run ({error})") from None
    return run


def finish(
    folder: Path, run: Run, show: Callable[[int, int, float], None] = lambda *_: None
) -> tuple[Path, Result]:
    """Write results and figures of a completed run; returns the figure's path and what the
    seeds came to.  show: see `final_choice.conclude`."""
    history, result = run.history(), run.conclude(show)
    figure = folder / "fig5.png"
    if not hosts.is_first():
        return figure, result
    rows = ["seed,generation,best,mean,num_nonfinite"]
    for s, g in np.ndindex(history.best.shape):
        seed = run.config.first_seed + s
        rows.append(
            f"{seed},{g + 1},{history.best[s, g]:.9g},{history.mean[s, g]:.9g},"
            f"{history.num_nonfinite[s, g]}"
        )
    write_atomically(folder / "metrics.csv", ("\n".join(rows) + "\n").encode())
    _write_npz(
        folder / "history.npz",
        {
            "best": history.best,
            "mean": history.mean,
            "num_nonfinite": history.num_nonfinite,
            "best_theta": decode_history(history, run.config),
            "theta": result.theta,
            "fitness": result.fitness,
            **({} if result.refined is None else {"refined": result.refined}),
        },
    )
    export.save(controller(run, result=result), folder / "params.json")
    _write_json(folder / "environment.json", environment(run))
    plots.fitness_curves(history, figure, result.refined)
    return figure, result


def controller(
    run: Run, seed: int | None = None, result: Result | None = None
) -> export.Controller:
    """The controller of one seed, or the best of all, with its provenance.

    result: of `run.conclude()`, where the caller has it already.
    """
    config = run.config
    row = None if seed is None else _row(config, seed)
    result = run.conclude() if result is None else result
    index = int(np.argmax(result.fitness)) if row is None else row
    best, bits = float(result.fitness[index]), None
    if result.bits is not None:
        bits = "".join("1" if b else "0" for b in result.bits[index])
    limits = run.env.limits
    return export.Controller(
        layout=run.layout,
        theta=np.asarray(result.theta[index], np.float64),
        bits=bits,
        output=config.output,
        limits=Limits(*(float(x) for x in (limits.v_min, limits.v_max, limits.omega_max))),
        control_dt=float(run.env.dt),
        provenance={
            "env": config.env,
            "suite": config.suite,
            "objective": config.objective,
            "generations": run.generation,
            "refine_steps": config.refine_steps,
            "seed": config.first_seed + index,
            "best_of_seeds": config.seeds if seed is None else 1,
            "fitness": best if np.isfinite(best) else None,
            "num_bits": config.ga.num_bits,
            "gray": config.ga.gray,
            "fntg_jax": fntg_jax.__version__,
            "jax": jax.__version__,
        },
    )


def _row(config: TrainConfig, seed: int) -> int:
    """Where a seed stands in arrays of all seeds.  Raises ValueError where the run lacks it."""
    last = config.first_seed + config.seeds - 1
    if not config.first_seed <= seed <= last:
        raise ValueError(f"seed = {seed}: the run has seeds {config.first_seed} to {last}")
    return seed - config.first_seed


def controller_of_generation(folder: Path, generation: int) -> export.Controller:
    """The best controller of one generation (from 1), of the seed that params.json comes from.
    Raises ValueError (one line) where the folder does not hold it."""
    best = export.load(folder / "params.json")
    config = load_config(folder)
    if not 1 <= generation <= config.generations:
        raise ValueError(f"generation = {generation}: the run has 1 to {config.generations}")
    seed = best.provenance.get("seed", config.first_seed)
    index = seed - config.first_seed if isinstance(seed, int) else -1
    shape = (config.seeds, config.generations, best.layout.num_genes)
    theta = _stored(folder, "best_theta", shape, index)[generation - 1]
    provenance = {**best.provenance, "generations": generation, "fitness": None}
    return dataclasses.replace(best, theta=theta, bits=None, provenance=provenance)


def controller_of_seed(folder: Path, seed: int) -> export.Controller:
    """The final controller of one seed of a completed run.  Raises ValueError (one line) where the
    folder does not hold it."""
    best = export.load(folder / "params.json")
    config = load_config(folder)
    index = _row(config, seed)
    if seed == best.provenance.get("seed"):
        return best
    theta = _stored(folder, "theta", (config.seeds, best.layout.num_genes), index)
    value = _stored(folder, "fitness", (config.seeds,), index)
    provenance = {
        **best.provenance,
        "seed": seed,
        "best_of_seeds": 1,
        "fitness": float(value) if np.isfinite(value) else None,
    }
    return dataclasses.replace(best, theta=theta, bits=None, provenance=provenance)


def _stored(folder: Path, name: str, shape: tuple[int, ...], index: int) -> np.ndarray:
    """Row `index` of an array of history.npz.  The file is not trusted."""
    path = folder / "history.npz"
    try:
        with zipfile.ZipFile(path) as archive:
            size = archive.getinfo(f"{name}.npy").file_size
        if size > 8 * math.prod(shape) + 1000 or not 0 <= index < shape[0]:
            raise ValueError("another shape than config.json says")
        with np.load(path, allow_pickle=False) as file:
            stored = file[name].astype(np.float64)
        row = stored[index] if stored.shape == shape else np.asarray(np.inf)
        if name != "fitness" and not np.all(np.abs(row) <= 5):
            raise ValueError("another shape or range than config.json says")
    except Exception as error:  # a damaged archive raises almost anything
        why = getattr(error, "strerror", None) or error
        raise ValueError(f"{path}: not the history of this run ({why})") from None
    return row


def load_history(folder: Path) -> History:
    """The history of a completed or interrupted run.  Raises ValueError as `restore`."""
    run = restore(folder)
    if run.generation == 0:
        raise ValueError(f"{folder}: nothing recorded yet; continue it with --resume")
    return run.history()


def environment(run: Run) -> dict[str, Any]:
    """What the run ran on: versions, device, commit, seconds."""
    device = jax.devices()[0]
    return {
        "versions": {"python": platform.python_version(), **_versions()},
        "platform": platform.platform(),
        "device": f"{device.platform}: {device.device_kind}",
        "num_devices": run.mesh.size,
        "num_processes": jax.process_count(),
        "git_commit": _git_commit(),
        "compile_seconds": round(run.compile_seconds, 3),
        "run_seconds": round(run.run_seconds, 3),
        "control_steps": run.control_steps,
    }


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _git_commit() -> str | None:
    """Commit of the source tree the package is imported from, "+changes" where it differs."""
    source = Path(__file__).parent

    def git(*arguments):
        done = subprocess.run(
            ["git", "-C", str(source), *arguments], capture_output=True, text=True, timeout=10
        )
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        commit = git("rev-parse", "HEAD") if git("ls-files", "--", __file__) else ""
        changed = git("status", "--porcelain", "--untracked-files=no") if commit else ""
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}+changes" if changed else commit or None


def _write_json(path: Path, value: Any) -> None:
    write_atomically(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def _write_npz(path: Path, arrays: dict[str, Any]) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomically(path, buffer.getvalue())
