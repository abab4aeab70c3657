"""What all tests share: a repeatable hypothesis profile and a way to run the command."""

import ctypes.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from fntg_jax.running import xla

# MuJoCo aborts the process where it draws without a display and was not told how before anything
# imported it.
if not os.environ.get("DISPLAY") and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")

# XLA reads its flags when it starts.  Without them the quadruped's step takes minutes to compile.
xla.configure()

# Compilation makes the first example slow: no deadlines.  Repeatable, so that a red test stays
# red; FNTG_HYPOTHESIS=random searches anew.
settings.register_profile(
    "repeatable",
    deadline=None,
    derandomize=os.environ.get("FNTG_HYPOTHESIS") != "random",
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("repeatable")

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="session")
def clean_env(tmp_path_factory):
    """Environment variables for child processes: CPU, and a compile cache of this session."""
    ours = ("XLA_", "JAX_", "FNTG_", "MUJOCO_")
    env = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    cache = tmp_path_factory.mktemp("cache")
    return {**env, "JAX_PLATFORMS": "cpu", "XDG_CACHE_HOME": str(cache), "COLUMNS": "80"}


@pytest.fixture(scope="session")
def python(clean_env):
    """Run a Python program in a fresh interpreter; its stdout."""

    def run(code: str, **env: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**clean_env, **env},
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="session")
def fntg(clean_env):
    """Run the command; returns the finished process."""

    def run(*arguments, cwd=None, **env: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            [sys.executable, "-m", "fntg_jax.commands.cli", *map(str, arguments)],
            env={**clean_env, **env},
            cwd=cwd,
            capture_output=True,
            text=True,
        )

    return run
