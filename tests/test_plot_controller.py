"""Pictures of controllers: they are written and show something."""

import numpy as np
import pytest
from PIL import Image

from fntg_jax import export
from fntg_jax.commands import cli
from tests.controllers import random_controller


@pytest.fixture
def files(tmp_path):
    for seed in range(3):
        export.save(random_controller(seed=seed), tmp_path / f"{seed}.json")
    return [str(tmp_path / f"{seed}.json") for seed in range(3)]


@pytest.mark.parametrize("num", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_plot_command(tmp_path, capsys, files, num):
    cli.main(["plot", *files[:num], "--out", str(tmp_path / "fig")])
    paths = capsys.readouterr().out.split()
    assert paths == [str(tmp_path / f"fig-{n}.png") for n in ("memberships", "surfaces")]
    for path in paths:
        image = np.asarray(Image.open(path).convert("RGB"))
        assert image.shape[1] > 600 * num
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100
        assert open(path.replace(".png", ".pdf"), "rb").read(5) == b"%PDF-"  # noqa: SIM115


def test_three_files_are_refused(files, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["plot", *files])
    assert stop.value.code == 2
    assert capsys.readouterr().err == "fntg: error: 3 controllers: allowed are one or two\n"
