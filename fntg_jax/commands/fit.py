"""`fntg fit`: a body's table from recordings of the robot."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import parse, say
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """Bring your own robot: speeds, lag and slip of every style, odometry and camera noise, from a
    recording of commands and poses; the table goes into `fntg match --home-body`.  The columns are
    time, style, v, v_y, omega, x, y, heading, then perhaps dx, dy, dtheta (odometry since the row
    before), then perhaps seen, bearing, distance, object_x, object_y."""

    log: Annotated[Path, tyro.conf.Positional]
    """the recording, .csv."""
    body: str = "ers210"
    """table to begin from, which keeps what the log does not tell: ers210, wheels or a file."""
    out: Path | None = None
    """file for the table, .json."""
    test: Path | None = None
    """another recording: how well both tables foresee it."""


def main(argv: list[str]) -> None:
    options = parse(FitOptions, argv, "fit")
    if options.out is not None and (
        options.out.suffix != ".json" or not options.out.parent.is_dir()
    ):
        raise ValueError(f"out = {options.out}: allowed is a .json in a folder that exists")
    xla.configure()
    import numpy as np

    from fntg_jax.files import write_atomically, writing
    from fntg_jax.running import matches, recordings

    match = matches.get_match("soccer", home=options.body, away=options.body)
    body, identify = match.bodies[0], match.identify
    styles = body.styles
    recording = recordings.read(options.log, styles.name)
    fresh = options.test and recordings.read(options.test, styles.name)
    log = recordings.as_log(recording, styles.name, identify.Log)
    say(f"{len(log.pose)} rows {log.dt:g} s apart")
    fitted = identify.fit(log, styles)
    print(f"{'style':10s}{'number':12s}{'before':>10s}{'fitted':>10s}{'error':>9s}")
    for one in fitted:
        row = styles.name.index(one.style)
        for name in identify.FITTED:
            before, error = getattr(styles, name)[row], one.errors[name]
            known = error < identify.KNOWN
            value = f"{one.values[name]:10.4f}{100 * error:7.1f} %" if known else "  not told"
            print(f"{one.style:10s}{name:12s}{before:10.4f}{value}")
    odometry = None if log.odometry is None else identify.odometry(log)
    for name, value in (odometry or {}).items():
        print(f"{'odometry':10s}{name:22s}{value:10.4f}")
    for kind, errors in recording.sightings.items():
        for name, values in zip(("bearing", "distance"), errors.T):
            what = f"{np.mean(values):+.4f} +- {np.std(values):.4f}"
            unit = "rad" if name == "bearing" else "of it"
            print(f"{kind:10s}{name:12s}{what:>20s} {unit} ({len(values)} sightings)")
    source = f"fntg fit {options.log.name}, from {options.body}"
    name = body.name if options.out is None else options.out.stem
    new, text = identify.table(body, name, source, fitted, odometry)
    if fresh is not None:
        other = recordings.as_log(fresh, styles.name, identify.Log)
        print(f"{'':16s}{'surprise':>10s}{'speed':>14s}{'turning':>14s}   on {options.test}")
        for title, table in (("before", styles), ("fitted", new.styles)):
            m = identify.misfit(other, table)
            print(f"{title:16s}{m.surprise:10.3f}{m.speed:10.4f} m/s{m.turning:8.4f} rad/s")
    if options.out is not None:
        with writing(options.out, "out"):
            write_atomically(options.out, text.encode())
        say(f"table {options.out}")
