"""One trainer, several tasks: a user's own, with memory, progress, judgement and resume."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import fntg_jax
from envs import kinematic
from fntg_jax.commands import cli
from fntg_jax.controller import genome
from fntg_jax.running import problem, registry, run_folder, runner, settings, xla

GENES = (fntg_jax.Gene("x", "m", 0.0, 2.0), fntg_jax.Gene("y", "m", -1.0, 1.0))


def fitness(key, theta, memory, progress):
    noise = 1e-4 * jax.random.normal(key, (theta.shape[0],))
    cost = jnp.sum((theta - jnp.asarray([1.5, -0.25])) ** 2, axis=1)
    seen = memory["seen"].at[memory["count"]].set(progress)
    return 1 / (0.01 + cost) + noise, {"seen": seen, "count": memory["count"] + 1, "key": key}


def init(key):
    return {"seen": jnp.zeros(6), "count": jnp.zeros((), int), "key": key}


def judge(key, theta, memory):
    del key
    off = jnp.hypot(theta[:, 0] - 1.5, theta[:, 1] + 0.25)
    # Sorted by name, the score is not the first.
    return {"asked": jnp.full(len(theta), memory["count"]), "off": off, "score": -off}


TASK = fntg_jax.Task("valley", GENES, fitness, init, judge, lambda genes: {"it.txt": str(genes)})
OPTIONS = {"seeds": 2, "generations": 6, "ga": {"population": 16, "mutation_rate": 0.05}}


def test_a_task_of_ones_own_learns_in_its_units_and_is_judged():
    learnt = fntg_jax.learn(task=TASK, **OPTIONS)
    assert learnt.controller is None and learnt.history.best.shape == (2, 6)
    assert 0 <= learnt.genes["x"] <= 2 and -1 <= learnt.genes["y"] <= 1
    assert sorted(learnt.judgement) == ["asked", "off", "score"] and learnt.judgement["asked"] == 6
    off = np.hypot(learnt.genes["x"] - 1.5, learnt.genes["y"] + 0.25)
    assert learnt.judgement["off"] == pytest.approx(off, abs=1e-5) and off < 0.5
    assert fntg_jax.train(task=TASK, **OPTIONS) == learnt.genes


def test_progress_runs_from_0_to_1_and_memory_survives_a_resume(tmp_path):
    config = settings.from_dict({**OPTIONS, "task": "valley"})
    whole = runner.complete(runner.Run(problem.resolve(config, TASK)))
    np.testing.assert_allclose(whole.now.population.memory["seen"][0], np.arange(6) / 5, atol=1e-6)
    folder = tmp_path / "run"
    run_folder.create(folder, config)
    part = runner.Run(problem.resolve(config, TASK))
    part.now = part.now._replace(chunk=2)
    part.advance()
    run_folder.save_checkpoint(folder, part)
    again = runner.complete(run_folder.restore(folder, TASK))
    plain = lambda run: [  # noqa: E731
        np.asarray(jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x)
        for x in jax.tree.leaves(run.now.population)
    ]
    for found, expected in zip(plain(again), plain(whole), strict=True):
        np.testing.assert_array_equal(found, expected)
    for found, expected in zip(again.history(), whole.history()):
        np.testing.assert_array_equal(found, expected)


def test_a_task_starts_from_an_earlier_run_or_its_genes(tmp_path):
    fntg_jax.learn(task=TASK, out=tmp_path / "first", **OPTIONS)
    document = json.loads((tmp_path / "first" / "params.json").read_text())
    document["genes"][0]["value"] = 1.75
    (tmp_path / "genes.json").write_text(json.dumps(document))

    def start(source, **more):
        options = {**OPTIONS, "task": "valley", "warm_start": str(tmp_path / source), **more}
        return runner.start(problem.resolve(settings.from_dict(options), TASK))

    def genes(run):
        bits = np.asarray(run.now.population.bits)[:, 0]  # of each seed the first
        return run.problem.in_units(np.asarray(genome.decode(bits, 15, False)))

    last = run_folder.restore(tmp_path / "first", TASK).now.population.bits
    again = start("first")
    np.testing.assert_array_equal(again.now.population.bits, last)
    assert again.generation == 0 and again.origin.startswith("the populations of")
    found = genes(start("genes.json", seeds=3))
    y = document["genes"][1]["value"]
    np.testing.assert_allclose(found, [[1.75, y]] * 3, atol=1e-4)
    # Another population: neighbours of its best.
    x = json.loads((tmp_path / "first" / "params.json").read_text())["genes"][0]["value"]
    found = genes(start("first", ga={"population": 8}))
    np.testing.assert_allclose(found, [[x, y]] * 2, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(task="hill") or d["genes"][0].update(name="z"), "genes are z, y"),
        (lambda d: d["genes"][0].update(unit="kg"), "x is in 'kg'"),
        (lambda d: d["genes"][0].update(value=3.0), "x = 3.0: allowed are 0 to 2"),
        (lambda d: d["genes"][0].update(value="a"), "x = 'a'"),
        (lambda d: d.pop("genes"), "no genes"),
    ],
)
def test_genes_that_do_not_fit_are_refused(change, words, tmp_path):
    genes = [{"name": g.name, "unit": g.unit, "value": 0.5} for g in GENES]
    document = {"format": "fntg-genes", "version": 1, "task": "valley", "genes": genes}
    change(document)
    (tmp_path / "genes.json").write_text(json.dumps(document))
    config = {**OPTIONS, "task": "valley", "warm_start": str(tmp_path / "genes.json")}
    with pytest.raises(ValueError, match="warm_start = ") as refusal:
        runner.start(problem.resolve(settings.from_dict(config), TASK))
    assert words in str(refusal.value) and "\n" not in str(refusal.value)


def test_the_command_learns_a_registered_task(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(xla, "configure", lambda **_: None)
    monkeypatch.setitem(registry._registered[registry.TASKS], "valley", lambda: TASK)
    folder = tmp_path / "run"
    options = ["--generations", "3", "--ga.population", "8", "--out", str(folder)]
    cli.main(["train", "--task", "valley", *options])
    assert "judged: asked" in capsys.readouterr().err
    document = json.loads((folder / "params.json").read_text())
    assert [gene["name"] for gene in document["genes"]] == ["x", "y"]
    assert (folder / "it.txt").exists() and (folder / "fig5.png").exists()
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", "--task", "valley", "--suite", "open", *options[:-1], str(folder) + "2"])
    assert stop.value.code == 2
    assert "suite = 'open': belongs to task bioa" in capsys.readouterr().err


def test_failing_code_of_a_task_is_told_from_ours(monkeypatch, capsys):
    def broken(key, theta, memory, progress):
        first, second = theta.shape[0], *theta  # a mistake of its author
        return first + second, memory

    task = TASK._replace(fitness=broken)
    with pytest.raises(registry.MemberError, match=r"'valley' failed, in .*test_tasks"):
        fntg_jax.train(task=task, **OPTIONS)
    monkeypatch.setattr(xla, "configure", lambda **_: None)
    monkeypatch.setitem(registry._registered[registry.TASKS], "valley", lambda: task)
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", "--task", "valley", "--out", "/dev/null/x"])
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", "--task", "valley", "--generations", "2"])
    told = capsys.readouterr().err
    assert stop.value.code == 1
    assert (
        told.index("the code of task 'valley' failed")
        < told.index("Traceback")
        < told.index("a mistake of its author")
    )


def test_genes_are_checked():
    for genes, words in (
        ((), "has no genes"),
        ((GENES[0], GENES[0]), "'x' is there twice"),
        ((fntg_jax.Gene("z", "", 1.0, 1.0),), "'z' has range 1.0 to 1.0"),
    ):
        with pytest.raises(ValueError, match=words):
            problem.resolve(settings.TrainConfig(), TASK._replace(genes=genes))


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_nan_is_reported_while_it_trains_and_at_the_end(share, tmp_path, monkeypatch, capsys):
    """All of it: nothing was learnt, status 2.  A part: the run ends well, and says how many."""

    def holes(key, theta, memory, progress):
        value, memory = fitness(key, theta, memory, progress)
        return jnp.where(jnp.arange(len(theta)) < share * len(theta), jnp.nan, value), memory

    monkeypatch.setattr(xla, "configure", lambda **_: None)
    make = lambda: TASK._replace(fitness=holes, judge=None)  # noqa: E731
    monkeypatch.setitem(registry._registered[registry.TASKS], "valley", make)
    folder = tmp_path / "run"
    arguments = ["--task", "valley", "--generations", "3", "--ga.population", "8"]
    status = 0
    try:
        cli.main(["train", *arguments, "--out", str(folder)])
    except SystemExit as stop:
        status = stop.code
    words = capsys.readouterr().err
    lost = round(share * 8)
    assert f"  {lost} genomes with NaN or infinite fitness" in words
    if share == 1:
        assert status == 2 and not (folder / "params.json").exists()
        last = words.strip().split("\n")[-1]
        assert last.startswith("fntg: error: task 'valley': no genome") and "--task valley" in last
    else:
        assert status == 0 and f"{3 * lost} of 24 genomes had NaN or infinite fitness" in words


def test_a_world_of_nothing_but_nan_ends_in_one_line(tmp_path, monkeypatch, capsys):
    class Lost:
        def __init__(self):
            self._env = kinematic.make()

        def __getattr__(self, name):
            return getattr(self._env, name)

        def measure(self, state):
            return jax.tree.map(lambda x: x * jnp.nan, self._env.measure(state))

    jax.tree_util.register_static(Lost)
    world = kinematic.world._replace(make=lambda **options: Lost())
    monkeypatch.setattr(xla, "configure", lambda **_: None)
    monkeypatch.setitem(registry._registered[registry.WORLDS], "lost", world)
    options = ["--env", "lost", "--generations", "2", "--ga.population", "8"]
    with pytest.raises(SystemExit) as stop:
        cli.main(["train", *options, "--out", str(tmp_path / "run")])
    assert stop.value.code == 2
    words = capsys.readouterr().err
    assert "8 genomes with NaN or infinite fitness" in words
    assert words.strip().split("\n")[-1].startswith("fntg: error: world 'lost': no genome")
