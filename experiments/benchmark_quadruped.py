"""Physics steps a second of the quadruped: our step, stock MJX, Warp, MuJoCo's C code.

    python -m experiments.benchmark_quadruped [--impls structured native] [--batches 1 60 240]

One row a back end and batch: compile time, steps a second (best of three) and what the paper's
generation (60 genomes x 4 starts x 220 control steps of 25) takes at that rate.  Stock MJX needs
FNTG_XLA_FLAGS=off, the structured step needs the flags: two runs.  On a GPU:

    python -m experiments.benchmark_quadruped --impls jax warp structured --batches 240 4096 65536
"""

import dataclasses
import time
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.running import xla

GENERATION = 60 * 4 * 220 * 25  # physics steps


@dataclasses.dataclass(frozen=True)
class Config:
    """What to time.

    Attributes:
        impls: our step, stock MJX, MJX on Warp, MuJoCo's C code.
        batches: environments side by side.
        control_steps: length of a timed roll-out.
        num_threads: of the native code.
        csv: where the table goes, too.
    """

    impls: tuple[Literal["structured", "jax", "warp", "native"], ...] = ("structured", "native")
    batches: tuple[int, ...] = (1, 16, 60, 240)
    control_steps: int = 44
    num_threads: int = 1
    csv: Path | None = None


def time_jax(impl: str, batch: int, control_steps: int) -> tuple[float, float]:
    """(compile time in s, steps a second) of the environment walking to and fro."""
    from envs import scenes
    from envs.base import Command
    from envs.quadruped import make

    env = make(impl)
    starts = scenes.open_field(jax.random.key(0), batch)
    t = jnp.arange(control_steps) * env.dt

    def one(env, scene):
        def control_step(state, t):
            return env.step(state, Command(0.2 * jnp.cos(t), jnp.sin(t))), None

        return jax.lax.scan(control_step, env.reset(scene), t)[0].qpos

    start = time.perf_counter()
    walk = jax.jit(jax.vmap(one, (None, 0))).lower(env, starts).compile()
    compile_time = time.perf_counter() - start
    walk(env, starts).block_until_ready()
    times = []
    for _ in range(3):
        start = time.perf_counter()
        walk(env, starts).block_until_ready()
        times.append(time.perf_counter() - start)
    return compile_time, batch * control_steps * env.solver.substeps / min(times)


def time_native(batch: int, control_steps: int, num_threads: int) -> tuple[float, float]:
    """The same number of steps in C, open loop."""
    import mujoco
    from mujoco import rollout

    from envs.quadruped import locomotion, physics

    solver, gait = physics.Solver(), locomotion.load_gait()
    model = physics.compile_model("lean", solver)
    num = control_steps * solver.substeps
    phases = jnp.arange(num) * solver.timestep / gait.period % 1
    points = np.asarray(locomotion.set_points(gait, phases, jnp.asarray([0.2, 0.0, 0.3])))
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros((batch, size))
    state[:, 1:20] = physics.settled(gait, solver)
    datas = [mujoco.MjData(model) for _ in range(num_threads)]
    times = []
    with rollout.Rollout(nthread=num_threads) as pool:
        for _ in range(3):
            start = time.perf_counter()
            pool.rollout(model, datas, state, np.tile(points, (batch, 1, 1)))
            times.append(time.perf_counter() - start)
    return 0.0, batch * num / min(times)


def run(config: Config) -> list[dict]:
    """The rows, printed as they come.  Raises ValueError on bad options."""
    script.check_least(config, control_steps=1, num_threads=1)
    if not config.impls:
        raise ValueError("impls = (): allowed is one back end or more")
    if min(config.batches, default=0) < 1:
        raise ValueError(f"batches = {config.batches}: allowed are numbers from 1")
    script.check_files(config, "csv")
    rows = []
    for impl in config.impls:
        for batch in config.batches:
            if impl == "native":
                compile_time, rate = time_native(batch, config.control_steps, config.num_threads)
            else:
                compile_time, rate = time_jax(impl, batch, config.control_steps)
            rows.append(
                {"impl": impl, "batch": batch, "compile_s": round(compile_time, 1)}
                | {"steps_per_s": round(rate), "generation_s": round(GENERATION / rate, 2)}
            )
            print(" ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    return rows


def main(argv: list[str] | None = None) -> None:
    config = script.options(Config, Config.__doc__, "experiments/benchmark_quadruped.py", argv)
    xla.configure()
    print(f"{jax.devices()}", flush=True)
    try:
        rows = run(config)
    except ValueError as error:
        refuse(str(error))
    if config.csv is not None:
        script.write_csv(config.csv, rows[0], [row.values() for row in rows])


if __name__ == "__main__":
    main()
