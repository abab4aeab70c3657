"""Gradient refinement: descends, projects, skips what is not finite, never makes worse; its
gradient against difference quotients; the command."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from envs import kinematic, mix, scenes
from fntg_jax import export, shipped
from fntg_jax.commands import cli
from fntg_jax.controller.layout import LAYOUTS, expand_scalars
from fntg_jax.learning import gradient, objective
from fntg_jax.learning.rollout import trajectory
from fntg_jax.running import xla
from tests.controllers import built_controller, random_controller
from tests.examples import random_thetas

TARGET = jnp.asarray([1.0, -2.0, 7.0])  # the last lies outside the bounds


def bowl(theta, scenes):
    """A noisy quadratic: scenes shift the target a little."""
    return jnp.sum((theta - TARGET - scenes) ** 2, axis=-1)


def run(cost_fn, optimiser, theta, num_steps=100):
    draw = lambda key: 0.01 * jax.random.normal(key, (3,))  # noqa: E731
    key, validation = jax.random.key(0), jnp.zeros(3)
    return jax.jit(
        lambda t: gradient.refine(key, t, cost_fn, draw, validation, optimiser, num_steps)
    )(theta)


def test_every_individual_descends_to_the_projected_minimum():
    starts = jnp.asarray([[0.0, 0.0, 0.0], [4.0, 4.0, -4.0]])
    refined = run(bowl, optax.adam(0.3), starts, 300)
    np.testing.assert_allclose(refined.theta, [[1, -2, 5]] * 2, atol=0.1)
    assert (refined.history[:, 0] == jax.vmap(lambda t: bowl(t, 0.0))(starts)).all()
    assert refined.history.shape == (2, 31)
    assert (refined.num_skipped == 0).all()


def test_it_never_returns_something_worse_than_it_was_given():
    start = jnp.asarray([[1.0, -2.0, 5.0]])  # the best there is
    refined = run(bowl, optax.sgd(100.0), start)
    assert refined.history[0, 1:].min() > refined.history[0, 0]  # the steps do harm
    np.testing.assert_array_equal(refined.theta, start)
    assert refined.cost[0] == refined.history[0, 0]


def test_gradients_that_are_not_finite_are_skipped_and_counted():
    def cliff(theta, scenes):
        # No gradient beyond theta_0 = 0.5: 0 * sqrt'(0) is NaN there.
        return bowl(theta, scenes) + jnp.sqrt(
            jnp.where(theta[:, 0] > 0.5, 0.0, 1.0) * (1 + 0 * theta[:, 0])
        )

    starts = jnp.asarray([[0.0, 0.0, 0.0], [-4.0, 0.0, 0.0]])
    refined = run(cliff, gradient.optimiser("adam", 100, 0.02), starts)
    assert 0 < refined.num_skipped[0] <= 100
    assert refined.num_skipped[1] == 0  # one individual's trouble is not another's
    assert np.isfinite(refined.theta).all() and np.isfinite(refined.cost).all()
    assert (refined.cost < refined.history[:, 0]).all()


def test_updates_that_are_not_finite_are_skipped_too():
    broken = optax.GradientTransformation(
        lambda theta: jnp.zeros((), int),
        lambda g, n, theta: (jnp.where(n % 2, -0.1 * g, jnp.inf), n + 1),
    )
    refined = run(bowl, broken, jnp.asarray([[0.0, 0.0, 0.0]]), 20)
    # A skipped step leaves the optimiser as it was: it stays at the count that breaks it.
    assert refined.num_skipped[0] == 20
    assert (refined.theta == 0).all()


@pytest.mark.parametrize("num_steps", [1, 7, 10, 13])
def test_as_many_steps_as_asked_for(num_steps):
    def slope(theta, scenes):
        return jnp.sum(theta, axis=-1) + 0 * jnp.sum(scenes)

    refined = run(slope, optax.sgd(0.1), jnp.zeros((1, 3)), num_steps)
    np.testing.assert_allclose(refined.theta, -0.1 * num_steps, rtol=1e-5)


@pytest.mark.parametrize("name", ["adam", "sgd", "lion", "nadam"])
def test_optimisers_by_name(name):
    refined = run(bowl, gradient.optimiser(name, 50, 0.05), jnp.zeros((2, 3)), 50)
    assert (refined.cost < refined.history[:, 0]).all()


@pytest.mark.parametrize("name", ["moon", "lbfgs", "polyak_sgd", "apply_updates", "__doc__", ""])
def test_what_is_no_first_order_optimiser_is_refused(name):
    with pytest.raises(ValueError, match=r"optimizer = .*allowed are") as refusal:
        gradient.optimiser(name, 10, 0.1)
    assert "\n" not in str(refusal.value)


def side(path) -> np.ndarray:
    """On which side of the model's jumps and kinks a trajectory is, step by step [..., N, 7]."""
    field, robot = kinematic.FIELD, np.asarray(path.snapshot.robot)
    discs = np.moveaxis(np.asarray(path.snapshot.obstacles), -2, 0)
    x, y = robot[..., 0], robot[..., 1]
    walls = [field.length / 2 - abs(x), field.width / 2 - abs(y)]
    walls += [np.hypot(d[..., 0] - x, d[..., 1] - y) - d[..., 2] for d in discs]
    seen, env = path.measured, kinematic.make()
    v, omega = (np.asarray(c) for c in path.command)
    marks = [
        np.argmin(walls, axis=0),  # the nearest obstacle
        x > 0,  # and which of two walls
        y > 0,
        np.asarray(seen.theta_obstacle) > 0,  # left or right
        np.asarray(seen.theta_ball) > 0,  # includes a jump at +-pi
    ]
    marks = [np.asarray(m)[..., :-1] for m in marks]
    marks += [(v <= env.limits.v_min) - 1 * (v >= env.limits.v_max), abs(omega) < 1.5]
    return np.stack(marks, -1)


@pytest.mark.slow
def test_the_gradient_is_that_of_difference_quotients_away_from_jumps():
    """Reverse mode in float64, every gene, still and moving scenes; trials that change side of a
    jump between the two ends of a quotient are left out, as the docstring says they must be."""
    layout, env, h = LAYOUTS["paper-31"], kinematic.make(), 1e-6
    thetas = 0.5 * random_thetas(layout, 2, seed=5)
    thetas[:, -2] = 2.0  # they move
    late = np.array(export.load(shipped("bioa")).theta)
    late[-2] -= 3.0  # too slow to arrive: a trial that succeeds costs nothing, and has no slope
    thetas = np.vstack([thetas, late])
    drawn = mix.concatenate(
        [scenes.SUITES[n](jax.random.key(3), 3) for n in ("blocked", "moving-ball")]
    )
    with jax.enable_x64(True):
        as_double = lambda x: jnp.asarray(x, jnp.float64 if x.dtype == np.float32 else x.dtype)  # noqa: E731
        drawn = jax.tree.map(lambda x: as_double(x)[:, None], drawn)  # a batch of one each
        batched = objective.smooth_descent(layout, env, scenes.paper, 1, checkpoint=True).cost_fn
        cost_fn = lambda theta, scenes: batched(theta[None], scenes)[0]  # noqa: E731
        slope = jax.jit(jax.vmap(jax.vmap(jax.grad(cost_fn), (None, 0)), (0, None)))
        found = np.asarray(slope(jnp.asarray(thetas), drawn))  # [P, T, genes]

        @jax.jit
        @partial(jax.vmap, in_axes=(0, None))
        @partial(jax.vmap, in_axes=(None, 0))
        def look(theta, scene):
            single = jax.tree.map(lambda x: x[0], scene)
            return cost_fn(theta, scene), trajectory(expand_scalars(layout, theta), single, env)

        # [P, 2, genes, genes]: each gene a little up and a little down.
        ends = thetas[:, None, None] + h * np.stack([np.eye(31), -np.eye(31)])
        cost, path = look(jnp.asarray(ends.reshape(-1, 31)), drawn)
        cost = np.asarray(cost).reshape(3, 2, 31, -1)
        sides = side(path).reshape(3, 2, 31, found.shape[1], -1)
    assert found.dtype == np.float64
    quotient = np.moveaxis((cost[:, 0] - cost[:, 1]) / (2 * h), 1, 2)
    smooth = np.moveaxis((sides[:, 0] == sides[:, 1]).all(-1), 1, 2)
    assert smooth.mean() > 0.9
    assert (np.abs(found).max((1, 2)) > 0.01).all()
    scale = np.abs(found).max(-1, keepdims=True)
    error = np.abs(found - quotient) / np.maximum(scale, 1e-3)
    assert error[smooth].max() < 1e-4


# The command.  The roll-out's gradient takes long to compile: here the cost is a bowl, and only
# the last test is the real thing.


@pytest.fixture
def command(monkeypatch, tmp_path, capsys):
    """Run `fntg refine` in this process and folder: exit status, stdout, stderr."""
    monkeypatch.setattr(xla, "configure", lambda: None)  # for a process of its own
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        try:
            cli.main(["refine", *map(str, arguments)])
            status = 0
        except SystemExit as stop:
            status = stop.code
        return status, *capsys.readouterr()

    return call


@pytest.fixture
def bowl_problem(monkeypatch):
    """Scenes are numbers; the least cost is where all genes are 1."""

    def problem(layout, env, suite, num_scenes, output, seed, checkpoint):
        cost = lambda theta, scenes: jnp.mean((theta - 1) ** 2, axis=-1) + 0 * jnp.sum(scenes)  # noqa: E731
        return objective.Descent(cost, lambda key: jnp.zeros(num_scenes), jnp.zeros(5))

    monkeypatch.setattr(objective, "smooth_descent", problem)
    monkeypatch.setattr("fntg_jax.running.evaluation.held_out_suites", lambda world: ["open"])


@pytest.mark.parametrize("method", ["gradient", "cma"])
def test_the_command_writes_a_controller_that_reads(command, bowl_problem, tmp_path, method):
    start = random_controller("full-63", provenance={"seed": 3})
    export.save(start, tmp_path / "in.json")
    steps = ("--method", method, "--steps", 40)
    status, out, err = command("in.json", *steps, "--rate", 0.05, "--out", "out.json")
    assert (status, out) == (0, "out.json\n"), err
    found = export.load(tmp_path / "out.json")
    before, after = (np.mean((c.theta - 1) ** 2) for c in (start, found))
    assert after < before and f"{before:.5g} before, {after:.5g} after" in err
    assert "held-out scenes" in err and "  open " in err and "skipped" not in err
    assert found.provenance["seed"] == 3 and found.provenance["refine_steps"] == 40
    assert found.provenance["refine_method"] == method
    assert found.provenance["fitness"] == pytest.approx(10 / (0.1 + after), rel=1e-5)


def test_the_command_returns_the_start_where_nothing_is_better(command, bowl_problem, tmp_path):
    export.save(built_controller(), tmp_path / "in.json")  # all genes 1
    text = (tmp_path / "in.json").read_text()
    status, _, err = command("in.json", "--steps", 10, "--rate", 1)
    assert status == 0 and "written as it was" in err
    assert (tmp_path / "refined.json").read_text() == text


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("--steps", 0), ("steps", "0")),
        (("--rate", "nan"), ("rate", "nan")),
        (("--sigma", 0), ("sigma", "0")),
        (("--method", "moon"), ("method", "moon", "cma")),
        (("--scenes", 0), ("scenes", "0")),
        (("--seed", -1), ("seed", "-1")),
        (("--optimizer", "moon"), ("optimizer", "moon", "adam")),
        (("--suite", "moon"), ("suite", "moon", "open")),
        (("--env", "moon"), ("env", "moon", "kinematic")),
        (("--env-options", "dt", 0), ("dt", "0.001")),
        (("--out", "nowhere/x.json"), ("out", "nowhere")),
        (("--out", "."), ("out",)),
    ],
    ids=lambda x: " ".join(map(str, x)),
)
def test_bad_options_are_refused(command, tmp_path, arguments, names):
    status, out, err = command("bioa", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert all(name in err for name in names), err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_refinement_improves_a_random_controller(command, tmp_path):
    export.save(random_controller(seed=1), tmp_path / "in.json")
    options = ("--steps", 30, "--rate", 0.03, "--scenes", 32, "--suite", "open")
    status, _, err = command("in.json", *options)
    assert status == 0, err
    found = export.load(tmp_path / "refined.json")
    assert found.provenance["objective"] == "smooth"
    line = next(x for x in err.split("\n") if "validation scenes" in x).split()
    before, after = (float(line[line.index(word) - 1]) for word in ("before,", "after"))
    assert after < 0.95 * before
