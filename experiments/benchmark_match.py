"""Speed of the match in environment steps (0.1 s of play of all six robots) a second.

    python -m experiments.benchmark_match [--quick] [--json]

bare: the match alone, robots driven by arithmetic on true positions.  senses: with all senses at
the objects level, written out for all robots in every step.  stack: `cerberus` against itself, once
that team is installed.  vmas: VMAS football, three a side, PyTorch, at its best batch (optional:
pip install vmas), after the others in the same run.  Each other is the best of several interleaved
repetitions on all cores.
"""

import argparse
import importlib.util
import json
import os
import time

from fntg_jax.running import xla

BLOCK = 64
SIZES = (1, 16, 128, 1024, 8192, 100_000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few seconds a number")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    xla.configure(num_cpu_devices=cores)
    programs = {"bare": _bare(), "senses": _senses()}
    stack = _stack()
    if stack is not None:
        programs["stack"] = stack
    blocks = 4 if options.quick else 32
    steps = 200 if options.quick else 1000
    best: dict[str, float | None] = dict.fromkeys(("bare", "senses", "stack", "vmas"))
    runs = {name: make(BLOCK * blocks * cores, steps) for name, make in programs.items()}
    for _ in range(3 if options.quick else 7):
        for name, run in runs.items():
            rate = BLOCK * blocks * cores * steps / _seconds(run)
            best[name] = max(rate, best[name] or 0.0)
    best["vmas"] = _vmas(2.0 if options.quick else 20.0)
    table = []
    if not options.quick:
        for size in SIZES:
            run = _bare()(size, max(10, min(2000, 2_000_000 // size)))
            seconds = min(_seconds(run) for _ in range(3))
            table.append((size, size * max(10, min(2000, 2_000_000 // size)) / seconds))
    if options.json:
        print(json.dumps({**best, "cores": cores, "by_matches": table}, allow_nan=False))
        return
    print(f"environment steps/s, {cores} cores, best of interleaved repetitions")
    for name, value in best.items():
        note = "left out: not installed" if value is None else f"{value:14,.0f}"
        print(f"{name:8s}{note}")
    if best["vmas"] and best["bare"]:
        print(f"bare / vmas {best['bare'] / best['vmas']:.0f}")
    for size, rate in table:
        print(f"{size:8d} matches at once, bare {rate:14,.0f}")


def _seconds(run) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _spread(block, num: int, fuse: bool):
    """`block(seeds) -> [rows, size]` over `num` seeds, in blocks, on all devices; compiled."""
    import jax
    import jax.numpy as jnp
    import numpy as np
    from jax.sharding import Mesh
    from jax.sharding import PartitionSpec as P

    size = min(num, BLOCK)
    blocks = -(-num // size)
    devices = jax.devices()[: min(len(jax.devices()), blocks)]
    blocks = -(-blocks // len(devices)) * len(devices)
    seeds = jnp.arange(blocks * size, dtype=jnp.int32).reshape(blocks, size)
    mesh = Mesh(np.asarray(devices), ("match",))
    fn = jax.shard_map(
        lambda s: jax.lax.map(block, s),
        mesh=mesh,
        in_specs=P("match"),
        out_specs=P("match"),
        check_vma=False,
    )
    # The match alone is faster when no kernel has several outputs (see docs/match.md).
    options: dict[str, str | bool] = {}
    if not fuse:
        options["xla_disable_hlo_passes"] = "cpu_multi_output_fusion"
    program = jax.jit(fn).lower(seeds).compile(options)
    jax.block_until_ready(program(seeds))
    return lambda: jax.block_until_ready(program(seeds))


def _program(with_senses: bool):
    import jax
    import jax.numpy as jnp

    from envs.base import Action, Walk
    from envs.soccer import Match

    match = Match(minutes=10)
    robots = match.robots

    def drive(state):
        r, ball = state.robots, state.ball
        x, y = ball.x - r.x, ball.y - r.y
        none = jnp.zeros_like(r.doing)
        omega = jnp.clip(3 * (r.cos * y - r.sin * x), -1, 1)
        kick = (x * x + y * y < 0.035).astype(jnp.int32)
        shape = (3, *r.x.shape)
        return Action(
            Walk(none, jnp.full_like(r.x, 0.15), jnp.zeros_like(r.x), omega),
            jnp.zeros(shape),
            kick,
            none,
            jnp.zeros((2, *r.x.shape), jnp.uint32),
        )

    def make(num: int, steps: int):
        def block(seeds):
            state = match.reset(seeds % 2, seeds)
            senses = jax.tree.map(jnp.zeros_like, match.sense_batch(state)) if with_senses else ()

            def step(carry, _):
                state, senses = carry
                # Carried, so that every sense of every robot is written in every step.
                senses = match.sense_batch(state) if with_senses else ()
                return (match.step_batch(state, drive(state)), senses), None

            (state, senses), _ = jax.lax.scan(step, (state, senses), None, length=steps)
            used = [state.ball.x, state.ball.y, *state.statistics.goals.astype(jnp.float32)]
            return jnp.stack(used + ([senses.proximity[0]] if with_senses else []))

        return _spread(block, num, fuse=with_senses)

    assert robots == 6
    return make


def _bare():
    return _program(False)


def _senses():
    return _program(True)


def _stack():
    """`cerberus` against itself, None where that team is not installed."""
    import jax.numpy as jnp

    from fntg_jax.learning import play
    from fntg_jax.running import matches

    if "cerberus" not in matches.team_names():
        return None
    match = matches.get_match("soccer", minutes=10)
    home, away = (matches.get_team("cerberus", match, k) for k in (0, 1))

    def make(num: int, steps: int):
        def block(seeds):
            result = play.play(match, home, away, seeds, num_steps=steps)
            return jnp.moveaxis(result.goals, 0, -1)

        return _spread(block, num, fuse=True)

    return make


def _vmas(seconds: float) -> float | None:
    """VMAS football, three a side, random actions: the best of several batch sizes."""
    if importlib.util.find_spec("vmas") is None:
        return None
    import vmas

    best = 0.0
    batches = (2048, 8192, 32768, 131072)
    for batch in batches:
        env = vmas.make_env(
            "football",
            num_envs=batch,
            device="cpu",
            continuous_actions=True,
            n_blue_agents=3,
            n_red_agents=3,
            ai_red_agents=False,
            ai_blue_agents=False,
        )
        env.reset()
        actions = [env.get_random_action(agent) for agent in env.agents]
        env.step(actions)
        start, count = time.perf_counter(), 0
        while time.perf_counter() - start < seconds / len(batches):
            env.step(actions)
            count += batch
        best = max(best, count / (time.perf_counter() - start))
    return best


if __name__ == "__main__":
    main()
