import math

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from envs.field import FIELD, Ball, Disc, bearing, distance, move_disc, nearest_obstacle, roll_ball
from tests import reference

vectors = hnp.arrays(np.float32, (256, 2), elements=st.floats(-4, 4, width=32))
jitted_bearing = jax.jit(jax.vmap(jax.value_and_grad(bearing, argnums=(0, 1))))


@given(v=vectors)
def test_bearing_is_atan2_with_its_gradient(v):
    angle, (by_x, by_y) = jax.tree.map(np.asarray, jitted_bearing(*v.T))
    x, y = v.T.astype(np.float64)
    exact = np.arctan2(y, x)
    error = np.abs(angle - exact)
    square = x * x + y * y
    assert np.minimum(error, 2 * np.pi - error)[square > 1e-50].max(initial=0) < 5e-7
    clear = square > 1e-6
    x, y, square = x[clear], y[clear], square[clear]
    np.testing.assert_allclose(by_x[clear], -y / square, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(by_y[clear], x / square, rtol=1e-5, atol=1e-6)
    assert np.isfinite(by_x).all()
    assert np.isfinite(by_y).all()


def test_bearing_quadrants_and_origin():
    axes = [(1, 0, 0), (0, 1, 0.5), (-1, 0, 1), (0, -1, -0.5)]
    for x, y, angle in [*axes, (1, 1, 0.25), (-2, -2, -0.75)]:
        assert float(bearing(jnp.float32(x), jnp.float32(y))) == pytest.approx(angle * math.pi)
    value, slope = jax.value_and_grad(bearing, argnums=(0, 1))(jnp.float32(0), jnp.float32(0))
    assert [float(n) for n in (value, *slope)] == [0, 0, 0]
    with jax.enable_x64(True):
        assert float(bearing(jnp.float64(0.3), jnp.float64(-0.7))) == math.atan2(-0.7, 0.3)


def test_distance_has_no_nan_at_the_origin():
    assert [float(n) for n in jax.grad(distance, argnums=(0, 1))(0.0, 0.0)] == [0, 0]
    assert float(distance(3.0, -4.0)) == 5


@jax.jit
@jax.vmap
def nearest_of_three(point, discs):
    return nearest_obstacle(*point, [Disc(*d) for d in discs])


def surface_points(discs) -> np.ndarray:
    """Walls and circles as many points."""
    s = np.linspace(-1, 1, 2801)
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    walls = [np.stack([s * 1.4, np.full_like(s, y)], 1) for y in (-0.9, 0.9)]
    walls += [np.stack([np.full_like(s, x), s * 0.9], 1) for x in (-1.4, 1.4)]
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.concatenate(walls + [d[:2] + d[2] * circle for d in discs])


def test_nearest_obstacle_against_brute_force():
    rng = np.random.default_rng(5)
    points = rng.uniform([-1.4, -0.9], [1.4, 0.9], (300, 2))
    discs = rng.uniform([-1.3, -0.8, 0.05], [1.3, 0.8, 0.15], (300, 3, 3))
    found = np.stack(nearest_of_three(points.astype(np.float32), discs.astype(np.float32)), 1)
    kinds = set()
    for point, three, (d, ux, uy) in zip(points, discs, found):
        inside = min(np.hypot(*(point - disc[:2])) - disc[2] for disc in three) < 0
        expected, direction = reference.nearest(*point, three)
        assert d == pytest.approx(expected, abs=2e-6)
        assert reference.wrapped(math.atan2(uy, ux) - direction) == pytest.approx(0, abs=1e-4)
        kinds.add(inside)
        if not inside:  # where the distance is plain geometry
            to = surface_points(three) - point
            lengths = np.hypot(*to.T)
            assert d == pytest.approx(lengths.min(), abs=6e-4)
            near = to[lengths.argmin()]
            cosine = (near @ [ux, uy]) / (np.hypot(*near) * math.hypot(ux, uy))
            assert cosine > 0.99 or d < 0.02  # the points lie 1 mm apart
    assert kinds == {True, False}


def test_outside_the_field_the_distance_is_negative_and_points_outward():
    d, ux, uy = nearest_obstacle(jnp.float32(1.5), jnp.float32(0.2), [])
    assert float(d) == pytest.approx(-0.1)
    assert (float(ux), float(uy)) == (1, 0)


@jax.jit
def rolled(ball, dt, deceleration, num):
    return jax.lax.fori_loop(0, num, lambda _, b: roll_ball(b, dt, deceleration), ball)


@given(
    place=st.tuples(st.floats(-1.3, 1.3), st.floats(-0.8, 0.8)),
    speed=st.floats(0.01, 0.6),
    course=st.floats(-math.pi, math.pi),
    deceleration=st.floats(0.01, 0.5),
    num=st.integers(0, 300),
)
def test_rolling_ball_against_closed_form(place, speed, course, deceleration, num):
    """Constant deceleration until it stops; bounces unfold to a straight line."""
    velocity = speed * math.cos(course), speed * math.sin(course)
    with jax.enable_x64(True):
        start = Ball(*(jnp.float64(n) for n in (*place, *velocity)))
        end = rolled(start, jnp.float64(0.1), jnp.float64(deceleration), num)
    expected = reference.ball_at(place, velocity, deceleration, 0.1 * num)
    assert (float(end.x), float(end.y)) == pytest.approx(expected, abs=1e-9)
    left = max(speed - deceleration * 0.1 * num, 0)
    assert math.hypot(end.vx, end.vy) == pytest.approx(left, abs=1e-9)
    half = FIELD.length / 2 - FIELD.ball_radius, FIELD.width / 2 - FIELD.ball_radius
    assert abs(end.x) <= half[0]
    assert abs(end.y) <= half[1]


def test_a_ball_bounces_and_a_still_one_stays():
    ball = roll_ball(Ball(1.35, 0.0, 0.3, 0.1), 0.1, 0.0)
    assert float(ball.x) == pytest.approx(2 * (1.4 - 0.042) - 1.38)
    assert float(ball.vx) < 0
    assert float(ball.vy) == pytest.approx(0.1)
    still = Ball(0.1, 0.2)
    assert roll_ball(still, 0.1, 0.05) is still
    stopped = roll_ball(Ball(0.1, 0.2, 0.0, 0.0), 0.1, 0.05)
    assert [float(n) for n in stopped] == pytest.approx([0.1, 0.2, 0, 0])


@given(
    place=st.tuples(st.floats(-1.2, 1.2), st.floats(-0.7, 0.7)),
    velocity=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    num=st.integers(1, 300),
)
def test_walking_obstacles_turn_at_the_walls(place, velocity, num):
    assume(max(map(abs, velocity)) > 1e-3)
    with jax.enable_x64(True):
        disc = Disc(*(jnp.float64(n) for n in (*place, 0.12, *velocity)))
        disc = moved(disc, num)
    expected = reference.disc_at((*place, 0.12), velocity, 0.1 * num)
    assert (float(disc.x), float(disc.y), float(disc.radius)) == pytest.approx(expected, abs=1e-9)
    assert abs(disc.vx) == pytest.approx(abs(velocity[0]))


@jax.jit
def moved(disc, num):
    return jax.lax.fori_loop(0, num, lambda _, d: move_disc(d, 0.1), disc)
