"""SIGINT and SIGTERM for work that takes long: heard also while compiled code or the compiler runs,
where a handler in Python would have to wait for its end."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator

from fntg_jax.commands.cli import say

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stop:
    """What was asked for.

    wanted: the number of the signal, 0 without one.  at_once: the next one ends the process; where
    it is false the first one leaves that to the work itself, at its next checkpoint, and the second
    one ends the process.  A second one always does.
    """

    def __init__(self) -> None:
        self.wanted = 0
        self.at_once = True


@contextlib.contextmanager
def listen(advice: Callable[[], str]) -> Iterator[Stop]:
    """Hear the signals while the body runs.  advice: the last line of a process that ends at once.

    Only in the main thread, as all of Python's signals.
    """
    stop = Stop()
    ours, theirs = os.pipe()
    os.set_blocking(theirs, False)

    def hear() -> None:
        # The interpreter's own C code writes the signal's number here, at once.
        while heard := os.read(ours, 1):
            number = heard[0]
            if number not in SIGNALS:
                continue
            if stop.at_once or stop.wanted:
                if sys.stderr is not None and sys.stderr.isatty():
                    say("\x1b[?25h")  # a progress bar had hidden the cursor
                say(advice())
                # No exception reaches a main thread that is inside the compiler.
                os._exit(128 + number)
            stop.wanted = number
            say("stopping at the end of this chunk of generations; again: at once")

    handlers = {s: signal.signal(s, lambda *_: None) for s in SIGNALS}
    before = signal.set_wakeup_fd(theirs, warn_on_full_buffer=False)
    thread = threading.Thread(target=hear, daemon=True)
    thread.start()
    try:
        yield stop
    finally:
        signal.set_wakeup_fd(before)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(theirs)
        thread.join()
        os.close(ours)
