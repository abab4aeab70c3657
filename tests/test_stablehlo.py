"""One robot's control for other machines: run where neither package can be imported."""

import json
import subprocess
import sys

import numpy as np
import pytest


@pytest.mark.slow
def test_runs_without_us(fntg, tmp_path):
    folder = tmp_path / "brain"
    done = fntg("export", "cerberus", folder, "--to", "stablehlo")
    assert done.returncode == 0, done.stderr
    blocked = (
        "import sys, runpy\n"
        "for name in ('fntg_jax', 'envs'):\n    sys.modules[name] = None\n"
        f"runpy.run_path({str(folder / 'run.py')!r}, run_name='__main__')\n"
    )

    def run():
        return subprocess.run(
            [sys.executable, "-c", blocked], capture_output=True, text=True, cwd=tmp_path
        )

    ran = run()
    assert ran.returncode == 0, ran.stderr
    assert "100 steps" in ran.stdout
    assert "stablehlo." in (folder / "control.mlir").read_text()
    signature = json.loads((folder / "signature.json").read_text())
    golden = dict(np.load(folder / "golden.npz"))
    assert len(signature["senses"]) == sum(name.startswith("sense") for name in golden)
    # It can fail: another bearing of the ball gives other actions.
    golden["sense0"] = golden["sense0"] + 0.3
    np.savez(folder / "golden.npz", **golden)
    assert run().returncode == 1


def test_refused_in_one_line(fntg, tmp_path):
    done = fntg("export", "chaser", tmp_path / "out", "--to", "stablehlo")
    assert done.returncode == 2 and "plays from the truth" in done.stderr
    assert not (tmp_path / "out").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "note").write_text("x")
    done = fntg("export", "cerberus", tmp_path / "mine", "--to", "stablehlo")
    assert done.returncode == 2 and "choose another" in done.stderr
