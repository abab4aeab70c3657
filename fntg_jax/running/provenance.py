"""What a run ran on: versions, device, commit."""

import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

_PACKAGES = ("fntg-jax", "jax", "jaxlib", "numpy", "optax", "mujoco", "mujoco-mjx", "brax")


def provenance() -> dict[str, Any]:
    """Versions, platform, device, number of processes and commit, as JSON values."""
    device = jax.devices()[0]
    return {
        "versions": {"python": platform.python_version(), **_versions()},
        "platform": platform.platform(),
        "device": f"{device.platform}: {device.device_kind}",
        "num_processes": jax.process_count(),
        "git_commit": _git_commit(),
    }


def version() -> str:
    """That of fntg-jax, as installed."""
    return metadata.version("fntg-jax")


def _versions() -> dict[str, str]:
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _git_commit() -> str | None:
    """Commit of the source tree the package is imported from, "+changes" where it differs."""
    source = Path(__file__).parent

    def git(*arguments):
        done = subprocess.run(
            ["git", "-C", str(source), *arguments], capture_output=True, text=True, timeout=10
        )
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        commit = git("rev-parse", "HEAD") if git("ls-files", "--", __file__) else ""
        changed = git("status", "--porcelain", "--untracked-files=no") if commit else ""
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}+changes" if changed else commit or None
