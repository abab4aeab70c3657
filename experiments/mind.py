"""What each part of a robot's mind is worth: ablations in goals a match, and errors of the map.

    python -m experiments.mind [--matches 64] [--minutes 2] [--json]

`cerberus` plays matches against another team with one part taken away at a time, same seeds each
time: landmarks, sound, infrared sensor, gyroscope, accelerometer, goalkeeper, BIOA (replaced by
turning to the place and going straight), all robots but one; and with perfect sight.  Goals come
with bootstrap 95 % intervals.  The map's errors are medians over robots and steps of play, with
everything in place and without each of the three sensors.
"""

import dataclasses
import json
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from envs.base import SEEN
from experiments import script
from fntg_jax.learning import play
from fntg_jax.robot.geometry import length
from fntg_jax.running import matches, statistics, xla

BALL = SEEN.index("ball")
FRESH = 1.0  # s: who saw the ball within this time sees it
CHUNK = 64  # matches at a time


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to play."""

    matches: int = 64
    """of each line, rounded up to 64s."""
    minutes: float = 2.0
    """of play in a match."""
    team: str = "cerberus"
    """or a team file."""
    against: str = "chaser"
    """the other team."""
    seed: int = 0
    """of the first match."""
    json: bool = False
    """print JSON instead of a table."""


class Parts(NamedTuple):
    """What is there: True, or False where it is taken away."""

    landmarks: Any = True
    sound: Any = True
    proximity: Any = True
    gyroscope: Any = True
    accelerometer: Any = True
    goalkeeper: Any = True
    bioa: Any = True
    team: Any = True  # else shirt 1 plays alone and its teammates stand


class Team(NamedTuple):
    """A team with parts of it taken away."""

    team: Any
    parts: Parts


class Memory(NamedTuple):
    """mind: the robot's own; unseen: s since it saw the ball itself."""

    mind: Any
    unseen: Any


def straight(d_ball, d_obstacle, theta_ball, theta_obstacle):
    """Instead of BIOA: turn to the place, go when it lies ahead, whatever stands between."""
    omega = jnp.clip(2.0 * theta_ball, -1.0, 1.0)
    ahead = jnp.maximum(0.0, 1.0 - 2.0 * jnp.abs(theta_ball))
    return jnp.clip(1.5 * d_ball, 0.0, 0.2) * ahead, omega


def _without(side: play.Side) -> play.Side:
    """The team as one whose parts can be taken away by data."""

    def begin(team, shirt, pose):
        return Memory(side.begin(team.team, shirt, pose), jnp.float32(99.0))

    def control(team, memory, senses):
        parts = team.parts
        frame, way = senses.frame, senses.displacement
        landmark = np.array([name.startswith("landmark") for name in SEEN])
        visible = frame.visible & (parts.landmarks | ~landmark)
        gyro = jnp.where(parts.gyroscope, senses.gyro, way[2] / 0.1)
        upright = jnp.stack([0 * gyro[0], 0 * gyro[0], 9.81 + 0 * gyro[0]])
        senses = senses._replace(
            frame=frame._replace(visible=visible),
            proximity=jnp.where(parts.proximity, senses.proximity, 0.9),
            gyro=gyro,
            acceleration=jnp.where(parts.accelerometer, senses.acceleration, upright),
            heard_valid=senses.heard_valid & parts.sound,
        )
        whole = team.team

        def bioa(*seen):
            plain = straight(*seen)
            return tuple(jnp.where(parts.bioa, a, b) for a, b in zip(whole.bioa(*seen), plain))

        changed = whole._replace(bioa=bioa, goalkeeper=whole.goalkeeper & parts.goalkeeper)
        mind, action = side.control(changed, memory.mind, senses)
        plays = parts.team | (mind.shirt == 1)
        still = lambda a: jnp.where(plays, a, jnp.zeros_like(a))  # noqa: E731
        action = jax.tree.map(still, action)
        unseen = jnp.where(visible[BALL], 0.0, memory.unseen + 0.1)
        return Memory(mind, unseen), action

    return play.Side(side.name, None, begin, control)


class Watched(NamedTuple):
    """Leaves [steps, N, B] of our robots: error of the map's ball (m), age that the map says and s
    since the robot saw it itself, on (it plays); position error of the robot (m)."""

    error: Any
    age: Any
    unseen: Any
    on: Any
    position: Any


def program(match, home: play.Side, away: play.Side, steps: int):
    """(team, parts, seeds [CHUNK]) -> goals [CHUNK, 2], penalties [CHUNK], `Watched`."""
    ours = _without(home)

    def run(team, parts, seeds):
        mine = ours._replace(team=Team(team, parts))
        state = match.reset(play.kickoffs(seeds), seeds)
        carry = state, play.begin(match, mine, away, state)

        def step(carry, _):
            truth = match.truth_batch(carry[0])
            carry, _ = play.control_step(match, mine, away, carry)
            memory = carry[1][0]
            each = lambda a: a.reshape(match.players, -1)  # noqa: E731
            around, belief = memory.mind.map, memory.mind.belief
            # What was believed in this step beside what was so in it, in the team's frame.
            x, y = (around.distance[BALL] * a[BALL] for a in (around.cos, around.sin))
            dx, dy = truth.ball[0, : match.players], truth.ball[1, : match.players]
            px, py, heading = truth.pose[:, : match.players]
            dx, dy = dx - px, dy - py
            c, s = jnp.cos(heading), jnp.sin(heading)
            seen = Watched(
                length(each(x) - (c * dx + s * dy), each(y) - (c * dy - s * dx)),
                each(around.age[BALL]),
                each(memory.unseen),
                truth.signal[: match.players] == 0,
                length(each(belief.x) - px, each(belief.y) - py),
            )
            return carry, seen

        (state, _), seen = jax.lax.scan(step, carry, None, length=steps)
        statistics = state.statistics
        return statistics.goals.T, statistics.penalties[0], seen

    return jax.jit(run)


def errors(seen: Watched) -> dict[str, Any]:
    """Medians of the ball's error (m) by who sees it, with the share of steps."""
    others = np.stack([np.delete(seen.unseen, k, axis=1).min(1) for k in range(3)], 1)
    own = seen.unseen < FRESH
    mate = ~own & (others < FRESH)
    rest = ~own & ~mate
    table = {}
    for name, which in (("seen", own), ("only by a teammate", mate), ("by nobody", rest)):
        which = which & seen.on
        values = seen.error[which]
        table[name] = {
            "share": float(which.sum() / max(seen.on.sum(), 1)),
            "median": float(np.median(values)) if len(values) else None,
            "p90": float(np.quantile(values, 0.9)) if len(values) else None,
        }
    return table


LINES = {
    "everything": Parts(),
    "no landmarks": Parts(landmarks=False),
    "no sound": Parts(sound=False),
    "no infrared sensor": Parts(proximity=False),
    "no gyroscope": Parts(gyroscope=False),
    "no accelerometer": Parts(accelerometer=False),
    "no goalkeeper": Parts(goalkeeper=False),
    "straight instead of BIOA": Parts(bioa=False),
    "one robot alone": Parts(team=False),
}
MAPS = ("everything", "no infrared sensor", "no gyroscope", "no accelerometer", "no landmarks")


def measure(run, team, parts: Parts, options: Options) -> dict[str, Any]:
    """One line: goals of both a match, and the map's errors."""
    parts = Parts(*map(jnp.asarray, parts))
    num = -(-options.matches // CHUNK)
    seeds = matches.match_seeds(num * CHUNK, options.seed).reshape(num, CHUNK)
    parts_of = [jax.device_get(run(team, parts, row)) for row in seeds]
    goals = np.concatenate([found[0] for found in parts_of])
    seen = zip(*(found[2] for found in parts_of))
    watched = Watched(*(np.concatenate(leaves, axis=-1) for leaves in seen))
    mean = lambda a: (float(a.mean()), *statistics.bootstrap_mean_of_counts(a))  # noqa: E731
    ours, theirs = goals[:, 0], goals[:, 1]
    return {
        "goals": mean(ours),
        "against": mean(theirs),
        "points": float(np.mean((ours > theirs) + 0.5 * (ours == theirs))),
        "penalties": float(np.concatenate([found[1] for found in parts_of]).mean()),
        "ball": errors(watched),
        "position": float(np.median(watched.position[watched.on])),
    }


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    with script.lines():
        script.check_least(options, matches=1, seed=0)
        if not 0.02 <= options.minutes <= 20:
            raise ValueError(f"minutes = {options.minutes}: allowed are 0.02 to 20")
        xla.configure()
        rows = {}
        for camera in ("objects", "perfect"):
            match = matches.get_match("soccer", minutes=options.minutes / 2, camera=camera)
            home, away = (
                matches.get_team(name, match, k)
                for k, name in enumerate((options.team, options.against))
            )
            run = program(match, home, away, match.steps)
            lines = LINES if camera == "objects" else {"perfect sight": Parts()}
            for name, parts in lines.items():
                rows[name] = measure(run, home.team, parts, options)
                if not options.json:
                    _print(name, rows[name])
    if options.json:
        document = {"matches": options.matches, "minutes": options.minutes, "rows": rows}
        print(json.dumps(document, indent=1, allow_nan=False))
        return
    print("\nball's error on the map, m: median (90 %), share of steps")
    for name in MAPS:
        cells = [
            f"{who}: {c['median']:.3f} ({c['p90']:.2f}), {100 * c['share']:.0f} %"
            for who, c in rows[name]["ball"].items()
            if c["median"] is not None
        ]
        print(f"{name:26s}{'; '.join(cells)}; own place {rows[name]['position']:.3f}")


def _print(name: str, row: dict[str, Any]) -> None:
    span = lambda m: f"{m[0]:.2f} ({m[1]:.2f}-{m[2]:.2f})"  # noqa: E731
    print(
        f"{name:26s}{span(row['goals']):>20s}  against {span(row['against']):>20s}  points "
        f"{100 * row['points']:.1f} %  calls {row['penalties']:.2f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
