"""Controller x environment under one scan.

An environment is anything with reset, step, observe, measure, failed and snapshot; nothing
here knows one by name.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from envs.base import Command, Environment
from fntg_jax.controller import network
from fntg_jax.controller.layout import Layout, Params, expand_scalars

SAMPLE_STEPS = (170, 200, 220)  # paper: "data were collected during the 170-th, 200-th and 220-th"
EPISODE_STEPS = SAMPLE_STEPS[-1]  # control steps of a trial


class Outcome(NamedTuple):
    """What one trial is judged by.  Batched trials carry leading axes.

    distance, v, omega: [3], m, m/s, rad/s, after steps 170, 200, 220; clearance: smallest
    true d_O of the trial, m; v_peak: largest v, m/s; failed: the robot fell.
    """

    distance: Float[Array, "3"]
    v: Float[Array, "3"]
    omega: Float[Array, "3"]
    clearance: Float[Array, ""]
    v_peak: Float[Array, ""]
    failed: Bool[Array, ""]


def rollout(
    params: Params,
    scene: Any,
    env: Environment,
    output: network.Output = "scale",
    sample_steps: tuple[int, ...] = SAMPLE_STEPS,
    checkpoint: bool = False,
) -> Outcome:
    """Drive one controller through one scene.

    Args:
        params: full parameter set, best from `layout.expand_scalars`, which vectorises.
        scene: one scene (`envs.base.Scene`), without a leading axis.
        env: anything with the methods of `envs.base.Environment`.
        output: how genes are read, see `network.command`.
        sample_steps: control steps after which distance and velocities are taken; the last one
            ends the trial.
        checkpoint: recompute each control step in the backward pass, so that reverse mode stores
            one state a step and nothing else.

    Returns:
        What the trial is judged by.  Velocities are those commanded.
    """
    state = env.reset(scene)

    def control_step(carry, _):
        state, clearance, v_peak, _ = carry
        command = network.command(params, env.observe(state), env.limits, output)
        # The peaks see the state before the step; the last state is added at the end.
        clearance = jnp.minimum(clearance, env.measure(state).d_obstacle)
        v_peak = jnp.maximum(v_peak, command.v)
        return (env.step(state, command), clearance, v_peak, command), None

    if checkpoint:
        control_step = jax.checkpoint(control_step)
    # Loops of gcd(170, 200, 220) = 10 steps under one loop of 22: the sampled steps are ends of
    # inner loops, nothing but the state has to leave a step, and one body is compiled.
    inner = math.gcd(*sample_steps)

    def segment(carry, end):
        carry, samples = carry
        carry, _ = jax.lax.scan(control_step, carry, None, length=inner)
        state, _, _, command = carry
        now = (env.measure(state).d_ball, command.v, command.omega)
        # Selected here, not stacked as the scan's outputs: XLA's CPU compiler writes the whole
        # stack of 22 anew after each segment, a quarter of all time.
        samples = tuple(
            jax.tree.map(partial(jnp.where, end == step), now, sample)
            for step, sample in zip(sample_steps, samples)
        )
        return (carry, samples), None

    first = env.measure(state).d_obstacle
    nothing = jnp.zeros_like(first)
    carry = (state, first, jnp.full_like(first, -jnp.inf), Command(nothing, nothing))
    samples = ((nothing,) * 3,) * len(sample_steps)
    ends = jnp.arange(inner, sample_steps[-1] + 1, inner)
    (carry, samples), _ = jax.lax.scan(segment, (carry, samples), ends)
    state, clearance, v_peak, _ = carry
    distance, v, omega = (jnp.stack(x) for x in zip(*samples))
    clearance = jnp.minimum(clearance, env.measure(state).d_obstacle)
    return Outcome(distance, v, omega, clearance, v_peak, env.failed(state))


def rollout_pairs(
    layout: Layout,
    theta: Float[Array, "P genes"],
    scenes: Any,
    env: Environment,
    axis: str | None = None,
    **options: Any,
) -> Outcome:
    """Every controller through every scene.

    The pairs are laid out as one flat batch, because the inner loops then run over contiguous
    trials instead of P times over T.  A large batch goes block by block (`num_blocks`).

    Args:
        layout: gene table (static under `jax.jit`).
        theta: [P, genes].
        scenes: T scenes: `envs.base.Scene`, leaves with a leading axis.
        env: anything with the methods of `envs.base.Environment`.
        axis: inside `jax.shard_map`, the devices along this axis share the blocks, and all get all
            outcomes.
        options: further arguments of `rollout`.

    Returns:
        Outcomes, leaves [P, T, ...].

    Raises ValueError where theta does not fit the layout.
    """
    num_scenes = jax.tree.leaves(scenes)[0].shape[0]
    num = theta.shape[0] * num_scenes

    def trial(pair):
        params = expand_scalars(layout, theta[pair // num_scenes])
        scene = jax.tree.map(lambda x: x[pair % num_scenes], scenes)
        return rollout(params, scene, env, **options)

    if num_blocks(num) == 1:
        outcome = jax.vmap(trial)(jnp.arange(num))
    else:
        outcome = _in_blocks(trial, num, axis)
    return jax.tree.map(lambda x: x.reshape(-1, num_scenes, *x.shape[1:]), outcome)


# Trials of a block: 512 were fastest on CPUs for the quadruped, and within a sixth of it for
# the kinematic world (blocks of 64 to 2048; all at once is two to three times slower).
_BLOCK = 512
_BLOCK_ELSEWHERE = 1 << 20  # a GPU wants many trials, within its memory
_LANES = 16  # of a vector register


def num_blocks(num_trials: int) -> int:
    """Into how many blocks a batch is cut: on a CPU so that a block's state stays in the cache.
    Whatever the number of devices: it changes no bit of a result.

    Args:
        num_trials: of the batch.
    """
    size = _BLOCK if jax.default_backend() == "cpu" else _BLOCK_ELSEWHERE
    return max(round(num_trials / size), 1)


def _in_blocks(trial, num, axis):
    """`trial` of 0 .. num - 1, leaves [num, ...], one block after the other."""
    blocks = num_blocks(num)
    # Whole registers; the last block is filled up with repetitions of the last trial.
    size = -(-num // (blocks * _LANES)) * _LANES

    def block(first):
        # One array leaves the loop: of several, XLA's CPU compiler writes all rows anew after each
        # block (35 instead of 76 M control steps/s).
        pairs = jnp.minimum(first + jnp.arange(size), num - 1)
        return jax.vmap(lambda pair: ravel_pytree(trial(pair))[0], out_axes=1)(pairs)

    if axis is None:
        rows = jax.lax.map(block, size * jnp.arange(blocks))  # [block, value, trial]
    else:
        # Every device gets as many blocks; the surplus repeats the last trial, too.
        share = -(-blocks // jax.lax.axis_size(axis))
        mine = share * jax.lax.axis_index(axis) + jnp.arange(share)
        rows = jax.lax.all_gather(jax.lax.map(block, size * mine), axis, tiled=True)
    rows = jnp.moveaxis(rows, 1, -1).reshape(rows.shape[0] * size, -1)[:num]
    like = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(trial, 0))
    return jax.vmap(ravel_pytree(like)[1])(rows)


class Trajectory(NamedTuple):
    """One trial step by step, [N + 1] states and the N commands between them.

    snapshot: the environment's positions; observation: what the controller saw; measured:
    the truth; command: v (m/s), omega (rad/s) applied from each state on; failed: at the end.
    """

    snapshot: Any
    observation: Any
    measured: Any
    command: Command
    failed: Bool[Array, ""]


def trajectory(
    params: Params,
    scene: Any,
    env: Environment,
    output: network.Output = "scale",
    num_steps: int = SAMPLE_STEPS[-1],
) -> Trajectory:
    """Record one trial, for pictures and replay.

    Args:
        params: full parameter set.
        scene: one scene, without a leading axis.
        env: anything with the methods of `envs.base.Environment`.
        output: how genes are read, see `network.command`.
        num_steps: control steps N.

    Returns:
        N + 1 states and the N commands between them.
    """

    def look(state):
        return env.snapshot(state), env.observe(state), env.measure(state)

    def control_step(state, _):
        seen = look(state)
        command = network.command(params, seen[1], env.limits, output)
        return env.step(state, command), (seen, command)

    state, (seen, commands) = jax.lax.scan(control_step, env.reset(scene), None, length=num_steps)
    seen = jax.tree.map(lambda xs, x: jnp.concatenate([xs, x[None]]), seen, look(state))
    return Trajectory(seen[0], seen[1], seen[2], commands, env.failed(state))


def outcome_of(measured: Any, command: Any, failed: Any) -> Outcome:
    """What a recorded trial is judged by.

    Args:
        measured: true observations, leaves [N + 1].
        command: v, m/s, and omega, rad/s, leaves [N].
        failed: whether the robot had fallen at the end.
    """
    after = np.asarray(SAMPLE_STEPS)
    return Outcome(
        distance=measured.d_ball[after],
        v=command.v[after - 1],
        omega=command.omega[after - 1],
        clearance=jnp.min(measured.d_obstacle),
        v_peak=jnp.max(command.v),
        failed=failed,
    )
