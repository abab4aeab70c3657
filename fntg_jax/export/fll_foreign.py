"""Engines of the FuzzyLite Language that others wrote, QtFuzzyLite for one, with the structure of
the paper's controller: four inputs with 2, 2, 2 and 3 terms, two outputs, 16 or 24 rules.

Names of terms, their order, the order of rules, comments and the number of decimals are free.
Formulas are evaluated, not matched: a term of theta_obstacle counts as "left", "right" or "not
influencing" where its values are those, and rule constants may be written in any way.
"""

import ast
import math
import operator
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from envs.base import Limits
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import HIGH, LAYOUTS, SHAPES, Params

INPUTS = ("d_ball", "d_obstacle", "theta_ball", "theta_obstacle")
OUTPUTS = ("v", "omega")
_LAYOUTS = ("paper-31", "reduced-47", "full-63")  # the first that has these parameters
_SIDES = ("left", "right", "not influencing")
_FITS = 1e-3  # of a formula to its label: numbers may be rounded to three decimals

_KEYS = {
    "description", "enabled", "range", "lock-range", "aggregation", "defuzzifier", "default",
    "lock-previous", "conjunction", "disjunction", "implication", "activation",
}  # fmt: skip

Block = dict[str, Any]  # key -> value; "term": name -> (kind, arguments); "rule": list


def loads(text: str, source: str) -> Controller:
    """The controller, its outputs in m/s and rad/s ("clip").  Raises ValueError (one line) that
    says what differs from the structure."""
    try:
        return _controller(_blocks(text))
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None


def _blocks(text: str) -> dict[str, Block]:
    """Name of a variable, or "rules" -> its block."""
    found: dict[str, Block] = {}
    block: Block = {}
    for number, raw in enumerate(text.split("\n"), 1):
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        key, colon, value = line.partition(":")
        value = " ".join(value.split())
        if not colon:
            raise ValueError(f"line {number}: not KEY: VALUE")
        if key in ("Engine", "InputVariable", "OutputVariable", "RuleBlock"):
            name = "rules" if key == "RuleBlock" else f"{key} {value}"
            if name in found:
                raise ValueError(f"line {number}: a second {name}")
            block = found[name] = {"term": {}, "rule": []}
        elif key == "term":
            name, _, rest = value.partition(" ")
            kind, _, arguments = rest.partition(" ")
            block.setdefault("term", {})[name] = (kind, arguments)
        elif key == "rule":
            block.setdefault("rule", []).append(value)
        elif key in _KEYS:
            block[key] = value
        else:
            raise ValueError(f"line {number}: {key[:40]!r} is no key of the FuzzyLite Language")
    if not any(name.startswith("Engine") for name in found):
        raise ValueError("no Engine")
    return found


def _controller(blocks: dict[str, Block]) -> Controller:
    inputs = {name: _block(blocks, f"InputVariable {name}") for name in INPUTS}
    outputs = {name: _block(blocks, f"OutputVariable {name}") for name in OUTPUTS}
    rules = _block(blocks, "rules")
    _expect(rules, "rules", "conjunction", "AlgebraicProduct")
    _expect(rules, "rules", "activation", "General", "")
    slots: dict[str, Any] = {}
    for family, name in zip("ABC", INPUTS):
        pairs = [_sigmoid(name, term, *value) for term, value in inputs[name]["term"].items()]
        if len(pairs) != 2:
            raise ValueError(f"{name} has {len(pairs)} terms: allowed are 2")
        slots[f"c_{family}"], slots[f"a_{family}"] = zip(*pairs)
    side_of, slots["sigma"] = _sides(inputs["theta_obstacle"]["term"])
    place = {n: {t: m for m, t in enumerate(inputs[n]["term"])} for n in INPUTS[:3]}
    place["theta_obstacle"] = side_of
    constants = {
        n: {t: _constant(n, t, *v) for t, v in outputs[n]["term"].items()} for n in OUTPUTS
    }
    tables = {name: np.full((2, 2, 2, 3), np.nan) for name in OUTPUTS}
    for text in rules["rule"]:
        where, said = _rule(text, place, constants)
        for name in OUTPUTS:
            if not np.isnan(tables[name][where]).all():
                raise ValueError(f"rule {text!r}: says again what another rule says")
            tables[name][where] = said[name]
    if np.isnan(tables["v"]).any():
        i, j, k, l = np.argwhere(np.isnan(tables["v"]))[0] + 1
        raise ValueError(f"no rule for terms {i}, {j}, {k} and {_SIDES[l - 1]!r}")
    bias = _bias(tables["v"], 1), _bias(tables["omega"], -1)
    v, omega = tables["v"] - bias[0], tables["omega"] - bias[1]
    layout, theta = _genes(Params(**slots, V=v, Omega=omega, bias=bias))
    (v_min, v_max), (low, high) = (_range(outputs[name], name) for name in OUTPUTS)
    if low != -high:
        raise ValueError(f"omega: range = {low:g} {high:g}: allowed are -X X")
    return Controller(layout, theta, "clip", Limits(v_min, v_max, high))


def _block(blocks: dict[str, Block], name: str) -> Block:
    if name not in blocks:
        raise ValueError(f"no {name}: wanted are inputs {', '.join(INPUTS)}, outputs v, omega")
    _expect(blocks[name], name, "enabled", "true", "")
    return blocks[name]


def _expect(block: Block, where: str, key: str, *allowed: str) -> None:
    if (value := block.get(key, "")) not in allowed:
        raise ValueError(f"{where}: {key} = {value!r}: allowed is {allowed[0]}")


def _range(block: Block, name: str) -> tuple[float, float]:
    _expect(block, name, "lock-range", "true")
    _expect(block, name, "defuzzifier", "WeightedAverage TakagiSugeno", "WeightedAverage",
            "WeightedAverage Automatic")  # fmt: skip
    _expect(block, name, "lock-previous", "false", "")
    low, high = _numbers(block.get("range", ""), f"{name}: range", 2)
    return low, high


def _numbers(text: str, what: str, count: int) -> list[float]:
    try:
        values = [float(x) for x in text.split()]
    except ValueError:
        values = []
    # A last 1 is the height of a term.
    if len(values) == count + 1 and values[-1] == 1:
        values.pop()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ValueError(f"{what} = {text!r}: allowed are {count} numbers")
    return values


def _sigmoid(variable: str, term: str, kind: str, arguments: str) -> list[float]:
    if kind != "Sigmoid":
        raise ValueError(f"{variable}: term {term} is a {kind}: allowed is Sigmoid")
    return _numbers(arguments, f"{variable}: term {term}", 2)


def _constant(variable: str, term: str, kind: str, arguments: str) -> float:
    if kind == "Constant":
        return _numbers(arguments, f"{variable}: term {term}", 1)[0]
    if kind != "Function":
        raise ValueError(f"{variable}: term {term} is a {kind}: allowed are Constant, Function")
    return _formula(arguments, f"{variable}: term {term}")(math.nan)


def _sides(terms: dict[str, tuple[str, str]]) -> tuple[dict[str, int], tuple[float, ...]]:
    """Which of left, right and not influencing every term is, and the sigma of each."""
    side_of, sigmas = {}, {}
    x = np.concatenate([-np.geomspace(3.1, 0.001, 60), np.geomspace(0.001, 3.1, 60)])
    for term, (kind, arguments) in terms.items():
        what = f"theta_obstacle: term {term}"
        if kind != "Function":
            raise ValueError(f"{what} is a {kind}: allowed is Function")
        formula = _formula(arguments, what)
        y = np.array([formula(float(u)) for u in x])
        left, right = y[x > 0], y[x < 0]
        side = 0 if not right.any() else 1 if not left.any() else 2
        bell = (left, right[::-1], 1 - left)[side]
        far = x[x > 0]
        at = int(np.argmin(abs(bell - 0.6)))  # where its slope tells most
        if not 0 < bell[at] < 1:
            raise ValueError(f"{what}: {arguments}: not a bell curve of theta_obstacle")
        sigma = float(far[at] / math.sqrt(-2 * math.log(bell[at])))
        wanted = np.exp(-(x**2) / (2 * sigma**2))
        wanted = (np.where(x > 0, wanted, 0), np.where(x > 0, 0, wanted), 1 - wanted)[side]
        if abs(y - wanted).max() > _FITS or side in sigmas:
            raise ValueError(f"{what}: {arguments}: wanted are {', '.join(_SIDES)}, one of each")
        side_of[term], sigmas[side] = side, sigma
    if len(sigmas) != 3:
        raise ValueError(f"theta_obstacle has {len(sigmas)} terms: allowed are 3")
    sigma = sigmas[2]
    if max(abs(s - sigma) for s in sigmas.values()) > _FITS:
        raise ValueError("theta_obstacle: its terms differ in sigma: allowed is one sigma")
    return side_of, (sigma, sigma, sigma)


def _rule(text: str, place: dict, constants: dict) -> tuple[tuple[Any, ...], dict[str, float]]:
    """Where in the tables a rule writes, and what."""
    match = re.fullmatch(r"if (.*) then (.*?)(?: with 1\.?0*)?", text)
    if match is None:
        raise ValueError(f"rule {text!r}: allowed is if ... then ..., of weight 1")

    def read(part: str, known: dict) -> dict[str, Any]:
        found = {}
        for clause in part.split(" and "):
            words = clause.split()
            if len(words) != 3 or words[1] != "is" or words[2] not in known.get(words[0], {}):
                raise ValueError(f"rule {text!r}: {clause!r} is not VARIABLE is TERM")
            found[words[0]] = known[words[0]][words[2]]
        return found

    labels, said = read(match[1], place), read(match[2], constants)
    if not set(INPUTS[:3]) <= set(labels) or set(said) != set(OUTPUTS):
        raise ValueError(f"rule {text!r}: names too few variables")
    i, j, k = (labels[name] for name in INPUTS[:3])
    return (i, j, k, labels.get("theta_obstacle", slice(None))), said


def _bias(table: np.ndarray, flip: int) -> float:
    """The output's bias, which is part of every constant: what makes mirrored rules equal (flip 1)
    or opposite (-1), or where there is none, what brings the constants near zero if need be."""
    mirrored = table[:, :, ::-1][..., [1, 0, 2]]
    middle = (table - flip * mirrored) / 2
    if flip == -1 and np.ptp(middle) < 1e-9:
        return float(middle.mean())
    return 0.0 if abs(table).max() <= HIGH else float((table.max() + table.min()) / 2)


def _genes(params: Params) -> tuple[Any, np.ndarray]:
    slots = np.concatenate([np.asarray(x, float).ravel() for x in params])
    assert len(slots) == sum(int(np.prod(s)) for s in SHAPES)
    for name in _LAYOUTS:
        layout = LAYOUTS[name]
        index, sign = np.asarray(layout.index), np.asarray(layout.sign)
        theta = np.zeros(layout.num_genes)
        theta[index[sign != 0]] = (slots * sign)[sign != 0]
        if np.allclose(theta[index] * sign, slots, rtol=0, atol=1e-9):
            return layout, theta
    raise AssertionError("full-63 has all parameters")


_BINARY = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
_CALLS: dict[str, Callable[..., float]] = {
    "exp": math.exp, "max": max, "min": min, "sqrt": math.sqrt, "abs": abs, "pow": pow,
    "gt": lambda a, b: float(a > b), "ge": lambda a, b: float(a >= b),
    "lt": lambda a, b: float(a < b), "le": lambda a, b: float(a <= b),
}  # fmt: skip


def _formula(text: str, what: str) -> Callable[[float], float]:
    """A formula of x in numbers, + - * / ^ and a few functions: never Python's eval."""
    strange = f"{what}: {text[:60]}: a formula that cannot be read"
    if len(text) > 1000:
        raise ValueError(strange)

    def value(node: Any, x: float) -> float:
        match node:
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.Name(id="x"):
                return x
            case ast.UnaryOp(op=ast.USub()):
                return -value(node.operand, x)
            case ast.BinOp() if type(node.op) in _BINARY:
                return _BINARY[type(node.op)](value(node.left, x), value(node.right, x))
            case ast.Call(func=ast.Name(id=name), keywords=[]) if name in _CALLS:
                return _CALLS[name](*(value(a, x) for a in node.args))
        raise ValueError(strange)

    try:
        tree = ast.parse(text.replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(strange) from None

    def at(x: float) -> float:
        try:
            found = value(tree, x)
        except (ArithmeticError, TypeError, RecursionError):
            raise ValueError(strange) from None
        if isinstance(found, complex) or (math.isnan(found) and not math.isnan(x)):
            raise ValueError(strange)
        return found

    return at
