import itertools
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envs import Command, Scene, kinematic, scenes
from fntg_jax.controller.layout import LAYOUTS, expand_scalars
from fntg_jax.learning.rollout import trajectory
from tests import reference
from tests.examples import random_thetas


def scene(start=(0.0, 0.0, 0.0), ball=(1.0, 0.5), obstacles=((0.5, -0.5, 0.1),), **more):
    return Scene(jnp.asarray(start), jnp.asarray(ball), jnp.asarray(obstacles), **more)


@partial(jax.jit, static_argnames="num")
def driven(env, where, v, omega, num):
    """Poses [num + 1, 3] and observations under constant or given commands [num]."""
    v, omega = (jnp.broadcast_to(jnp.asarray(x, jnp.result_type(float)), num) for x in (v, omega))

    def step(state, command):
        new = env.step(state, Command(*command))
        return new, (env.snapshot(new), env.observe(new), env.measure(new))

    first = env.reset(where)
    start = env.snapshot(first), env.observe(first), env.measure(first)
    _, rest = jax.lax.scan(step, first, (v, omega))
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), start, rest)


@given(
    start=st.tuples(st.floats(-1, 1), st.floats(-0.5, 0.5), st.floats(-3, 3)),
    v=st.floats(-0.2, 0.3),
    omega=st.floats(-3, 3),
)
def test_constant_command_is_an_exact_circle(start, v, omega):
    expected = reference.drive(start, v, omega, 60 * 0.1)
    with jax.enable_x64(True):
        poses = driven(kinematic.make(), scene(start), v, omega, 60)[0].robot
        assert poses[-1, :2].tolist() == pytest.approx(expected[:2], abs=1e-9)
        assert reference.wrapped(float(poses[-1, 2]) - expected[2]) == pytest.approx(0, abs=1e-9)
    single = driven(kinematic.make(), scene(start), v, omega, 60)[0].robot
    assert single.dtype == jnp.float32
    assert single[-1, :2].tolist() == pytest.approx(expected[:2], abs=1e-5)


def test_heading_stays_a_unit_vector():
    env = kinematic.make()
    state = jax.lax.fori_loop(
        0, 220, lambda _, s: env.step(s, Command(0.2, 1.5)), env.reset(scene())
    )
    assert float(state.cos**2 + state.sin**2) == pytest.approx(1, abs=1e-4)


def test_observations_are_those_of_the_reference():
    drawn = jax.tree.map(np.asarray, scenes.open_field(jax.random.key(3), 1000))
    env = kinematic.make()
    seen = np.stack(jax.jit(jax.vmap(lambda s: env.observe(env.reset(s))))(drawn), 1)
    for got, start, ball, discs in zip(seen[:200], drawn.start, drawn.ball, drawn.obstacles):
        expected = np.asarray(reference.observe(start.astype(float), ball, discs))
        error = got - expected
        error[2:] = [reference.wrapped(x) for x in error[2:]]
        np.testing.assert_allclose(error, 0, atol=3e-6)


def test_left_is_positive():
    env = kinematic.make()
    seen = env.observe(env.reset(scene(ball=(1.0, 0.5), obstacles=((0.5, -0.3, 0.1),))))
    assert seen.theta_ball > 0 > seen.theta_obstacle
    turned = driven(env, scene(), 0.0, 1.0, 5)[0].robot
    assert float(turned[-1, 2]) == pytest.approx(0.5, abs=1e-6)


def test_closed_loop_converges_with_first_order_in_dt():
    """The controller holds its command for dt, so halving dt halves the error."""
    layout = LAYOUTS["paper-31"]
    where = scene(start=(-1.0, -0.1, 0.4), ball=(0.6, 0.3), obstacles=((-0.3, -0.75, 0.1),))
    seconds = 3.0
    with jax.enable_x64(True):
        where = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), where._replace(seed=0))

        @partial(jax.jit, static_argnames="num")
        @partial(jax.vmap, in_axes=(0, None))
        def end(theta, num):
            env = kinematic.Kinematic(dt=seconds / num)
            path = trajectory(expand_scalars(layout, theta), where, env, num_steps=num)
            return path.snapshot.robot[-1, :2]

        thetas = 0.25 * random_thetas(layout, 6, seed=11)
        # Always "far" and under way: the labels of theta_O jump at 0, which has no order.
        fixed = {"a_B1": -5, "c_B1": -5, "a_B2": 5, "c_B2": -5, "b_21": 2.0}
        for gene, value in fixed.items():
            thetas[:, [g.name for g in layout.genes].index(gene)] = value
        ends = [np.asarray(end(thetas, num)) for num in (80, 160, 320, 640)]
    steps = [np.linalg.norm(a - b) for a, b in itertools.pairwise(ends)]
    assert steps[0] > 1e-5
    np.testing.assert_allclose(np.log2(np.divide(steps[:-1], steps[1:])), 1, atol=0.1)


def speeds(env, v, omega, num=60):
    """(v, omega) of the body, step by step, from its poses."""
    poses = driven(env, scene(start=(-0.3, 0.2, 0.0)), v, omega, num)[0].robot
    v = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) / 0.1
    turn = np.unwrap(np.asarray(poses[:, 2]))
    return v, np.diff(turn) / 0.1


def test_options_are_off_by_default():
    env = kinematic.make()
    assert env == kinematic.Kinematic()
    assert (env.actuation, env.sensing, env.latency) == (None, None, 0)
    v, omega = speeds(env, 0.2, 0.5, 3)
    np.testing.assert_allclose(v, 0.2, rtol=1e-2)  # chord for arc
    np.testing.assert_allclose(omega, 0.5, rtol=1e-4)
    _, seen, truth = driven(env, scene(), 0.1, 0.3, 5)
    jax.tree.map(np.testing.assert_array_equal, seen, truth)


def test_acceleration_is_limited():
    v, _ = speeds(kinematic.make(v_rate=0.1, lag=0.0), 0.2, 0.0)
    np.testing.assert_allclose(v[:25], np.minimum(0.01 * np.arange(1, 26), 0.2), atol=1e-5)
    _, omega = speeds(kinematic.make(omega_rate=0.5, lag=0.0), 0.0, 0.3)
    np.testing.assert_allclose(omega[:8], np.minimum(0.05 * np.arange(1, 9), 0.3), atol=1e-4)


def test_lag_is_first_order():
    v, _ = speeds(kinematic.make(lag=0.5, v_rate=100, omega_rate=1000), 0.2, 0.0)
    expected = 0.2 * (1 - np.exp(-0.1 * np.arange(1, 61) / 0.5))
    np.testing.assert_allclose(v, expected, atol=1e-5)


@pytest.mark.parametrize("latency", [1, 2, 5])
def test_latency_shows_the_past(latency):
    """After n steps the controller sees the truth of step n - latency (the start, before)."""
    _, seen, truth = driven(kinematic.make(latency=latency), scene(), 0.2, 0.3, 20)
    age = np.maximum(np.arange(21) - latency, 0)
    # Two compilations of the same measurement may round differently.
    near = lambda a, b: np.testing.assert_allclose(a, b[age], atol=1e-6)  # noqa: E731
    jax.tree.map(near, seen, truth)


def test_noise_has_its_spread_and_follows_the_seed():
    env = kinematic.make(angle_noise=0.05, range_noise=0.1)
    _, seen, truth = driven(env, scene(seed=7), 0.0, 0.0, 2000)
    far, near = seen.d_ball / truth.d_ball - 1, seen.d_obstacle / truth.d_obstacle - 1
    turns = seen.theta_ball - truth.theta_ball, seen.theta_obstacle - truth.theta_obstacle
    draws = np.stack([far / 0.1, near / 0.1, *(t / 0.05 for t in turns)])
    np.testing.assert_allclose(draws.mean(1), 0, atol=5 / math.sqrt(2000))
    np.testing.assert_allclose(draws.std(1), 1, atol=5 / math.sqrt(2 * 2000))
    np.testing.assert_allclose(np.corrcoef(draws), np.eye(4), atol=0.12)
    assert abs(np.corrcoef(far[1:], far[:-1])[0, 1]) < 0.12  # anew every step
    again = driven(env, scene(seed=7), 0.0, 0.0, 2000)[1]
    other = driven(env, scene(seed=8), 0.0, 0.0, 2000)[1]
    np.testing.assert_array_equal(seen.d_ball, again.d_ball)
    assert not np.array_equal(seen.d_ball, other.d_ball)


def test_noisy_angles_stay_wrapped():
    env = kinematic.make(angle_noise=0.5)
    behind = scene(ball=(-1.0, 0.0), seed=1)
    _, seen, _ = driven(env, behind, 0.0, 0.0, 500)
    angles = np.asarray(seen.theta_ball)
    assert np.abs(angles).max() <= math.pi + 1e-6
    assert (angles > 2).any()
    assert (angles < -2).any()


QUIET = {"angle_noise": 0.0, "range_noise": 0.0}
EXACT = {"v_rate": 100.0, "omega_rate": 1000.0, "lag": 0.0}


def test_a_lost_frame_repeats_the_last_one():
    _, seen, truth = driven(kinematic.make(dropout=1, **QUIET), scene(), 0.2, 0.0, 20)
    np.testing.assert_array_equal(seen.d_ball, np.full(21, truth.d_ball[0]))
    env = kinematic.make(dropout=0.3, **QUIET)
    _, seen, truth = driven(env, scene(seed=3), 0.001, 0.0, 1000)
    d_ball = np.asarray(seen.d_ball)
    # Two compilations of the same frame may round differently; a step is 9e-5 m.
    repeated = np.abs(np.diff(d_ball)) < 1e-5
    assert abs(repeated.mean() - 0.3) < 5 * math.sqrt(0.21 / 1000)
    np.testing.assert_allclose(d_ball[1:][~repeated], truth.d_ball[1:][~repeated], atol=1e-6)


def test_a_ball_out_of_view_stays_where_it_was_seen_last():
    # The robot turns on the spot, once around; obstacles are seen all the time.
    env = kinematic.make(view=1.0, **QUIET)
    _, seen, truth = driven(env, scene(ball=(1.0, 0.0)), 0.0, 0.5, 126)
    visible = np.abs(truth.theta_ball) < 0.5
    assert 10 < visible.sum() < 40
    np.testing.assert_allclose(seen.theta_ball[visible], truth.theta_ball[visible], atol=1e-6)
    last = float(truth.theta_ball[:60][visible[:60]][-1])
    np.testing.assert_allclose(seen.theta_ball[30:100], last, atol=1e-6)
    np.testing.assert_allclose(seen.theta_obstacle, truth.theta_obstacle, atol=1e-6)


def test_slip_has_its_spread_and_a_body_its_top_speed():
    v, _ = speeds(kinematic.make(slip=0.2, **EXACT), 0.2, 0.0, 1000)
    np.testing.assert_allclose(v.mean(), 0.2, atol=5 * 0.04 / math.sqrt(1000))
    np.testing.assert_allclose(v.std(), 0.04, rtol=0.15)
    v, _ = speeds(kinematic.make(v_top=0.05, **EXACT), 0.2, 0.0, 5)
    np.testing.assert_allclose(v, 0.05, rtol=1e-3)
    v, _ = speeds(kinematic.make(slip=0.0, **EXACT), 0.2, 0.0, 5)
    np.testing.assert_allclose(v, 0.2, rtol=1e-3)


def test_ball_and_obstacles_move_as_the_reference_says():
    where = scene(
        ball_velocity=jnp.asarray([0.25, 0.2]), obstacle_velocity=jnp.asarray([[0.1, -0.05]])
    )
    with jax.enable_x64(True):
        where = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), where._replace(seed=0))
        places, _, _ = driven(kinematic.make(), where, 0.0, 0.0, 220)
    where = jax.tree.map(lambda x: np.asarray(x, np.float64), where)
    for n in range(0, 221, 20):
        ball = reference.ball_at(where.ball, where.ball_velocity, 0.05, 0.1 * n)
        disc = reference.disc_at(where.obstacles[0], where.obstacle_velocity[0], 0.1 * n)
        np.testing.assert_allclose(places.ball[n], ball, atol=1e-9)
        np.testing.assert_allclose(places.obstacles[n, 0], disc, atol=1e-9)


def mirrored(where):
    return where._replace(
        start=where.start * jnp.asarray([1.0, -1.0, -1.0]),
        ball=where.ball * jnp.asarray([1.0, -1.0]),
        obstacles=where.obstacles * jnp.asarray([1.0, -1.0, 1.0]),
    )


def test_mirrored_scenes_give_mirrored_paths():
    layout, env = LAYOUTS["mirror-28"], kinematic.make()
    where = scene(start=(-1.0, -0.1, 0.4), ball=(0.6, 0.3), obstacles=((-0.3, 0.1, 0.1),))

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    def paths(theta, where):
        return trajectory(expand_scalars(layout, theta), where, env).snapshot.robot

    with jax.enable_x64(True):
        thetas = jnp.asarray(random_thetas(layout, 30))
        where = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), where._replace(seed=0))
        there, back = (np.asarray(paths(thetas, w)) for w in (where, mirrored(where)))
    np.testing.assert_allclose(there[..., :2], back[..., :2] * [1, -1], atol=1e-6)
    assert np.ptp(there[:, -1, 1]) > 0.5  # they do go different ways


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 0.0}, r"dt = 0.0.*0.001 to 1"),
        ({"dt": math.nan}, r"dt = nan"),
        ({"lag": -1}, r"lag = -1.*0 to 10"),
        ({"dropout": 1.5}, r"dropout = 1.5.*0 to 1"),
        ({"latency": 1.5}, r"latency = 1.5.*whole"),
        ({"v_min": 0.3}, r"v_min = 0.3.*v_max = 0.2"),
        ({"speed": 1}, r"'speed'.*dt"),
    ],
)
def test_bad_options_are_refused_by_name(options, message):
    with pytest.raises(ValueError, match=message):
        kinematic.make(**options)


def test_a_sideways_command_moves_along_the_turned_arc():
    env, v, v_y, omega = kinematic.make(), 0.12, -0.05, 0.7
    state = env.step(env.reset(scene(start=(0.2, -0.1, 0.5))), Command(v, omega, v_y))
    # Fine Euler steps of the definition.
    x, y, heading, n = 0.2, -0.1, 0.5, 20000
    for _ in range(n):
        x += (v * np.cos(heading) - v_y * np.sin(heading)) * env.dt / n
        y += (v * np.sin(heading) + v_y * np.cos(heading)) * env.dt / n
        heading += omega * env.dt / n
    np.testing.assert_allclose([state.x, state.y], [x, y], atol=1e-6)
    np.testing.assert_allclose(
        [state.cos, state.sin], [np.cos(heading), np.sin(heading)], atol=1e-6
    )
