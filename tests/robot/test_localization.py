import jax
import jax.numpy as jnp
import numpy as np

from envs.field import FIELD
from fntg_jax.robot import localization
from fntg_jax.robot.geometry import unit
from fntg_jax.robot.messages import Displacement

MAP = np.array([(mark.x, mark.y) for mark in FIELD.landmarks])


def drive(seed, num_steps=400, wrong=0.0, start_error=(0.0, 0.0, 0.0)):
    """Errors (m, rad) and normalised errors squared of a robot that circles and looks about."""
    rng = np.random.default_rng(seed)
    truth = np.array([-0.6, -0.3, 0.4])
    belief = localization.begin(jnp.asarray(truth + start_error))
    update = jax.jit(localization.update)
    errors, squares = [], []
    for n in range(num_steps):
        step = np.array([0.012, 0.0, 0.03])
        c, s = np.cos(truth[2]), np.sin(truth[2])
        truth = truth + np.array([c * step[0], s * step[0], step[2]])
        noisy = step * (1 + 0.08 * rng.normal(size=3))
        to = MAP - truth[:2]
        far, angle = np.hypot(*to.T), np.arctan2(to[:, 1], to[:, 0]) - truth[2]
        pan = 1.5 * np.sin(0.4 * n)
        off = (angle - pan + np.pi) % (2 * np.pi) - np.pi
        visible = np.abs(off) < 0.5
        far = far * (1 + 0.07 * rng.normal(size=6))
        angle = angle + 0.035 * rng.normal(size=6)
        marks = MAP.copy()
        if rng.random() < wrong:
            far, angle = np.roll(far, 1), np.roll(angle, 1)
        belief = update(
            belief,
            Displacement(*jnp.asarray(noisy)),
            unit(jnp.asarray(noisy[2])),
            *(jnp.asarray(x) for x in (far, np.cos(angle), np.sin(angle), visible)),
            jnp.full(6, 0.07),
            jnp.asarray(marks),
        )
        b = jax.tree.map(float, belief)
        turn = np.arctan2(b.sin, b.cos) - truth[2]
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        e = np.array([b.x - truth[0], b.y - truth[1], turn])
        cov = np.array([[b.xx, b.xy, b.xt], [b.xy, b.yy, b.yt], [b.xt, b.yt, b.tt]])
        errors.append((np.hypot(*e[:2]), abs(turn)))
        squares.append(e @ np.linalg.solve(cov, e))
    return np.array(errors), np.array(squares)


def test_it_follows_and_is_consistent():
    errors, squares = zip(*(drive(seed) for seed in range(6)))
    assert np.mean([e[50:, 0].mean() for e in errors]) < 0.05
    # Three numbers: a filter that is right has a mean of 3; ours may doubt itself, not boast.
    assert 0.5 < np.mean([s[50:].mean() for s in squares]) < 4.0


def test_wrong_identities_do_not_throw_it():
    assert np.mean([drive(seed, wrong=0.1)[0][50:, 0].mean() for seed in range(4)]) < 0.07


def test_a_robot_put_elsewhere_finds_itself():
    late = [drive(seed, start_error=(0.5, 0.3, 0.5))[0][-100:, 0].mean() for seed in range(5)]
    assert np.median(late) < 0.1
