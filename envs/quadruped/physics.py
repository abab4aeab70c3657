"""Three ways to compute one physics step of the lean model, and the pose it starts from.

jax: stock MJX.  warp: MJX's Warp back end, for CUDA; no gradients.  structured: the same
equations written out for a trunk with four three-joint legs (`dynamics`).
"""

import contextlib
import dataclasses
import functools
import io
import os
import warnings
from collections.abc import Callable

import jax
import mujoco
import numpy as np

from envs.base import Refusal
from envs.quadruped import dynamics, mjcf, rigid_body
from envs.quadruped.locomotion import Gait, leg_inverse, stance

with contextlib.redirect_stdout(io.StringIO()):  # "Failed to import warp", which is optional
    from mujoco import mjx

_FUSION = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion"
IMPLS = ("jax", "warp", "structured")
NUM_Q, NUM_V = 19, 18  # coordinates and speeds of the lean model

# (qpos [19], qvel [18], set-points [12], how the dog differs) -> (qpos, qvel) one timestep later
StepFn = Callable[..., tuple[jax.Array, jax.Array]]


@dataclasses.dataclass(frozen=True)
class Solver:
    """How physics is computed.  Static: another value is another compiled program.

    impl: see above.  timestep: s.  substeps: of a control step.  iterations, ls_iterations: of
    Newton's method and its line search; impl='structured' has 1 and, to the same precision, a line
    search of its own.  The defaults are the fastest that are stable.
    """

    impl: str = "structured"
    timestep: float = 0.004
    substeps: int = 25
    iterations: int = 1
    ls_iterations: int = 8

    def __post_init__(self):
        if self.impl not in IMPLS:
            raise ValueError(f"impl = {self.impl!r}: allowed are {', '.join(IMPLS)}")
        for name in ("timestep", "substeps", "iterations", "ls_iterations"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be above 0")
        if self.impl == "structured" and self.iterations != 1:
            raise ValueError(f"iterations = {self.iterations}: impl='structured' does 1")


@functools.cache
def compile_model(variant: str, solver: Solver, num_obstacles: int = 2) -> mujoco.MjModel:
    """The MuJoCo model of a variant."""
    return mujoco.MjModel.from_xml_string(
        mjcf.mjcf(
            variant,
            timestep=solver.timestep,
            iterations=solver.iterations,
            ls_iterations=solver.ls_iterations,
            num_obstacles=num_obstacles,
        )
    )


@functools.cache
def _numbers(solver: Solver) -> rigid_body.Constants:
    return rigid_body.constants_of(compile_model(mjcf.LEAN, solver))


def constants(solver: Solver, variation: rigid_body.Variation) -> rigid_body.Constants:
    """The lean model's numbers, for a dog that differs from it."""
    return rigid_body.vary(_numbers(solver), variation)


@functools.cache
def step_fn(solver: Solver) -> StepFn:
    """The physics step of the lean model under a solver.

    Only position and velocity are carried from step to step: without warm start nothing else
    has a memory.  Raises ValueError where Warp is not installed for impl='warp', or where XLA's
    flags would make impl='jax' abort the process or its CPU devices let it hang.
    """
    fused = "xla_cpu_use_multi_output_fusion" in os.environ.get("XLA_FLAGS", "")
    on_cpu = jax.default_backend() == "cpu"
    if solver.impl == "structured":
        if on_cpu and not fused:
            warnings.warn(f"{_FUSION} is not in XLA_FLAGS: compiling takes minutes", stacklevel=2)

        def structured(qpos, qvel, ctrl, variation=rigid_body.Variation()):
            return dynamics.step(constants(solver, variation), qpos, qvel, ctrl)

        return structured
    if solver.impl == "jax" and on_cpu and fused:
        # jaxlib 0.10.2: "Check failed: GetNumDims() == other.GetNumResults()", an abort.
        raise Refusal(
            f"impl = 'jax' does not compile with {_FUSION}, which fntg sets: FNTG_XLA_FLAGS=off"
            " leaves it out; or take impl = 'structured', --env quadruped"
        )
    if solver.impl == "jax" and on_cpu and jax.local_device_count() > 1:
        # jaxlib 0.10.2: batched Cholesky factorisations on two CPU devices of one process wait for
        # each other's threads for ever.  The structured step has none.
        raise Refusal(
            "impl = 'jax' can hang on more than one CPU device in a process: set"
            " XLA_FLAGS=--xla_force_host_platform_device_count=1, or take impl = 'structured',"
            " --env quadruped"
        )
    if solver.impl == "warp":
        _silence_warp()
    model = compile_model(mjcf.LEAN, solver)
    # Called under a trace, too: the model must still be made of constants.
    with jax.ensure_compile_time_eval():
        mjx_model = mjx.put_model(model, impl=solver.impl)
        if solver.impl == "warp":
            # Else it warns on stdout of every step that Newton's method stopped at the iterations
            # it was given.
            mjx_model = mjx_model.tree_replace({"opt._impl.warn_overflow": 0})
        data = mjx.make_data(model, impl=solver.impl)

    def step(qpos, qvel, ctrl, variation=rigid_body.Variation()):
        if any(x is not None for x in variation):
            raise ValueError(f"impl = {solver.impl!r}: only 'structured' varies the dog")
        new = mjx.step(mjx_model, data.replace(qpos=qpos, qvel=qvel, ctrl=ctrl))
        return new.qpos, new.qvel

    return step


def _silence_warp() -> None:
    """No list of loaded kernels on stdout, where results go."""
    try:
        import warp
    except ModuleNotFoundError:
        raise ValueError("impl = 'warp' needs Warp: pip install 'fntg-jax[warp]'") from None
    warp.config.log_level = warp.LOG_WARNING


def settled(gait: Gait, solver: Solver) -> np.ndarray:
    """Coordinates [19] of the dog standing at rest at the origin, heading along x.

    Found by letting it stand for two seconds in native MuJoCo.  Feet at exactly the floor's
    height would be in contact in one precision and not in the other.  Computed without JAX: making
    a world must not start it, since XLA's flags may not be set yet.
    """
    model = compile_model(mjcf.LEAN, solver)
    joints = leg_inverse(stance(gait, np), np).ravel()
    data = mujoco.MjData(model)
    data.qpos[2] = gait.height + 0.01
    data.qpos[7:] = joints
    data.ctrl[:] = joints
    for _ in range(round(2.0 / solver.timestep)):
        mujoco.mj_step(model, data)
    pose = np.asarray(data.qpos, np.float32)
    pose[:2] = 0
    return pose
