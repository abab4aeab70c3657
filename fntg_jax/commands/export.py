"""`fntg export`: a controller in another format, checked right after writing it."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from fntg_jax.commands.cli import load_controller, parse, say


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """Write a controller in another format.  What was written is run on 20 000 observations
    against a float64 reference; the largest errors go to stderr."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json, an exported .fll, or a run folder."""
    out: Annotated[Path, tyro.conf.Positional]
    """file to write; - for stdout."""
    to: Literal["json", "numpy", "c", "fll"] = "json"
    """format: json (the exchange format), numpy (one Python file), c (one C99 header; the time
    of a call is printed too), fll (FuzzyLite Language)."""
    seed: int | None = None
    """of a run folder: this seed's best controller instead of the best of all."""


def main(argv: list[str]) -> None:
    options = parse(ExportOptions, argv, "export")
    from fntg_jax.files import write_atomically

    to_file = str(options.out) != "-"
    if to_file and not options.out.parent.is_dir():
        raise ValueError(f"out = {options.out}: {options.out.parent} is not a folder")
    controller = load_controller(options.controller, options.seed)
    text = _WRITERS[options.to](controller)
    if not to_file:
        sys.stdout.write(text)
        return
    try:
        write_atomically(options.out, text.encode())
    except OSError as error:
        raise ValueError(f"out = {options.out}: {error.strerror or error}") from None
    say(f"wrote {options.out}")


def _json(controller: Any) -> str:
    import numpy as np

    from fntg_jax import export

    text = export.dumps(controller)
    read = export.loads(text)
    _check(controller, "JSON, float32", lambda x: np.stack(read(*x.T), axis=-1), double=False)
    return text


def _numpy(controller: Any) -> str:
    from fntg_jax.export import numpy_format

    text = numpy_format.dumps(controller)
    _check(controller, "NumPy, float64", lambda x: numpy_format.commands(text, x), double=True)
    return text


def _c(controller: Any) -> str:
    from fntg_jax.export import c_format

    text = c_format.dumps(controller)
    if c_format.compiler() is None:
        say("not checked: no C compiler found (set CC)")
        return text
    for double in (False, True):
        seconds: list[float] = []

        def commands(inputs, double=double, seconds=seconds):
            done = c_format.run(text, inputs, double)
            seconds.append(done.seconds)
            return done.commands

        _check(controller, "C, double" if double else "C, float", commands, double)
        say(f"  {1e9 * seconds[0]:.0f} ns a call here ({' '.join(c_format.compiler() or [])} -O2)")
    return text


def _fll(controller: Any) -> str:
    from fntg_jax.export import fll_format, verify

    text = fll_format.dumps(controller)
    read = fll_format.loads(text)
    _check(controller, "FLL, read back", lambda x: verify.reference(read, x), double=True)
    say("  that is our own reader; tests/fll/verify.py runs pyfuzzylite")
    return text


def _check(controller: Any, what: str, commands: Any, double: bool) -> None:
    from fntg_jax.export import verify

    error = verify.max_error(controller, commands)
    say(
        f"{what}: largest error over {verify.NUM_OBSERVATIONS} observations "
        f"{error.v:.1e} m/s, {error.omega:.1e} rad/s"
    )
    if not verify.within(controller, error, verify.FLOAT64 if double else verify.FLOAT32):
        say("fntg: error: that is more than rounding; nothing was written. Please report this")
        raise SystemExit(1)


_WRITERS = {"json": _json, "numpy": _numpy, "c": _c, "fll": _fll}
