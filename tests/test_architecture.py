"""Who may import whom, read from the source and from a fresh interpreter."""

import ast
import json

import pytest

from tests.conftest import ROOT


def imports(package: str) -> dict[str, set[str]]:
    """Top-level packages that every file of a package imports, anywhere in it."""
    found = {}
    for path in (ROOT / package).rglob("*.py"):
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative import"
                names.add(node.module.split(".")[0])
        found[str(path.relative_to(ROOT))] = names
    return found


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("fntg_jax", {"experiments", "tests", "brax", "mujoco"}),
        ("envs", {"fntg_jax", "experiments", "tests"}),
    ],
)
def test_arrows_between_packages(package, forbidden):
    found = imports(package)
    assert any("jax" in names for names in found.values())  # it does find imports
    assert {path: names & forbidden for path, names in found.items() if names & forbidden} == {}


def test_only_one_file_knows_brax():
    users = {
        path for p in ("fntg_jax", "envs") for path, names in imports(p).items() if "brax" in names
    }
    assert users <= {"envs/brax.py"}


def test_importing_stays_light(python):
    code = """
import json, sys
import fntg_jax, fntg_jax.controller.network, fntg_jax.learning.ga
import fntg_jax.learning.rollout, fntg_jax.export, envs
print(json.dumps(sorted({name.split(".")[0] for name in sys.modules})))
"""
    loaded = set(json.loads(python(code)))
    assert "jax" in loaded
    heavy = {"brax", "mujoco", "matplotlib", "jsonschema", "tyro", "rich", "optax", "scipy.stats"}
    assert not loaded & heavy


def test_the_environment_variables_of_xla_are_the_users(python):
    code = "import os, fntg_jax.running.runner; print(os.environ.get('XLA_FLAGS'))"
    assert python(code).strip() == "None"


def test_flags_can_be_left_out_with_several_devices(python):
    code = """
import os
from fntg_jax.running import xla
xla.configure(num_cpu_devices=2)
import jax
print(os.environ.get("XLA_FLAGS"), len(jax.devices()))
"""
    assert python(code, FNTG_XLA_FLAGS="off").split() == ["None", "2"]


def test_no_drawer_for_everything():
    assert not [p for package in ("fntg_jax", "envs") for p in (ROOT / package).rglob("util*.py")]
