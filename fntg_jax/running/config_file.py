"""config.json of a run folder, and how large the files beside it may be."""

import json
from pathlib import Path

from fntg_jax.files import read_text
from fntg_jax.running import settings
from fntg_jax.running.settings import TrainConfig


def load(folder: Path) -> TrainConfig:
    """The configuration of a run folder.

    Args:
        folder: of the run.

    Raises ValueError (one line) when it is none or is damaged.
    """
    path = folder / "config.json"
    try:
        text = read_text(path, "configuration")
    except ValueError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"{folder}: not a run folder (config.json: {why})") from None
    try:
        data = json.loads(text)
    except ValueError as error:
        raise ValueError(f"{path}: not JSON ({error})") from None
    except RecursionError:
        raise ValueError(f"{path}: not a configuration: nested too deeply") from None
    try:
        return settings.from_dict(data)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def most_bytes(config: TrainConfig, num_genes: int, num_memory: int = 0) -> int:
    """More than the arrays of this run's checkpoint, or of its history, take: what is larger is
    none.  num_memory: bytes of what the task remembers."""
    length = num_genes * max(config.ga.num_bits, 8)
    each = config.ga.population + config.generations + config.refine_steps * config.refine_top
    return 1_000_000 + config.seeds * (each + 1) * (length + 100) + 2 * num_memory
