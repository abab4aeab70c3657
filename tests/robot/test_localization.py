"""The match's Kalman filter and Monte Carlo: cuthbert as oracle, wrong names, lifted robots."""

import cuthbert
import cuthbert.gaussian.moments
import cuthbert.smc.particle_filter
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cuthbertlib.resampling import systematic

from envs.field import FIELD
from fntg_jax.robot import localization, monte_carlo
from fntg_jax.robot.localization import Noise
from fntg_jax.robot.messages import Displacement, Seen

PLACES = np.array([(mark.x, mark.y) for mark in FIELD.landmarks])
NOISE = Noise(motion=0.2, skid=0.005, turn_skid=0.01, bearing=0.035)
SPREAD = 0.07


def simulate(num, steps, seed, sightings=0.65, wrong=0.0, start=None):
    """Robots that follow the filter's own model: truth [steps, 3, num], ways, landmarks, start.

    Nothing of the code under test is used.
    """
    rng = np.random.default_rng(seed)
    if start is None:
        start = np.stack(
            [rng.uniform(-1, 1, num), rng.uniform(-0.6, 0.6, num), rng.uniform(-3, 3, num)]
        )
    x, y, h = start
    truth, ways, seen = [], [], []
    for _ in range(steps):
        # Towards the middle of the field, more or less.
        error = (np.arctan2(-y, -x) - h + np.pi) % (2 * np.pi) - np.pi
        asked = np.array([np.full(num, 0.015), np.full(num, 0.003), 0.03 * np.clip(error, -1, 1)])
        skid = np.array([NOISE.skid, NOISE.skid, NOISE.turn_skid])[:, None]
        dx, dy, turn = asked + np.hypot(NOISE.motion * asked, skid) * rng.normal(size=asked.shape)
        middle = h + turn / 2
        x = x + np.cos(middle) * dx - np.sin(middle) * dy
        y = y + np.sin(middle) * dx + np.cos(middle) * dy
        h = h + turn
        off_x, off_y = PLACES[:, :1] - x, PLACES[:, 1:] - y
        distance = np.hypot(off_x, off_y)
        bearing = np.arctan2(off_y, off_x) - h
        visible = rng.random(distance.shape) < sightings / len(PLACES)
        # A wrong name: the next landmark's place is what is seen.
        other = (rng.random(distance.shape) < wrong)[None]
        distance, bearing = np.where(other, np.roll([distance, bearing], 1, 1), [distance, bearing])
        distance = distance * (1 + SPREAD * rng.normal(size=distance.shape))
        bearing = bearing + NOISE.bearing * rng.normal(size=bearing.shape)
        truth.append((x, y, h))
        ways.append(asked)
        seen.append((distance, np.cos(bearing), np.sin(bearing), visible))
    way = Displacement(*(jnp.asarray(w, jnp.float32) for w in np.stack(ways, 1)))
    distance, cos, sin = (
        jnp.asarray(np.stack([s[n] for s in seen]), jnp.float32) for n in range(3)
    )
    visible = jnp.asarray(np.stack([s[3] for s in seen]))
    seen = Seen(distance, cos, sin, visible, jnp.full(distance.shape, SPREAD))
    return np.array(truth), way, seen, np.array(start)


@jax.jit
def follow(belief, way, seen):
    """Beliefs after every step."""

    def step(belief, inputs):
        belief = localization.update(belief, *inputs, jnp.asarray(PLACES, jnp.float32), NOISE)
        return belief, belief

    return jax.lax.scan(step, belief, (way, seen))[1]


def begin(start):
    return localization.begin(jnp.asarray(start, jnp.float32), 0.03, 0.05)


def covariance(b):
    return np.array([[b.xx, b.xy, b.xh], [b.xy, b.yy, b.yh], [b.xh, b.yh, b.hh]])


def off(b, truth):
    """Errors in x, y, heading [3, ...]."""
    h = np.arctan2(b.sin, b.cos) - truth[..., 2, :]
    h = (h + np.pi) % (2 * np.pi) - np.pi
    return np.array([b.x - truth[..., 0, :], b.y - truth[..., 1, :], h])


def one_landmark_a_step(seen):
    turn = jnp.arange(seen.visible.shape[0]) % len(PLACES)
    visible = turn[:, None, None] == jnp.arange(len(PLACES))[:, None]
    return seen._replace(visible=jnp.broadcast_to(visible, seen.visible.shape))


def test_the_kalman_filter_is_cuthberts():
    _, way, seen, start = simulate(1, 40, 1)
    seen = one_landmark_a_step(seen)
    ours = follow(begin(start), way, seen)
    which = jnp.argmax(seen.visible[..., 0], axis=1)
    rows = jnp.arange(40)
    bearing = jnp.arctan2(seen.sin[rows, which, 0], seen.cos[rows, which, 0])
    inputs = {
        "way": jnp.stack([w[:, 0] for w in way], -1),
        "mark": jnp.asarray(PLACES)[which],
        "seen": jnp.stack([seen.distance[rows, which, 0], bearing], -1),
    }

    def dynamics(state, u):
        def moments(p):
            middle = p[2] + u["way"][2] / 2
            c, s = jnp.cos(middle), jnp.sin(middle)
            turn = jnp.array([[c, -s], [s, c]])
            sd = jnp.hypot(NOISE.motion * u["way"], jnp.array([*[NOISE.skid] * 2, NOISE.turn_skid]))
            root = jnp.zeros((3, 3)).at[:2, :2].set(turn * sd[:2]).at[2, 2].set(sd[2])
            return p + jnp.append(turn @ u["way"][:2], u["way"][2]), root

        return moments, state.mean

    def observation(state, u):
        def moments(p):
            d = u["mark"] - p[:2]
            distance, direction = jnp.hypot(*d), jnp.arctan2(d[1], d[0]) - p[2]
            near = direction + 2 * jnp.pi * jnp.round((u["seen"][1] - direction) / (2 * jnp.pi))
            return jnp.array([distance, near]), jnp.diag(
                jnp.array([SPREAD * distance, NOISE.bearing])
            )

        return moments, state.mean, u["seen"]

    root = jnp.diag(jnp.array([0.03, 0.03, 0.05]))
    theirs = cuthbert.gaussian.moments.build_filter(
        jnp.asarray(start[:, 0], jnp.float32), root, dynamics, observation
    )
    states = cuthbert.filter(theirs, inputs, theirs.init_prepare())
    assert np.all(ours.doubt == 0)  # all were believed
    np.testing.assert_allclose(off(ours, np.asarray(states.mean)[1:, :, None]), 0, atol=2e-4)
    expected = np.asarray(states.chol_cov @ jnp.swapaxes(states.chol_cov, -1, -2))[1:]
    np.testing.assert_allclose(
        np.moveaxis(covariance(ours)[..., 0], -1, 0), expected, atol=1e-6, rtol=0.02
    )


def test_the_normalised_error_is_inside_its_95_percent_band():
    num = 500
    truth, way, seen, start = simulate(num, 150, 2)
    rng = np.random.default_rng(3)
    beliefs = follow(
        begin(start + np.array([[0.03], [0.03], [0.05]]) * rng.normal(size=start.shape)), way, seen
    )
    last = jax.tree.map(lambda leaf: leaf[-1], beliefs)
    e = off(last, truth[-1]).T[..., None]
    squared = (np.swapaxes(e, 1, 2) @ np.linalg.solve(covariance(last).T, e)).ravel()
    # The mean of num values of chi squared with 3 degrees of freedom.
    assert abs(squared.mean() - 3) < 1.96 * np.sqrt(6 / num)


def test_monte_carlo_is_cuthberts():
    num, steps = 20_000, 12
    _, way, seen, start = simulate(1, steps, 4)
    seen = one_landmark_a_step(seen)
    way, seen = jax.tree.map(lambda leaf: leaf[..., 0], (way, seen))
    marks = jnp.asarray(PLACES)
    first = jnp.asarray(start[:, 0], jnp.float32)

    @jax.jit
    def ours(key):
        def step(p, inputs):
            n, way, seen = inputs
            return monte_carlo.update(jax.random.fold_in(key, n), p, way, seen, marks, NOISE), None

        p = monte_carlo.known(key, num, first, 0.03, 0.05)
        return jax.lax.scan(step, p, (jnp.arange(steps), way, seen))[0]

    p = ours(jax.random.key(0))
    which = jnp.argmax(seen.visible, axis=1)
    rows = jnp.arange(steps)
    inputs = {
        "way": jnp.stack(way, -1),
        "mark": marks[which],
        "distance": seen.distance[rows, which],
        "bearing": jnp.arctan2(seen.sin[rows, which], seen.cos[rows, which]),
    }

    def propagate(key, p, u):
        e = jax.random.normal(key, (3,))
        skid = jnp.array([NOISE.skid, NOISE.skid, NOISE.turn_skid])
        dx, dy, turn = u["way"] + jnp.sqrt((NOISE.motion * u["way"]) ** 2 + skid**2) * e
        c, s = jnp.cos(p[2] + turn / 2), jnp.sin(p[2] + turn / 2)
        return p + jnp.array([c * dx - s * dy, s * dx + c * dy, turn])

    def log_potential(_, p, u):
        d = u["mark"] - p[:2]
        distance = jnp.hypot(*d)
        angle = jnp.arctan2(d[1], d[0]) - p[2] - u["bearing"]
        angle = jnp.arctan2(jnp.sin(angle), jnp.cos(angle))
        sds = jnp.array([SPREAD * distance, NOISE.bearing])
        z = jnp.array([distance - u["distance"], angle]) / sds
        return jnp.log(jnp.exp(-0.5 * z @ z) / distance + monte_carlo.CLUTTER)

    theirs = cuthbert.smc.particle_filter.build_filter(
        lambda key: first + jnp.array([0.03, 0.03, 0.05]) * jax.random.normal(key, (3,)),
        propagate,
        log_potential,
        num,
        systematic.resampling,
    )
    key = jax.random.key(1)
    states = cuthbert.filter(theirs, inputs, theirs.init_prepare(key=key), key=key)
    particles, weights = states.particles[-1], jax.nn.softmax(states.log_weights[-1])
    mean = weights @ particles
    sd = jnp.sqrt(weights @ (particles - mean) ** 2)
    mine = jnp.stack([p.x, p.y, p.heading])
    np.testing.assert_allclose(mine.mean(1), mean, atol=0.1 * float(sd.max()))
    np.testing.assert_allclose(mine.std(1), sd, rtol=0.1)


def test_wrong_names_do_little_harm():
    truth, way, seen, start = simulate(300, 200, 5)
    right = np.hypot(*off(follow(begin(start), way, seen), truth)[:2]).mean()
    truth, way, seen, start = simulate(300, 200, 5, wrong=0.1)
    assert np.hypot(*off(follow(begin(start), way, seen), truth)[:2]).mean() < 1.3 * right


def test_a_robot_that_begins_anywhere_or_is_lifted_finds_itself():
    num = 300
    _, way, seen, start = simulate(num, 50, 6)
    lost = localization.unknown((num,))
    assert np.all(localization.pose(lost).sd >= 1)
    for first in (lost, begin(np.roll(start, 1, axis=1))):  # nobody knows; everybody is wrong
        truth, way, seen, _ = simulate(num, 50, 7, start=start)
        taken = np.hypot(*off(follow(first, way, seen), truth)[:2]) < 0.25
        assert np.mean(taken[-1]) > 0.97
        assert np.median(taken.argmax(axis=0)) < 20


def test_a_batch_in_trailing_axes_is_vmap():
    _, way, seen, start = simulate(5, 8, 8)
    several = follow(begin(start), way, seen)
    one_by_one = jax.vmap(follow, in_axes=(-1, -1, -1), out_axes=-1)(begin(start), way, seen)
    for a, b in zip(jax.tree.leaves(several), jax.tree.leaves(one_by_one)):
        np.testing.assert_allclose(a, b, atol=1e-5)


@pytest.mark.parametrize("heading", [0.0, 3.1, -3.1])
def test_two_landmarks_in_one_picture_give_the_pose(heading):
    x, y = 0.4, -0.3
    d = PLACES - [x, y]
    direction = np.arctan2(d[:, 1], d[:, 0]) - heading
    seen = Seen(
        jnp.asarray(np.hypot(*d.T)),
        jnp.asarray(np.cos(direction)),
        jnp.asarray(np.sin(direction)),
        jnp.arange(6) < 2,
        jnp.full(6, SPREAD),
    )
    still = Displacement(*jnp.zeros(3))
    b = localization.update(
        localization.unknown(), still, seen, jnp.asarray(PLACES, jnp.float32), NOISE
    )
    np.testing.assert_allclose([b.x, b.y, b.cos, b.sin][:2], [x, y], atol=1e-4)
    np.testing.assert_allclose([b.cos, b.sin], [np.cos(heading), np.sin(heading)], atol=1e-4)
    assert b.doubt < localization.LOST
