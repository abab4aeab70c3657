"""What the fuzzy labels of a learnt controller have come to mean.

Nothing is assumed.  The paper calls the first of a pair "near" (and leaves it open for the
ball's direction); learning is free to swap a pair, or to make it useless.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from fntg_jax.controller import network
from fntg_jax.controller.controller import Controller

INDISTINCT = 0.1  # a pair whose shares vary less than this over the field tells nothing apart

_WORDS = {"A": ("near", "far"), "B": ("near", "far"), "C": ("right", "left")}  # low x, high x
_BETWEEN = {
    "A": ("in between", "near or far"),
    "B": ("in between", "near or far"),
    "C": ("in between", "to either side"),
}
_INPUTS = {"A": ("d_B", "m"), "B": ("d_O", "m"), "C": ("theta_B", "rad"), "D": ("theta_O", "rad")}


class Label(NamedTuple):
    """A fuzzy label: symbol ("A1"), name, and in words where it has over half of its family's
    weight."""

    symbol: str
    name: str
    where: str


def shares(controller: Controller, family: str, x: np.ndarray) -> np.ndarray:
    """Shares of a family's labels at inputs x (m or rad): [labels, ...], summing to 1."""
    p = controller.params
    if family == "D":
        return np.stack(network.obstacle_side_shares(jnp.asarray(x), p.sigma))
    first = network.sigmoid_share(
        jnp.asarray(x), getattr(p, f"a_{family}"), getattr(p, f"c_{family}")
    )
    return np.stack([first, 1 - first])


def input_range(family: str, field: Any) -> tuple[float, float]:
    """What the input of a family can be on a field: m or rad."""
    ends = {
        "A": (0.0, float(np.hypot(field.length, field.width))),
        "B": (0.0, min(field.length, field.width) / 2),
    }
    return ends.get(family, (-np.pi, np.pi))


def describe_labels(
    controller: Controller, field: Any
) -> tuple[dict[str, tuple[Label, ...]], list[str]]:
    """Names of all labels from their shares over the field, and notes on what is unexpected."""
    found, notes = {}, []
    for family, (symbol, unit) in _INPUTS.items():
        x = np.linspace(*input_range(family, field), 801)
        y = shares(controller, family, x)
        names: tuple[str, ...] = ("left", "right", "not in the way")
        if family != "D":
            names, note = _pair_names(family, y[0])
            notes += [note] if note else []
        found[family] = tuple(
            Label(f"{family}{n + 1}", name, _where(x, row, symbol, unit))
            for n, (name, row) in enumerate(zip(names, y))
        )
    return found, notes


def _pair_names(family: str, share: np.ndarray) -> tuple[tuple[str, str], str]:
    """Names of both labels from the first one's share over rising x, and a note or ""."""
    change = np.diff(share)
    rise, fall = change[change > 0].sum(), -change[change < 0].sum()
    symbols = f"{family}1 and {family}2"
    if np.ptp(share) < INDISTINCT:
        what = "direction" if family == "C" else "distance"
        note = f"{symbols} tell nothing apart: their shares are the same all over the field"
        return (f"any {what} ({family}1)", f"any {what} ({family}2)"), note
    low, high = _WORDS[family]
    if min(rise, fall) < INDISTINCT * max(rise, fall):
        if rise > fall:
            swapped = family != "C"
            note = f'{symbols} have swapped: {family}1 is "{high}", {family}2 is "{low}"'
            return (high, low), note if swapped else ""
        return (low, high), ""
    inside, outside = _BETWEEN[family]
    hump = share[np.argmax(np.abs(share - share[0]))] > share[0]
    names = (inside, outside) if hump else (outside, inside)
    return names, f"{symbols} split the middle from both ends instead of {low} from {high}"


def _where(x: np.ndarray, share: np.ndarray, symbol: str, unit: str) -> str:
    over = share > 0.5
    if over.all():
        return f"over half everywhere ({share.min():.2f} to {share.max():.2f})"
    if not over.any():
        return f"never over half (at most {share.max():.2f})"
    edges = np.flatnonzero(np.diff(over.astype(int)))
    # Ends of the stretches over half; an open end is the end of the field.
    # Adding 0.0 after rounding turns -0.0 into 0.0.
    crossings = [f"{round((x[n] + x[n + 1]) / 2, 2) + 0.0:.2f}" for n in edges]
    bounds: list[str | None] = [None] * int(over[0]) + crossings
    bounds += [None] * int(over[-1])
    parts = []
    for low, high in zip(bounds[::2], bounds[1::2]):
        if low is None:
            parts.append(f"{symbol} < {high} {unit}")
        elif high is None:
            parts.append(f"{symbol} > {low} {unit}")
        else:
            parts.append(f"{low} < {symbol} < {high} {unit}")
    return "over half for " + " or ".join(parts)
