"""Golden vectors from two fuzzy libraries that nobody here wrote: simpful and pyfuzzylite.

pyfuzzylite declares numpy < 2, so this runs in an environment of its own and imports nothing
of the project; it builds the 24 rules from the `parameters` of each controller file.

    python -m tests.golden.make_controllers                 # in the project's environment
    python -m venv golden && golden/bin/pip install simpful==2.12.0 pyfuzzylite==8.0.6
    golden/bin/python tests/golden/make_golden.py

reads controller-LAYOUT.json and writes expected-LAYOUT.json beside this file.
"""

import itertools
import json
import math
from importlib import metadata
from pathlib import Path

import fuzzylite as fl
import numpy as np
import simpful as sf

HERE = Path(__file__).parent
INPUTS = ("d_B", "d_O", "theta_B", "theta_O")
RANGES = ((0.0, 3.4), (-0.1, 0.9), (-math.pi, math.pi), (-math.pi, math.pi))
SIGMOIDS = {"d_B": "A", "d_O": "B", "theta_B": "C"}
SIDES = ("left", "right", "not_influencing")
RULES = tuple(itertools.product(range(2), range(2), range(2), range(3)))


def rule_text(i, j, k, m, consequent):
    labels = (f"A{i + 1}", f"B{j + 1}", f"C{k + 1}", SIDES[m])
    return labels, consequent.format("".join(str(n + 1) for n in (i, j, k, m)))


def gains(document):
    if document["output"] == "clip":
        return 1.0, 1.0
    return document["limits"]["v_max"] / 5, document["limits"]["omega_max"] / 5


def constants(document):
    """(rule, v, omega): the bias added to every rule is the bias added to their average."""
    p, gain = document["parameters"], gains(document)
    for rule in RULES:
        i, j, k, m = rule
        values = p["V"][i][j][k][m] + p["bias"][0], p["Omega"][i][j][k][m] + p["bias"][1]
        yield rule, gain[0] * values[0], gain[1] * values[1]


class Side(fl.Term):
    """The paper's D_l: half a bell, or what a bell leaves."""

    def __init__(self, name, sigma):
        super().__init__(name)
        self.sigma = sigma

    def membership(self, x):
        bell = np.exp(-np.square(x) / (2 * self.sigma**2))
        if self.name == "left":
            return np.where(x > 0, bell, 0.0)
        return np.where(x <= 0, bell, 0.0) if self.name == "right" else 1 - bell


def with_fuzzylite(document, observations):
    p, limits = document["parameters"], document["limits"]
    inputs = []
    for name, (low, high) in zip(INPUTS, RANGES):
        if name in SIGMOIDS:
            family = SIGMOIDS[name]
            terms = [
                fl.Sigmoid(f"{family}{n + 1}", p[family]["c"][n], p[family]["a"][n]) for n in (0, 1)
            ]
        else:
            terms = [Side(side, sigma) for side, sigma in zip(SIDES, p["sigma"])]
        inputs.append(fl.InputVariable(name, minimum=low, maximum=high, terms=terms))

    def output(name, low, high, values):
        terms = [fl.Constant(term, value) for term, value in values]
        return fl.OutputVariable(
            name,
            minimum=low,
            maximum=high,
            lock_range=True,
            defuzzifier=fl.WeightedAverage("TakagiSugeno"),
            aggregation=None,
            terms=terms,
        )

    table = [("".join(str(n + 1) for n in rule), v, w) for rule, v, w in constants(document)]
    rules = []
    for rule in RULES:
        labels, consequent = rule_text(*rule, "v is v{0} and omega is w{0}")
        antecedent = " and ".join(f"{name} is {label}" for name, label in zip(INPUTS, labels))
        rules.append(fl.Rule.create(f"if {antecedent} then {consequent}"))
    engine = fl.Engine(
        "FNTG",
        input_variables=inputs,
        output_variables=[
            output("v", limits["v_min"], limits["v_max"], [(f"v{n}", v) for n, v, _ in table]),
            output(
                "omega",
                -limits["omega_max"],
                limits["omega_max"],
                [(f"w{n}", w) for n, _, w in table],
            ),
        ],
        rule_blocks=[
            fl.RuleBlock(
                "rules", conjunction=fl.AlgebraicProduct(), activation=fl.General(), rules=rules
            )
        ],
    )
    for rule in rules:
        rule.load(engine)
    found = []
    for observation in observations:
        engine.restart()
        for variable, value in zip(engine.input_variables, observation):
            variable.value = value
        engine.process()
        found.append([np.asarray(v.value).item() for v in engine.output_variables])
    return found


def with_simpful(document, observations):
    p, limits = document["parameters"], document["limits"]
    system = sf.FuzzySystem(operators=["AND_PRODUCT"], show_banner=False)

    def sigmoid(a, c):
        return lambda x: 1 / (1 + math.exp(-a * (x - c)))

    def side(name, sigma):
        def membership(x):
            bell = math.exp(-x * x / (2 * sigma**2))
            inside = {"left": x > 0, "right": x <= 0}
            return (bell if inside[name] else 0.0) if name in inside else 1 - bell

        return membership

    for name, bounds in zip(INPUTS, RANGES):
        if name in SIGMOIDS:
            f = SIGMOIDS[name]
            sets = [
                sf.FuzzySet(function=sigmoid(p[f]["a"][n], p[f]["c"][n]), term=f"{f}{n + 1}")
                for n in (0, 1)
            ]
        else:
            sets = [sf.FuzzySet(function=side(s, g), term=s) for s, g in zip(SIDES, p["sigma"])]
        variable = sf.LinguisticVariable(sets, universe_of_discourse=list(bounds))
        system.add_linguistic_variable(name, variable)
    rules = []
    for rule, v, omega in constants(document):
        labels, number = rule_text(*rule, "{0}")
        terms = [f"({name} IS {label})" for name, label in zip(INPUTS, labels)]
        antecedent = terms[0]
        for term in terms[1:]:
            antecedent = f"({antecedent} AND {term})"
        for letter, output, value in (("v", "v", v), ("w", "omega", omega)):
            system.set_crisp_output_value(f"{letter}{number}", value)
            rules.append(f"IF {antecedent} THEN ({output} IS {letter}{number})")
    system.add_rules(rules)
    found = []
    for observation in observations:
        for name, value in zip(INPUTS, observation):
            system.set_variable(name, value)
        result = system.Sugeno_inference(["v", "omega"])
        found.append(
            [
                min(max(float(result["v"]), limits["v_min"]), limits["v_max"]),
                min(max(float(result["omega"]), -limits["omega_max"]), limits["omega_max"]),
            ]
        )
    return found


def main():
    rng = np.random.default_rng(2001)
    low, high = np.transpose(RANGES)
    for path in sorted(HERE.glob("controller-*.json")):
        document = json.loads(path.read_text())
        observations = rng.uniform(low, high, (20, 4)).tolist()
        observations[0][3] = 0.0
        golden = {
            "made_by": {name: metadata.version(name) for name in ("simpful", "pyfuzzylite")},
            "observations": observations,
            "simpful": with_simpful(document, observations),
            "pyfuzzylite": with_fuzzylite(document, observations),
        }
        target = HERE / path.name.replace("controller", "expected")
        target.write_text(json.dumps(golden, indent=1) + "\n")
        print(target.name, np.abs(np.subtract(golden["simpful"], golden["pyfuzzylite"])).max())


if __name__ == "__main__":
    main()
