"""A controller as one C99 header: no allocation, no tables, float or double."""

import os
import re
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller
from fntg_jax.files import inert_json

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")

_TEMPLATE = """\
/* Fuzzy-neural trajectory generator: (d_B, d_O, theta_B, theta_O) -> (v, omega).
 * Written by fntg-jax.  C99 and C++, no allocation, no state; link with -lm.
 * float by default; define FNTG_DOUBLE before including for double.
 * A NaN among the inputs gives NaN commands: check sensors before calling.
 * layout @layout@, trained at a control step of @control_dt@ s
 * @provenance@
 */
#ifndef FNTG_CONTROLLER_H
#define FNTG_CONTROLLER_H

#include <math.h>

#ifdef FNTG_DOUBLE
typedef double fntg_real;
#define FNTG_C(x) x
#define FNTG_EXP exp
#else
typedef float fntg_real;
#define FNTG_C(x) x##f
#define FNTG_EXP expf
#endif

static inline fntg_real fntg_clip(fntg_real x, fntg_real low, fntg_real high)
{
    return x < low ? low : x > high ? high : x;
}

static inline fntg_real fntg_mix(fntg_real share, fntg_real first, fntg_real second)
{
    return second + share * (first - second);
}

static inline fntg_real fntg_exp(fntg_real x)
{
    return FNTG_EXP(fntg_clip(x, FNTG_C(-60.0), FNTG_C(60.0)));
}

/* Share of the first of two sigmoids 1 / (1 + exp(-a (x - c))) in their sum. */
static inline fntg_real fntg_share(fntg_real x, fntg_real a1, fntg_real c1,
                                   fntg_real a2, fntg_real c2)
{
    const fntg_real e1 = fntg_exp(-a1 * (x - c1)), e2 = fntg_exp(-a2 * (x - c2));
    return (FNTG_C(1.0) + e2) / (FNTG_C(2.0) + e1 + e2);
}

/* Distances in m, angles in rad (> 0 is left); *v in m/s, *omega in rad/s. */
static inline void fntg_command(fntg_real d_ball, fntg_real d_obstacle, fntg_real theta_ball,
                                fntg_real theta_obstacle, fntg_real *v, fntg_real *omega)
{
    const fntg_real a = fntg_share(d_ball, @A@);
    const fntg_real b = fntg_share(d_obstacle, @B@);
    const fntg_real c = fntg_share(theta_ball, @C@);
    const fntg_real t = -theta_obstacle * theta_obstacle;
    const fntg_real zero = FNTG_C(0.0);
    /* Obstacle left, right, not influencing. */
    const fntg_real left = theta_obstacle > zero ? FNTG_EXP(t * @k1@) : zero;
    const fntg_real right = theta_obstacle > zero ? zero : FNTG_EXP(t * @k2@);
    const fntg_real none = FNTG_C(1.0) - FNTG_EXP(t * @k3@) + FNTG_C(1e-16);
    const fntg_real total = left + right + none;
    const fntg_real d1 = left / total, d2 = right / total, d3 = none / total;

@tables@
    *v = fntg_clip(@gain_v@ * (@mean_v@ + @bias_v@), @v_min@, @v_max@);
    *omega = fntg_clip(@gain_omega@ * (@mean_omega@ + @bias_omega@), -@omega_max@, @omega_max@);
}

#endif
"""

# Reads observations (double, 4 each), writes commands (double, 2 each), then times the calls.
_DRIVER = """\
#include <stdio.h>
#include <time.h>
#include "controller.h"
#define NUM 20000
#define REPEATS 50
static double inputs[NUM][4], outputs[NUM][2];
int main(void)
{
    size_t n = fread(inputs, sizeof inputs[0], NUM, stdin), i;
    int r;
    volatile fntg_real sink = 0;
    clock_t start;
    for (i = 0; i < n; i++) {
        fntg_real v, w;
        fntg_command((fntg_real)inputs[i][0], (fntg_real)inputs[i][1], (fntg_real)inputs[i][2],
                     (fntg_real)inputs[i][3], &v, &w);
        outputs[i][0] = v;
        outputs[i][1] = w;
    }
    start = clock();
    for (r = 0; r < REPEATS; r++)
        for (i = 0; i < n; i++) {
            fntg_real v, w;
            fntg_command((fntg_real)inputs[i][0], (fntg_real)inputs[i][1],
                         (fntg_real)inputs[i][2], (fntg_real)inputs[i][3], &v, &w);
            sink = v + w;
        }
    (void)sink;
    fprintf(stderr, "%.9g", (double)(clock() - start) / CLOCKS_PER_SEC / REPEATS / (double)n);
    return fwrite(outputs, sizeof outputs[0], n, stdout) == n ? 0 : 1;
}
"""


class CRun(NamedTuple):
    """Commands [n, 2] of a compiled header, and seconds a call."""

    commands: np.ndarray
    seconds: float


def dumps(controller: Controller) -> str:
    """The header as text."""
    p, limits = controller.params, controller.limits
    gains = network.output_gains(limits, controller.output)
    lines = []
    for name, table in (("v", p.V), ("w", p.Omega)):
        for i, k in np.ndindex(2, 2):
            near, far = (_over_sides(table[i, j, k]) for j in range(2))
            lines.append(f"    const fntg_real {name}{i + 1}{k + 1} =")
            lines.append(f"        fntg_mix(b, {near},\n                 {far});")
    mean = "fntg_mix(a, fntg_mix(c, {0}11, {0}12), fntg_mix(c, {0}21, {0}22))"
    slopes = 0.5 / np.maximum(p.sigma**2, 1e-10)
    values = {
        "layout": controller.layout.name,
        "control_dt": repr(float(controller.control_dt)),
        "provenance": inert_json(controller.provenance),
        **{f: _family(getattr(p, f"a_{f}"), getattr(p, f"c_{f}")) for f in "ABC"},
        **{f"k{n + 1}": _number(slopes[n]) for n in range(3)},
        "tables": "\n".join(lines),
        "mean_v": mean.format("v"),
        "mean_omega": mean.format("w"),
        "gain_v": _number(gains[0]),
        "gain_omega": _number(gains[1]),
        "bias_v": _number(p.bias[0]),
        "bias_omega": _number(p.bias[1]),
        "v_min": _number(limits.v_min),
        "v_max": _number(limits.v_max),
        "omega_max": _number(limits.omega_max),
    }
    # In one pass: provenance that looks like a mark stays provenance.
    return re.sub(r"@(\w+)@", lambda mark: values[mark[1]], _TEMPLATE)


def compiler() -> list[str] | None:
    """The C compiler's command (CC, else cc), or None where there is none."""
    words = shlex.split(os.environ.get("CC", "")) or ["cc"]
    return words if shutil.which(words[0]) else None


def run(text: str, inputs: np.ndarray, double: bool = False, flags: tuple = FLAGS) -> CRun:
    """Compile a header and run it on [n, 4] observations, n up to 20 000.

    Raises RuntimeError with the compiler's words when it does not compile without warnings.
    """
    command = compiler()
    if command is None:
        raise RuntimeError("no C compiler found (set CC)")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "controller.h").write_text(text)
        Path(folder, "driver.c").write_text(_DRIVER)
        define = ["-DFNTG_DOUBLE"] if double else []
        program = str(Path(folder, "driver"))
        built = subprocess.run(
            [*command, *flags, *define, "driver.c", "-o", program, "-lm"],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        if built.returncode:
            raise RuntimeError(f"{' '.join(command)} failed: {built.stderr.strip()}")
        done = subprocess.run(
            [program], input=np.ascontiguousarray(inputs).tobytes(), capture_output=True, check=True
        )
    return CRun(np.frombuffer(done.stdout).reshape(-1, 2), float(done.stderr))


def _number(x) -> str:
    # repr is the shortest text that reads back as the same double; C wants a point or exponent.
    text = repr(float(x))
    return f"FNTG_C({text})" if not text.startswith("-") else f"(-FNTG_C({text[1:]}))"


def _family(a, c) -> str:
    return ", ".join(_number(x) for x in (a[0], c[0], a[1], c[1]))


def _over_sides(row) -> str:
    # d1 + d2 + d3 = 1: a far rule that ignores the angle needs no sum.
    if row[0] == row[1] == row[2]:
        return _number(row[0])
    return " + ".join(f"d{n + 1} * {_number(x)}" for n, x in enumerate(row))
