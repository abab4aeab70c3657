"""`fntg see`: landmarks in pictures drawn here by projecting corners, in photographs where they
are at hand, and none in what is no picture."""

import csv
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fntg_jax.commands import cli
from fntg_jax.robot import colours, poles

PHOTOS = Path(os.environ.get("FNTG_PHOTOS", Path(__file__).parents[2] / ".." / "shared/photos"))
FOCAL, HEIGHT = 617.0, 0.41
PAINT = {
    "pink": (150, 75, 105),
    "yellow": (170, 155, 60),
    "skyblue": (45, 95, 125),
    "green": (50, 120, 70),
}


def photograph(landmarks, pitch, light=(1.0, 1.0, 1.0), seed=0):
    """A grey room, a green floor and poles (lower, upper, distance, bearing), 480 x 640."""
    rng = np.random.default_rng(seed)
    picture = np.empty((480, 640, 3))
    horizon = 240 - FOCAL * math.tan(pitch)
    rows = np.arange(480)[:, None, None]
    wall = np.repeat(rng.uniform(90, 180, (1, 40, 1)), 16, 1)
    picture[:] = np.where(rows < horizon + 25, wall, np.array([90.0, 130.0, 40.0]))

    def project(x, y, z):
        ahead = x * math.cos(pitch) - (z - HEIGHT) * math.sin(pitch)
        up = x * math.sin(pitch) + (z - HEIGHT) * math.cos(pitch)
        return 320 - FOCAL * y / ahead, 240 - FOCAL * up / ahead

    for lower, upper, distance, bearing in landmarks:
        x, y = distance * math.cos(bearing), distance * math.sin(bearing)
        parts = ((0.0, 0.18, None), (0.18, 0.285, lower), (0.285, 0.39, upper))
        for low, high, paint in parts:
            across = 0.05 * FOCAL / x
            column, bottom = project(x, y, low)
            _, top = project(x, y, high)
            area = np.clip(np.arange(640) + 0.5 - column + across + 0.5, 0, 1)
            area = np.minimum(area, np.clip(column + across - np.arange(640), 0, 1))[None]
            area = area * np.clip(np.arange(480) + 1 - top, 0, 1)[:, None]
            area = (area * np.clip(bottom - np.arange(480), 0, 1)[:, None])[..., None]
            colour = np.array(PAINT[paint] if paint else (190.0, 185.0, 175.0))
            picture = picture * (1 - area) + colour * area
    picture = picture * np.array(light) + rng.normal(0, 4, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


def write(path, picture):
    Image.fromarray(picture).save(path)
    return str(path)


def see(capsys, *argv):
    cli.main(["see", *argv, "--json"])
    return json.loads(capsys.readouterr().out)


def test_every_landmark_is_found_where_it_stands(tmp_path, capsys):
    cases = [
        ([("pink", "yellow", 7.5, 0.2), ("green", "pink", 4.0, -0.3)], 0.10, (1, 1, 1)),
        ([("yellow", "pink", 2.2, -0.1), ("pink", "skyblue", 8.0, 0.35)], -0.05, (0.6, 0.7, 0.7)),
        ([("skyblue", "pink", 5.0, 0.0), ("pink", "green", 3.0, 0.25)], 0.15, (1.2, 1.1, 0.9)),
        ([], 0.05, (1, 1, 1)),
    ]
    files, pitches = [], []
    for n, (landmarks, pitch, light) in enumerate(cases):
        files.append(write(tmp_path / f"{n}.png", photograph(landmarks, pitch, light, n)))
        pitches += ["--pitch", str(math.degrees(pitch))]
    out = see(capsys, *files, "--focal", "617", "--height", "0.41", *pitches)
    assert [row["image"] for row in out] == files
    for row, (landmarks, _, _) in zip(out, cases, strict=True):
        seen = {(o["lower"], o["upper"]): o for o in row["objects"]}
        assert set(seen) == {(lower, upper) for lower, upper, _, _ in landmarks}
        for lower, upper, distance, bearing in landmarks:
            found = seen[lower, upper]
            assert found["kind"] == "landmark" and found["name"] == f"{lower}/{upper}"
            assert found["distance"] == pytest.approx(distance, rel=0.08)
            assert found["bearing"] == pytest.approx(bearing, abs=math.radians(0.2))
            x0, y0, x1, y1 = found["box"]
            assert x1 - x0 == pytest.approx((y1 - y0) * 0.10 / 0.21, rel=1e-2)
            assert poles.FOUND <= found["confidence"] <= 1


def test_the_size_of_landmarks_is_an_argument(tmp_path, capsys):
    file = write(tmp_path / "a.png", photograph([("pink", "yellow", 6.0, 0.1)], 0.1))
    camera = ["--focal", "617", "--pitch", str(math.degrees(0.1))]
    twice = ["--height", "0.82", "--band", "0.21", "--thickness", "0.2", "--foot", "0.36"]
    (row,) = see(capsys, file, *camera, *twice)
    assert row["objects"][0]["distance"] == pytest.approx(12.0, rel=0.08)


def test_a_landmark_in_the_air_is_none(tmp_path, capsys):
    file = write(tmp_path / "a.png", photograph([("pink", "yellow", 6.0, 0.1)], 0.1))
    (row,) = see(capsys, file, "--focal", "617", "--height", "0.41", "--pitch", "-2")
    assert row["objects"] == []


def test_drawing(tmp_path, capsys):
    picture = photograph([("pink", "yellow", 6.0, 0.1)], 0.1)
    files = [write(tmp_path / f"{n}.png", picture) for n in range(2)]
    out = tmp_path / "out.png"
    cli.main(["see", *files, "--focal", "617", "--height", "0.41", "--pitch", "5.7"])
    words = capsys.readouterr().out
    assert "a.png" not in words and words.count("pink/yellow") == 2
    see(capsys, *files, "--focal=617", "--height=0.41", "--pitch=5.7", "--draw", str(out))
    drawn = np.asarray(Image.open(out))
    assert drawn.shape == (960, 640, 3)
    assert 100 < (drawn[:480] != picture).any(-1).sum() < 0.05 * picture[..., 0].size


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--pitch", "nan"], "pitch = nan: allowed are -60 to 60"),
        (["--pitch", "1", "--pitch", "2"], "pitch: given 2 times"),
        ([], "pitch: given 0 times"),
        (["--pitch", "1", "--height", "-1"], "height = -1.0: allowed"),
        (["--pitch", "1", "--colors", "mars"], "colors 'mars': allowed are"),
        (["--pitch", "1", "--draw", "no/such/folder.png"], "draw = no/such/folder.png"),
        (["--pitch", "1", "--picture"], "--picture"),
    ],
)
def test_wrong_options_get_one_line(tmp_path, capsys, change, words):
    file = write(tmp_path / "a.png", np.zeros((120, 160, 3), np.uint8))
    refused(capsys, [file, "--focal", "617", "--height", "0.41", *change], words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no picture that can be read"),
        (b"\xff\xd8\xff\xe0 no jpeg", "no picture that can be read"),
        (None, "No such file"),
    ],
)
def test_what_is_no_picture_gets_one_line(tmp_path, capsys, content, words):
    good = write(tmp_path / "good.png", np.zeros((120, 160, 3), np.uint8))
    file = tmp_path / "bad.jpg"
    if content is not None:
        file.write_bytes(content)
    argv = [good, str(file), "--focal", "617", "--height", "0.41", "--pitch", "1"]
    refused(capsys, argv, f"bad.jpg: {words}")


def refused(capsys, argv, words):
    with pytest.raises(SystemExit) as stop:
        cli.main(["see", *argv])
    out, err = capsys.readouterr()
    assert stop.value.code == 2 and out == "" and err.count("\n") == 1 and words in err
    return err


def test_a_table_that_is_none_gets_one_line(tmp_path):
    file = tmp_path / "table.npz"
    for content in (b"", b"PK\x03\x04"):
        file.write_bytes(content)
        with pytest.raises(ValueError, match="no colour table"):
            colours.load(str(file))
    np.savez(file, label=np.zeros(5, np.uint8), confidence=np.zeros(5, np.uint8))
    with pytest.raises(ValueError, match=r"allowed is uint8\[32768\]"):
        colours.load(str(file))


@pytest.mark.skipif(not (PHOTOS / "labels.csv").is_file(), reason=f"no photographs in {PHOTOS}")
def test_photographs():
    with open(PHOTOS / "poses.csv") as file:
        poses = {row["image"]: row for row in csv.DictReader(file)}
    with open(PHOTOS / "labels.csv") as file:
        labels = [row for row in csv.DictReader(file) if row["kind"] == "landmark"]
    table = colours.load("nao")
    names = {"magenta": "pink", "blue": "skyblue", "yellow": "yellow", "green": "green"}
    missed, false = 0, 0
    for name, pose in poses.items():
        picture = np.asarray(Image.open(PHOTOS / name).convert("RGB"))
        pitch = math.radians(float(pose["cam_pitch_down_deg"]))
        found = poles.find(picture, pitch, table, poles.View(617, 0.41))
        true = {(names[r["lower"]], names[r["upper"]]): r for r in labels if r["image"] == name}
        for k in np.flatnonzero(found.score >= poles.FOUND):
            lower, upper = (colours.CLASSES[c] for c in poles.IDENTITIES[found.identity[k]])
            row = true.pop((lower, upper), None)
            if row is None:
                false += 1
                continue
            assert found.distance[k] == pytest.approx(float(row["dist_cam_m"]), rel=0.15)
            bearing = math.radians(float(row["bearing_body_deg"])) - float(pose["head_yaw"])
            assert found.bearing[k] == pytest.approx(bearing, abs=math.radians(1))
        missed += len(true)
    assert (missed, false) == (0, 0)
