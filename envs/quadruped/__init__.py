"""The Sony ERS-210 walking in physics: model, locomotion and environment.

MuJoCo and MJX are imported when a world is made, not before.
"""

import os
from collections.abc import Callable
from functools import partial
from typing import Any

from envs import mix, scenes
from envs.base import Film, Limits, Scene, World, check_options
from envs.field import FIELD
from envs.quadruped.constants import OWN

# Option -> (least, largest) value.
_LIMITS = {"v_min": (-0.3, 0.3), "v_max": (0.001, 0.3), "omega_max": (0.01, 2.0)}
_OTHER = {"dt": (0.004, 1), "ball_deceleration": (0, 10), "servo_speed": (0.1, 100)}
# How trials differ (`nature.Nature`).
_NATURE = {
    **{"friction_low": (0.1, 2), "friction_high": (0.1, 2), "mass": (0, 0.5), "gain": (0, 0.5)},
    **{"torque": (0, 0.5), "latency": (0, 0.3), "angle_noise": (0, 3.2), "range_noise": (0, 1)},
    **{"push": (0, 2), "pose": (0, 0.3)},
}
_TIMESTEP = 0.004  # s, of physics


def make(impl: str = "structured", /, **options: float) -> Any:
    """A `Quadruped` from flat options by name: dt (a multiple of 4 ms); v_min, v_max, omega_max;
    ball_deceleration; servo_speed (how fast set-points may move; 1: Sony's joint speeds); and what
    differs from trial to trial (`nature.Nature`): friction_low, friction_high, mass, gain, torque,
    latency, angle_noise, range_noise, push, pose.

    impl: structured, jax or warp.  Raises ValueError naming the option, its value and the
    allowed range, and where MuJoCo is not installed.
    """
    check_options(options, {**_LIMITS, **_OTHER, **_NATURE})
    limits = Limits(**OWN | {name: options.pop(name) for name in _LIMITS if name in options})
    if limits.v_min >= limits.v_max:
        raise ValueError(f"env option v_min = {limits.v_min}: must be below v_max = {limits.v_max}")
    dt = options.pop("dt", 0.1)
    substeps = round(dt / _TIMESTEP)
    if abs(substeps * _TIMESTEP - dt) > 1e-6:
        raise ValueError(f"env option dt = {dt}: allowed are multiples of {_TIMESTEP}")
    drawn = {name: options.pop(name) for name in _NATURE if name in options}
    low, high = (drawn.get(f"friction_{end}", 1.0) for end in ("low", "high"))
    if low > high:
        raise ValueError(
            f"env option friction_low = {low}: must not be above friction_high = {high}"
        )
    if drawn and impl != "structured":
        raise ValueError(f"env option {next(iter(drawn))}: only the world quadruped varies the dog")
    try:
        from envs.quadruped.environment import standing
        from envs.quadruped.nature import Nature
        from envs.quadruped.physics import Solver
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("mujoco"):
            raise
        raise ValueError(
            f"the quadruped needs {error.name}: pip install mujoco mujoco-mjx"
        ) from error
    # MuJoCo loads its OpenGL back end when it is imported; each fails with errors of its own.
    except (AttributeError, OSError, RuntimeError) as error:
        chosen = os.environ.get("MUJOCO_GL", "")
        raise ValueError(
            f"MUJOCO_GL = {chosen!r}: MuJoCo does not start with it ({error}); unset it, or set egl"
            " (Debian: libegl1 libgl1-mesa-dri) or osmesa (libosmesa6)"
        ) from error
    fields: dict[str, Any] = dict(options)
    return standing(
        limits=limits,
        solver=Solver(impl, _TIMESTEP, substeps),
        nature=Nature(**drawn) if drawn else None,
        **fields,
    )


def _film(env: Any, batch: Scene, control: Callable[[Any], Any], window: bool) -> Film:
    from envs.quadruped.render import FullFilm

    return FullFilm(env, batch, control, window)


def _world(impl: str) -> World:
    # Feet stick and slip: the gradient is finite and wrong, and takes minutes to compile.
    return World(partial(make, impl), scenes.SUITES, mix.Mix, FIELD, _film, differentiable=False)


world = _world("structured")
world_mjx = _world("jax")
world_warp = _world("warp")
