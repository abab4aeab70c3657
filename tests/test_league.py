"""The league: who plays whom, what the table says, and that pairings in one program are the
matches that two teams play alone."""

import csv
from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.learning import play
from fntg_jax.learning.mixture import mixture
from fntg_jax.running import league, matches


def test_schedule():
    home, away, seeds = league.schedule(4, 6, seed=3)
    pairs = list(zip(home, away))
    assert len(pairs) == 36
    assert {pair: pairs.count(pair) for pair in set(pairs)} == dict.fromkeys(
        permutations(range(4), 2), 3
    )
    # Both legs of a pair on the same seeds, other pairs on others.
    for a, b in ((0, 1), (2, 3)):
        legs = [sorted(seeds[(home == i) & (away == j)]) for i, j in ((a, b), (b, a))]
        assert legs[0] == legs[1]
    assert len(set(seeds)) == 18
    with pytest.raises(ValueError, match="matches = 3: allowed are even"):
        league.schedule(2, 3, seed=0)


def played(goals_of):
    """A league of three in which team a scores goals_of[a, b] against b."""
    home, away, seeds = league.schedule(3, 20, seed=0)
    goals = np.stack([goals_of[home, away], goals_of[away, home]], axis=1)
    nothing = np.zeros_like(goals)
    statistics = {"goals": goals, "shots": nothing, "saves": nothing}
    return league.Played(("a", "b", "c"), home, away, seeds, statistics)


def test_table_and_cross():
    result = played(np.array([[0, 2, 3], [1, 0, 1], [0, 1, 0]]))
    rows = league.table(result, seed=0)
    assert (
        rows[0].team == "a" and [r.rating for r in rows] == sorted([r.rating for r in rows])[::-1]
    )
    a, b, c = sorted(rows)
    assert (a.wins, a.draws, a.losses, a.points) == (40, 0, 0, 120)
    assert (b.goals, b.against, b.draws, b.points) == (40, 60, 20, 20)
    assert (c.goals, c.against, c.losses) == (20, 80, 20)
    assert a.rating > 25 > max(b.rating, c.rating) and a.uncertainty < 25 / 3
    points, difference = league.cross(result)
    np.testing.assert_array_equal(points[0], [np.nan, 1, 1])
    np.testing.assert_array_equal(difference, -difference.T)
    assert difference[0, 2] == 3 and points[1, 2] == 0.5
    assert result.statistics["goals"][league.closest(result)].tolist() == [1, 1]
    assert sorted(result.statistics["goals"][league.wildest(result)]) in ([0, 3], [1, 2])


def test_a_mixture_plays_as_its_members():
    match = matches.get_match("soccer", players=1, minutes=0.5)
    names = ("random", "chaser", "still")
    home, away = (
        mixture([matches.get_team(name, match, side) for name in names]) for side in (0, 1)
    )
    seeds = jnp.arange(8, dtype=jnp.int32)
    a, b = np.array([1, 0, 2, 1, 0, 1, 2, 0]), np.array([0, 1, 0, 0, 1, 2, 1, 1])

    # Two programs round differently, and a match is chaotic after a touch: six seconds of ways.
    places = {"num_steps": 60, "watch": lambda match, state: state.robots.x}

    @jax.jit
    def mixed(home_teams, away_teams):
        return play.play(
            match,
            home[0]._replace(team=home_teams),
            away[0]._replace(team=away_teams),
            seeds,
            each=(True, True),
            **places,
        )

    pick = lambda stacked, rows: jax.tree.map(lambda x: x[rows], stacked)  # noqa: E731
    _, watched = mixed(pick(home[1], a), pick(away[1], b))
    sides = matches.get_team("chaser", match, 0), matches.get_team("random", match, 1)
    _, alone = jax.jit(lambda s: play.play(match, *sides, s, **places))(seeds)
    mine = (a == 1) & (b == 0)
    assert mine.sum() == 2 and watched.shape == (8, 2)
    np.testing.assert_allclose(watched[mine], alone[mine], atol=0.05)
    assert np.abs(watched[~mine] - alone[~mine]).max(axis=1).min() > 1


@pytest.mark.slow
def test_command(fntg, tmp_path):
    out = tmp_path / "league"
    options = ("still", "random", "chaser", "--matches", "4", "--minutes", "0.2")
    done = fntg("league", *options, "--out", out)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((out / "league.csv").open()))
    assert {row["team"] for row in rows} == {"still", "random", "chaser"}
    assert all(int(row["matches"]) == 8 for row in rows)
    assert len(list(csv.DictReader((out / "matches.csv").open()))) == 12
    page = (out / "index.html").read_text()
    assert "closest.html" in page and (out / "wildest.html").exists()
    assert "in this recording" not in page
    again = fntg("league", *options, "--out", tmp_path / "again")
    assert again.stdout == done.stdout


def test_refused_in_one_line(fntg, tmp_path):
    for arguments, words in (
        (("still",), "two and more"),
        (("still", "still"), "twice"),
        (("still", "nobody"), "nobody"),
        (("still", "random", "--matches", "3"), "matches = 3"),
        ((str(tmp_path),), "no .json"),
    ):
        done = fntg("league", *arguments, "--out", tmp_path / "none" / "out")
        assert done.returncode == 2, arguments
        assert words in done.stderr and done.stderr.strip().count("\n") <= 1, done.stderr
        assert not (tmp_path / "none").exists()
