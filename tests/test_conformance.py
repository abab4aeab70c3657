"""Every member of this package keeps the laws; members that break one are found out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import Gene, Task
from envs.kinematic import world as kinematic
from envs.soccer import Match
from fntg_jax import export
from fntg_jax.commands import cli
from fntg_jax.export import c_format, fll_format, numpy_format, verify
from fntg_jax.learning.ga import SELECTIONS
from fntg_jax.running import conformance, registry, xla


def wrong(checks):
    found = list(checks)
    assert found
    return [check for check in found if check.wrong]


SLOW = [pytest.param(n, marks=pytest.mark.slow) for n in ("quadruped", "quadruped-mjx")]


@pytest.mark.parametrize("name", ["kinematic", *SLOW])
def test_worlds(name):
    assert wrong(conformance.world(registry.get_world(name))) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", registry.names(registry.MATCHES))
def test_matches(name):
    assert wrong(conformance.match(registry.get_match(name)())) == []


class Forgetful(Match):
    """One seed for all, and goals against it."""

    def reset(self, kickoff=0, seed=0):
        return super().reset(kickoff, 0 * jnp.asarray(seed))

    def score(self, state):
        return state.statistics.goals - state.game.tick


@pytest.mark.slow
def test_matches_that_break_a_law_are_found_out():
    found = [check.what for check in wrong(conformance.match(Forgetful(players=1), 4))]
    assert found == ["another seed, another match", "goals start at 0 and do not fall"]


@pytest.mark.slow
def test_gait():
    assert wrong(conformance.task(registry.get_task("gait")())) == []


@pytest.mark.parametrize("name", SELECTIONS)
def test_selections(name):
    assert wrong(conformance.selection(SELECTIONS[name])) == []


def _json(text, inputs):
    return np.stack(export.loads(text)(*inputs.T), axis=-1)


def _fll(text, inputs):
    return verify.reference(fll_format.loads(text), inputs)


@pytest.mark.parametrize(
    ("dumps", "commands", "share"),
    [
        (export.dumps, _json, verify.FLOAT32),
        (numpy_format.dumps, numpy_format.commands, verify.FLOAT64),
        (fll_format.dumps, _fll, verify.FLOAT64),
        pytest.param(
            c_format.dumps,
            lambda text, inputs: c_format.run(text, inputs, True).commands,
            verify.FLOAT64,
            marks=pytest.mark.skipif(c_format.compiler() is None, reason="no C compiler"),
        ),
    ],
    ids=["json", "numpy", "fll", "c"],
)
def test_exports(dumps, commands, share):
    assert wrong(conformance.export(dumps, commands, share)) == []


class Broken:
    """The kinematic world with one method replaced."""

    def __init__(self, **methods):
        self._env = kinematic.make()
        self.__dict__.update(methods)

    def __getattr__(self, name):
        return getattr(self._env, name)


def with_env(**methods):
    def make(**options):
        kinematic.make(**options)
        return Broken(**methods)

    return kinematic._replace(make=make)


def nan_step(state, command):
    new = kinematic.make().step(state, command)
    return jax.tree.map(lambda x: x * jnp.nan if jnp.issubdtype(x.dtype, jnp.floating) else x, new)


def recovers(state):
    return kinematic.make().measure(state).d_ball > 0.5


@pytest.mark.parametrize(
    ("world", "what"),
    [
        (kinematic._replace(make=lambda **options: kinematic.make()), "unknown option"),
        (with_env(step=lambda state, command: (state, 0)), "keeps structure"),
        (with_env(step=nan_step), "no NaN"),
        (with_env(failed=lambda state: ~recovers(state) & (state.x > 9)), ""),
    ],
)
def test_worlds_that_break_a_law_are_found_out(world, what):
    found = [check.what for check in wrong(conformance.world(world))]
    assert found == [] if not what else any(what in law for law in found)


@pytest.mark.parametrize(
    ("fitness", "what"),
    [
        (lambda key, theta, memory, progress: (theta, memory), "is [P]"),
        (lambda key, theta, memory, progress: (theta[:, 0], 1.0), "memory"),
        (lambda key, theta, memory, progress: (theta[:, 0] * jnp.nan, memory), "is finite"),
        (lambda key, theta, memory, progress: (theta[:, 0] - 99, memory), "from 0"),
    ],
)
def test_tasks_that_break_a_law_are_found_out(fitness, what):
    genes = (Gene("a", "", 0.0, 1.0),)
    found = [check.what for check in wrong(conformance.task(Task("mine", genes, fitness)))]
    assert any(what in law for law in found)


@pytest.mark.parametrize(
    ("operator", "what"),
    [
        (lambda key, fitness, num, config: jnp.zeros(num), "indices"),
        (lambda key, fitness, num, config: jax.random.randint(key, (num,), 0, 8), "better breed"),
        (lambda key, fitness, num, config: jnp.full(num, 6), "none breeds more"),
    ],
)
def test_selections_that_break_a_law_are_found_out(operator, what):
    assert any(what in check.what for check in wrong(conformance.selection(operator)))


def test_an_export_that_forgets_the_biases_is_found_out():
    def commands(text, inputs):
        controller = export.loads(text)
        return verify.reference(controller, inputs) * 0.999

    assert len(wrong(conformance.export(export.dumps, commands))) == 12


def test_doctor_runs_the_suite_on_a_world_of_ones_own(monkeypatch, capsys):
    monkeypatch.setattr(xla, "configure", lambda **_: None)
    monkeypatch.setitem(registry._registered[registry.WORLDS], "mine", with_env(step=nan_step))
    with pytest.raises(SystemExit) as stop:
        cli.main(["doctor", "--world", "mine"])
    assert stop.value.code == 1
    assert "WRONG: not finite" in capsys.readouterr().out
