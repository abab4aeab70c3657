"""Learning on several hosts: one process on each, all of them running the same program.

Process 0 alone reads and writes files; what it reads reaches the others from there, so hosts need
not share a file system.  With one process every function here does nothing.
"""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

# A process that is silent for so long is lost.  JAX's default of 100 s is longer than a minute.
_HEARTBEAT_SECONDS = 30
# What a failed exchange begins with.  Where NumPy waits for it, jax 0.10.2 raises ValueError.
_STATUS = ("UNKNOWN: ", "UNAVAILABLE: ", "INTERNAL: ", "ABORTED: ", "DEADLINE_EXCEEDED: ")
_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


def join(coordinator: str | None, num_processes: int | None, process_id: int | None) -> None:
    """Wait for all processes to meet.  Before any computation.

    What is not given JAX takes from the cluster it detects (Slurm, Open MPI, Kubernetes, TPU).

    Args:
        coordinator: host:port of process 0.
        num_processes: how many there are.
        process_id: which of them this is, from 0.

    Raises ValueError (one line) where something is missing or wrong.
    """
    if coordinator is not None:
        host, colon, port = coordinator.rpartition(":")
        if not (host and colon and port.isdigit() and 0 < int(port) < 65536):
            raise ValueError(f"coordinator = {coordinator!r}: allowed is HOST:PORT")
    # Gloo, which talks for CPUs, writes to stdout, where results belong.
    results = os.dup(1)
    os.dup2(2, 1)
    sys.stdout = os.fdopen(results, "w")
    # Only a service for other hosts need listen beyond this one.
    local = coordinator is not None and coordinator.rpartition(":")[0] in _LOOPBACK
    try:
        jax.distributed.initialize(
            coordinator,
            num_processes,
            process_id,
            coordinator_bind_address=coordinator if local else None,
            heartbeat_timeout_seconds=_HEARTBEAT_SECONDS,
            shutdown_timeout_seconds=_HEARTBEAT_SECONDS,
        )
    except (ValueError, RuntimeError) as error:
        line = str(error).split("\n")[0]
        raise ValueError(
            f"distributed: {line} (needed: --coordinator HOST:PORT --num-processes N "
            "--process-id K, where no cluster is detected)"
        ) from None


def is_first() -> bool:
    """Whether this process is the one that reads, writes and reports."""
    return jax.process_index() == 0


def from_first(fn: Callable[[], bytes]) -> bytes:
    """What a function gives on process 0, on all of them.

    Args:
        fn: called on process 0 alone.

    Raises ValueError on all where it does on process 0.
    """
    if jax.process_count() == 1:
        return fn()
    from jax.experimental.multihost_utils import broadcast_one_to_all

    answer = b""
    if is_first():
        try:
            answer = b"+" + fn()
        except ValueError as error:
            answer = b"-" + str(error).encode()
    size = int(broadcast_one_to_all(np.asarray(len(answer))))
    data = np.frombuffer(answer.ljust(size, b"\0"), np.uint8)
    answer = np.asarray(broadcast_one_to_all(data), np.uint8).tobytes()
    if answer[:1] == b"-":
        raise ValueError(answer[1:].decode())
    return answer[1:]


def largest(*values: int) -> tuple[int, ...]:
    """Of each value, the largest among the processes: what one wants, all do.

    Args:
        values: of this process.
    """
    if jax.process_count() == 1:
        return values
    from jax.experimental.multihost_utils import process_allgather

    return tuple(int(x) for x in np.max(process_allgather(np.asarray(values)), axis=0))


def gather(array: Any) -> np.ndarray:
    """All of an array that is spread over processes, on each of them.

    Args:
        array: of JAX.
    """
    if jax.process_count() == 1:
        return np.asarray(array)
    from jax.experimental.multihost_utils import process_allgather

    return np.asarray(process_allgather(array, tiled=True))


# Says its first line of input when that ends without a last word.
_WATCHER = """
import sys
text = sys.stdin.read()
if not text.endswith("done"):
    sys.stderr.write(text)
"""


@contextlib.contextmanager
def together(advice: str) -> Iterator[None]:
    """When another process is lost, end this one with a clear last line.

    A closed connection is an exception: exit status 1.  A host that falls silent, or the loss of
    process 0, is noticed inside JAX (after half a minute at most), which aborts this process
    there and then: a small process beside it has the last word.

    Without it, measured with jax 0.10.2 and one of two idle or busy processes killed: the other
    ends 0.2 to 0.5 s later where process 0 was lost and 28 s later where it was the other one, all
    four times by SIGABRT and without a last line that says why.

    Args:
        advice: in that line, how to go on.
    """
    if jax.process_count() == 1:
        yield
        return
    line = f"fntg: error: another process was lost; {advice}\n"
    command = [sys.executable, "-I", "-S", "-c", _WATCHER]
    watcher = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, start_new_session=True)
    assert watcher.stdin is not None
    watcher.stdin.write(line)
    watcher.stdin.flush()
    try:
        yield
    except (jax.errors.JaxRuntimeError, ValueError) as error:
        words = str(error).split("\n")[0]
        if isinstance(error, ValueError) and not words.startswith(_STATUS):
            raise
        print(words, file=sys.stderr, flush=True)
        # Not by an exception, which on its way out waits for the lost one.
        os._exit(1)
    finally:
        with contextlib.suppress(OSError):
            watcher.stdin.write("done")
            watcher.stdin.close()
