"""The Python API: the README's example runs, and importing is light."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fntg_jax
from fntg_jax import export
from fntg_jax.running import run_folder
from tests.controllers import random_controller
from tests.small_run import small_run

ROOT = Path(__file__).parents[1]


def examples():
    texts = [path.read_text() for path in sorted(ROOT.glob("README*.md"))]
    return [code for text in texts for code in re.findall(r"```python\n(.*?)```", text, re.S)]


def test_the_readme_has_an_example():
    assert any("fntg.train(" in code for code in examples())


@pytest.mark.parametrize("code", examples())
def test_examples_of_the_readme_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(code, names)
    if "drive" in names:
        assert len(names["v"]) == 2
        assert 0 <= names["success"].low <= names["success"].share <= names["success"].high <= 1


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
    assert export.dumps(fntg_jax.load(folder)) == export.dumps(run_folder.controller(run))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"preset": "no"}, "preset = 'no': known are"),
        ({"generation": 3}, "'generation': unknown; known are"),
        ({"generations": "3"}, "generations = '3': allowed is int"),
        ({"generations": 0}, "generations = 0: allowed are whole numbers from 1"),
        ({"ga": {"populations": 3}}, "'populations': unknown"),
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
