"""`fntg localize`: the path of a robot from a log of odometry and landmarks."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import parse, say
from fntg_jax.files import write_atomically, writing
from fntg_jax.running import registry, xla


@dataclasses.dataclass(frozen=True)
class LocalizeOptions:
    """Where a robot was, from a log of odometry and landmarks.  LOG has the header
    time,kind,name,a,b,c and rows start,,x,y,heading (none: the pose is unknown);
    odometry,,dx,dy,dtheta (robot's frame, since the last such row); landmark,NAME,distance,bearing,
    (m, rad, s).  The odometry's errors and the sensors' noise are estimated, too.  Prints the path
    of the poses' file; with --truth the errors."""

    log: Annotated[Path, tyro.conf.Positional]
    """CSV file, rows in order of time."""
    map: Path | None = None
    """CSV file of the landmarks, name,x,y (m); default: the field of 2001."""
    out: Path = Path("poses.csv")
    """where time,x,y,heading,sd_x,sd_y,sd_heading go, a row for each odometry row."""
    truth: Path | None = None
    """CSV file of the true path, time,x,y,heading: print the errors."""
    plot: Path | None = None
    """draw the path with its 95 % ellipses into this .png (and a .pdf beside it)."""


def main(argv: list[str]) -> None:
    options = parse(LocalizeOptions, argv, "localize")
    picture = options.plot
    if picture is not None and (picture.suffix != ".png" or not picture.parent.is_dir()):
        raise ValueError(f"plot = {picture}: allowed is a .png file in a folder that exists")
    xla.configure()
    from fntg_jax.running import localize

    if options.map is not None:
        landmarks = localize.read_map(options.map)
    else:
        field = registry.get_world("kinematic").field
        landmarks = {mark.name: (mark.x, mark.y) for mark in field.landmarks}
    truth = None if options.truth is None else localize.read_truth(options.truth)
    rows = localize.read_log(options.log, landmarks)
    poses = localize.localize(rows, landmarks)
    report = None if truth is None else localize.report(poses, truth)
    with writing(options.out, "out"):
        write_atomically(options.out, localize.table(poses))
    if picture is not None:
        from fntg_jax.showing import path

        with writing(picture, "plot"):
            say(f"plot {path.plot(poses, landmarks, truth, picture)}")
    print(options.out)
    if report is not None:
        print(report)
