"""A controller as one Python file that needs NumPy and nothing else."""

import numpy as np

from envs.base import Limits
from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller
from fntg_jax.files import inert_json

_TEMPLATE = '''\
"""Fuzzy-neural trajectory generator: (d_B, d_O, theta_B, theta_O) -> (v, omega).

Written by fntg-jax; needs NumPy only.  Import it and call command(...).
"""

import numpy as np

# layout {layout}, trained at a control step of {control_dt} s
# {provenance}
V_MIN, V_MAX, OMEGA_MAX = {v_min}, {v_max}, {omega_max}  # m/s, m/s, rad/s
GAIN_V, GAIN_OMEGA = {gain_v}, {gain_omega}  # m/s and rad/s per unit of V and Omega
# Sigmoids 1 / (1 + exp(-a (x - c))): slopes a (1/m, 1/rad), centres c (m, rad).
A = {A}  # of d_B
B = {B}  # of d_O
C = {C}  # of theta_B
SIGMA = {sigma}  # rad: obstacle on the left, on the right, not influencing
# Rule constants, indexed [i][j][k][l].
V = {V}
OMEGA = {Omega}
BIAS_V, BIAS_OMEGA = {bias}


def command(d_ball, d_obstacle, theta_ball, theta_obstacle):
    """Distances in m, angles in rad (> 0 is left), scalars or arrays; v in m/s, omega in rad/s."""
    a, b, c = _pair(d_ball, A), _pair(d_obstacle, B), _pair(theta_ball, C)
    d = _sides(theta_obstacle)
    v = omega = 0.0
    for i, j, k, l in np.ndindex(2, 2, 2, 3):
        mu = a[i] * b[j] * c[k] * d[l]
        v = v + mu * V[i][j][k][l]
        omega = omega + mu * OMEGA[i][j][k][l]
    v, omega = GAIN_V * (v + BIAS_V), GAIN_OMEGA * (omega + BIAS_OMEGA)
    return np.clip(v, V_MIN, V_MAX), np.clip(omega, -OMEGA_MAX, OMEGA_MAX)


def _pair(x, family):
    """Shares of the two labels; they sum to 1."""
    (a1, a2), (c1, c2) = family
    x = np.asarray(x, float)
    e1 = np.exp(np.clip(-a1 * (x - c1), -60, 60))
    e2 = np.exp(np.clip(-a2 * (x - c2), -60, 60))
    share = (1 + e2) / (2 + e1 + e2)
    return share, 1 - share


def _sides(theta):
    """Shares of obstacle "left", "right" and "not influencing"; they sum to 1."""
    theta = np.asarray(theta, float)
    g1, g2, g3 = (np.exp(-(theta**2) / (2 * max(s * s, 1e-10))) for s in SIGMA)
    left, right, none = np.where(theta > 0, g1, 0), np.where(theta > 0, 0, g2), 1 - g3 + 1e-16
    total = left + right + none
    return left / total, right / total, none / total
'''


def dumps(controller: Controller) -> str:
    """The file as text."""
    limits = {k: float(v) for k, v in controller.limits._asdict().items()}
    gains = network.output_gains(Limits(**limits), controller.output)
    p = controller.params
    plain = {field: np.asarray(value).tolist() for field, value in p._asdict().items()}
    return _TEMPLATE.format(
        layout=controller.layout.name,
        control_dt=float(controller.control_dt),
        provenance=inert_json(controller.provenance),
        gain_v=float(gains[0]),
        gain_omega=float(gains[1]),
        A=(plain["a_A"], plain["c_A"]),
        B=(plain["a_B"], plain["c_B"]),
        C=(plain["a_C"], plain["c_C"]),
        sigma=plain["sigma"],
        V=_table(plain["V"]),
        Omega=_table(plain["Omega"]),
        bias=tuple(plain["bias"]),
        **limits,
    )


def commands(text: str, inputs: np.ndarray) -> np.ndarray:
    """Run an exported file: [n, 4] observations to [n, 2] commands."""
    namespace: dict = {"__name__": "exported"}
    exec(compile(text, "exported controller", "exec"), namespace)
    return np.stack(namespace["command"](*inputs.T), axis=-1)


def _table(value: list, indent: int = 0) -> str:
    """Nested lists, a line for each innermost one."""
    pad = " " * indent
    if not isinstance(value[0], list):
        return f"{pad}{value}"
    inner = "".join(f"{_table(part, indent + 4)},\n" for part in value)
    return f"{pad}[\n{inner}{pad}]"
