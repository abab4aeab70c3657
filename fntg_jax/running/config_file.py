"""config.json of a run folder."""

import json
from pathlib import Path

from fntg_jax.running import settings
from fntg_jax.running.settings import TrainConfig


def load(folder: Path) -> TrainConfig:
    """The configuration of a run folder.  Raises ValueError (one line) when it is none or is
    damaged."""
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
        return settings.from_dict(data)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None
