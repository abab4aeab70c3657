"""Numbers, files and signals that once broke a training: one line, bounded memory, a way on."""

import io
import json
import os
import signal
import subprocess
import sys
import time
import zipfile

import jax
import numpy as np
import pytest

from envs import scenes
from fntg_jax import files
from fntg_jax.commands import cli
from fntg_jax.running import (
    checkpoint,
    config_file,
    problem,
    run_folder,
    runner,
    settings,
    statistics,
    xla,
)
from fntg_jax.running.settings import TrainConfig
from tests.small_run import small_run


@pytest.fixture
def status(monkeypatch, capsys, tmp_path):
    """Run the command in this process: exit status and its words."""
    monkeypatch.setattr(xla, "configure", lambda *args, **kwargs: None)
    monkeypatch.chdir(tmp_path)

    def run(*arguments) -> tuple[int, str]:
        code = 0
        try:
            cli.main([str(a) for a in arguments])
        except SystemExit as stop:
            code = stop.code
        return code, capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    "wrong",
    [
        {"refine_steps": 3 * 10**9},
        {"generations": 10**400},
        {"num_scenes": 10**30},
        {"scene_pool": 2_000_000},
        {"ga": {"population": 10**20}},
        {"ga": {"num_points": 200}},
        {"env_options": {"dt": "x"}},
        {"fitness": {"clearance": 1e300}},
        {"smooth": {"near": 1e-300}},
        {"layout": "x" * 100_000},
    ],
    ids=str,
)
def test_numbers_out_of_range_are_one_short_line(wrong, status, tmp_path):
    config = json.loads((small_run() / "config.json").read_text())
    for name, value in wrong.items():
        config[name] = {**config[name], **value} if isinstance(value, dict) else value
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.json").write_text(json.dumps(config))
    code, words = status("train", "--resume", folder)
    assert (code, words.count("\n")) == (2, 1)
    assert words.startswith("fntg: error: ") and next(iter(wrong)) in words
    assert len(words) < 1100


def test_too_many_seeds_are_refused_before_anything_is_made_for_each(status, tmp_path):
    start = time.monotonic()
    code, words = status("train", "--seeds", 10**9, "--out", tmp_path / "a" / "run")
    assert code == 2 and "GB of memory" in words
    assert time.monotonic() - start < 5
    assert list(tmp_path.iterdir()) == []


def test_scenes_come_in_batches_that_change_nothing(monkeypatch):
    key = jax.random.key(0)
    whole = scenes.open_field(key, 40)
    draw = jax.jit(scenes.open_field, static_argnums=1)
    room = draw.lower(key, 100_000).compile().memory_analysis().temp_size_in_bytes
    assert room < 100e6  # 1.3 GB at once
    jax.clear_caches()
    monkeypatch.setattr(scenes, "_BATCH", 16)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(scenes.open_field(key, 40))):
        np.testing.assert_array_equal(a, b)
    jax.clear_caches()


@pytest.fixture
def folder(tmp_path):
    """A copy of a small run's folder, without its results."""
    copy = tmp_path / "run"
    copy.mkdir()
    for name in ("config.json", "checkpoint.npz"):
        (copy / name).write_bytes((small_run() / name).read_bytes())
    return copy


@pytest.mark.parametrize("name", ["config.json", "checkpoint.npz", "params.json"])
@pytest.mark.parametrize("kind", ["fifo", "device"])
def test_what_has_no_end_is_not_read(name, kind, folder, status):
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name) if kind == "fifo" else (folder / name).symlink_to("/dev/zero")
    command = ("export", folder, "-") if name == "params.json" else ("train", "--resume", folder)
    code, words = status(*command)
    assert code == 2 and name in words and "not a regular file" in words


@pytest.mark.parametrize("command", ["resume", "warm-start"])
def test_an_archive_that_unpacks_to_more_than_a_run_is_not_unpacked(command, folder, status):
    path = folder / "checkpoint.npz"
    data = io.BytesIO()
    np.save(data, np.zeros(0))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("extra.npy", data.getvalue() + bytes(40_000_000))
    words = {"resume": (), "warm-start": ("--seeds", 2, "--ga.population", 8)}[command]
    code, said = status("train", f"--{command}", folder, *words)
    assert code == 2 and "bytes unpacked: allowed are" in said and said.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("generation", lambda x: x.astype(complex)),
        ("generation", lambda x: x + 1),
        ("history_mean", lambda x: x[:, :1]),
        ("seconds", lambda x: x[:1]),
        ("bits", lambda x: x[:, :, :-1]),
    ],
)
def test_a_checkpoint_whose_arrays_disagree_is_refused(name, change):
    run = run_folder.restore(small_run())
    arrays = checkpoint.to_arrays(run)
    checkpoint.from_arrays(run, arrays)
    with pytest.raises(ValueError, match=f"{name}|its state another number"):
        checkpoint.from_arrays(run, {**arrays, name: change(arrays[name])})


def test_no_honest_run_is_larger_than_allowed():
    for config in (
        TrainConfig(generations=1, ga=settings.GAConfig(population=2)),
        settings.PRESETS["robust"],
    ):
        run = runner.Run(problem.resolve(TrainConfig(ga=config.ga, generations=3)))
        size = sum(x.nbytes for x in checkpoint.to_arrays(run).values())
        assert size < checkpoint.most_bytes(run.problem) < 200 * size + 2_000_000


def test_a_folder_killed_while_being_born_can_be_started_again(tmp_path):
    folder, config = tmp_path / "run", TrainConfig(generations=1)
    folder.mkdir()
    (folder / ".config.json.abcd_123").write_text("{")
    assert run_folder.create(folder, config) is None
    assert [p.name for p in folder.iterdir()] == ["config.json"]
    assert config_file.load(folder) == config
    with pytest.raises(ValueError, match="exists already"):
        run_folder.create(folder, config)


def test_stale_temporary_files_of_ours_are_swept(tmp_path):
    for name in (".checkpoint.npz.abcd1234", ".checkpoint.npz.mine", ".other.abcd1234", "a"):
        (tmp_path / name).touch()
    files.sweep(tmp_path, run_folder.FILES)
    left = {".checkpoint.npz.mine", ".other.abcd1234", "a"}
    assert {p.name for p in tmp_path.iterdir()} == left


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: no")])
def test_running_out_of_memory_leaves_no_folder(error, status, monkeypatch, tmp_path):
    def fail(problem):
        raise error

    monkeypatch.setattr(runner, "start", fail)
    code, words = status("train", "--out", tmp_path / "deep" / "run")
    assert code == 2 and words.startswith("fntg: error: out of memory")
    assert list(tmp_path.iterdir()) == []


def test_a_run_whose_fitness_overflows_says_so(status, tmp_path):
    huge = ("--fitness.distance", 1e30, "--fitness.gamma", 1e30, "--fitness.still", 1e30)
    small = ("--generations", 1, "--ga.population", 8)
    code, words = status("train", *huge, *small, "--out", tmp_path / "run")
    assert code == 3 and "overflow" in words.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("refine", "bioa", "--env", "quadruped", "--steps", 1), "take --method cma"),
        (("export", "bioa", "x.json", "--seed", 3), "seed = 3: bioa is no run folder"),
        (("replay", "bioa", "--generations", 1), "only a run folder has them"),
        (("replay", "bioa", "--out", "/nonexistent/x.html"), "/nonexistent is not a folder"),
        (("replay", "bioa", "--out", "x.gif", "--width", 9), "width = 9: allowed are 100 to 1280"),
        (("evaluate", "born"), "born: not finished; continue it: fntg train --resume born"),
        (("report", "born", "--scenes", -4), "scenes = -4: allowed are"),
    ],
    ids=lambda x: str(x[0]),
)
def test_what_cannot_be_is_said_before_any_work(arguments, words, status, tmp_path):
    (tmp_path / "born").mkdir()
    (tmp_path / "born" / "config.json").write_text("{}")
    code, said = status(*arguments)
    assert code == 2 and words in said and said.count("\n") == 1


def test_scripts_say_one_line_too(capsys, monkeypatch):
    from experiments import noise

    monkeypatch.setattr("sys.argv", ["noise.py", "--nonsense", "3"])
    with pytest.raises(SystemExit) as stop:
        noise.main()
    said = capsys.readouterr()
    assert (stop.value.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "nonsense" in said.err and "see experiments/noise.py --help" in said.err


def test_one_failure_of_thousands_is_not_all():
    assert str(statistics.wilson(1999, 2000)).startswith("99.9 %")
    assert str(statistics.wilson(2000, 2000)).startswith("100.0 %")
    assert str(statistics.wilson(1, 9000)).startswith("0.1 %")


# Signals, in processes of their own.

LONG = ("--generations", 1, "--suite", "open", "--num-scenes", 8, "--ga.population", 8)
PHASES = [
    ("tracing and compiling ...", ()),
    ("choosing the controllers", ("--refine-steps", 500_000, "--refine-method", "cma")),
]


@pytest.mark.parametrize(("line", "more"), PHASES, ids=["compiling", "refining"])
def test_a_signal_ends_what_can_be_repeated_at_once(line, more, clean_env, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "fntg_jax.commands.cli", "train"]
        + [str(x) for x in (*LONG, *more, "--out", tmp_path / "run")],
        env=clean_env,
        stderr=subprocess.PIPE,
        text=True,
    )
    for words in process.stderr:
        if words.startswith(line):
            break
    time.sleep(0.3)  # into what follows
    process.send_signal(signal.SIGTERM)
    start = time.monotonic()
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 143
    assert time.monotonic() - start < 5
    assert rest.endswith(f"stopped; continue with: fntg train --resume {tmp_path / 'run'}\n")
    assert "Traceback" not in rest


def test_a_signal_in_the_last_chunk_stops_before_the_refinement(status, monkeypatch, tmp_path):
    advance = runner.Run.advance

    def interrupted(run):
        progress = advance(run)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.2)  # the thread that hears it
        return progress

    monkeypatch.setattr(runner.Run, "advance", interrupted)
    small = ("--generations", 1, "--ga.population", 8, "--refine-steps", 3)
    code, words = status("train", *small, "--out", tmp_path / "run")
    assert code == 143
    assert "stopped after generation 1 of 1; continue with" in words
    assert "choosing" not in words
