"""`fntg match`: two teams, many matches under the referee."""

import dataclasses
import json
import os
from pathlib import Path

from fntg_jax.commands.cli import parse, say
from fntg_jax.running import xla


@dataclasses.dataclass(frozen=True)
class MatchOptions:
    """Matches between two teams, many at once: goals, wins with 95 % intervals, statistics.  A team
    is still, random, chaser or another that is installed, or a file (.json, or .py that defines
    make(match, side))."""

    home: str = "chaser"
    """the team that plays towards +x first."""
    away: str = "still"
    """the other team."""
    matches: int | None = None
    """how many, default 100, of walking dogs 1; home kicks off in every other one."""
    seed: int = 0
    """decides all noise."""
    minutes: float = 10.0
    """of a half."""
    players: int = 3
    """robots a side, 1 to 5."""
    camera: str = "objects"
    """what robots see: objects, image (pixels), or perfect (the truth)."""
    sound: str = "symbols"
    """how they talk: symbols, audio (samples), or none."""
    home_body: str = "ers210"
    """body of the home team: ers210, wheels or a table of your own (.json)."""
    away_body: str = "ers210"
    """body of the away team."""
    body: str = "tables"
    """what moves the bodies: tables, or quadruped: six walking dogs in one MuJoCo model."""
    film: Path | None = None
    """also write a film of the first match, .webp, .gif, or .mp4 (which needs ffmpeg)."""
    film_from: float = 0.0
    """s from the kick-off to where it begins; 0 with --body quadruped."""
    film_seconds: float = 30.0
    """of play that it shows."""
    json: bool = False
    """print JSON instead of a table."""
    out: Path | None = None
    """also write matches.csv, a row for each match and team, into this folder."""
    html: Path | None = None
    """also write the first match as one page to watch (up to 33 minutes in all)."""


COLUMNS = ("own_goals", "possession", "shots", "saves", "passes", "touches", "falls", "penalties")


def main(argv: list[str]) -> None:
    options = parse(MatchOptions, argv, "match")
    if options.out is not None and options.out.exists() and not options.out.is_dir():
        raise ValueError(f"out = {options.out}: allowed is a folder")
    if not 0 <= options.seed < 2**31:
        raise ValueError(f"seed = {options.seed}: allowed are 0 to {2**31 - 1}")
    if options.matches is None:
        options = dataclasses.replace(options, matches=100 if options.body == "tables" else 1)
    xla.configure(num_cpu_devices=len(os.sched_getaffinity(0)))
    from fntg_jax.running import matches

    assert options.matches is not None
    if not 1 <= options.matches <= matches.MOST:
        raise ValueError(f"matches = {options.matches}: allowed are 1 to {matches.MOST}")
    if not 0.01 <= options.minutes <= 1000:
        raise ValueError(f"minutes = {options.minutes}: allowed are 0.01 to 1000 a half")
    if options.camera == "image" and options.sound == "audio":
        # XLA takes minutes and 20 GB to compile both in one program (jax 0.10.2, CPU).
        raise ValueError(
            "sound = 'audio': not together with camera = 'image' yet; take one of them"
        )
    match = matches.get_match(
        "soccer",
        players=options.players,
        home=options.home_body,
        away=options.away_body,
        camera=options.camera,
        sound=options.sound,
        minutes=options.minutes,
    )
    sides = matches.get_team(options.home, match, 0), matches.get_team(options.away, match, 1)
    if options.html is not None and (options.html.is_dir() or not options.html.parent.is_dir()):
        raise ValueError(f"html = {options.html}: allowed is a file in a folder that exists")
    if options.film is not None:
        _check_film(options)
    if options.html is not None or (options.film is not None and options.body == "tables"):
        _watch(options, match, sides)
    say(f"{options.matches} matches of {match.steps} control steps")
    if options.body == "tables":
        results = matches.play_matches(match, *sides, options.matches, options.seed)
    else:
        results = _physical(options, match, sides)
    home, away, draws = matches.summarize(results, (options.home, options.away))
    if options.out is not None:
        say(f"rows {_write(options.out, results, (options.home, options.away))}")
    if options.json:
        document = {
            "matches": options.matches,
            "minutes": options.minutes,
            "seed": options.seed,
            "camera": options.camera,
            "sound": options.sound,
            "draws": draws.share,
            "home": _document(home),
            "away": _document(away),
        }
        print(json.dumps(document, indent=1, allow_nan=False))
        return
    print(f"{'':16s}{'home':>24s}{'away':>24s}")
    pair = lambda name, cells: print(f"{name:16s}" + "".join(f"{c:>24s}" for c in cells))  # noqa: E731
    pair("team", (home.team[-22:], away.team[-22:]))
    pair("goals", [f"{s.goals:.2f} ({_span(s.goals_interval)})" for s in (home, away)])
    pair("wins", [str(s.wins) for s in (home, away)])
    pair(
        "points", [f"{100 * s.points:.1f} % ({_percent(s.points_interval)})" for s in (home, away)]
    )
    for name in COLUMNS:
        unit = (lambda v: f"{100 * v:.1f} %") if name == "possession" else (lambda v: f"{v:.2f}")
        pair(name.replace("_", " "), [unit(s.means[name]) for s in (home, away)])
    print(f"{'draws':16s}{draws!s:>24s}")


_FILMS = (".webp", ".gif", ".mp4")


def _check_film(options: MatchOptions) -> None:
    import shutil

    assert options.film is not None
    suffix = options.film.suffix.lower()
    if suffix not in _FILMS or not options.film.parent.is_dir():
        raise ValueError(
            f"film = {options.film}: allowed are names ending in {', '.join(_FILMS)} in a folder "
            "that exists"
        )
    if suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise ValueError(f"film = {options.film}: no ffmpeg found; .webp and .gif need none")
    if not 1 <= options.film_seconds <= 600:
        raise ValueError(f"film_seconds = {options.film_seconds}: allowed are 1 to 600")
    latest = 120 * options.minutes if options.body == "tables" else 0.0
    if not 0 <= options.film_from <= latest:
        raise ValueError(f"film_from = {options.film_from}: allowed are 0 to {latest:g}")


def _physical(options: MatchOptions, match, sides):
    """Matches of walking dogs, one after the other."""
    from fntg_jax.files import write_atomically, writing
    from fntg_jax.running import physical
    from fntg_jax.showing import film

    bodies = physical.get_bodies(options.body, match)
    keep = (2, options.film_seconds) if options.film is not None else (0, 0.0)
    played = physical.play_matches(
        match,
        bodies,
        sides,
        options.matches or 1,
        options.seed,
        keep,
        lambda done, total: say(f"{done} of {total} matches"),
    )
    lasted = (match.steps - 1) * match.dt
    say(f"{lasted / played.seconds:.1f} x real time (the first match, compiled)")
    if options.film is not None:
        say("drawing ...")
        pictures = bodies.pictures(played.poses, 640, 360)
        with writing(options.film, "film"):
            write_atomically(options.film, film.encoded(pictures, match.dt / 2, options.film))
        say(f"film {options.film}")
    return played.results


def _watch(options: MatchOptions, match, sides) -> None:
    """The first match of those that are played, by tables: as a page, as a film."""
    import jax

    from fntg_jax.files import write_atomically, writing
    from fntg_jax.learning import play
    from fntg_jax.running import matches
    from fntg_jax.showing import film, match_film, match_page

    seeds = matches.match_seeds(1, options.seed)
    home, away = sides
    history = jax.jit(lambda s: play.record(match, home, away, s))(seeds[0])
    shown = match_page.recording(match, jax.device_get(history), sides, match.calls)
    if options.html is not None:
        with writing(options.html, "html"):
            write_atomically(options.html, match_page.page(shown).encode())
        say(f"page {options.html}")
    if options.film is not None and options.body == "tables":
        pictures = match_film.pictures(shown, options.film_from, options.film_seconds)
        with writing(options.film, "film"):
            write_atomically(options.film, film.encoded(pictures, 2 * match.dt, options.film))
        say(f"film {options.film}")


def _span(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.2f}-{interval[1]:.2f}"


def _percent(interval: tuple[float, float]) -> str:
    return f"{100 * interval[0]:.1f}-{100 * interval[1]:.1f}"


def _document(summary) -> dict:
    return {
        "team": summary.team,
        "goals": summary.goals,
        "goals_interval": list(summary.goals_interval),
        "wins": summary.wins.share,
        "wins_interval": [summary.wins.low, summary.wins.high],
        "points": summary.points,
        "points_interval": list(summary.points_interval),
        **{name: summary.means[name] for name in COLUMNS},
    }


def _write(folder: Path, results, names: tuple[str, str]) -> Path:
    from fntg_jax.files import csv_table, write_atomically, writing

    header = ["match", "seed", "kickoff", "side", "team", *results.statistics]
    rows = []
    for n, seed in enumerate(results.seeds):
        for k, side in enumerate(("home", "away")):
            values = [int(value[n, k]) for value in results.statistics.values()]
            rows.append([n, seed, ("home", "away")[seed % 2], side, names[k], *values])
    path = folder / "matches.csv"
    with writing(folder, "out"):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, csv_table(header, rows))
    return path
