"""A controller in the FuzzyLite Language (fuzzylite, QtFuzzyLite, pyfuzzylite), and back.

The engine computes v and omega in m/s and rad/s: rule constants are the formulas
gain * (V + bias), the outputs are clipped by their locked ranges.  Formulas of fuzzylite know
neither negative nor exponential numbers, hence `(0 - 4.7)` and plain decimals.
"""

import re
from typing import Any

import numpy as np

from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import get_layout, rules
from fntg_jax.export import fll_foreign, json_format
from fntg_jax.files import inert_json

_INPUTS = (("d_ball", "A", "0 4"), ("d_obstacle", "B", "-1 1"), ("theta_ball", "C", "-3.2 3.2"))


def dumps(controller: Controller) -> str:
    """The engine as text, in the shortest decimals that read back exactly."""
    p, limits = controller.params, controller.limits
    gains = network.output_gains(limits, controller.output)
    about = {
        "layout": controller.layout.name,
        "output": controller.output,
        "control_dt": float(controller.control_dt),
        **({} if controller.bits is None else {"bits": controller.bits}),
        "provenance": controller.provenance,
    }
    lines = ["Engine: fntg", f"  description: {inert_json(about)}"]
    for name, family, bounds in _INPUTS:
        a, c = getattr(p, f"a_{family}"), getattr(p, f"c_{family}")
        lines += [f"InputVariable: {name}", "  enabled: true", f"  range: {bounds}"]
        lines += ["  lock-range: false"]
        lines += [f"  term: {family}{n + 1} Sigmoid {_plain(c[n])} {_plain(a[n])}" for n in (0, 1)]
    lines += ["InputVariable: theta_obstacle", "  enabled: true", "  range: -3.2 3.2"]
    lines += ["  lock-range: false"]
    lines += [f"  term: D{n + 1} Function {formula}" for n, formula in enumerate(_sides(p.sigma))]
    for name, symbol, table, gain, bias, low, high in (
        ("v", "V", p.V, gains[0], p.bias[0], limits.v_min, limits.v_max),
        ("omega", "W", p.Omega, gains[1], p.bias[1], -limits.omega_max, limits.omega_max),
    ):
        lines += [f"OutputVariable: {name}", "  enabled: true"]
        lines += [f"  range: {_plain(low)} {_plain(high)}", "  lock-range: true"]
        lines += ["  aggregation: none", "  defuzzifier: WeightedAverage TakagiSugeno"]
        lines += ["  default: nan", "  lock-previous: false"]
        for rule in rules(controller.layout):
            constant = table[rule] if len(rule) == 4 else table[rule][0]
            formula = f"{_number(gain)} * ({_number(constant)} + {_number(bias)})"
            lines.append(f"  term: {symbol}{_index(rule)} Function {formula}")
    lines += ["RuleBlock: rules", "  enabled: true", "  conjunction: AlgebraicProduct"]
    lines += ["  disjunction: none", "  implication: none", "  activation: General"]
    variables = [name for name, _, _ in _INPUTS] + ["theta_obstacle"]
    for rule in rules(controller.layout):
        antecedent = " and ".join(
            f"{variable} is {family}{n + 1}" for variable, family, n in zip(variables, "ABCD", rule)
        )
        index = _index(rule)
        lines.append(f"  rule: if {antecedent} then v is V{index} and omega is W{index}")
    return "\n".join(lines) + "\n"


def loads(text: str, source: str = "controller.fll") -> Controller:
    """Read an engine: one that `dumps` wrote comes back without loss, any other of the same
    structure by `fll_foreign`.  Raises ValueError (one line) that says what differs."""
    try:
        return _own(text, source)
    except ValueError:
        return fll_foreign.loads(text, source)


def _own(text: str, source: str) -> Controller:
    """An engine that `dumps` wrote: parameters and limits from its terms and ranges, the rest from
    its description.  A text that `dumps` would not write again is refused."""
    strange = f"{source}: not a controller that fntg export has written"
    head = re.match(r"Engine: fntg\n  description: (.*)\n", text)
    if head is None:
        raise ValueError(strange)
    about = json_format.parse_json(head[1], source)
    try:
        terms = dict(re.findall(r"^  term: (\w+) \w+ (.*)$", text, re.M))
        limits = dict(re.findall(r"^OutputVariable: (\w+)\n.*\n  range: (.*)$", text, re.M))
        v_min, v_max = (float(x) for x in limits["v"].split())
        sigmoids = {
            f: [[float(x) for x in terms[f"{f}{n}"].split()] for n in (1, 2)] for f in "ABC"
        }
        parameters: dict[str, Any] = {
            f: {"a": [a for _, a in pair], "c": [c for c, _ in pair]}
            for f, pair in sigmoids.items()
        }
        parameters["sigma"] = [
            _read(re.findall(r"max\((.*?) \* ", terms[f"D{n}"])[0]) for n in _123
        ]
        parameters["V"] = _tables(terms, "V")
        parameters["Omega"] = _tables(terms, "W")
        parameters["bias"] = [_constant(terms[f"{symbol}1111"])[1] for symbol in "VW"]
        layout = get_layout(about["layout"])
        slots = [x for name in parameters for x in _flat(parameters[name])]
        theta = {g: s * x + 0.0 for x, g, s in zip(slots, layout.index, layout.sign) if s}
        document = {
            "format": json_format.FORMAT,
            "version": json_format.VERSION,
            **about,
            "theta": [theta[g] for g in range(layout.num_genes)],
            "limits": {
                "v_min": v_min,
                "v_max": v_max,
                "omega_max": float(limits["omega"].split()[1]),
            },
            "parameters": parameters,
        }
    except (KeyError, IndexError, TypeError, ValueError):
        raise ValueError(strange) from None
    controller = json_format.from_dict(document, source)
    if dumps(controller) != text:
        raise ValueError(strange)
    return controller


_123 = (1, 2, 3)


def _sides(sigma) -> list[str]:
    """Formulas of D_1 "left", D_2 "right", D_3 "not influencing", divided by their sum where
    the sigmas differ (with one sigma the sum is 1)."""
    bells = [
        f"exp(0 - x * x / (2 * max({_number(s)} * {_number(s)}, 0.0000000001)))" for s in sigma
    ]
    left, right = f"gt(x, 0) * {bells[0]}", f"le(x, 0) * {bells[1]}"
    if len(set(sigma)) == 1:
        return [left, right, f"1 - {bells[2]}"]
    # The small number settles 0 / 0 as the trainer does: "not influencing".
    none = f"(1 - {bells[2]} + 0.0000000000000001)"
    return [f"{side} / ({left} + {right} + {none})" for side in (left, right, none)]


def _plain(x) -> str:
    return np.format_float_positional(float(x), trim="0")


def _number(x) -> str:
    return f"(0 - {_plain(-x)})" if x < 0 else _plain(x)


def _read(number: str) -> float:
    return -float(number[5:-1]) if number.startswith("(0 - ") else float(number)


def _constant(formula: str) -> tuple[float, float]:
    """Rule constant and bias of the formula "gain * (constant + bias)"."""
    constant, bias = formula.partition(" * (")[2][:-1].split(" + ")
    return _read(constant), _read(bias)


def _index(rule: tuple[int, ...]) -> str:
    return "".join(str(n + 1) for n in rule)


def _tables(terms: dict[str, str], symbol: str) -> list:
    def one(i, j, k, side):
        far = f"{symbol}{i}{j}{k}"
        return _constant(terms[far] if far in terms else terms[f"{far}{side}"])[0]

    pair = (1, 2)
    return [[[[one(i, j, k, n) for n in _123] for k in pair] for j in pair] for i in pair]


def _flat(value: Any) -> list[float]:
    if isinstance(value, dict):  # a family: slots are a_1, a_2, c_1, c_2
        value = [*value["a"], *value["c"]]
    return [x for v in value for x in _flat(v)] if isinstance(value, list) else [value]
