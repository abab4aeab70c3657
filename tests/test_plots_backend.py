"""Drawing leaves the caller's matplotlib as it is."""


def test_the_back_end_of_the_caller_stays(python, tmp_path):
    code = f"""
import matplotlib, numpy as np
matplotlib.use("svg")
from fntg_jax.running.runner import History
from fntg_jax.showing import plots
one = np.ones((1, 3))
plots.fitness_curves(History(one, one, one, one), {str(tmp_path / "a.png")!r})
print(matplotlib.get_backend())
"""
    assert python(code).strip() == "svg"
    assert (tmp_path / "a.png").stat().st_size > 5000
