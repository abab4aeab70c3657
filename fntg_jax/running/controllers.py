"""The controllers of a run, and of its folder, with where they come from."""

import dataclasses
from pathlib import Path

import jax
import numpy as np

from envs.base import Limits
from fntg_jax import export
from fntg_jax.files import read_arrays, read_bytes
from fntg_jax.running import config_file
from fntg_jax.running.provenance import version
from fntg_jax.running.runner import Result, Run
from fntg_jax.running.settings import TrainConfig


def of_run(run: Run, seed: int | None = None, result: Result | None = None) -> export.Controller:
    """The controller of one seed, or the best of all, with its provenance.

    Args:
        run: completed, of task bioa.
        seed: which; None for the best.
        result: of `run.conclude()`, where the caller has it already.

    Raises ValueError in other tasks, and on a seed that the run lacks.
    """
    if run.problem.task is not None:
        raise ValueError(f"a run of task {run.config.task!r} has genes, and no controller")
    config = run.config
    row = None if seed is None else _row(config, seed)
    result = run.conclude() if result is None else result
    index = int(np.argmax(result.fitness)) if row is None else row
    best, bits = float(result.fitness[index]), None
    if result.bits is not None:
        bits = "".join("1" if b else "0" for b in result.bits[index])
    limits = run.problem.env.limits
    return export.Controller(
        layout=run.problem.layout,
        theta=np.asarray(result.theta[index], np.float64),
        bits=bits,
        output=config.output,
        limits=Limits(*(float(x) for x in (limits.v_min, limits.v_max, limits.omega_max))),
        control_dt=float(run.problem.env.dt),
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
            "fntg_jax": version(),
            "jax": jax.__version__,
        },
    )


def _row(config: TrainConfig, seed: int) -> int:
    """Where a seed stands in arrays of all seeds.  Raises ValueError where the run lacks it."""
    last = config.first_seed + config.seeds - 1
    if not config.first_seed <= seed <= last:
        raise ValueError(f"seed = {seed}: the run has seeds {config.first_seed} to {last}")
    return seed - config.first_seed


def of_generation(folder: Path, generation: int) -> export.Controller:
    """The best controller of one generation, of the seed that params.json comes from.

    Args:
        folder: of a completed run.
        generation: from 1.

    Raises ValueError (one line) where the folder does not hold it.
    """
    best = export.load(folder)
    config = config_file.load(folder)
    if not 1 <= generation <= config.generations:
        raise ValueError(f"generation = {generation}: the run has 1 to {config.generations}")
    seed = best.provenance.get("seed", config.first_seed)
    index = seed - config.first_seed if isinstance(seed, int) else -1
    shape = (config.seeds, config.generations, best.layout.num_genes)
    theta = _stored(folder, config, best.layout.num_genes, "best_theta", shape, index)[
        generation - 1
    ]
    provenance = {**best.provenance, "generations": generation, "fitness": None}
    return dataclasses.replace(best, theta=theta, bits=None, provenance=provenance)


def of_seed(folder: Path, seed: int) -> export.Controller:
    """The final controller of one seed of a completed run.

    Args:
        folder: of the run.
        seed: one of the run's.

    Raises ValueError (one line) where the folder does not hold it.
    """
    best = export.load(folder)
    config = config_file.load(folder)
    index = _row(config, seed)
    if seed == best.provenance.get("seed"):
        return best
    theta = _stored(
        folder, config, best.layout.num_genes, "theta", (config.seeds, best.layout.num_genes), index
    )
    value = _stored(folder, config, best.layout.num_genes, "fitness", (config.seeds,), index)
    provenance = {
        **best.provenance,
        "seed": seed,
        "best_of_seeds": 1,
        "fitness": float(value) if np.isfinite(value) else None,
    }
    return dataclasses.replace(best, theta=theta, bits=None, provenance=provenance)


def _stored(
    folder: Path,
    config: TrainConfig,
    num_genes: int,
    name: str,
    shape: tuple[int, ...],
    index: int,
) -> np.ndarray:
    """Row `index` of an array of history.npz.  The file is not trusted."""
    path = folder / "history.npz"
    try:
        if not 0 <= index < shape[0]:
            raise ValueError("another shape than config.json says")
        most = config_file.most_bytes(config, num_genes)
        stored = read_arrays(read_bytes(path, "history", most), most).get(name)
        if stored is None or stored.shape != shape or stored.dtype.kind != "f":
            raise ValueError("another shape than config.json says")
        row = stored[index].astype(np.float64)
        if name != "fitness" and not np.all(np.abs(row) <= 5):
            raise ValueError("another range than config.json says")
    except ValueError as error:
        raise ValueError(f"{path}: not the history of this run ({error})") from error
    return row
