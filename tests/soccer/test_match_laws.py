"""Laws of the match: mirror images, energy, walls, no NaN, fast balls, contract."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Action, Command, Scene, Walk
from envs.scenes import BALL_DECELERATION
from envs.soccer import Match, noise
from envs.soccer.state import RollingBall

MATCH = Match(minutes=1)
N, R, B = 3, 6, 16
STEP = jax.jit(MATCH.step_batch)
SENSE = jax.jit(MATCH.sense_batch)
KICK_MIRRORED = np.array([0, 1, 3, 2, 4])


def random_actions(steps, seed, wild=1.0, batch=B, robots=R):
    rng = np.random.default_rng(seed)
    many = (steps, robots, batch)
    f = lambda scale, shape=many: rng.uniform(-scale, scale, shape).astype(np.float32)  # noqa: E731
    whole = lambda top, p: rng.integers(1, top, many) * (rng.random(many) < p)  # noqa: E731
    return Action(
        Walk(
            rng.integers(0, 9, many).astype(np.int32), f(0.3 * wild), f(0.1 * wild), f(1.5 * wild)
        ),
        f(1.5, (steps, 3, robots, batch)),
        whole(5, 0.1).astype(np.int32),
        whole(5, 0.1).astype(np.int32),
        (rng.integers(0, 9, (steps, 2, robots, batch)) * (rng.random(many)[:, None] < 0.05)).astype(
            np.uint32
        ),
    )


def swapped(state):
    """The same match turned by half a turn, with the teams' names exchanged."""
    other = np.roll(np.arange(R), N)
    r = jax.tree.map(lambda a: a[other], state.robots)
    r = r._replace(**{k: -getattr(r, k) for k in ("x", "y", "cos", "sin", "push_x", "push_y")})
    ball = jax.tree.map(lambda a: -a, state.ball)
    t = state.talk
    talk = t._replace(
        low=t.low[other],
        high=t.high[other],
        left=t.left[other],
        garbled=t.garbled[other][:, other],
        arrived=t.arrived[other][:, other],
    )
    g = state.game
    game = g._replace(
        first=1 - g.first,
        kicker=1 - g.kicker,
        spot_x=-g.spot_x,
        spot_y=-g.spot_y,
        toucher=jnp.where(g.toucher < 0, -1, (g.toucher + N) % R),
        shot=jnp.where(g.shot == 0, 0, 3 - g.shot),
        caller=g.caller,
    )
    return state._replace(
        robots=r,
        ball=ball,
        talk=talk,
        game=game,
        statistics=jax.tree.map(lambda a: a[::-1], state.statistics),
    )


ODD = (
    "y",
    "sin",
    "v_y",
    "omega",
    "pan",
    "roll",
    "odometry_y",
    "odometry_turn",
    "turned",
    "push_y",
    "gained_y",
)


def reflected(state):
    """The match in a mirror along the x axis."""
    r = state.robots
    r = r._replace(**{k: -getattr(r, k) for k in ODD})
    r = r._replace(doing=jnp.where(r.doing < 5, jnp.asarray(KICK_MIRRORED)[r.doing % 5], r.doing))
    ball = state.ball._replace(y=-state.ball.y, vy=-state.ball.vy)
    game = state.game._replace(spot_y=-state.game.spot_y, hand=-state.game.hand)
    return state._replace(robots=r, ball=ball, game=game)


def reflected_action(a):
    walk = a.walk._replace(v_y=-a.walk.v_y, omega=-a.walk.omega)
    head = a.head * np.array([1, -1, -1], np.float32)[:, None, None]
    return a._replace(walk=walk, head=head, kick=KICK_MIRRORED[a.kick].astype(np.int32))


def same(a, b, skip=("caller",)):
    for part, other in zip(a, b):
        for name, x, y in zip(part._fields, part, other):
            if name not in skip:
                np.testing.assert_allclose(
                    np.asarray(x, float), np.asarray(y, float), atol=1e-5, err_msg=name
                )


def start(seed=0):
    return MATCH.reset(np.arange(B) % 2, seed + np.arange(B))


LONG = pytest.param(600, marks=pytest.mark.slow)  # stuck balls and their ties included


@pytest.mark.parametrize("steps", [150, LONG])
def test_exchanging_the_teams_mirrors_the_match(steps):
    state = start()
    mirror = swapped(start())
    for n in range(steps):
        action = jax.tree.map(lambda a, n=n: a[n % 150], ACTIONS)
        other = jax.tree.map(lambda a: np.roll(a, N, axis=-2), action)
        state, mirror = STEP(state, action), STEP(mirror, other)
    same(swapped(state), mirror)
    a, b = SENSE(state), SENSE(mirror)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b)):
        np.testing.assert_allclose(np.roll(np.asarray(x, float), N, axis=-2), y, atol=1e-5)


@pytest.mark.parametrize("steps", [150, LONG])
def test_a_mirror_along_x_mirrors_the_match(steps):
    state, mirror = start(), reflected(start())
    for n in range(steps):
        action = jax.tree.map(lambda a, n=n: a[n % 150], ACTIONS)
        state, mirror = STEP(state, action), STEP(mirror, reflected_action(action))
    same(reflected(state), mirror)
    a, b = SENSE(state), SENSE(mirror)
    marks = [0, 4, 5, 6, 1, 2, 3, *range(7, 14)]
    np.testing.assert_allclose(-a.frame.bearing[np.array(marks)], b.frame.bearing, atol=1e-5)
    np.testing.assert_array_equal(a.frame.visible[np.array(marks)], b.frame.visible)
    np.testing.assert_allclose(a.proximity, b.proximity, atol=1e-5)
    np.testing.assert_allclose(-a.gyro[2], b.gyro[2], atol=1e-5)


ACTIONS = random_actions(150, 1)


@pytest.mark.slow
def test_1e8_random_steps_stay_finite_and_on_the_field():
    """Whole matches of wild actions, drawn within: 10^8 steps in about a minute and a half."""
    match, batch = Match(minutes=10), 64

    def act(state):
        r, tick = state.robots, state.game.tick
        key = noise.key(state.game.seed ^ jnp.uint32(0xABCD), tick, r.lane)
        held = noise.key(state.game.seed ^ jnp.uint32(0x1234), tick // 15, r.lane)
        wide = lambda key, n, most: most * (2 * noise.uniform(key, 200 + n) - 1)  # noqa: E731
        whole = lambda n, top: (noise.uniform(key, 200 + n) * top).astype(jnp.int32)  # noqa: E731
        rarely = lambda n, x: jnp.where(noise.uniform(key, 200 + n) < 0.1, x, 0)  # noqa: E731
        return Action(
            Walk(whole(0, 10), wide(held, 1, 0.5), wide(held, 2, 0.2), wide(held, 3, 3.0)),
            jnp.stack([wide(key, n, 2.0) for n in (4, 5, 6)]),
            rarely(7, whole(8, 6)),
            rarely(9, whole(10, 6)),
            jnp.stack([rarely(11, noise.bits(key, 212)), rarely(11, noise.bits(key, 213))]),
        )

    @jax.jit
    def run(seeds):
        def step(carry, _):
            state, worst = carry
            state = match.step_batch(state, act(state))
            r = state.robots
            out = jnp.maximum(abs(r.x) - 1.7, abs(r.y) - 0.9)
            ball = jnp.maximum(abs(state.ball.x) - 1.7, abs(state.ball.y) - 0.9)
            far = jnp.maximum(jnp.where(r.out <= 0, out, -1).max(0), ball)
            return (state, jnp.maximum(worst, far)), None

        carry = match.reset(seeds % 2, seeds), jnp.full(batch, -1.0)
        return jax.lax.scan(step, carry, None, length=match.steps)[0]

    for first in range(0, -(-(10**8) // match.steps), batch):
        state, worst = run(first + jnp.arange(batch))
        for leaf in jax.tree.leaves(state):
            assert np.isfinite(np.asarray(leaf, float)).all()
        assert float(worst.max()) < 0 and (state.game.phase == 3).all()


def test_one_rolling_law():
    assert MATCH.rolling.deceleration == BALL_DECELERATION


@pytest.mark.slow
def test_run_out_as_in_the_full_model():
    """A ball that leaves a dog as slowly as one that is pushed (0.2 m/s) and as fast as one that is
    kicked (0.36 m/s, envs/quadruped/data/kicks.json) rolls as far as in MuJoCo, within 15 %."""
    from envs.quadruped import make, mjcf, native

    speeds = np.array([0.2, 0.36], np.float32)
    start = np.tile(np.array([-1.2, 0.6, 0.0], np.float32), (2, 1))
    ball = np.tile(np.array([-1.0, -0.2], np.float32), (2, 1))
    velocity = np.stack([speeds, 0 * speeds], 1)
    scenes = Scene(
        start, ball, np.zeros((2, 0, 3), np.float32), ball_velocity=velocity, seed=np.zeros(2, int)
    )
    still = lambda seen, n: Command(jnp.zeros(2), jnp.zeros(2))  # noqa: E731
    path = native.run(make(), scenes, still, mjcf.FULL, num_steps=85).ball
    assert np.abs(path[-1] - path[-2]).max() < 1e-3  # it lies still
    full = np.linalg.norm(path[-1] - path[0], axis=1)
    match, mine = Match(players=1), []
    step = jax.jit(match.step)
    nothing = jax.tree.map(lambda a: np.zeros((2, *a.shape[1:-2]), a.dtype), ACTIONS)
    for speed in speeds:
        robots = jnp.array([[-1.2, 0.6, 0], [1.2, 0.6, 0]])
        state = match.place(match.reset(0, 0), robots, jnp.array([-1.0, -0.2, speed, 0]))
        for _ in range(85):
            state = step(state, nothing)
        mine.append(float(jnp.hypot(state.ball.x + 1.0, state.ball.y + 0.2)))
    np.testing.assert_allclose(mine, full, rtol=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("players", [1, 5])
def test_random_play_stays_finite_and_on_the_field(players):
    match = Match(players=players, minutes=0.5)
    robots, batch = match.robots, 128
    actions = random_actions(50, 2, 5.0, batch, robots)

    @jax.jit
    def run(state):
        def step(carry, n):
            state, worst = carry
            action = jax.tree.map(lambda a: jnp.asarray(a)[n % 50], actions)
            state = match.step_batch(state, action)
            on = state.robots.out <= 0
            far = jnp.where(
                on, jnp.maximum(abs(state.robots.x) - 1.7, abs(state.robots.y) - 0.9), -1
            )
            ball = jnp.maximum(abs(state.ball.x) - 1.7, abs(state.ball.y) - 0.9)
            worst = jnp.maximum(worst, jnp.maximum(far.max(), ball.max()))
            return (state, worst), None

        return jax.lax.scan(step, (state, jnp.float32(-1.0)), jnp.arange(700))

    (state, worst), _ = run(match.reset(np.zeros(batch, int), np.arange(batch)))
    # What is not a number stays so: it is seen at the end.
    for leaf in jax.tree.leaves((state, match.sense_batch(state))):
        assert np.isfinite(np.asarray(leaf, float)).all()
    assert worst < 0
    assert (state.game.phase == 3).all()
    assert state.statistics.touches.sum() > 0


def test_energy_never_grows_without_a_kick():
    rng = np.random.default_rng(0)
    batch = 128
    state = MATCH.reset(np.zeros(batch, int), np.arange(batch))
    state = state._replace(game=state.game._replace(phase=jnp.zeros(batch, jnp.int32)))
    state = state._replace(
        ball=RollingBall(
            *(jnp.asarray(rng.uniform(-w, w, batch), jnp.float32) for w in (1.3, 0.8, 3.0, 3.0))
        )
    )
    nothing = jax.tree.map(lambda a: np.zeros((*a.shape[1:-1], batch), a.dtype), ACTIONS)
    energy = state.ball.vx**2 + state.ball.vy**2
    for _ in range(40):
        goals = np.asarray(state.statistics.goals.sum(0))
        state = STEP(state, nothing)
        new = state.ball.vx**2 + state.ball.vy**2
        assert (new <= energy * (1 + 1e-6) + 1e-9).all()
        assert (np.asarray(state.statistics.goals.sum(0)) >= goals).all()
        energy = new


def test_a_ball_of_3_m_per_s_passes_through_nothing():
    """Fired at bodies at every angle, it never comes out behind them."""
    batch = 256
    match = Match(players=1)
    state = match.reset(np.zeros(batch, int), np.arange(batch))
    turn = np.linspace(0, 2 * np.pi, batch, endpoint=False)
    start_x = np.random.default_rng(1).uniform(-0.7, -0.4, batch)
    zero = jnp.zeros(batch)
    robots = state.robots._replace(
        x=jnp.stack([zero, zero + 1.2]),
        y=jnp.stack([zero, zero + 0.7]),
        cos=jnp.asarray(np.stack([np.cos(turn)] * 2), jnp.float32),
        sin=jnp.asarray(np.stack([np.sin(turn)] * 2), jnp.float32),
    )
    ball = RollingBall(jnp.asarray(start_x, jnp.float32), zero, zero + 3.0, zero)
    state = state._replace(
        robots=robots, ball=ball, game=state.game._replace(phase=zero.astype(int))
    )
    nothing = jax.tree.map(lambda a: np.zeros((*a.shape[1:-2], 2, batch), a.dtype), ACTIONS)
    step = jax.jit(match.step_batch)
    for _ in range(6):
        state = step(state, nothing)
        # Straight through: behind the body and still near its axis of flight.
        assert not ((np.asarray(state.ball.x) > 0.1) & (abs(np.asarray(state.ball.y)) < 0.02)).any()


@pytest.mark.parametrize(
    "bodies", [("ers210", "ers210"), ("wheels", "wheels"), ("ers210", "wheels")]
)
def test_contract(bodies):
    """Pure, vmap = one by one, one compile, constant structure, a seed decides everything."""
    match = Match(players=2, home=bodies[0], away=bodies[1], minutes=0.2)
    traces = []

    @jax.jit
    def step(state, action):
        traces.append(1)
        return match.step(state, action)

    actions = random_actions(20, 3, batch=1, robots=4)
    one = lambda n: jax.tree.map(lambda a: np.moveaxis(a[n, ..., 0], -1, 0), actions)  # noqa: E731
    ends = []
    for seed in (5, 5, 6):
        state = jax.jit(match.reset)(0, seed)
        like = jax.tree.map(lambda a: (a.shape, a.dtype), state)
        for n in range(20):
            state = step(state, one(n))
        assert jax.tree.map(lambda a: (a.shape, a.dtype), state) == like
        ends.append(state)
    assert len(traces) == 1
    same(ends[0], ends[1], skip=())
    assert not np.array_equal(ends[0].robots.x, ends[2].robots.x)
    both = jax.vmap(match.step)(
        jax.tree.map(lambda a, b: jnp.stack([a, b]), ends[0], ends[2]),
        jax.tree.map(lambda a: np.stack([a, a]), one(0)),
    )
    same(jax.tree.map(lambda a: a[1], both), match.step(ends[2], one(0)))
