"""First populations out of an earlier run or a controller, instead of random ones."""

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
from fntg_jax.files import read_arrays, read_bytes
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
    """A population around one controller: itself, and copies with Gaussian steps (standard
    deviation `spread`) on a third of their genes, clipped to the genes' range."""
    k_step, k_which = jax.random.split(key)
    shape = (size, len(theta))
    step = spread * jax.random.normal(k_step, shape) * jax.random.bernoulli(k_which, 1 / 3, shape)
    around = jnp.clip(jnp.asarray(theta) + step.at[0].set(0), LOW, HIGH)
    return genome.encode(around, num_bits, gray)


def start(problem: Problem) -> Start:
    """The populations that `config.warm_start` stands for: of a run folder the last ones, where
    seeds, population and coding are the same; else neighbours of its best controller, or of the
    one in the file.  Raises ValueError (one line) when it cannot be read or has another layout.
    """
    config, num_genes = problem.config, problem.layout.num_genes

    def read() -> bytes:
        try:
            first = _start(config, num_genes)
        except ValueError as error:
            raise ValueError(f"warm_start = {config.warm_start}: {error}") from None
        return np.packbits(first.bits).tobytes() + os.fsencode(first.origin)

    shape = (config.seeds, config.ga.population, num_genes * config.ga.num_bits)
    data, num = hosts.from_first(read), math.prod(shape)
    packed = np.frombuffer(data, np.uint8, count=-(-num // 8))
    bits = jnp.asarray(np.unpackbits(packed, count=num).astype(bool).reshape(shape))
    return Start(bits, os.fsdecode(data[len(packed) :]))


def _start(config: TrainConfig, num_genes: int) -> Start:
    source = file = Path(config.warm_start)
    if os.path.isdir(source):  # Path.is_dir raises on names that no file can have
        file = source / "params.json"
        saved = config_file.load(source)
        _check(config, layout=saved.layout, output=saved.output)
        if _shape(saved) == _shape(config) and (source / "checkpoint.npz").exists():
            return Start(
                _last_populations(source, config, num_genes), f"the populations of {source}"
            )
    controller = export.load(file)
    _check(config, layout=controller.layout.name, output=controller.output)
    theta, coding = jnp.asarray(controller.theta, jnp.float32), config.ga
    seeds = config.first_seed + np.arange(config.seeds)
    bits = [
        neighbours(
            jax.random.fold_in(jax.random.key(np.uint32(seed)), _KEY),
            theta,
            coding.population,
            coding.num_bits,
            coding.gray,
        )
        for seed in seeds
    ]
    return Start(jnp.stack(bits), f"neighbours of the controller of {source}")


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
        packed = read_arrays(read_bytes(path, "checkpoint", most), most)["bits"]
        shape = (config.seeds, config.ga.population, -(-length // 8))
        if packed.dtype != np.uint8 or packed.shape != shape:
            raise ValueError(f"bits are {packed.dtype} {packed.shape}, not uint8 {shape}")
    except Exception as error:  # a damaged archive raises almost anything
        why = getattr(error, "strerror", None) or error
        raise ValueError(f"{path.name}: not the checkpoint of this run ({why})") from None
    return jnp.asarray(np.unpackbits(packed, axis=-1, count=length).astype(bool))
