"""The structured step and MJX against MuJoCo's C code."""

import copy
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from envs.quadruped import dynamics, physics, rigid_body  # noqa: E402
from envs.quadruped.locomotion import SPEED, limit, load_gait, set_points  # noqa: E402
from envs.quadruped.physics import Solver  # noqa: E402

CONTROL_STEPS, SUBSTEPS = 220, 25
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def model():
    return physics.compile_model("lean", Solver())


def open_loop_set_points(walks=3):
    """Set-points [walks, 5500, 12] of strides that change every two seconds."""
    gait = load_gait()
    ticks = np.arange(CONTROL_STEPS * SUBSTEPS)
    rng = np.random.default_rng(0)
    strides = rng.uniform((-0.1, -0.05, -1.0), (0.25, 0.05, 1.0), (walks, 11, 3))
    # From one stride to the next within half a second: the walk of `follow`, roughly.
    seconds = ticks * Solver().timestep
    knots = np.arange(11) * 2.0
    smooth = np.stack(
        [[np.interp(seconds, knots, strides[w, :, i]) for i in range(3)] for w in range(walks)]
    )
    phases = jnp.asarray(seconds / gait.period % 1, jnp.float32)
    points = jax.vmap(jax.vmap(partial(set_points, gait)), (None, 0))
    points = points(phases, jnp.asarray(smooth.swapaxes(1, 2), jnp.float32))
    # What the servos are asked for.
    most = Solver().timestep * jnp.asarray(SPEED)
    return np.asarray(jax.vmap(lambda p: limit(p, p[0], most))(points))


def native(model, start, points):
    """Coordinates [5500, 19] of one walk in C."""
    data = mujoco.MjData(model)
    data.qpos[:] = start
    path = []
    for ctrl in points:
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data)
        path.append(data.qpos.copy())
    return np.array(path)


def deviation(path, truth):
    """Largest distance of the trunks (m) and largest angle between them (degrees)."""
    place = np.max(np.linalg.norm(path[..., :3] - truth[..., :3], axis=-1))
    # The angle of the rotation between two quaternions, from its sine: exact when small.
    w, v = truth[..., 3:4], truth[..., 4:7]
    pw, pv = path[..., 3:4], path[..., 4:7]
    between = w * pv - pw * v - np.cross(v, pv)
    angle = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(between, axis=-1), 0, 1)))
    return place, np.max(angle)


def simulate(step, start, points):
    """Coordinates [walks, 5500, 19] by one of our steps."""

    def one(points):
        def substep(carry, ctrl):
            new = step(*carry, ctrl)
            return new, new[0]

        return jax.lax.scan(substep, (jnp.asarray(start), jnp.zeros(18)), points)[1]

    return np.asarray(jax.jit(jax.vmap(one))(points))


def test_accelerations_are_those_of_c(model):
    numbers = rigid_body.constants_of(model)
    rest = physics.settled(load_gait(), Solver())
    rng = np.random.default_rng(1)
    data = mujoco.MjData(model)
    low, high = model.jnt_range[1:].T
    states, wanted, contacts = [], [], []
    for n in range(300):
        q = rest.astype(np.float64)
        q[7:] += rng.normal(0, 0.15, 12)
        # Half of them on their elbows, a third with a joint at a limit.
        q[2] += rng.normal(0, 0.01) - 0.03 * (n % 2)
        if n % 3 == 0:
            joint = rng.integers(12)
            q[7 + joint] = (low, high)[n % 2][joint] + rng.normal(0, 0.02)
        turn = np.array([1, *rng.normal(0, 0.15, 3)])
        turn[3] += (n % 3 == 0) * rng.normal(0, 2)
        q[3:7] = turn / np.linalg.norm(turn)
        v, ctrl = rng.normal(0, 0.5, 18), q[7:] + rng.normal(0, 0.2, 12)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, ctrl
        mujoco.mj_forward(model, data)
        states.append((q, v, ctrl))
        wanted.append(data.qacc.copy())
        contacts.append(data.ncon)
    arrays = (jnp.asarray(np.array(x), jnp.float32) for x in zip(*states))
    solve = jax.jit(jax.vmap(lambda *x: dynamics.accelerations(numbers, *x, 8)))
    got, wanted = np.asarray(solve(*arrays)), np.array(wanted)
    error = np.max(np.abs(got - wanted), axis=1) / np.max(np.abs(wanted), axis=1)
    assert set(contacts) >= set(range(7))
    assert np.median(error) < 2e-6
    # A foot within rounding of the floor touches in one precision and not in the other.
    assert np.quantile(error, 0.98) < 1e-4


@pytest.fixture(scope="module")
def walked():
    """Set-points, the start, and where the structured step gets to."""
    points, start = open_loop_set_points(), physics.settled(load_gait(), Solver())
    return points, start, simulate(physics.step_fn(Solver()), start, points)


def test_structured_follows_c_open_loop(model, walked):
    points, start, path = walked
    truth = np.array([native(model, start, p) for p in points])
    assert np.ptp(truth[:, :, :2], axis=1).max() > 0.5  # it walks somewhere
    place, angle = deviation(path, truth)
    assert place < 1e-3
    assert angle < 0.1


def _gain(model):
    model.actuator_gainprm[:, 0] *= 1.01
    model.actuator_biasprm[:, 1] *= 1.01


def _friction(model):
    model.pair_friction[:, :2] *= 0.97


def _mass(model):
    model.body_mass[:] *= 1.01
    model.body_inertia[:] *= 1.01


def _dry_friction(model):
    model.dof_frictionloss[:] *= 1.05


@pytest.mark.parametrize("change", [_gain, _friction, _mass, _dry_friction])
def test_a_slightly_different_model_is_told_apart(change, walked):
    points, start, path = walked
    other = copy.copy(physics.compile_model("lean", Solver()))
    change(other)
    truth = np.array([native(other, start, p) for p in points])
    place, angle = deviation(path, truth)
    assert place > 1e-3
    assert angle > 0.1


def _without_flags(code, timeout):
    """Run Python with XLA as it comes: MJX does not compile under the trainer's flags."""
    env = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=env | {"JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_mjx_follows_c_open_loop(model, tmp_path, impl):
    if impl == "warp":
        pytest.importorskip("warp")
    points = open_loop_set_points()
    start = physics.settled(load_gait(), Solver())
    np.savez(tmp_path / "in.npz", points=points, start=start)
    code = f"""
import numpy as np
from envs.quadruped import physics
from tests.quadruped.test_truth import simulate
given = np.load(r"{tmp_path / "in.npz"}")
path = simulate(physics.step_fn(physics.Solver(impl="{impl}")), given["start"], given["points"])
np.save(r"{tmp_path / "out.npy"}", path)
"""
    done = _without_flags(code, 280)
    assert done.returncode == 0, done.stderr
    assert not done.stdout  # both back ends are fond of talking
    truth = np.array([native(model, start, p) for p in points])
    # Where C itself parts by more than this from a start 1e-6 m higher, rounding decides.
    higher = start + 1e-6 * (np.arange(len(start)) == 2)
    nudged = np.array([native(model, higher, p) for p in points])
    steady = np.abs(nudged - truth)[..., :2].max(axis=(1, 2)) < 1e-4
    assert steady.any()
    place, angle = deviation(np.load(tmp_path / "out.npy")[steady], truth[steady])
    assert place < 1e-3
    assert angle < 0.1


@pytest.mark.slow
def test_batched_mjx_does_not_hang():
    # Two batched Cholesky factorisations at once hang jaxlib for ever; eulerdamp would make two.
    # A hang runs into the time limit.
    code = """
import jax, jax.numpy as jnp, numpy as np
from envs.quadruped import physics
from envs.quadruped.locomotion import load_gait
step = physics.step_fn(physics.Solver(impl="jax"))
rest = jnp.asarray(physics.settled(load_gait(), physics.Solver()))
def one(v):
    ctrl = rest[7:]
    return jax.lax.fori_loop(0, 200, lambda _, s: step(*s, ctrl), (rest, v))[0]
out = jax.jit(jax.vmap(one))(0.01 * jax.random.normal(jax.random.key(0), (240, 18)))
assert np.isfinite(out).all()
"""
    done = _without_flags(code, 200)
    assert done.returncode == 0, done.stderr


def test_structured_step_calls_no_library_that_could_hang():
    step = physics.step_fn(Solver())
    shapes = (jnp.zeros((8, n)) for n in (19, 18, 12))
    text = jax.jit(jax.vmap(step)).lower(*shapes).as_text()
    assert "multiply" in text
    assert "custom_call" not in text


def test_mjx_on_two_cpu_devices_is_refused(tmp_path):
    code = """
import jax
jax.config.update("jax_num_cpu_devices", 2)
from envs.quadruped import physics
try:
    physics.step_fn(physics.Solver(impl="jax"))
except ValueError as error:
    print(error)
"""
    done = _without_flags(code, 100)
    assert "can hang" in done.stdout, done.stderr


def test_missing_warp_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(ValueError, match=r"pip install 'fntg-jax\[warp\]'"):
        physics.step_fn(Solver(impl="warp"))


def test_solver_settings_are_checked():
    with pytest.raises(ValueError, match="impl = 'cpp'"):
        Solver(impl="cpp")
    with pytest.raises(ValueError, match="substeps = 0"):
        Solver(substeps=0)
    with pytest.raises(ValueError, match="iterations = 2"):
        Solver(iterations=2)
