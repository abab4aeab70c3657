"""What a compiled program will need, against what there is: known before it runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax


def check(compiled: Any, num_devices: int = 1) -> int:
    """Bytes that a compiled program needs, arguments and results included, on all of this
    process's `num_devices` where they share the host's memory.  Raises ValueError (one line)
    where there is less."""
    found = compiled.memory_analysis()
    if found is None:  # not every back end says
        return 0
    need = found.argument_size_in_bytes + found.output_size_in_bytes + found.temp_size_in_bytes
    need *= num_devices if jax.default_backend() == "cpu" else 1
    free = available()
    if free is not None and need > free:
        raise ValueError(
            f"this needs about {need / 1e9:.1f} GB of memory and {free / 1e9:.1f} GB are free: "
            "take fewer genomes, scenes or seeds"
        )
    return need


def announce(num_bytes: int, say: Callable[[str], None]) -> None:
    """Say what a program needs where it is much, more than 1 GB."""
    if num_bytes > 1e9:
        say(f"this takes about {num_bytes / 1e9:.1f} GB of memory")


def available() -> int | None:
    """Bytes that are free for us: of the device, or of the host (also inside a container).  None
    where it cannot be told."""
    stats = jax.local_devices()[0].memory_stats() if jax.default_backend() != "cpu" else None
    if stats and "bytes_limit" in stats:
        return stats["bytes_limit"] - stats.get("bytes_in_use", 0)
    try:
        lines = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        free = 1024 * int(lines["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return None
    try:
        group = Path("/sys/fs/cgroup")
        limit = int((group / "memory.max").read_text())
        free = min(free, limit - int((group / "memory.current").read_text()))
    except (OSError, ValueError):
        pass  # no container, or none with a limit ("max")
    return free
