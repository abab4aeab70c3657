"""The Python API: what it takes and refuses, and that importing is light."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fntg_jax
from fntg_jax import export
from fntg_jax.running import controllers, run_folder
from tests.controllers import random_controller
from tests.small_run import small_run


def test_importing_is_light():
    code = "import sys, fntg_jax; print('jax' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"


def test_train_writes_the_run_folder_it_is_asked_for():
    folder = small_run()
    config = json.loads((folder / "config.json").read_text())
    assert (config["generations"], config["ga"]["population"]) == (2, 8)
    assert config["ga"]["mutation_rate"] == 0.001
    run = run_folder.restore(folder)
    assert run.done
    assert export.dumps(fntg_jax.load(folder)) == export.dumps(controllers.of_run(run))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preset": "no"}, "preset = 'no': known are"),
        ({"generation": 3}, "'generation': unknown; known are"),
        ({"generations": "3"}, "generations = '3': allowed is int"),
        ({"generations": 0}, "generations = 0: allowed are whole numbers from 1"),
        ({"ga": {"populations": 3}}, "'populations': unknown"),
        ({"ga": fntg_jax.PaperWeights()}, "allowed is a GAConfig"),
        ({"ga": fntg_jax.GAConfig(population=1)}, "population = 1"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        fntg_jax.train(**options)


def test_a_controller_takes_numbers_and_arrays_and_gives_numpy():
    controller = random_controller()
    v, omega = controller(1.0, 0.4, 0.2, -1.5)
    assert type(v) is type(omega) is float
    vs, omegas = controller(np.full((2, 3), 1.0), 0.4, [0.2, 0.2, 0.2], -1.5)
    assert type(vs) is type(omegas) is np.ndarray
    assert vs.shape == omegas.shape == (2, 3)
    np.testing.assert_allclose(vs, v, rtol=1e-6)
    np.testing.assert_allclose(omegas, omega, rtol=1e-6)


def test_learn_returns_the_whole_run():
    seen: list[fntg_jax.Progress] = []
    ga = fntg_jax.GAConfig(population=8)
    learnt = fntg_jax.learn(ga=ga, generations=3, seeds=2, on_progress=seen.append)
    assert learnt.config.ga == ga
    assert learnt.history.best.shape == learnt.history.mean.shape == (2, 3)
    assert [p.generation for p in seen][-1] == 3
    best = int(np.argmax(learnt.fitness))
    assert learnt.controller == learnt.controllers[best] != learnt.controllers[1 - best]
    # Nothing was refined, and the four starts never change: the best of all generations.
    np.testing.assert_allclose(learnt.fitness, learnt.history.best.max(axis=1), rtol=1e-6)
    assert learnt.controller == fntg_jax.train(ga={"population": 8}, generations=3, seeds=2)
    assert repr(learnt).startswith("Learnt(2 seeds, 3 generations, fitness ")


def test_evaluate_takes_names_files_and_options(tmp_path):
    path = tmp_path / "mine.json"
    controller = fntg_jax.load("bioa")
    fntg_jax.save(controller, path)
    quick = {"suite": "open", "scenes": 100}
    named = fntg_jax.evaluate("bioa", **quick)
    assert fntg_jax.evaluate(str(path), **quick).rates == named.rates
    assert fntg_jax.evaluate(controller, **quick).rates == named.rates
    assert named.rates["success"].share > 0.9
    late = fntg_jax.evaluate("bioa", env_options={"latency": 8}, **quick)
    assert late.rates["success"].share < 0.5
    assert repr(named).startswith("Evaluation('open', 100 scenes: reach ")
    with pytest.raises(ValueError, match="env option 'delay': known are"):
        fntg_jax.evaluate("bioa", env_options={"delay": 8})


def test_a_file_of_that_name_comes_before_the_shipped_controller(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fntg_jax.load("bioa") == fntg_jax.load(fntg_jax.shipped("bioa"))
    (tmp_path / "bioa").write_text(export.dumps(random_controller()))
    assert fntg_jax.load("bioa") == random_controller()
    with pytest.raises(ValueError, match="nobody: No such file"):
        fntg_jax.load("nobody")


def test_everything_public_is_there():
    assert set(fntg_jax.__all__) <= set(dir(fntg_jax))
    for name in fntg_jax.__all__:
        assert getattr(fntg_jax, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        fntg_jax.nothing  # noqa: B018


def test_public_names_stand_in_init_files_and_exist():
    root = Path(fntg_jax.__file__).parents[1]
    for path in [*root.glob("fntg_jax/**/*.py"), *root.glob("envs/**/*.py")]:
        if not re.search(r"^__all__\b", path.read_text(), re.MULTILINE):
            continue
        assert path.name == "__init__.py", path
        module = importlib.import_module(".".join(path.parent.relative_to(root).parts))
        for name in module.__all__:
            if not hasattr(module, name):  # a module of that package
                importlib.import_module(f"{module.__name__}.{name}")
