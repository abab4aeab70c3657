"""What a compiled program will need, against what there is: known before it runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax


def check(compiled: Any, num_devices: int = 1) -> int:
    """Bytes that a compiled program needs, arguments and results included.

    Args:
        compiled: of `jax.jit(...).lower(...).compile()`.
        num_devices: of this process, where they share the host's memory.

    Raises ValueError (one line) where there is less.
    """
    found = compiled.memory_analysis()
    if found is None:  # not every back end says
        return 0
    need = found.argument_size_in_bytes + found.output_size_in_bytes + found.temp_size_in_bytes
    need *= num_devices if jax.default_backend() == "cpu" else 1
    refuse_beyond(need)
    return need


def refuse_beyond(need: int) -> None:
    """Raises ValueError (one line) where fewer bytes are free."""
    free = available()
    if free is not None and need > free:
        raise ValueError(
            f"this needs about {need / 1e9:.1f} GB of memory and {free / 1e9:.1f} GB are free: "
            "take fewer genomes, scenes or seeds"
        )


def announce(num_bytes: int, say: Callable[[str], None]) -> None:
    """Say what a program needs where it is much, more than 1 GB.

    Args:
        num_bytes: of `check`.
        say: told a line.
    """
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
    return min([free, *_group_limits(Path("/proc/self/cgroup"), Path("/sys/fs/cgroup"))])


def _group_limits(own: Path, root: Path) -> list[int]:
    """Bytes left in our control group and in all above it (a container, a Slurm job, a systemd
    slice), of version 1 and 2, as far as they have a limit."""
    try:
        lines = [line.split(":", 2) for line in own.read_text().splitlines()]
    except OSError:
        return []
    found = []
    for _, controllers, path in (line for line in lines if len(line) == 3):
        if controllers == "":
            top, names = root, ("memory.max", "memory.current")
        elif "memory" in controllers.split(","):
            top, names = root / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        group = Path(path.strip("/"))
        for folder in (group, *group.parents):
            try:
                limit, used = (int((top / folder / name).read_text()) for name in names)
            except (OSError, ValueError):
                continue  # no such group seen from here, or no limit ("max")
            found.append(max(limit - used, 0))
    return found
