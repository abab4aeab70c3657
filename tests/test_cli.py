"""The command in real processes: run folders, interruption, bad input."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.learning.fitness import success

SMALL = ("--seeds", 2, "--generations", 6, "--ga.population", 8, "--first-seed", 5)


@pytest.fixture(scope="module")
def finished(fntg, tmp_path_factory):
    """A tiny complete run: (process, folder)."""
    folder = tmp_path_factory.mktemp("runs") / "small"
    return fntg("train", *SMALL, "--out", folder), folder


def arrays(path):
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def test_stdout_is_the_folder_and_stderr_tells_what_happens(finished):
    done, folder = finished
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{folder}\n"
    assert "compiling took" in done.stderr
    assert "generation 6/6" in done.stderr
    assert "Traceback" not in done.stderr
    assert str(folder / "params.json") in done.stderr


def test_run_folder_is_complete_and_agrees_with_itself(finished):
    _, folder = finished
    names = {p.name for p in folder.iterdir()}
    assert names == {
        "config.json",
        "metrics.csv",
        "history.npz",
        "params.json",
        "provenance.json",
        "checkpoint.npz",
        "fig5.png",
        "fig5.pdf",
    }
    config = json.loads((folder / "config.json").read_text())
    assert (config["seeds"], config["generations"], config["first_seed"]) == (2, 6, 5)
    assert config["ga"]["population"] == 8
    assert config["layout"] == "paper-31"
    history = arrays(folder / "history.npz")
    assert history["best"].shape == history["mean"].shape == (2, 6)
    assert history["best_theta"].shape == (2, 6, 31)
    assert (history["best"] >= history["mean"]).all()
    assert (np.diff(history["best"]) >= 0).all()  # an elite on fixed scenes
    table = np.genfromtxt(folder / "metrics.csv", delimiter=",", names=True)
    assert table["seed"].tolist() == [5] * 6 + [6] * 6
    assert table["generation"].tolist() == [*range(1, 7)] * 2
    for name in ("best", "mean", "num_nonfinite"):
        np.testing.assert_allclose(table[name], history[name].ravel(), rtol=1e-7)
    controller = export.load(folder / "params.json")
    champion = int(history["best"].max(1).argmax())
    first = history["best"][champion].argmax()
    np.testing.assert_array_equal(controller.theta, history["best_theta"][champion, first])
    assert controller.provenance["seed"] == 5 + champion
    assert controller.provenance["fitness"] == pytest.approx(history["best"].max())
    environment = json.loads((folder / "provenance.json").read_text())
    assert {"jax", "numpy", "python"} <= set(environment["versions"])
    assert environment["compile_seconds"] > 0
    assert environment["run_seconds"] > 0
    assert environment["control_steps"] == 2 * 6 * 8 * 4 * 220
    assert (folder / "fig5.png").read_bytes()[:4] == b"\x89PNG"
    assert (folder / "fig5.pdf").read_bytes()[:4] == b"%PDF"


@pytest.fixture
def here(capsys, monkeypatch):
    """Run the command in this process, which costs no start: its stdout."""
    from fntg_jax.commands import cli
    from fntg_jax.running import xla

    # The flags of XLA are for a process of its own.
    monkeypatch.setattr(xla, "configure", lambda *args, **kwargs: None)

    def run(*arguments) -> str:
        cli.main([str(a) for a in arguments])
        return capsys.readouterr().out

    return run


def test_export_writes_the_controller(finished, here, tmp_path):
    _, folder = finished
    assert here("export", folder, "-") == (folder / "params.json").read_text()
    assert here("export", folder, tmp_path / "one.json", "--seed", 6) == ""
    assert export.load(tmp_path / "one.json").provenance["seed"] == 6


def test_evaluate_reports_parts_with_intervals(finished, here):
    _, folder = finished
    out = here("evaluate", folder, "--suite", "open", "--scenes", 1000, "--json")
    report = json.loads(out)
    assert list(report) == ["open"]
    assert report["open"]["scenes"] == 1000
    rates = {k: v for k, v in report["open"].items() if k != "scenes"}
    assert set(rates) == {"reach", "safe", "stop", "success"}
    for rate in rates.values():
        assert 0 <= rate["low"] <= rate["share"] <= rate["high"] <= 1
        assert rate["share"] * 1000 == pytest.approx(round(rate["share"] * 1000))
    assert rates["success"]["share"] <= min(rates[p]["share"] for p in ("reach", "safe", "stop"))


# Interruption.  Evolution of some seconds in chunks of ten generations, so that there is a middle.

LONG = ("--seeds", 1, "--generations", 2000, "--ga.population", 8)


@pytest.fixture(scope="module")
def uninterrupted(fntg, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "long"
    done = fntg("train", *LONG, "--out", folder)
    assert done.returncode == 0, done.stderr
    return folder


# The command with a checkpoint after every chunk, not every other second, so that a short run
# has one when it is killed.
EAGER = """
import sys
from fntg_jax.commands import cli
from fntg_jax.commands import train
train._CHECKPOINT_SECONDS = 0.0
cli.main(sys.argv[1:])
"""


def stopped(clean_env, folder, number) -> tuple[int, str, str]:
    """Start the run, send it a signal once evolution is under way."""
    process = subprocess.Popen(
        [sys.executable, "-c", EAGER, *map(str, ("train", *LONG, "--out", folder))],
        env=clean_env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    seen = []
    for line in process.stderr:
        seen.append(line)
        if line.startswith("generation "):
            process.send_signal(number)
            break
    out, rest = process.communicate()
    return process.returncode, out, "".join(seen) + rest


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGKILL, -9),
        (signal.SIGTERM, 143),
        pytest.param(signal.SIGINT, 130, marks=pytest.mark.slow),  # as SIGTERM
    ],
    ids=["kill", "terminate", "interrupt"],
)
def test_a_stopped_run_resumes_to_the_same_bits(
    number, status, uninterrupted, clean_env, fntg, tmp_path
):
    folder = tmp_path / "run"
    code, out, words = stopped(clean_env, folder, number)
    assert (code, out) == (status, "")
    assert "Traceback" not in words
    assert not (folder / "params.json").exists()
    generation = int(arrays(folder / "checkpoint.npz")["generation"][0])
    assert 0 < generation < 2000
    if number != signal.SIGKILL:
        assert words.rstrip().endswith(f"continue with: fntg train --resume {folder}")
        assert f"after generation {generation} of 2000" in words
    again = fntg("train", "--resume", folder)
    assert again.returncode == 0, again.stderr
    assert f"continuing after generation {generation}\n" in again.stderr
    assert again.stdout == f"{folder}\n"
    found, expected = (arrays(f / "history.npz") for f in (folder, uninterrupted))
    assert found.keys() == expected.keys()
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    read = [json.loads((f / "params.json").read_text()) for f in (folder, uninterrupted)]
    assert read[0] == read[1]


# Bad input: in-process where the parser and the checks are what matters, since a process costs
# seconds; that the status and the single line reach the shell is shown by real processes.


@pytest.fixture
def refused(capsys, tmp_path, monkeypatch):
    """Run the command in this process; the one line it says on refusing."""
    from fntg_jax.commands import cli
    from fntg_jax.running import xla

    monkeypatch.chdir(tmp_path)
    # The flags of XLA are for a process of its own.
    monkeypatch.setattr(xla, "configure", lambda *args, **kwargs: None)

    def run(*arguments) -> str:
        before = sorted(tmp_path.rglob("*"))
        with pytest.raises(SystemExit) as stop:
            cli.main([str(a) for a in arguments])
        told = capsys.readouterr()
        assert stop.value.code == 2
        assert told.out == ""
        assert told.err.count("\n") == 1
        assert told.err.startswith("fntg: error: ")
        assert sorted(tmp_path.rglob("*")) == before  # nothing written
        return told.err

    return run


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("--layout", "paper-32"), ("layout", "paper-32", "paper-31")),
        (("--ga.population", -60), ("population", "-60")),
        (("--ga.population", 7), ("population", "7", "even")),
        (("--ga.num-elites", -1), ("num_elites", "-1")),
        (("--ga.num-elites", 60), ("num_elites", "60", "59")),
        (("--ga.num-elites", 1.5), ("1.5",)),
        (("--ga.mutation-rate", 2), ("mutation_rate", "2")),
        (("--ga.selection", "lottery"), ("lottery", "roulette")),
        (("--generations", 0), ("generations", "0")),
        (("--seeds", -1), ("seeds", "-1")),
        (("--first-seed", 2**32), ("first_seed", "4294967296")),
        (("--num-scenes", 0), ("num_scenes", "0")),
        (("--scene-pool", 3 * 10**9), ("scene_pool", "1000000")),
        (("--suite", "open:1e308,blocked:1"), ("share of suite open", "1e+308", "1e6")),
        (("--output", "tanh"), ("tanh", "scale", "clip")),
        (("--suite", "moon"), ("moon", "open")),
        (("--env", "moon"), ("moon", "kinematic")),
        (("--env-options", "dt", 0), ("dt", "0.001")),
        (("--env-options", "gravity", 9.81), ("gravity", "latency")),
        (("--env", "quadruped", "--env-options", "impl", 1), ("'impl'", "v_min")),
        (("--fitness.gamma", 0), ("gamma",)),
        (("--preset", "moon"), ("moon", "paper")),
        (("--colour", "red"), ("colour",)),
        (("--resume", "nowhere"), ("nowhere", "run folder")),
        (("--resume", "nowhere", "--seeds", 3), ("--resume",)),
        (("--resume=nowhere", "--seeds=3"), ("--resume", "no other option")),
    ],
    ids=lambda x: " ".join(map(str, x)),
)
def test_bad_training_options_are_refused(refused, arguments, names):
    message = refused("train", *arguments)
    assert all(name in message for name in names), message


def test_bad_paths_and_files_are_refused(refused, finished, tmp_path):
    _, folder = finished
    (tmp_path / "file").write_text("x")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thing").write_text("x")
    bad = tmp_path / "bad.json"
    document = json.loads((folder / "params.json").read_text())
    document["parameters"]["V"][0][0][0][0] += 0.5
    bad.write_text(json.dumps(document))
    assert "exists already" in refused("train", "--out", tmp_path / "full")
    assert str(tmp_path / "file") in refused("train", "--out", tmp_path / "file" / "run")
    assert "not a run folder" in refused("train", "--resume", tmp_path / "full")
    for command in (("evaluate", bad), ("export", bad, "-")):
        assert "parameters.V" in refused(*command) or "bits" in refused(*command)
    assert "No such file" in refused("evaluate", tmp_path / "none.json")
    assert "file" in refused("export", folder, tmp_path / "file" / "x.json")
    assert "seed = 7" in refused("export", folder, tmp_path / "x.json", "--seed", 7)
    assert "moon" in refused("evaluate", folder, "--suite", "moon")
    assert "scenes = 0" in refused("evaluate", folder, "--scenes", 0)
    assert "scenes = 3000000000" in refused("evaluate", folder, "--scenes", 3 * 10**9)
    assert "'fly'" in refused("fly")


@pytest.mark.parametrize("name", ["config.json", "checkpoint.npz"])
def test_damaged_run_folders_are_refused(refused, finished, tmp_path, name):
    _, folder = finished
    copy = tmp_path / "copy"
    copy.mkdir()
    for file in ("config.json", "checkpoint.npz"):
        (copy / file).write_bytes((folder / file).read_bytes())
    whole = (copy / name).read_bytes()
    for damage in (b"", whole[: len(whole) // 2], b"[" * 100_000, b"[]", b"null"):
        (copy / name).write_bytes(damage)
        assert name in refused("train", "--resume", copy)
    if name == "config.json":
        config = json.loads(whole)
        (copy / name).write_text(json.dumps({**config, "generations": 12}))
        assert "another configuration" in refused("train", "--resume", copy)
        (copy / name).write_text(json.dumps({**config, "seeds": "2"}))
        assert "seeds" in refused("train", "--resume", copy)


def test_refusal_reaches_the_shell(fntg, tmp_path):
    done = fntg("train", "--ga.population", "-60", "--out", tmp_path / "run")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "population" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_success_of_a_suite_is_counted_per_scene(finished):
    """`evaluate` in the library: shares are means over its own outcome."""
    from fntg_jax.running import evaluation, registry

    _, folder = finished
    controller, world = export.load(folder / "params.json"), registry.get_world("kinematic")
    found = evaluation.evaluate(controller, world, "paper", 4)
    parts = success(found.outcome)
    for name in evaluation.PARTS:
        assert found.rates[name].share == np.mean(getattr(parts, name))


def test_a_full_disk_under_stdout_is_one_line(monkeypatch, capsys):
    from fntg_jax.commands import doctor

    monkeypatch.setattr(doctor, "main", lambda argv: print("found"))
    with open("/dev/full", "w") as full:
        monkeypatch.setattr("sys.stdout", full)
        with pytest.raises(SystemExit) as stop:
            cli.main(["doctor"])
    assert stop.value.code == 2
    assert capsys.readouterr().err == "fntg: error: output: No space left on device\n"


def test_a_lost_reader_of_words_stops_nothing(monkeypatch):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as nobody:
        monkeypatch.setattr("sys.stderr", nobody)
        cli.say("still here")
        monkeypatch.undo()
        with contextlib.suppress(OSError):
            nobody.close()
