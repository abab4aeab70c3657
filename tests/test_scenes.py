import functools
from functools import partial

import jax
import numpy as np
import pytest
from scipy import ndimage

from envs import mix as mixtures
from envs import scenes
from envs.field import FIELD
from tests import reference

each_suite = pytest.mark.parametrize("name", [n for n in scenes.SUITES if n != "paper"])
HALF = np.asarray([FIELD.length, FIELD.width]) / 2
ROUNDING = 1e-5


NUM = 1000  # of every suite, everywhere, so that each is compiled once
ROLLING = {"moving-ball", "moving-anywhere", "traffic"}
WALKING = {"moving-obstacles", "traffic"}
CROWDS = {"crowded", "traffic"}


@functools.cache
def draw(name, seed=1, num=NUM):
    return jax.tree.map(np.asarray, scenes.SUITES[name](jax.random.key(seed), num))


def apart(a, b):
    return np.linalg.norm(a - b, axis=-1)


def rest_of(scene):
    """Where every ball comes to lie."""
    if scene.ball_velocity is None:
        return scene.ball
    return np.asarray(
        [reference.ball_at(p, v, 0.05, 1e3) for p, v in zip(scene.ball, scene.ball_velocity)]
    )


def margins_of(name):
    near = name.endswith("anywhere")
    return (0.06, 0.06) if near else (scenes.BALL_TO_WALL, scenes.BALL_TO_OBSTACLE)


@each_suite
def test_declared_distances(name):
    scene = draw(name)
    start, ball, discs = scene.start[:, :2], rest_of(scene), scene.obstacles
    near = 2e-4 if name in ROLLING else ROUNDING  # float32 rolls in steps
    to_wall, to_obstacle = margins_of(name)
    assert (HALF - abs(start) >= scenes.START_TO_WALL - ROUNDING).all()
    assert (HALF - abs(ball) >= to_wall - near).all()
    assert (apart(start, scene.ball) >= scenes.START_TO_BALL - ROUNDING).all()
    radius = discs[..., 2]
    assert (apart(discs[..., :2], ball[:, None]) - radius >= to_obstacle - near).all()
    to_start = apart(discs[..., :2], start[:, None]) - radius
    assert (to_start >= scenes.START_TO_OBSTACLE - ROUNDING).all()
    assert (abs(discs[..., :2]) <= HALF - radius[..., None] + ROUNDING).all()
    assert (radius >= 0.08).all()
    assert (radius <= 0.145 + ROUNDING).all()
    assert discs.shape[1] == (2 if name in CROWDS else 1)
    gap = apart(discs[:, 0, :2], discs[:, -1, :2]) - radius.sum(1)
    assert name not in CROWDS or (gap >= 0.50 - ROUNDING).all()
    assert (abs(scene.start[:, 2]) <= np.pi).all()


@pytest.mark.parametrize("name", [n for n in scenes.SUITES if n not in WALKING])
def test_every_scene_can_be_done(name):
    """Flood fill on a grid of 1 cm: a robot's centre that keeps 0.145 m from everything comes
    from its start to within 0.10 m of the ball."""
    scene, num = draw(name), 4 if name == "paper" else 300
    x, y = np.meshgrid(*(np.arange(-h, h, 0.01) for h in HALF), indexing="ij")
    for start, ball, discs in zip(scene.start[:num], rest_of(scene), scene.obstacles):
        free = (HALF[0] - abs(x) >= 0.145) & (HALF[1] - abs(y) >= 0.145)
        for cx, cy, radius in discs:
            free &= np.hypot(x - cx, y - cy) - radius >= 0.145
        rooms, _ = ndimage.label(free)
        here = rooms[tuple(np.rint((start[:2] + HALF) / 0.01).astype(int))]
        there = rooms[np.hypot(x - ball[0], y - ball[1]) < 0.10]
        assert here > 0 and here in there, (start, ball, discs)


def test_balls_anywhere_lie_at_walls_and_obstacles():
    scene = draw("anywhere")
    to_wall = (HALF - abs(scene.ball)).min(1)
    to_obstacle = apart(scene.obstacles[:, 0, :2], scene.ball) - scene.obstacles[:, 0, 2]
    for gap in (to_wall, to_obstacle):
        assert gap.min() < 0.08 and (gap < 0.30).mean() > 0.05


@pytest.mark.parametrize("name", sorted(ROLLING))
def test_rolling_balls_never_run_into_obstacles(name):
    scene = draw(name)
    still = np.zeros_like(scene.obstacles[..., :2])
    walks = still if scene.obstacle_velocity is None else scene.obstacle_velocity
    least = scenes.BALL_TO_OBSTACLE if name == "traffic" else FIELD.ball_radius
    for row in range(60):
        for disc, velocity in zip(scene.obstacles[row], walks[row]):
            for t in np.arange(0, 22, 0.1):
                ball = reference.ball_at(scene.ball[row], scene.ball_velocity[row], 0.05, t)
                at = reference.disc_at(disc, velocity, t)
                # Checked by the suite at instants 0.06 m (traffic: 0.16 m) of way apart.
                assert apart(np.asarray(at[:2]), np.asarray(ball)) - disc[2] >= least - 0.016


def test_margins_are_options_of_a_suite():
    scene = scenes.get_suite("blocked/wall=0.06/obstacle=0.2")(jax.random.key(1), NUM)
    gap = apart(scene.obstacles[:, 0, :2], scene.ball) - scene.obstacles[:, 0, 2]
    assert 0.20 - ROUNDING <= gap.min() < 0.21
    assert 0.06 - ROUNDING <= (HALF - abs(scene.ball)).min() < 0.08
    mixed = mixtures.Mix((("open", 1.0), ("blocked/wall=0.06/obstacle=0.2", 1.0)))
    few = jax.eval_shape(partial(mixed, num_scenes=10), jax.random.key(0))
    assert few.start.shape == (10, 3)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("shut", "suite = 'shut': known are paper, open"),
        ("open/roof=1", "option 'roof=1' of suite open: known are wall=METRES, obstacle=METRES"),
        ("open/wall", "wall = '' of suite open: allowed are 0.06 to 0.4 m"),
        ("open/wall=0.01", "wall = '0.01' of suite open: allowed are 0.06 to 0.4 m"),
        ("open/wall=nan", "wall = 'nan' of suite open"),
        ("paper/wall=0.1", "option 'wall=0.1' of suite paper: known are none"),
    ],
)
def test_wrong_suites_are_refused(name, words):
    with pytest.raises(ValueError, match=words):
        scenes.get_suite(name)


@each_suite
def test_same_key_same_scenes_other_key_others(name):
    one, same, other = draw(name, 1), draw.__wrapped__(name, 1), draw(name, 2)
    jax.tree.map(np.testing.assert_array_equal, one, same)
    assert np.intersect1d(one.start[:, 0], other.start[:, 0]).size < NUM / 100
    assert len(np.unique(one.start, axis=0)) == len(np.unique(one.seed)) == NUM


def test_random_scenes_fill_what_they_may():
    """No corner is forgotten: places and headings span their ranges."""
    scene = draw("open")
    span = HALF - 0.30
    assert (np.ptp(scene.start[:, :2], axis=0) > 1.95 * span).all()
    assert np.ptp(scene.start[:, 2]) > 1.95 * np.pi
    assert (np.ptp(scene.ball, axis=0) > 1.9 * (HALF - 0.30)).all()


def test_blocked_really_is():
    scene = draw("blocked")
    a, b, c = scene.start[:, :2], scene.ball, scene.obstacles[:, 0, :2]
    way = np.linspace(0, 1, 400)[:, None, None]
    off = apart(a + way * (b - a), c).min(0)
    assert (off <= 0.145 + ROUNDING).all()
    assert off.max() > 0.12
    assert off.min() < 0.02
    assert (apart(a, b) >= 1.0 - ROUNDING).all()


def test_only_what_is_named_moves():
    moving = {n: draw(n) for n in scenes.SUITES}
    assert {n for n, s in moving.items() if s.ball_velocity is not None} == ROLLING
    assert {n for n, s in moving.items() if s.obstacle_velocity is not None} == WALKING
    speed = np.linalg.norm(draw("moving-ball").ball_velocity, axis=-1)
    assert speed.min() >= 0.05 - ROUNDING
    assert speed.max() <= 0.30 + ROUNDING
    assert np.ptp(speed) > 0.2
    speed = np.linalg.norm(draw("moving-obstacles").obstacle_velocity, axis=-1)
    assert speed.min() >= 0.02 - ROUNDING
    assert speed.max() <= 0.10 + ROUNDING


def test_walking_obstacles_never_come_too_near_the_ball():
    scene = draw("moving-obstacles")
    some = slice(100)
    for ball, discs, velocities in zip(
        scene.ball[some], scene.obstacles[some], scene.obstacle_velocity[some]
    ):
        for disc, velocity in zip(discs, velocities):
            path = np.asarray([reference.disc_at(disc, velocity, t) for t in np.arange(0, 22, 0.1)])
            # Checked by the suite at every 0.4 s, 0.04 m apart: 1 mm in between.
            assert (apart(path[:, :2], ball) - disc[2]).min() >= 0.35 - 1e-3


def test_the_paper_suite_is_fixed():
    one, other = draw("paper", 1, 4), draw("paper", 2, 4)
    jax.tree.map(np.testing.assert_array_equal, one, other)
    assert len(np.unique(one.start, axis=0)) == 4
    assert len(np.unique(one.ball, axis=0)) == 1
    start, ball, disc = one.start[:, :2], one.ball[0], one.obstacles[0, 0]
    assert (apart(start, ball) > 0.30).all()
    assert apart(disc[:2], ball) - disc[2] >= 0.35
    assert (HALF - abs(start) >= 0.25).all()
    assert (apart(start, disc[:2]) - disc[2] > scenes.START_TO_OBSTACLE).all()
    way = start[0] + np.linspace(0, 1, 400)[:, None] * (ball - start[0])
    assert apart(way, disc[:2]).min() < 0.145  # from the first start the obstacle is in the way


def test_number_of_obstacles_is_free():
    for num in (0, 1, 3):
        draw_few = partial(scenes.open_field, num_scenes=5, num_obstacles=num)
        assert jax.eval_shape(draw_few, jax.random.key(0)).obstacles.shape == (5, num, 3)


def test_mix_keeps_its_shares_and_joins_still_with_moving():
    mix = mixtures.Mix((("open", 1.0), ("moving-ball", 1.0), ("moving-obstacles", 1.0)))
    scene = jax.tree.map(np.asarray, mix(jax.random.key(0), 3 * NUM))
    rolls = np.any(scene.ball_velocity != 0, axis=-1)
    walks = np.any(scene.obstacle_velocity != 0, axis=(-2, -1))
    assert len(rolls) == 3 * NUM
    assert (rolls.sum(), walks.sum(), (rolls & walks).sum()) == (NUM, NUM, 0)
    few = jax.eval_shape(partial(mix, num_scenes=8), jax.random.key(0))
    assert few.start.shape == (8, 3)


def test_a_bad_mix_is_refused():
    with pytest.raises(ValueError, match=r"'shut'.*open.*blocked"):
        mixtures.Mix((("shut", 1.0),))
    for share in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"share of suite open = .*above 0"):
            mixtures.Mix((("open", share),))


def test_a_mix_with_more_obstacles_changes_no_scene():
    mixed = mixtures.Mix((("moving-obstacles", 1.0), ("crowded", 1.0)))(jax.random.key(0), 20)
    assert mixed.obstacles.shape == (20, 2, 3) and mixed.obstacle_velocity.shape == (20, 2, 2)
    walking = jax.tree.map(lambda x: x[:10], mixed)
    np.testing.assert_array_equal(walking.obstacles[:, 0], walking.obstacles[:, 1])
    np.testing.assert_array_equal(walking.obstacle_velocity[:, 0], walking.obstacle_velocity[:, 1])
    assert (mixed.obstacle_velocity[10:] == 0).all()
