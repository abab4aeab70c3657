"""`fntg say` and `fntg listen`: recordings as people have them, and files that are none."""

import json
import struct

import numpy as np
import pytest
from scipy import signal
from scipy.io import wavfile

from fntg_jax.commands import cli
from fntg_jax.running import sounds

SAID = [
    "--sender",
    "2",
    "--team",
    "1",
    "--x",
    "-0.8",
    "--y",
    "0.4",
    "--ball-x",
    "1",
    "--ball-y",
    "0",
]


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    path = tmp_path_factory.mktemp("say") / "message.wav"
    cli.main(["say", *SAID, str(path)])
    rate, samples = wavfile.read(path)
    return rate, samples / 32768


def heard(capsys, path):
    capsys.readouterr()
    cli.main(["listen", str(path), "--json"])
    (answer,) = json.loads(capsys.readouterr().out)
    return answer["messages"]


def variants(rate, clean):
    rng = np.random.default_rng(0)
    silence = rng.normal(0, 0.003, 2 * rate)
    long = np.concatenate([silence, clean + rng.normal(0, 0.003, len(clean)), silence])
    yield "silence", rate, long
    for new in (8000, 11025, 22050, 44100, 48000):
        yield f"{new} Hz", new, signal.resample_poly(long, new, rate)
    yield "soft", rate, 0.01 * clean
    yield "clipped", rate, np.clip(5 * clean, -1, 1)
    echo = np.convolve(long, np.r_[1, np.zeros(480), 0.5, np.zeros(500), 0.3])
    yield "echo", rate, echo / 2
    yield "hum", rate, 0.3 * long + 0.5 * np.sin(2 * np.pi * 50 / rate * np.arange(len(long)))
    yield "skew", rate, np.interp(np.arange(0, len(long) - 1, 1.002), np.arange(len(long)), long)
    yield "right ear only", rate, np.stack([rng.normal(0, 0.2, len(long)), long], 1)


def test_recordings(said, tmp_path, capsys):
    rate, clean = said
    for name, new_rate, samples in variants(rate, clean):
        path = tmp_path / "recording.wav"
        wavfile.write(path, new_rate, samples.astype(np.float32))
        messages = heard(capsys, path)
        assert [(m["sender"], m["team"]) for m in messages] == [(2, 1)], name
        assert abs(messages[0]["x"] + 0.8) < 0.014 and messages[0]["confidence"] > 0.99


def test_kinds_of_numbers(said, tmp_path, capsys):
    rate, clean = said
    path = tmp_path / "recording.wav"
    for samples in (
        np.round(clean * 100 + 128).astype(np.uint8),
        np.round(clean * 2**31 * 0.9).astype(np.int32),
        clean.astype(np.float64),
    ):
        wavfile.write(path, rate, samples)
        assert len(heard(capsys, path)) == 1
    data = np.round(clean * 2**23 * 0.9).astype("<i4").view(np.uint8).reshape(-1, 4)[:, :3]
    header = struct.pack("<4sI4s4sIHHIIHH", b"RIFF", 36 + data.size, b"WAVE", b"fmt ", 16, 1, 1,
                         rate, rate * 3, 3, 24)  # fmt: skip
    path.write_bytes(header + struct.pack("<4sI", b"data", data.size) + data.tobytes())
    assert len(heard(capsys, path)) == 1


def test_files_that_are_no_sounds_get_one_line(said, tmp_path, capsys):
    rate, clean = said
    good = tmp_path / "good.wav"
    sounds.write_wav(good, rate, clean)
    bad = tmp_path / "bad.wav"
    nan = clean.astype(np.float32)
    nan[100] = np.nan

    def wav(rate, samples):
        return lambda: wavfile.write(bad, rate, samples)

    for write in (
        lambda: bad.write_bytes(b""),
        lambda: bad.write_bytes(b"no sound at all, but some text"),
        lambda: bad.write_bytes(good.read_bytes()[:30]),
        lambda: bad.write_bytes(good.read_bytes()[:44]),
        lambda: bad.write_bytes(good.read_bytes()[:1000]),
        lambda: bad.write_bytes(good.read_bytes().replace(b"fmt ", b"fmu ")),
        wav(rate, nan),
        wav(4000, clean.astype(np.float32)),
        wav(rate, np.zeros(0, np.int16)),
        lambda: bad.unlink(),
    ):
        write()
        with pytest.raises(SystemExit) as stop:
            cli.main(["listen", str(good), str(bad), "--json"])
        printed = capsys.readouterr()
        assert stop.value.code == 2 and printed.out == ""
        assert str(bad) in printed.err and printed.err.count("\n") == 1


def test_wrong_options_of_say_get_one_line_and_no_file(tmp_path, capsys):
    path = tmp_path / "message.wav"
    for wrong in (["--sender", "7"], ["--x", "3"], ["--x", "nan"], ["--ball-x", "1"]):
        with pytest.raises(SystemExit) as stop:
            cli.main(["say", *wrong, str(path)])
        assert stop.value.code == 2 and capsys.readouterr().err.count("\n") == 1
        assert not path.exists()
