"""Runs a .fis in Octave's fuzzy-logic-toolkit, which no one here wrote."""

import shutil
import subprocess

import numpy as np

_SCRIPT = """
pkg load fuzzy-logic-toolkit
warning off
system = readfis("{fis}");
x = dlmread("{inputs}");
dlmwrite("{outputs}", evalfis(x, system), "precision", 17);
"""


def available() -> bool:
    """Whether Octave and the toolkit are installed."""
    if shutil.which("octave-cli") is None:
        return False
    done = subprocess.run(
        ["octave-cli", "--eval", "pkg load fuzzy-logic-toolkit"], capture_output=True, timeout=120
    )
    return done.returncode == 0


def run(folder, text: str, inputs: np.ndarray, limits) -> np.ndarray:
    """Commands [n, 2] of observations [n, 4], clipped to the limits."""
    (folder / "c.fis").write_text(text)
    np.savetxt(folder / "in.csv", inputs, fmt="%.17g", delimiter=",")
    script = _SCRIPT.format(
        fis=folder / "c.fis", inputs=folder / "in.csv", outputs=folder / "out.csv"
    )
    subprocess.run(
        ["octave-cli", "--eval", script], check=True, capture_output=True, text=True, timeout=300
    )
    found = np.loadtxt(folder / "out.csv", delimiter=",")
    return np.stack(
        [
            np.clip(found[:, 0], limits.v_min, limits.v_max),
            np.clip(found[:, 1], -limits.omega_max, limits.omega_max),
        ],
        axis=-1,
    )
