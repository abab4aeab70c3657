"""The `fntg` command: dispatch, option parsing, error messages.

Results go to stdout, words and progress to stderr; exit status 0, 2 for bad input (one line on
stderr), 3 for a training run whose fitness overflowed, 130 and 143 after Ctrl-C and SIGTERM.  Each
command is a module of `fntg_jax.commands` with a function `main(argv)`.
"""

import contextlib
import importlib
import io
import os
import re
import sys
import traceback
from pathlib import Path
from typing import Any

import tyro

COMMANDS = {
    "train": "learn controllers and write a run folder",
    "refine": "improve a controller, along gradients or by CMA-ES",
    "sweep": "learn over a grid of settings and seeds, and compare them",
    "evaluate": "success of a controller on suites of unseen scenes",
    "rules": "the rule base in plain words, with how often each rule fires",
    "replay": "watch trials: one HTML page, or an animated GIF or WebP",
    "plot": "membership functions and control surfaces, PNG and PDF",
    "report": "a run as one self-contained HTML page",
    "export": "write a run's or file's controller in another format",
    "localize": "where a robot was, from a log of odometry and landmarks",
    "see": "landmarks in photographs: which, in what direction, how far",
    "match": "two teams, many matches under the referee: goals, wins, statistics",
    "league": "a round robin of teams: table, ratings, cross table, replays",
    "bench": "a score card of a team or controller on frozen scenes and matches",
    "fit": "a body's table from recordings of the robot",
    "say": "a robot's message as sound: a WAV file",
    "listen": "the robots' messages in recorded sounds",
    "doctor": "versions, devices, cache and rendering, against what was tested",
}


def main(argv: list[str] | None = None) -> None:
    """Entry point of the `fntg` command."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help"):
        print("usage: fntg COMMAND [OPTIONS]\n")
        for name, what in COMMANDS.items():
            print(f"  {name:10s}{what}")
        print("\n`fntg COMMAND --help` lists the options of a command.")
        raise SystemExit(0)
    command, rest = argv[0], argv[1:]
    if command == "--version":
        from fntg_jax import __version__

        print(__version__)
        raise SystemExit(0)
    if command not in COMMANDS:
        refuse(f"command {command!r}: known are {', '.join(COMMANDS)}")
    try:
        importlib.import_module(f"fntg_jax.commands.{command}").main(rest)
        if sys.stdout is not None:
            sys.stdout.flush()  # what cannot be written shall not wait for the interpreter's end
    except ValueError as error:
        refuse(str(error))
    except _member_error() as error:
        say(f"fntg: error: {error}:")
        traceback.print_exception(error.__cause__)
        raise SystemExit(1) from None
    except MemoryError:
        refuse("out of memory: take fewer genomes, scenes or seeds")
    except RuntimeError as error:
        # What XLA raises; its class would have to be imported, with all of jax.
        if "RESOURCE_EXHAUSTED" not in str(error) and "Out of memory" not in str(error):
            raise
        refuse("out of memory: take fewer genomes, scenes or seeds")
    except KeyboardInterrupt:
        # Outside of evolution, which stops at the end of a chunk, there is nothing to save.
        raise SystemExit(130) from None
    except BrokenPipeError:
        # The reader has gone (`fntg ... | head`); nothing is left to say to it.
        _drop_stdout()
        raise SystemExit(1) from None
    except OSError as error:
        # A full disk, or a full /dev/stdout.
        _drop_stdout()
        refuse(f"{error.filename or 'output'}: {error.strerror or error}")


def _drop_stdout() -> None:
    """Nothing more goes there, also nothing that is still waiting."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _member_error() -> type[Exception]:
    """`registry.MemberError`: asked for only when something was raised."""
    from fntg_jax.running.registry import MemberError

    return MemberError


def refuse(message: str) -> None:
    # Names and values from outside are quoted in it: no line breaks, no terminal sequences.
    line = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in " ".join(message.split()))
    print(f"fntg: error: {line if len(line) < 1000 else line[:900] + ' ...'}", file=sys.stderr)
    raise SystemExit(2)


def say(message: str) -> None:
    """A line on stderr.  Where nobody reads it any more, the work goes on all the same."""
    with contextlib.suppress(OSError):
        print(message, file=sys.stderr, flush=True)


def parse(cls: type, argv: list[str], command: str, default: Any = None) -> Any:
    """The options of a command.  Raises ValueError in one line."""
    return read_options(
        cls, argv, f"fntg {command}", {} if default is None else {"default": default}
    )


def read_options(cls: type, argv: list[str], program: str, options: dict[str, Any]) -> Any:
    """tyro, with its boxed error message folded to one line of a ValueError."""
    caught = io.StringIO()
    try:
        with contextlib.redirect_stderr(caught):
            return tyro.cli(cls, args=argv, prog=program, **options)
    except SystemExit as stop:
        if stop.code != 2:
            sys.stderr.write(caught.getvalue())
            raise
    lines = [re.sub(r"[│╭╮╰╯─]+", " ", line).strip() for line in caught.getvalue().split("\n")]
    body = [line for line in lines[1:] if line]
    rules = [n for n, line in enumerate(caught.getvalue().split("\n")[1:]) if "───" in line]
    message = " ".join(body[: rules[0]] if rules else body)
    raise ValueError(f"{message} (see {program} --help)")


def load_controller(path: Path, seed: int | None = None) -> Any:
    """A controller from a parameter file or a run folder, of which `seed` picks another than the
    best."""
    import fntg_jax

    if seed is None:
        return fntg_jax.load(path)
    if not os.path.isdir(path):
        raise ValueError(f"seed = {seed}: {path} is no run folder, which alone has several")
    from fntg_jax.running import controllers

    return controllers.of_seed(path, seed)


if __name__ == "__main__":
    main()
