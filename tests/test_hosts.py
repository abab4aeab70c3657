"""Several processes, over loopback: what they learn is what one learns, and none is left behind."""

import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from fntg_jax.running import parallel

LONG = ("--seeds", "3", "--generations", "4000", "--ga.population", "8")
EAGER = """
import sys
from fntg_jax.commands import cli
from fntg_jax.commands import train
train._CHECKPOINT_SECONDS = 0.0
cli.main(sys.argv[1:])
"""


def start(clean_env, *arguments):
    """Two processes of `fntg train`, this port theirs alone."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    meet = ("--distributed", "--coordinator", f"127.0.0.1:{port}", "--num-processes", "2")
    return [
        subprocess.Popen(
            [sys.executable, "-c", EAGER, "train", *meet, "--process-id", str(n), *arguments],
            env=clean_env,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for n in (0, 1)
    ]


def history(folder):
    with np.load(folder / "history.npz") as file:
        return {name: file[name] for name in file}


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0, 1])
def test_two_processes_learn_what_one_learns_even_when_one_is_lost(lost, clean_env, fntg, tmp_path):
    folder, alone = tmp_path / "two", tmp_path / "one"
    pair = start(clean_env, *LONG, "--out", str(folder))
    while not (folder / "checkpoint.npz").exists():
        assert all(p.poll() is None for p in pair), pair[0].communicate()
        time.sleep(0.05)
    assert not (folder / "params.json").exists()
    pair[lost].send_signal(signal.SIGKILL)
    began = time.monotonic()
    out, words = pair[1 - lost].communicate(timeout=60)
    assert time.monotonic() - began < 60
    assert pair[1 - lost].returncode in (1, -signal.SIGABRT) and out == ""
    pair[lost].communicate()
    last = words.strip().split("\n")[-1]
    assert last.startswith("fntg: error: another process was lost") and "Traceback" not in words
    assert last.endswith(f"continue with: fntg train --resume {folder}")
    # On, with one process and other devices than before.
    assert fntg("train", "--resume", folder).returncode == 0
    assert fntg("train", *LONG, "--out", alone, XLA_FLAGS=ONE_DEVICE).returncode == 0
    found, expected = history(folder), history(alone)
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    assert (folder / "params.json").read_text() == (alone / "params.json").read_text()


ONE_DEVICE = "--xla_force_host_platform_device_count=1"


@pytest.mark.slow
def test_two_processes_finish_one_folder_and_stop_together(clean_env, fntg, tmp_path):
    folder = tmp_path / "two"
    pair = start(clean_env, *LONG, "--out", str(folder))
    while not (folder / "checkpoint.npz").exists():
        time.sleep(0.05)
    pair[1].send_signal(signal.SIGTERM)
    ended = [p.communicate(timeout=60) for p in pair]
    assert [p.returncode for p in pair] == [143, 143], ended
    pair = start(clean_env, "--resume", str(folder))
    ended = [p.communicate() for p in pair]
    assert [p.returncode for p in pair] == [0, 0], ended
    assert [out for out, _ in ended] == [f"{folder}\n", ""]
    # A refusal of the first is the refusal of all.
    pair = start(clean_env, *LONG, "--out", str(folder))
    for process in pair:
        out, words = process.communicate()
        assert (process.returncode, out) == (2, "")
        assert words.strip().split("\n")[-1].endswith("choose a new folder, or --resume it")


@pytest.mark.slow
def test_two_processes_start_from_an_earlier_run(clean_env, fntg, tmp_path):
    """Three seeds, so that devices are filled up with rows that no file may hold."""
    source, folder, alone = (tmp_path / name for name in ("source", "two", "one"))
    small = ("--seeds", "3", "--ga.population", "8", "--generations")
    assert fntg("train", *small, "4", "--out", source).returncode == 0
    warm = (*small, "30", "--warm-start", str(source))
    done = fntg("train", *warm, "--out", alone, XLA_FLAGS=ONE_DEVICE)
    assert done.returncode == 0, done.stderr
    assert f"starting from the populations of {source}\n" in done.stderr
    ended = [p.communicate(timeout=120) for p in start(clean_env, *warm, "--out", str(folder))]
    assert ended[0][0] == f"{folder}\n", ended
    assert (folder / "metrics.csv").read_text() == (alone / "metrics.csv").read_text()
    assert (folder / "params.json").read_text() == (alone / "params.json").read_text()
    pair = start(clean_env, *small, "30", "--warm-start", "nowhere", "--out", str(tmp_path / "new"))
    for process in pair:
        out, words = process.communicate(timeout=120)
        assert (process.returncode, out) == (2, "")
        assert words.strip().split("\n")[-1].startswith("fntg: error: warm_start = nowhere: ")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--coordinator", "host:1"), "only with --distributed"),
        (("--distributed", "--coordinator", "host"), "HOST:PORT"),
        (("--distributed",), "--coordinator HOST:PORT"),
    ],
)
def test_bad_meetings_are_refused(arguments, words, fntg, tmp_path):
    done = fntg("train", *arguments, "--out", tmp_path / "run")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("fntg: error: ") and done.stderr.count("\n") == 1
    assert words in done.stderr and not (tmp_path / "run").exists()


def test_processes_without_work_are_refused(monkeypatch):
    monkeypatch.setattr(parallel.jax, "process_count", lambda: 2)
    with pytest.raises(ValueError, match="seeds = 1: too few for 2 processes"):
        parallel.make_mesh(1, 1)


@pytest.mark.slow
def test_two_processes_share_the_matches_of_one_seed(clean_env, fntg, tmp_path):
    """Task team: blocks of matches of one generation, half of them on either process."""
    folder, alone = tmp_path / "two", tmp_path / "one"
    tiny = ("--preset", "team", "--generations", "2", "--ga.population", "32")
    tiny += ("--task-options", "seconds", "1", "players", "1")
    env = {**clean_env, "XLA_FLAGS": ONE_DEVICE}
    ended = [p.communicate(timeout=500) for p in start(env, *tiny, "--out", str(folder))]
    assert ended[0][0] == f"{folder}\n", ended
    done = fntg("train", *tiny, "--out", alone, XLA_FLAGS=ONE_DEVICE)
    assert done.returncode == 0, done.stderr
    assert (folder / "metrics.csv").read_text() == (alone / "metrics.csv").read_text()
    assert (folder / "team.json").read_text() == (alone / "team.json").read_text()
