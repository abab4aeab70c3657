"""`fntg export`: a controller in another format, checked right after writing it."""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from fntg_jax.commands.cli import load_controller, parse, say


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """Write a controller in another format.  The name of the file says which: .json (the exchange
    format), .py (NumPy only), .h (C99; the time of a call is printed too), .fll (FuzzyLite
    Language), .fis (MATLAB's and Octave's fuzzy toolboxes).  What was written is run on 20 000
    observations against a float64 reference; the largest errors go to stderr.  --to stablehlo
    writes a folder with the whole control of one robot of a team, for other machines."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json, an .fll, or a run folder; for stablehlo a team."""
    out: Annotated[Path | None, tyro.conf.Positional] = None
    """file to write; - for stdout; for stablehlo a folder (default TEAM-stablehlo)."""
    to: Literal["", "json", "numpy", "c", "fll", "fis", "stablehlo"] = ""
    """format, where it goes to stdout (else json); of a file it has to fit the name."""
    force: bool = False
    """replace a file that fntg export has not written."""
    seed: int | None = None
    """of a run folder: this seed's best controller instead of the best of all."""


_SUFFIXES = {".json": "json", ".py": "numpy", ".h": "c", ".fll": "fll", ".fis": "fis"}
# What our own files have among their first bytes.
_MARKS = (b'"format": "fntg-params"', b"Written by fntg-jax", b"Engine: fntg", b"Name='fntg'")


def main(argv: list[str]) -> None:
    options = parse(ExportOptions, argv, "export")
    if options.to == "stablehlo":
        _stablehlo(options)
        return
    if options.out is None:
        raise ValueError("out is missing: a file to write, or - for stdout")
    from fntg_jax.files import write_atomically, writing

    to_file = str(options.out) != "-"
    to = _format(options) if to_file else options.to or "json"
    controller = load_controller(options.controller, options.seed)
    text = _WRITERS[to](controller)
    if not to_file:
        sys.stdout.write(text)
        return
    with writing(options.out, "out"):
        write_atomically(options.out, text.encode())
    say(f"wrote {options.out}")


def _stablehlo(options: ExportOptions) -> None:
    """The folder of `running.stablehlo`."""
    team = str(options.controller)
    folder = options.out or Path(f"{Path(team).stem}-stablehlo")
    ours = (folder / "signature.json").exists()
    if folder.exists() and not ours and not (folder.is_dir() and not any(folder.iterdir())):
        raise ValueError(f"out = {folder}: exists, not written by fntg export; choose another")
    from fntg_jax.files import writing
    from fntg_jax.running import stablehlo, xla

    xla.configure()
    with writing(folder, "out"):
        error = stablehlo.write(team, folder)
    say(f"StableHLO, read back: largest difference over {stablehlo.STEPS} steps {error:.1e}")
    if error > stablehlo.TOLERANCE:
        say("fntg: error: that is more than rounding. Please report this")
        raise SystemExit(1)
    say(f"wrote {folder}; python {folder / 'run.py'} runs it again without this package")


def _format(options: ExportOptions) -> str:
    """The format that the name of the file asks for.  Raises ValueError where it asks for none or
    another than `to`, or where something stands there that is not ours."""
    from fntg_jax.files import check_out

    assert options.out is not None
    check_out(options.out)
    to = _SUFFIXES.get(options.out.suffix.lower())
    if to is None:
        raise ValueError(
            f"out = {options.out}: allowed are names ending in {', '.join(_SUFFIXES)}, and -"
        )
    if options.to not in ("", to):
        raise ValueError(f"out = {options.out}: that is a name for {to}, not for {options.to}")
    if options.out.exists() and not options.force:
        with open(options.out, "rb") as file:
            head = file.read(400)
        if head and not any(mark in head for mark in _MARKS):
            raise ValueError(
                f"out = {options.out}: exists, not written by fntg export; --force replaces it"
            )
    return to


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


def _fis(controller: Any) -> str:
    from fntg_jax.export import fis_format

    text = fis_format.dumps(controller)
    say("FIS: not run here; docs/exports.md says how Octave checks it. Clip v and omega to Range")
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


_WRITERS = {"json": _json, "numpy": _numpy, "c": _c, "fll": _fll, "fis": _fis}
