"""A differential-drive robot: the body that shows what a port of the behaviours takes."""

from typing import Any

from envs import mix, scenes
from envs.base import Limits, World, check_options
from envs.field import FIELD

_LIMITS = {"v_min": (-0.5, 0.5), "v_max": (0.001, 0.5), "omega_max": (0.01, 4.0)}
_OTHER = {"dt": (0.004, 1), "ball_deceleration": (0, 10)}


def make(**options: float) -> Any:
    """A `Wheeled` from flat options by name: dt (a multiple of 4 ms); v_min, v_max, omega_max;
    ball_deceleration.  Raises ValueError naming the option, its value and what is allowed."""
    from envs.wheeled.environment import SUBSTEP, Wheeled

    check_options(options, {**_LIMITS, **_OTHER})
    own = {"v_min": 0.0, "v_max": 0.2, "omega_max": 1.5}
    limits = Limits(**own | {name: options.pop(name) for name in _LIMITS if name in options})
    if limits.v_min >= limits.v_max:
        raise ValueError(f"env option v_min = {limits.v_min}: must be below v_max = {limits.v_max}")
    dt = options.get("dt", 0.1)
    if abs(round(dt / SUBSTEP) * SUBSTEP - dt) > 1e-6:
        raise ValueError(f"env option dt = {dt}: allowed are multiples of {SUBSTEP}")
    fields: dict[str, Any] = dict(options)
    return Wheeled(limits=limits, **fields)


world = World(make, scenes.SUITES, mix.Mix, FIELD)
