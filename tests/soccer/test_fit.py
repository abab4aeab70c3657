"""`fntg fit`: planted numbers come back, and the file is a body that plays."""

import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Action, Walk
from envs.soccer import Match, bodies, identify, noise, tables
from envs.soccer.state import Robots

BEFORE = tables.load_body("ers210").styles
PLANTED = {"forward": 0.19, "backward": 0.11, "lateral": 0.06, "turn": 1.3, "lag": 0.22}
PLANTED |= {"slip": 0.09, "slip_turn": 0.05, "odometry": 0.03, "odometry_turn": 0.05}


def record(seed, num=6000):
    """A log of the world's own walk under a planted table, styles DEFAULT and FAST."""
    rng = np.random.default_rng(seed)
    table = BEFORE._replace(**{name: (value,) * 9 for name, value in PLANTED.items()})
    kind = tables.load_body("ers210")._replace(styles=table)
    hold = np.cumsum(rng.uniform(size=num) < 0.07)
    drawn = rng.uniform(-1, 1, (hold[-1] + 1, 3)) * [0.35, 0.12, 1.6]
    command, style = drawn[hold], np.repeat([0, 3], num // 2)
    feelings = tables.load("senses", tables.Feelings)
    zero = jnp.zeros(1)
    lane = jnp.zeros(1, jnp.uint32)

    def step(robots, now):
        n, u, s = now
        key = noise.key(jnp.uint32(seed), n, lane)
        own = noise.key(jnp.uint32(seed), jnp.int32(-1), lane)
        action = Action(Walk(s[None], *u[:, None]), None, s[None], s[None], None)
        both, free = bodies.Bodies(kind, kind), jnp.ones(1, bool)
        new = bodies.walk(both, robots, action, free, key, own, zero + 1, feelings, 0.1)
        r = robots
        seen = (r.x, r.y, r.cos, r.sin, r.odometry_x, r.odometry_y, r.odometry_turn)
        return new, jnp.concatenate(seen)

    start = Robots(*(zero for _ in Robots._fields))._replace(cos=zero + 1)
    given = jnp.arange(num), jnp.asarray(command, jnp.float32), jnp.asarray(style, jnp.int32)
    x, y, cos, sin, *told = np.asarray(jax.lax.scan(step, start, given)[1], float).T
    pose = np.stack([x, y, np.arctan2(sin, cos)], 1)
    return identify.Log(0.1, style, command, pose, np.stack(told, 1), np.arange(num) == 0)


@pytest.fixture(scope="module")
def log():
    return record(1)


def test_planted_numbers_come_back_within_five_per_cent(log):
    fitted = identify.fit(log, BEFORE)
    assert [one.style for one in fitted] == ["DEFAULT", "FAST"]
    for one in fitted:
        for name, value in one.values.items():
            assert value == pytest.approx(PLANTED[name], rel=0.05), (one.style, name)
    found = identify.odometry(log)
    for name in ("odometry", "odometry_turn"):
        assert found[name] == pytest.approx(PLANTED[name], rel=0.1), name
    new, text = identify.table(tables.load_body("ers210"), "mine", "test", fitted, found)
    fresh = record(2, 2000)
    before, after = identify.misfit(fresh, BEFORE), identify.misfit(fresh, new.styles)
    assert after.surprise < before.surprise - 1
    assert after.speed < before.speed and after.turning < before.turning
    assert '"name": "mine"' in text


def test_what_a_log_does_not_tell_stays(log):
    # Never faster than a third of the table's speeds: their limits are not in the log.
    slow = log._replace(command=np.clip(log.command, -0.02, 0.02) * [1, 1, 0])
    rows = np.arange(len(slow.pose))
    still = slow._replace(pose=np.stack([0.002 * rows, 0 * rows, 0 * rows], 1))
    (one, _) = identify.fit(still, BEFORE)
    assert one.values["turn"] == BEFORE.turn[0]


def rows_of(log, names):
    for n in range(len(log.pose)):
        x, y, heading = log.pose[n]
        ball = x + 1.0, y + 0.5
        bearing = np.arctan2(0.5, 1.0) - heading + 0.02 * np.sin(n)
        seen = ["ball", bearing, np.hypot(1, 0.5) * 1.05, *ball] if n % 3 == 0 else [""] * 5
        yield [0.1 * n, names[log.style[n]], *log.command[n], *log.pose[n], *log.odometry[n], *seen]


def test_command(fntg, tmp_path, log):
    header = (
        "time,style,v,v_y,omega,x,y,heading,dx,dy,dtheta,seen,bearing,distance,object_x,object_y"
    )
    path = tmp_path / "log.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerow(header.split(","))
        csv.writer(file).writerows(rows_of(log, BEFORE.name))
    done = fntg("fit", path, "--out", tmp_path / "mine.json", "--test", path)
    assert done.returncode == 0, done.stderr
    assert "ball" in done.stdout and "0.0500 +- 0.0000" in done.stdout
    assert tables.load_body(str(tmp_path / "mine.json")).styles.forward[0] == pytest.approx(
        0.19, rel=0.05
    )
    Match(home=str(tmp_path / "mine.json"))
    lines = path.read_text().splitlines()
    for row, words in (
        (lines[5].replace("DEFAULT", "SLOWER"), "row 6: style = 'SLOWER'"),
        (lines[5].replace(lines[5].split(",")[5], "here", 1), "row 6: x = 'here'"),
        (lines[3], "must rise"),
    ):
        path.write_text("\n".join([*lines[:5], row, *lines[6:]]) + "\n")
        done = fntg("fit", path)
        assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
        assert words in done.stderr
