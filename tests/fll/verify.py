"""Run an exported FLL file in pyfuzzylite, a reader that is not ours.

pyfuzzylite needs numpy < 2, so it lives in an environment of its own:

    fntg export X controller.fll --to fll
    fntg export X controller.py --to numpy
    python -m venv fll-venv && fll-venv/bin/pip install "numpy<2" pyfuzzylite
    fll-venv/bin/python tests/fll/verify.py controller.fll controller.py [golden.csv]

Prints the largest difference between the two over 20 000 observations; exit status 1 when it is
more than rounding.  With a third file, writes 300 observations and what pyfuzzylite made of
them: the golden vectors beside this script.
"""

import runpy
import sys
from pathlib import Path

import fuzzylite
import numpy as np


def pyfuzzylite_commands(engine, inputs):
    for variable, values in zip(engine.input_variables, inputs.T):
        variable.value = values
    engine.process()
    return np.stack([np.asarray(o.value) for o in engine.output_variables], axis=-1)


def main(fll, python, golden=None):
    engine = fuzzylite.FllImporter().from_string(Path(fll).read_text())
    command = runpy.run_path(python)["command"]
    low, high = (0, -0.1, -np.pi, -np.pi), (3.4, 0.9, np.pi, np.pi)
    inputs = np.random.default_rng(1).uniform(low, high, (20_000, 4)).astype(np.float32)
    inputs[:3, 3] = (0, 1e-4, -1e-4)  # both sides of the switch from left to right
    inputs = inputs.astype(float)
    theirs = pyfuzzylite_commands(engine, inputs)
    error = np.abs(theirs - np.stack(command(*inputs.T), axis=-1)).max(axis=0)
    print(f"{fll}: largest difference {error[0]:.1e} m/s, {error[1]:.1e} rad/s")
    distinct = [len(np.unique(column)) for column in theirs.T]
    print(f"({distinct[0]} different v and {distinct[1]} different omega among {len(inputs)})")
    if golden:
        header = "d_ball,d_obstacle,theta_ball,theta_obstacle,v,omega"
        rows = np.hstack([inputs, theirs])[:300]
        np.savetxt(golden, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    return 0 if (error < 1e-12).all() else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
