"""Task `team`: who plays whom on which seeds, what a match is worth, and a run to the end."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.robot.genes import GENES
from fntg_jax.running import matches, team_task
from fntg_jax.teams import team_file


def test_worth_by_hand():
    worth = team_task.value_of(jnp.asarray([[1, 1], [3, 1], [0, 4]]))
    np.testing.assert_allclose(worth[0], [0.5, 0.5])
    np.testing.assert_allclose(worth[1], [1 / (1 + np.exp(-2.8)), 1 / (1 + np.exp(2.8))], rtol=1e-6)
    np.testing.assert_allclose(worth.sum(1), 1, rtol=1e-6)
    # The ball always in the opponents' goal and all possession; nothing of both.
    dense = team_task.dense_of(
        jnp.asarray([[10, 0], [0, 0], [3, 1]]), jnp.asarray([14.0, -14.0, 0.0]), 10, 1.4
    )
    np.testing.assert_allclose(dense, [[1, 0], [0.25, 0.75], [0.625, 0.375]], rtol=1e-6)


class Statistics:
    def __init__(self, goals):
        self.goals, self.possession = goals, jnp.zeros_like(goals)


@pytest.fixture
def ladder(monkeypatch):
    """Matches won by whoever has the larger first gene; the seeds and pairings that were asked."""
    asked = {}

    def played(rules, home, kinds, theirs, seeds):
        asked.update(home=home, kinds=kinds, theirs=theirs, seeds=seeds)
        goals = jnp.stack([home[:, 0] > theirs[:, 0], home[:, 0] < theirs[:, 0]], 1)
        return Statistics(goals.astype(jnp.int32)), jnp.zeros((len(seeds), 1))

    monkeypatch.setattr(team_task, "_played", played)
    return asked


def population(task, size):
    low, high = (np.array([getattr(g, n) for g in task.genes]) for n in ("low", "high"))
    return jnp.asarray(np.linspace(low, high, size)[np.random.default_rng(0).permutation(size)])


def test_generation(ladder):
    task = team_task.task(shipped=4, hall=2, rivals=4, size=3)
    theta = population(task, 6)
    memory = task.init(jax.random.key(0))
    fitness, (hall, count) = task.fitness(jax.random.key(1), theta, memory, 1.0)
    # Who is better gets more, also for the matches that it is asked to as a rival.
    assert (np.diff(np.asarray(fitness)[np.argsort(theta[:, 0])]) >= 0).all()
    assert fitness.max() > 0.7 and fitness.min() < 0.3
    assert count == 1
    best = int(jnp.argmax(theta[:, 0]))
    np.testing.assert_array_equal(hall[0], theta[best])
    np.testing.assert_array_equal(hall[1:], memory[0][1:])
    # All genomes on the same seeds, each of them with both kick-offs, none of them held out.
    seeds = np.asarray(ladder["seeds"]).reshape(10, 6)
    assert (seeds == seeds[:, :1]).all() and (seeds[::2] + 1 == seeds[1::2]).all()
    assert (seeds[::2] % 2 == 0).all() and seeds.max() < 2**30
    kinds = np.asarray(ladder["kinds"]).reshape(10, 6)[:, 0]
    assert kinds.tolist() == [0, 0, 1, 1, 0, 0, 0, 0, 0, 0]
    theirs, own = np.asarray(ladder["theirs"]).reshape(10, 6, -1), np.asarray(theta)
    for slot in range(6, 10):
        assert sorted(map(tuple, theirs[slot])) == sorted(map(tuple, own))
        assert (theirs[slot] != own).any(axis=1).all()  # nobody plays itself
    # As many to an average genome as to the field: relative fitness.
    again, _ = task.fitness(jax.random.key(1), theta, memory, 1.0)
    np.testing.assert_array_equal(again, fitness)
    early, _ = task.fitness(jax.random.key(1), theta, memory, 0.0)
    np.testing.assert_allclose(early, 0.5 * fitness + 0.25, rtol=1e-5)  # dense is 0.5 here


def test_judgement(ladder):
    task = team_task.task()
    theta = population(task, 6)
    judged = task.judge(jax.random.key(1), theta, task.init(jax.random.key(0)))
    assert np.asarray(ladder["seeds"]).min() >= 2**30
    by_hand = task.init(jax.random.key(0))[0][0, 0]
    np.testing.assert_array_equal(judged["score"], np.where(theta[:, 0] > by_hand, 1, 0))
    assert set(judged) > {"against_cerberus", "against_chaser", "goals"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": 1}, "'speed': known are seconds"),
        ({"shipped": 3}, "shipped = 3: allowed are even numbers 0 to 64"),
        ({"bioa": 0.5}, "bioa = 0.5: allowed are whole numbers"),
        ({"shipped": 0, "hall": 0, "rivals": 0}, "nobody plays"),
    ],
)
def test_refused(options, words):
    with pytest.raises(ValueError, match=words):
        team_task.task(**options)


def test_bioa_may_evolve_and_the_file_plays(tmp_path):
    task = team_task.task(bioa=1)
    assert len(task.genes) == len(GENES) + 31
    values = {g.name: float(np.float32(0.5 * (g.low + g.high))) for g in task.genes}
    (tmp_path / "team.json").write_text(task.files(values)["team.json"])
    read = team_file.load(tmp_path / "team.json")
    assert read.genes._asdict() == {g.name: values[g.name] for g in GENES}
    np.testing.assert_array_equal(read.bioa.theta, np.zeros(31))
    matches.get_team(str(tmp_path / "team.json"), matches.get_match("soccer"), 0)


@pytest.mark.slow
def test_a_run_to_the_end_and_on_from_a_checkpoint(fntg, tmp_path):
    options = ("--preset", "team", "--ga.population", "4", "--generations", "3")
    options += ("--refine-steps", "1", "--task-options", "seconds", "2", "players", "1")
    done = fntg("train", *options, "--out", tmp_path / "a")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a" / "fig5.png").exists()
    history = np.load(tmp_path / "a" / "history.npz")
    assert history["strength"].shape == (1, 3) and history["refined"].shape == (1, 2)
    team = json.loads((tmp_path / "a" / "team.json").read_text())
    genes = json.loads((tmp_path / "a" / "params.json").read_text())["genes"]
    assert team["genes"] == {gene["name"]: gene["value"] for gene in genes}
    played = fntg(
        "match",
        "--home",
        tmp_path / "a" / "team.json",
        "--away",
        "still",
        "--matches",
        "1",
        "--minutes",
        "0.05",
    )
    assert played.returncode == 0, played.stderr
    _resumed(tmp_path)


def _resumed(tmp_path):
    """Two generations, a checkpoint, a third: the same populations as three in one go."""
    from fntg_jax.running import run_folder, runner
    from fntg_jax.running.problem import resolve

    folder = tmp_path / "a"
    whole = run_folder.restore(folder)
    run = runner.start(resolve(whole.config))
    run.advance()
    run_folder.save_checkpoint(folder, run)
    later = run_folder.restore(folder)
    while not later.done:
        later.advance()
    for one, other in zip(jax.tree.leaves(later.history()), jax.tree.leaves(whole.history())):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(*(jax.tree.leaves(r.state.memory) for r in (later, whole))):
        np.testing.assert_array_equal(one, other)
