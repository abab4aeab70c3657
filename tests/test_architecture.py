"""Who may import whom, read from the source and from a fresh interpreter."""

import ast
import json
from pathlib import Path

import pytest

from tests.conftest import ROOT

# Rooms of the house, and which rooms each may import.  "fntg_jax" is the face, its __init__.
ARROWS = {
    "envs": set(),
    "fntg_jax.files": set(),
    "fntg_jax.robot": {"envs.base"},
    "fntg_jax.controller": {"envs.base"},
    "fntg_jax.learning": {"envs.base", "fntg_jax.controller", "fntg_jax.robot"},
    "fntg_jax.export": {"envs.base", "fntg_jax.controller", "fntg_jax.robot", "fntg_jax.files"},
    # A team is a `learning.play.Side`.
    "fntg_jax.teams": {
        *("envs.base", "fntg_jax.robot", "fntg_jax.controller", "fntg_jax.export"),
        *("fntg_jax.files", "fntg_jax.learning"),
    },
}
ARROWS["fntg_jax.running"] = ARROWS["fntg_jax.teams"] | {"fntg_jax.learning", "fntg_jax.teams"}
ARROWS["fntg_jax.showing"] = ARROWS["fntg_jax.running"] | {"fntg_jax.running"}
ARROWS["fntg_jax.gym"] = ARROWS["fntg_jax.showing"]
# What users import: it may use everything but the command line.
ARROWS["fntg_jax"] = ARROWS["fntg_jax.showing"] | {"fntg_jax.showing", "fntg_jax.gym"}
ARROWS["fntg_jax.commands"] = ARROWS["fntg_jax"] | {"fntg_jax"}
PACKAGES = ("fntg_jax", "envs", "experiments", "tests")


def graph(root: Path, *packages: str) -> dict[str, set[str]]:
    """Module -> modules of our packages that it imports, anywhere in it: also inside functions,
    under TYPE_CHECKING and through `importlib.import_module("...")`."""
    files = {
        ".".join(p.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): p
        for package in packages
        for p in (root / package).rglob("*.py")
    }
    found: dict[str, set[str]] = {}
    for module, path in files.items():
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0 and node.module, f"{path}: relative import"
                # `from a import b`: the module a.b where there is one, else a name in a.
                full = {f"{node.module}.{alias.name}" for alias in node.names}
                names |= {n if n in files else node.module for n in full}
            elif (
                isinstance(node, ast.Call)
                and "import_module" in ast.unparse(node.func)
                and node.args
                and isinstance(node.args[0], ast.Constant)
            ):
                names.add(str(node.args[0].value))
        found[module] = {n for n in names if n.split(".")[0] in PACKAGES} - {module}
    return found


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Every circle that a walk along the arrows comes upon."""
    done: set[str] = set()
    found = []

    def walk(module, path):
        if module in path:
            found.append([*path[path.index(module) :], module])
        elif module not in done:
            for target in sorted(arrows.get(module, ())):
                walk(target, [*path, module])
            done.add(module)

    for module in sorted(arrows):
        walk(module, [])
    return found


def room(module: str) -> str:
    """The room of ARROWS that a module stands in."""
    fits = [name for name in ARROWS if f"{module}.".startswith(f"{name}.")]
    # A file on the first floor of fntg_jax is a room of its own or does not belong there.
    best = max(fits, key=len, default="")
    return module if best == "fntg_jax" and module != best else best


def wrong(arrows: dict[str, set[str]]) -> list[str]:
    """Arrows that no entry of ARROWS allows."""
    found = []
    for module, targets in arrows.items():
        here = room(module)
        for target in targets:
            inside = target == here or target.startswith(f"{here}.")
            inside &= here != "fntg_jax"
            allowed = ARROWS.get(here, set())
            if not inside and target not in allowed and room(target) not in allowed:
                found.append(f"{module} -> {target}")
    return found


def test_arrows_run_down_only():
    arrows = graph(ROOT, "fntg_jax", "envs")
    assert len(arrows) > 80 and sum(map(len, arrows.values())) > 200
    assert wrong(arrows) == []


def test_no_circles():
    assert circles(graph(ROOT, *PACKAGES)) == []


@pytest.mark.parametrize(
    ("files", "circle", "direction"),
    [
        ({"fntg_jax/learning/a.py": "import fntg_jax.running.b"}, False, True),
        ({"fntg_jax/robot/a.py": "from fntg_jax.controller import c"}, False, True),
        ({"fntg_jax/controller/a.py": "from envs import kinematic"}, False, True),
        ({"fntg_jax/running/a.py": "import fntg_jax"}, False, True),
        ({"envs/a.py": "from fntg_jax.learning import ga"}, False, True),
        ({"fntg_jax/running/a.py": "from envs.base import World"}, False, False),
        (
            {
                "fntg_jax/running/a.py": "def f():\n    from fntg_jax.running import b",
                "fntg_jax/running/b.py": "from fntg_jax.running.a import f",
            },
            True,
            False,
        ),
        (
            {
                "envs/a.py": "import importlib\nb = importlib.import_module('envs.b')",
                "envs/b.py": "if True:\n    from envs import a",
            },
            True,
            False,
        ),
    ],
)
def test_planted_arrows_are_found(tmp_path, files, circle, direction):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    arrows = graph(tmp_path, "fntg_jax", "envs")
    assert bool(circles(arrows)) == circle
    assert bool(wrong(arrows)) == direction


def imports(package: str) -> dict[str, set[str]]:
    """Top-level packages that every file of a package imports, anywhere in it."""
    found = {}
    for path in (ROOT / package).rglob("*.py"):
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module.split(".")[0])
        found[str(path.relative_to(ROOT))] = names
    return found


def test_the_trainer_knows_no_simulator():
    found = imports("fntg_jax")
    assert any("jax" in names for names in found.values())  # it does find imports
    forbidden = {"brax", "mujoco"}
    assert {path: names & forbidden for path, names in found.items() if names & forbidden} == {}


def test_only_one_file_knows_brax():
    users = {
        path for p in ("fntg_jax", "envs") for path, names in imports(p).items() if "brax" in names
    }
    assert users == {"envs/brax.py"}


def test_storage_does_not_draw():
    """No room below `showing` imports matplotlib, at whatever level."""
    below = ("controller", "learning", "robot", "export", "running", "teams")
    users = [
        path
        for path, names in imports("fntg_jax").items()
        if "matplotlib" in names and path.split("/")[1] in below
    ]
    assert users == []


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
