from functools import partial

import jax
import numpy as np
import pytest

from envs import scenes
from envs.field import FIELD
from tests import reference

each_suite = pytest.mark.parametrize("name", [n for n in scenes.SUITES if n != "paper"])
HALF = np.asarray([FIELD.length, FIELD.width]) / 2
ROUNDING = 1e-5


NUM = 1000  # of every suite, everywhere, so that each is compiled once


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


@each_suite
def test_declared_distances(name):
    scene = draw(name)
    start, ball, discs = scene.start[:, :2], rest_of(scene), scene.obstacles
    near = 2e-4 if name == "moving-ball" else ROUNDING  # float32 rolls in steps
    assert (HALF - abs(start) >= 0.25 - ROUNDING).all()
    assert (HALF - abs(ball) >= 0.30 - near).all()
    assert (apart(start, scene.ball) >= 0.30 - ROUNDING).all()
    radius = discs[..., 2]
    assert (apart(discs[..., :2], ball[:, None]) - radius >= 0.35 - near).all()
    assert (apart(discs[..., :2], start[:, None]) - radius >= 0.25 - ROUNDING).all()
    assert (abs(discs[..., :2]) <= HALF - radius[..., None] + ROUNDING).all()
    assert (radius >= 0.08).all()
    assert (radius <= 0.145 + ROUNDING).all()
    assert discs.shape[1] == (2 if name == "crowded" else 1)
    gap = apart(discs[:, 0, :2], discs[:, -1, :2]) - radius.sum(1)
    assert name != "crowded" or (gap >= 0.50 - ROUNDING).all()
    assert (abs(scene.start[:, 2]) <= np.pi).all()


@each_suite
def test_same_key_same_scenes_other_key_others(name):
    one, same, other = draw(name, 1), draw(name, 1), draw(name, 2)
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
    assert {n for n, s in moving.items() if s.ball_velocity is not None} == {"moving-ball"}
    assert {n for n, s in moving.items() if s.obstacle_velocity is not None} == {"moving-obstacles"}
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
            # Checked by the suite at every half second, 0.05 m apart: 1 mm in between.
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
    assert (apart(start, disc[:2]) - disc[2] > 0.25).all()
    way = start[0] + np.linspace(0, 1, 400)[:, None] * (ball - start[0])
    assert apart(way, disc[:2]).min() < 0.145  # from the first start the obstacle is in the way


def test_number_of_obstacles_is_free():
    for num in (0, 1, 3):
        draw_few = partial(scenes.open_field, num_scenes=5, num_obstacles=num)
        assert jax.eval_shape(draw_few, jax.random.key(0)).obstacles.shape == (5, num, 3)


def test_mix_keeps_its_shares_and_joins_still_with_moving():
    mix = scenes.Mix((("open", 1.0), ("moving-ball", 1.0), ("moving-obstacles", 1.0)))
    scene = jax.tree.map(np.asarray, mix(jax.random.key(0), 3 * NUM))
    rolls = np.any(scene.ball_velocity != 0, axis=-1)
    walks = np.any(scene.obstacle_velocity != 0, axis=(-2, -1))
    assert len(rolls) == 3 * NUM
    assert (rolls.sum(), walks.sum(), (rolls & walks).sum()) == (NUM, NUM, 0)
    few = jax.eval_shape(partial(mix, num_scenes=8), jax.random.key(0))
    assert few.start.shape == (8, 3)


def test_a_bad_mix_is_refused():
    with pytest.raises(ValueError, match=r"'shut'.*open.*blocked"):
        scenes.Mix((("shut", 1.0),))
    for share in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"share of suite open = .*above 0"):
            scenes.Mix((("open", share),))


def test_a_mix_with_more_obstacles_changes_no_scene():
    mixed = scenes.Mix((("moving-obstacles", 1.0), ("crowded", 1.0)))(jax.random.key(0), 20)
    assert mixed.obstacles.shape == (20, 2, 3) and mixed.obstacle_velocity.shape == (20, 2, 2)
    walking = jax.tree.map(lambda x: x[:10], mixed)
    np.testing.assert_array_equal(walking.obstacles[:, 0], walking.obstacles[:, 1])
    np.testing.assert_array_equal(walking.obstacle_velocity[:, 0], walking.obstacle_velocity[:, 1])
    assert (mixed.obstacle_velocity[10:] == 0).all()
