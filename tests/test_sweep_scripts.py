"""The sweep scripts at a tiny budget: each runs, draws, and writes the numbers it drew."""

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from experiments import sweeps

OPTIONS = sweeps.Options(seeds=2, generations=2, population=8)
# Settings; those that compile more than one program take long.
SCRIPTS = [
    ("dt", 5),
    pytest.param("mutation_crossover", 20, marks=pytest.mark.slow),
    pytest.param("budget", 6, marks=pytest.mark.slow),
    pytest.param("bits", 10, marks=pytest.mark.slow),
    pytest.param("selection", 5, marks=pytest.mark.slow),
    pytest.param("layout", 12, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("name", "settings"), SCRIPTS)
def test_sweep(name, settings, tmp_path):
    table = sweeps.run(name, OPTIONS)
    path = sweeps.plot(table, tmp_path / "figure.png")
    picture = np.asarray(Image.open(path).convert("L"))
    assert picture.shape[0] > 300 and 0.001 < (picture < 128).mean() < 0.6
    assert path.with_suffix(".pdf").stat().st_size > 5000
    rows = list(csv.DictReader(path.with_suffix(".csv").open()))
    assert len(rows) == settings * OPTIONS.seeds
    best = [float(row["best"]) for row in rows]
    np.testing.assert_allclose(best, table.best.ravel(), rtol=1e-6)
    # Settings differ; `best` would tie where elitism kept a genome of generation 0.
    assert len(set(table.mean.ravel())) > settings


def test_every_sweep_has_its_script():
    scripts = {p.stem: p.read_text() for p in Path(sweeps.__file__).parent.glob("sweep_*.py")}
    assert set(scripts) == {f"sweep_{name}" for name in sweeps.SWEEPS}
    for name in sweeps.SWEEPS:
        assert f'sweeps.main("{name}")' in scripts[f"sweep_{name}"]
