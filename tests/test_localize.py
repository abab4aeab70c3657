"""`fntg localize` on logs whose truth is known, and on logs that are no logs."""

import dataclasses

import numpy as np
import pytest

from envs.field import FIELD
from experiments import localization_logs as logs
from fntg_jax.running import localize

LANDMARKS = {mark.name: (mark.x, mark.y) for mark in FIELD.landmarks}
USUAL = logs.Settings(drive="wander")


def solve(tmp_path, settings, seed):
    """Errors and estimates of a log that went through its file."""
    log = logs.make(settings, LANDMARKS, seed)
    logs.write(log, tmp_path / "log.csv", tmp_path / "truth.csv")
    poses = localize.localize(localize.read_log(tmp_path / "log.csv", LANDMARKS), LANDMARKS)
    return poses, localize.errors(poses, localize.read_truth(tmp_path / "truth.csv"))


@pytest.mark.parametrize(
    ("change", "limit"),
    [
        ({}, 2.5),
        ({"range_noise": 0.21, "bearing_noise": np.radians(6)}, 4.5),
        ({"sightings": 0.65 / 20, "head": "any"}, 8.0),
        ({"misnamed": 0.1, "scale": -0.08, "drift": -0.02}, 2.5),
    ],
)
def test_errors_stay_small(tmp_path, change, limit):
    poses, errors = solve(tmp_path, dataclasses.replace(USUAL, **change), 7)
    assert poses.pose.shape == (1200, 3)
    assert 100 * errors.position.mean() < limit
    assert np.degrees(errors.heading.mean()) < limit


def test_a_robot_that_is_lifted_or_begins_anywhere_is_found_again(tmp_path):
    change = {"kidnapped": (20.0, 40.0), "started": False, "seconds": 60.0}
    poses, errors = solve(tmp_path, dataclasses.replace(USUAL, **change), 8)
    assert poses.lost[0] > 0.9
    for since in (0.0, 20.0, 40.0):
        later = (poses.time > since + 5) & (poses.time < since + 20)
        assert errors.position[later].max() < 0.25


def test_the_command(fntg, tmp_path):
    logs.write(logs.make(USUAL, LANDMARKS, 3), tmp_path / "log.csv", tmp_path / "truth.csv")
    (tmp_path / "map.csv").write_text(
        "name,x,y\n" + "".join(f"{n},{x},{y}\n" for n, (x, y) in LANDMARKS.items())
    )
    options = ["--out", "poses.csv", "--truth", "truth.csv", "--plot", "path.png"]
    done = fntg("localize", "log.csv", *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("poses.csv\n") and "position, cm" in done.stdout
    text = (tmp_path / "poses.csv").read_text()
    assert text.startswith("time,x,y,heading,sd_x,sd_y,sd_heading\n0.1,")
    assert text.count("\n") == 1201
    assert (tmp_path / "path.png").stat().st_size > 10_000
    again = fntg("localize", "log.csv", "--map", "map.csv", "--out", "again.csv", cwd=tmp_path)
    assert again.returncode == 0 and (tmp_path / "again.csv").read_text() == text


HEADER = "time,kind,name,a,b,c\n"


@pytest.mark.parametrize(
    ("text", "row", "reason"),
    [
        ("", 1, "must be 'time,kind,name,a,b,c'"),
        ("time,x\n", 1, "must be 'time,kind,name,a,b,c'"),
        (HEADER + "0.1,odometry,,0.1,0,0\n0.2,odometry,,0.1,0\n", 3, "5 cells"),
        (HEADER + "0.1,jump,,0.1,0,0\n", 2, "kind = 'jump'"),
        (HEADER + "0.1,odometry,,0.1,x,0\n", 2, "dy = 'x'"),
        (HEADER + "0.1,odometry,,0.1,nan,0\n", 2, "dy = 'nan'"),
        (HEADER + "0.2,odometry,,0.1,0,0\n\n0.1,odometry,,0.1,0,0\n", 4, "not be before 0.2"),
        (HEADER + "0.1,landmark,red/blue,1,0,\n", 2, "name = 'red/blue'"),
        (HEADER + "0.1,landmark,green/pink,-1,0,\n", 2, "distance = -1"),
        (HEADER + "0.1,landmark,green/pink,1,30,\n", 2, "bearing = 30"),
    ],
)
def test_a_bad_log_is_named_with_row_and_reason(tmp_path, text, row, reason):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ValueError) as caught:
        localize.read_log(path, LANDMARKS)
    assert f"{path} row {row}: " in str(caught.value) and reason in str(caught.value)


def test_a_bad_log_leaves_no_poses(fntg, tmp_path):
    (tmp_path / "log.csv").write_text(HEADER + "0.1,odometry,,0.1,x,0\n")
    done = fntg("localize", "log.csv", cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "log.csv row 2: dy = 'x'" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]


@pytest.mark.slow
def test_the_experiment_at_a_tiny_budget(tmp_path, capsys):
    from experiments import localization

    options = localization.Options(out=tmp_path, logs=2, seconds=3.0, cost=2)
    path = localization.run(options)
    assert path.stat().st_size > 20_000 and path.with_suffix(".pdf").exists()
    printed = capsys.readouterr().out
    rows = path.with_suffix(".csv").read_text().splitlines()
    assert rows[0] == "question,level,method,log,value"
    for method in localization.METHODS:
        assert method in printed and any(f',"{method}",' in row for row in rows)
