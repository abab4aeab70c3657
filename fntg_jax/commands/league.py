"""`fntg league`: a round robin of teams."""

import dataclasses
import os
import time
from pathlib import Path
from typing import Annotated

import tyro

from fntg_jax.commands.cli import parse, say
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class LeagueOptions:
    """Every team against every other, both at home, thousands of matches in one program: table,
    ratings, cross table, and a page with the closest and the wildest match."""

    teams: Annotated[tuple[str, ...], tyro.conf.Positional]
    """teams as `fntg match` takes them; a folder stands for the .json and .py in it."""
    matches: int = 100
    """of each pair, even: half of them with either at home, on the same seeds."""
    minutes: float = 1.0
    """of a half."""
    players: int = 3
    """robots a side, 1 to 5."""
    seed: int = 0
    """decides all noise, and the order of the ratings."""
    out: Path | None = None
    """folder to be made; default runs/league-DATE-TIME."""


def main(argv: list[str]) -> None:
    options = parse(LeagueOptions, argv, "league")
    folder = options.out or Path("runs") / f"league-{time.strftime('%Y%m%d-%H%M%S')}"
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"out = {folder}: exists already; choose a new folder")
    if not 0 <= options.seed < 2**31:
        raise ValueError(f"seed = {options.seed}: allowed are 0 to {2**31 - 1}")
    if not 0.01 <= options.minutes <= 16:
        raise ValueError(f"minutes = {options.minutes}: allowed are 0.01 to 16 a half")
    xla.configure(num_cpu_devices=len(os.sched_getaffinity(0)))
    from fntg_jax.files import write_atomically, writing
    from fntg_jax.running import league, matches
    from fntg_jax.showing import league_page

    teams = league.names_of(options.teams)
    labels = [league.label(team) for team in teams]
    if twice := {name for name in labels if labels.count(name) > 1}:
        raise ValueError(f"teams: two are called {min(twice)}; rename a file")
    match = matches.get_match("soccer", players=options.players, minutes=options.minutes)
    num = len(league.schedule(len(teams), options.matches, options.seed)[0])
    say(f"{len(teams)} teams, {num} matches of {match.steps} control steps")
    started = time.perf_counter()
    played = league.play_league(
        match,
        teams,
        options.matches,
        options.seed,
        lambda done, total: say(f"{done} of {total} matches"),
    )
    say(f"{time.perf_counter() - started:.1f} s, compiling included")
    rows = league.table(played, options.seed)
    with writing(folder, "out"):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / "league.csv", league_page.table_csv(rows))
        write_atomically(folder / "matches.csv", league_page.matches_csv(played))
        league_page.figure(played, rows, folder / "cross.png")
        replays = []
        for file, title, which in (
            ("closest.html", "the closest match", league.closest(played)),
            ("wildest.html", "the wildest match", league.wildest(played)),
        ):
            pair = [teams[played.home[which]], teams[played.away[which]]]
            sides = [matches.get_team(name, match, side) for side, name in enumerate(pair)]
            text, score = _replay(match, sides, played.seeds[which])
            write_atomically(folder / file, text.encode())
            goals = played.statistics["goals"][which]
            words = f"{league.label(pair[0])} {goals[0]}:{goals[1]} {league.label(pair[1])}"
            if list(score) != list(goals):
                words += f" in the league, {score[0]}:{score[1]} in this recording"
            replays.append((file, title, f"{words}, match {which}, seed {played.seeds[which]}"))
        about = (
            f"{options.matches} matches of every pair, two halves of {options.minutes:g} minutes, "
            f"{options.players} robots a side, seed {options.seed}."
        )
        page = league_page.page(rows, about, replays)
        write_atomically(folder / "index.html", page.encode())
    print(league_page.as_text(rows), end="")
    say(f"page {folder / 'index.html'}")


def _replay(match, sides, seed):
    """The page of one match, and its score."""
    import jax
    import numpy as np

    from fntg_jax.learning import play
    from fntg_jax.showing import match_page

    home, away = sides
    history = jax.device_get(jax.jit(lambda s: play.record(match, home, away, s))(seed))
    shown = match_page.recording(match, history, (home, away), match.calls)
    return match_page.page(shown), np.asarray(history.statistics.goals)
