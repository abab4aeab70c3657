"""Bounds of a configuration's fields: written once, beside the field, and checked in one place."""

import dataclasses
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

LARGEST = 1e30  # what a number is in float32 counts: 1e300 is infinite there, 1e-300 nothing


class Bounds(NamedTuple):
    """Least and largest value; above: the least itself is not allowed."""

    least: float
    most: float = LARGEST
    above: bool = False

    def hold(self, value: Any) -> bool:
        """Whether a value is allowed; NaN never is."""
        low = value > self.least if self.above else value >= self.least
        return bool(low and value <= self.most and (value == 0 or abs(value) >= 1 / LARGEST))

    def words(self, whole: bool) -> str:
        """What is allowed."""
        what = "whole numbers" if whole else "numbers"
        least, most = (str(x) if whole else f"{x:g}" for x in (self.least, self.most))
        if self.above:
            return f"{what} above {least}, up to {most}"
        return f"{what} from {least} to {most}"


def bounded(
    default: Any,
    least: float,
    most: float = LARGEST,
    above: bool = False,
    static: bool = False,
) -> Any:
    """A field of a frozen dataclass with its bounds.

    Args:
        default: value; of whole numbers an int, of others a float.
        least: smallest value.
        most: largest.
        above: `least` itself is not allowed.
        static: of a pytree: programs are compiled for it.
    """
    return dataclasses.field(
        default=default, metadata={"bounds": Bounds(least, most, above), "static": static}
    )


def check(config: Any, group: str = "") -> None:
    """Check all fields that have bounds (`bounded`) or are words (Literal).

    Args:
        config: a dataclass of numbers and words; others of its fields are not looked at.
        group: its name in what it is a field of.

    Raises ValueError: field, value, what is allowed.
    """
    kinds = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value, allowed = getattr(config, field.name), ""
        bounds = field.metadata.get("bounds")
        if get_origin(kinds[field.name]) is Literal:
            words = get_args(kinds[field.name])
            allowed = "" if value in words else ", ".join(words)
        elif bounds is not None and not bounds.hold(value):
            allowed = bounds.words(isinstance(field.default, int))
        if allowed:
            name = f"{group}.{field.name}" if group else field.name
            raise ValueError(f"{name} = {value!r}: allowed are {allowed}")
