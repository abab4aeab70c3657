"""A controller for MATLAB's Fuzzy Logic Toolbox and Octave's fuzzy-logic-toolkit: a Sugeno .fis.

Sigmoids, rules and constants are the paper's.  What the format lacks:
- A label on one side of zero: a two-sided Gaussian (`gauss2mf`) whose other side is 1e-12 rad wide,
  so that "left" and "right" are exact but for |theta_O| < 1e-9 rad.
- One minus a label: "not influencing" is NOT "ahead", a negative index in the rules.
- Limits of an output: v and omega come out as the rules have them, and whoever drives a robot with
  them has to clip them to the `Range` of the output, as `fntg_jax.controller.network` does.
"""

import numpy as np

from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import rules

# Far beyond what a field holds: the toolboxes clip inputs to these.
_INPUTS = (("d_ball", "A", "0 200"), ("d_obstacle", "B", "-1 200"), ("theta_ball", "C", "-4 4"))
_EDGE, _THIN = "0.000000001", "0.000000000001"  # rad
_AHEAD = 3  # the label whose negation is "not influencing"


def dumps(controller: Controller) -> str:
    """The system as text.  Raises ValueError for layouts whose "left", "right" and "not
    influencing" do not add up to 1 (several sigmas): the format cannot divide by their sum."""
    p, limits, layout = controller.params, controller.limits, controller.layout
    if len({abs(s) for s in p.sigma.tolist()}) != 1:
        raise ValueError(
            f"layout = {layout.name!r}: a .fis needs one sigma for left, right and not influencing"
        )
    gains = network.output_gains(limits, controller.output)
    listed = rules(layout)
    lines = ["[System]", "Name='fntg'", "Type='sugeno'", "Version=2.0", "NumInputs=4"]
    lines += ["NumOutputs=2", f"NumRules={len(listed)}", "AndMethod='prod'", "OrMethod='probor'"]
    lines += ["ImpMethod='prod'", "AggMethod='sum'", "DefuzzMethod='wtaver'"]
    for n, (name, family, bounds) in enumerate(_INPUTS):
        a, c = getattr(p, f"a_{family}"), getattr(p, f"c_{family}")
        lines += ["", f"[Input{n + 1}]", f"Name='{name}'", f"Range=[{bounds}]", "NumMFs=2"]
        lines += [
            f"MF{m + 1}='{family}{m + 1}':'sigmf',[{_plain(a[m])} {_plain(c[m])}]" for m in (0, 1)
        ]
    sigma = _plain(np.sqrt(max(p.sigma[0] ** 2, 1e-10)))
    lines += ["", "[Input4]", "Name='theta_obstacle'", "Range=[-4 4]", "NumMFs=3"]
    lines += [f"MF1='left':'gauss2mf',[{_THIN} {_EDGE} {sigma} {_EDGE}]"]
    lines += [f"MF2='right':'gauss2mf',[{sigma} 0 {_THIN} 0]"]
    lines += [f"MF3='ahead':'gaussmf',[{sigma} 0]"]
    for n, (name, table, gain, bias, low, high) in enumerate(
        (
            ("v", p.V, gains[0], p.bias[0], limits.v_min, limits.v_max),
            ("omega", p.Omega, gains[1], p.bias[1], -limits.omega_max, limits.omega_max),
        )
    ):
        lines += ["", f"[Output{n + 1}]", f"Name='{name}'", f"Range=[{_plain(low)} {_plain(high)}]"]
        lines += [f"NumMFs={len(listed)}"]
        for m, rule in enumerate(listed):
            constant = gain * ((table[rule] if len(rule) == 4 else table[rule][0]) + bias)
            index = "".join(str(label + 1) for label in rule)
            lines.append(f"MF{m + 1}='r{index}':'constant',[{_plain(constant)}]")
    lines += ["", "[Rules]"]
    for m, rule in enumerate(listed):
        labels = [label + 1 for label in rule] + [0] * (4 - len(rule))
        if labels[3] == _AHEAD:
            labels[3] = -_AHEAD
        lines.append(f"{' '.join(map(str, labels))}, {m + 1} {m + 1} (1) : 1")
    return "\n".join(lines) + "\n"


def _plain(x) -> str:
    """The shortest decimals that read back exactly, without an exponent."""
    return np.format_float_positional(float(x), trim="0")
