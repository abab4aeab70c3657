"""First populations out of an earlier run or its result, instead of random ones."""

import json
import math
import os
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key

from fntg_jax import export
from fntg_jax.controller import genome
from fntg_jax.controller.layout import HIGH, LOW
from fntg_jax.files import read_arrays, read_bytes, read_text
from fntg_jax.running import config_file, hosts
from fntg_jax.running.problem import Problem
from fntg_jax.running.settings import TrainConfig

_KEY = 0x3A9  # folded into a seed's key: evolution draws from the key itself


class Start(NamedTuple):
    """bits: populations of all seeds; origin: where they come from, in words."""

    bits: Bool[Array, "S P L"]
    origin: str


def neighbours(
    key: Key[Array, ""],
    theta: Float[Array, " genes"],
    size: int,
    num_bits: int = 15,
    gray: bool = False,
    spread: float = 0.15,
) -> Bool[Array, "P L"]:
    """A population around one individual: itself, and copies with Gaussian steps on a third of
    their genes.

    Args:
        key: random key.
        theta: [genes], in (-5, 5).
        size: of the population.
        num_bits: bits a gene.
        gray: Gray code instead of plain binary.
        spread: standard deviation of a step, in genes; they are clipped to [-5, 5].

    Returns:
        Genomes, bool [size, genes * num_bits].
    """
    k_step, k_which = jax.random.split(key)
    shape = (size, len(theta))
    step = spread * jax.random.normal(k_step, shape) * jax.random.bernoulli(k_which, 1 / 3, shape)
    around = jnp.clip(jnp.asarray(theta) + step.at[0].set(0), LOW, HIGH)
    return genome.encode(around, num_bits, gray)


def start(problem: Problem) -> Start:
    """The populations that `config.warm_start` stands for: of a run folder the last ones, where
    seeds, population and coding are the same; else neighbours of its best result, or of the one in
    the file.  Whatever a task remembers begins anew.

    Args:
        problem: of the new run.

    Raises ValueError (one line) when it cannot be read or has other genes.
    """
    config, num_genes = problem.config, len(problem.genes)

    def read() -> bytes:
        try:
            first = _start(problem)
        except ValueError as error:
            raise ValueError(f"warm_start = {config.warm_start}: {error}") from error
        return np.packbits(first.bits).tobytes() + os.fsencode(first.origin)

    shape = (config.seeds, config.ga.population, num_genes * config.ga.num_bits)
    data, num = hosts.from_first(read), math.prod(shape)
    packed = np.frombuffer(data, np.uint8, count=-(-num // 8))
    bits = jnp.asarray(np.unpackbits(packed, count=num).astype(bool).reshape(shape))
    return Start(bits, os.fsdecode(data[len(packed) :]))


def _start(problem: Problem) -> Start:
    config, num_genes = problem.config, len(problem.genes)
    source = file = Path(config.warm_start)
    if os.path.isdir(source):  # Path.is_dir raises on names that no file can have
        file = source / "params.json"
        saved = config_file.load(source)
        _check(config, task=saved.task)
        if problem.task is None:
            _check(config, layout=saved.layout, output=saved.output)
        if _shape(saved) == _shape(config) and (source / "checkpoint.npz").exists():
            return Start(
                _last_populations(source, config, num_genes), f"the populations of {source}"
            )
    if problem.task is None:
        controller = export.load(file)
        _check(config, layout=controller.layout.name, output=controller.output)
        theta, what = controller.theta, "the controller"
    else:
        theta, what = _genes(file, problem), "the genes"
    coding, seeds = config.ga, config.first_seed + np.arange(config.seeds)
    bits = [
        neighbours(
            jax.random.fold_in(jax.random.key(np.uint32(seed)), _KEY),
            jnp.asarray(theta, jnp.float32),
            coding.population,
            coding.num_bits,
            coding.gray,
        )
        for seed in seeds
    ]
    return Start(jnp.stack(bits), f"neighbours of {what} of {source}")


def _genes(file: Path, problem: Problem) -> np.ndarray:
    """Genes in (-5, 5) out of a params.json of a task other than bioa (`genes.document`)."""
    try:
        document = json.loads(read_text(file, "parameter file"))
        found: Any = document["genes"] if document["format"] == "fntg-genes" else None
        names, units = [g["name"] for g in found], [g["unit"] for g in found]
        values = [g["value"] for g in found]
    except (KeyError, TypeError, RecursionError, json.JSONDecodeError) as error:
        raise ValueError("no genes of a task in it") from error
    wanted = [g.name for g in problem.genes]
    if names != wanted:
        raise ValueError(f"its genes are {_few(names)}, the new run's are {_few(wanted)}")
    for gene, unit, value in zip(problem.genes, units, values):
        if unit != gene.unit:
            raise ValueError(f"gene {gene.name} is in {unit!r}, the new run's is in {gene.unit!r}")
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and gene.low <= value <= gene.high):
            raise ValueError(
                f"gene {gene.name} = {value!r}: allowed are {gene.low:g} to {gene.high:g}"
            )
    return problem.from_units(values)


def _few(names: list[Any]) -> str:
    return ", ".join(map(str, names[:4])) + (f" and {len(names) - 4} more" if names[4:] else "")


def _check(config: TrainConfig, **found: Any) -> None:
    for name, value in found.items():
        wanted = getattr(config, name)
        if value != wanted:
            raise ValueError(f"its {name} is {value}, the new run's is {wanted}")


def _shape(config: TrainConfig) -> tuple:
    return config.seeds, config.ga.population, config.ga.num_bits, config.ga.gray


def _last_populations(folder: Path, config: TrainConfig, num_genes: int) -> Bool[Array, "S P L"]:
    """From the folder's checkpoint.  Raises ValueError when it is damaged."""
    length = num_genes * config.ga.num_bits
    path = folder / "checkpoint.npz"
    try:
        most = config_file.most_bytes(config, num_genes)
        packed = read_arrays(read_bytes(path, "checkpoint", most), most).get("bits")
        if packed is None:
            raise ValueError("no bits in it")
        shape = (config.seeds, config.ga.population, -(-length // 8))
        if packed.dtype != np.uint8 or packed.shape != shape:
            raise ValueError(f"bits are {packed.dtype} {packed.shape}, not uint8 {shape}")
    except ValueError as error:
        raise ValueError(f"{path.name}: not the checkpoint of this run ({error})") from error
    return jnp.asarray(np.unpackbits(packed, axis=-1, count=length).astype(bool))
