"""Memory: predicted before anything runs; too little is an answer in one line."""

import jax
import jax.numpy as jnp
import pytest

from fntg_jax.commands import cli
from fntg_jax.running import memory


def test_prediction_counts_arguments_and_results():
    double = jax.jit(lambda x: 2 * x).lower(jnp.zeros(250_000)).compile()
    assert 2e6 <= memory.check(double) < 4e6
    assert memory.check(double, 3) == 3 * memory.check(double)


def test_too_little_is_refused(monkeypatch):
    double = jax.jit(lambda x: 2 * x).lower(jnp.zeros(250_000)).compile()
    monkeypatch.setattr(memory, "available", lambda: 1_000_000)
    with pytest.raises(ValueError, match=r"about 0\.0 GB .* 0\.0 GB are free: take fewer genomes"):
        memory.check(double)
    monkeypatch.setattr(memory, "available", lambda: None)  # unknown: no refusal
    assert memory.check(double) > 0


def test_available_is_a_plausible_number():
    found = memory.available()
    assert found is None or 0 < found < 2**50


@pytest.mark.parametrize(
    ("own", "folder", "names"),
    [
        ("0::/slurm/job_7/step_0\n", "", ("memory.max", "memory.current")),
        (
            "9:name=systemd:/\n4:cpu,memory:/slurm/job_7/step_0\n",
            "memory",
            ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        ),
    ],
    ids=["v2", "v1"],
)
def test_limits_of_all_groups_above_count(tmp_path, own, folder, names):
    (tmp_path / "own").write_text(own)
    job = tmp_path / folder / "slurm" / "job_7"
    (job / "step_0").mkdir(parents=True)
    for group, values in ((job, ("5000", "2000")), (job / "step_0", ("max", "1000"))):
        for name, value in zip(names, values):
            (group / name).write_text(value + "\n")
    assert memory._group_limits(tmp_path / "own", tmp_path) == [3000]
    assert memory._group_limits(tmp_path / "none", tmp_path) == []


def test_a_population_beyond_memory_is_refused_before_it_is_made(fntg, tmp_path):
    done = fntg("train", "--ga.population", 2 * 10**9, "--out", tmp_path / "run")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "GB of memory" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: no")])
def test_running_out_is_one_line(error, monkeypatch, capsys):
    from fntg_jax.commands import doctor

    def fail(argv):
        raise error

    monkeypatch.setattr(doctor, "main", fail)
    with pytest.raises(SystemExit) as stop:
        cli.main(["doctor"])
    assert stop.value.code == 2
    assert capsys.readouterr().err == (
        "fntg: error: out of memory: take fewer genomes, scenes or seeds\n"
    )
