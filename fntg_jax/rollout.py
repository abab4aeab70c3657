"""Controller x environment under one scan.

An environment is anything with reset, step, observe, measure, failed and snapshot; nothing
here knows one by name.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from fntg_jax import fntg
from fntg_jax.layout import Layout, Params, expand_scalars

SAMPLE_STEPS = (170, 200, 220)  # paper: "data were collected during the 170-th, 200-th and 220-th"


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
    env: Any,
    output: fntg.Output = "scale",
    sample_steps: tuple[int, ...] = SAMPLE_STEPS,
    unroll: int = 1,
    checkpoint: bool = False,
) -> Outcome:
    """Drive one controller through one scene.

    params: best from `layout.expand_scalars`, which vectorises.  Velocities are those
    commanded.  checkpoint: recompute each control step in the backward
    pass, so that reverse mode stores one state a step and nothing else.
    """
    state = env.reset(scene)

    def control_step(carry, _):
        state, clearance, v_peak, _ = carry
        command = fntg.command(params, env.observe(state), env.limits, output)
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
        carry, _ = jax.lax.scan(control_step, carry, None, length=inner, unroll=unroll)
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
    carry = (state, first, jnp.full_like(first, -jnp.inf), fntg.Command(nothing, nothing))
    samples = ((nothing,) * 3,) * len(sample_steps)
    ends = jnp.arange(inner, sample_steps[-1] + 1, inner)
    (carry, samples), _ = jax.lax.scan(segment, (carry, samples), ends)
    state, clearance, v_peak, _ = carry
    distance, v, omega = (jnp.stack(x) for x in zip(*samples))
    clearance = jnp.minimum(clearance, env.measure(state).d_obstacle)
    return Outcome(distance, v, omega, clearance, v_peak, env.failed(state))


def rollout_pairs(
    layout: Layout, theta: Float[Array, "P genes"], scenes: Any, env: Any, **options: Any
) -> Outcome:
    """Every controller through every scene: theta [P, genes] and T scenes give outcomes [P, T].

    The pairs are laid out as one flat batch, because the inner loops then run over contiguous
    trials instead of P times over T.  On CPU a large batch goes block by block, so that a
    block's state stays in the cache.  options: those of `rollout`.
    """
    num_scenes = jax.tree.leaves(scenes)[0].shape[0]
    num = theta.shape[0] * num_scenes

    def trial(pair):
        params = expand_scalars(layout, theta[pair // num_scenes])
        scene = jax.tree.map(lambda x: x[pair % num_scenes], scenes)
        return rollout(params, scene, env, **options)

    num_blocks = round(num / _BLOCK) if jax.default_backend() == "cpu" else 1
    if num_blocks <= 1:
        outcome = jax.vmap(trial)(jnp.arange(num))
    else:
        outcome = _in_blocks(trial, num, num_blocks)
    return jax.tree.map(lambda x: x.reshape(-1, num_scenes, *x.shape[1:]), outcome)


# Trials of a block.  60 000 trials of the kinematic world, speed relative to the C version on one
# core (Xeon 2.8 GHz, jax 0.10.2, disturbed by others): 0.3 all at once; in blocks of 64: 0.87,
# 128: 0.89, 256: 0.83, 512: 0.76, 1024: 0.72, 2048: 0.78.  2048 trials of the quadruped, thousand
# control steps/s: 42-55 all at once; 256: 35, 512: 59, 1024: 56.
_BLOCK = 512
_LANES = 16  # of a vector register


def _in_blocks(trial, num, num_blocks):
    """`trial` of 0 .. num - 1, leaves [num, ...], so many blocks one after the other."""
    # Whole registers; the last block is filled up with repetitions of the last trial.
    size = -(-num // (num_blocks * _LANES)) * _LANES

    def block(first):
        # One array leaves the loop: of several, XLA's CPU compiler writes all rows anew after each
        # block (35 instead of 76 M control steps/s).
        pairs = jnp.minimum(first + jnp.arange(size), num - 1)
        return jax.vmap(lambda pair: ravel_pytree(trial(pair))[0], out_axes=1)(pairs)

    rows = jax.lax.map(block, size * jnp.arange(num_blocks))  # [block, value, trial]
    rows = jnp.moveaxis(rows, 1, -1).reshape(num_blocks * size, -1)[:num]
    like = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(trial, 0))
    return jax.vmap(ravel_pytree(like)[1])(rows)


class Trajectory(NamedTuple):
    """One trial step by step, [N + 1] states and the N commands between them.

    snapshot: the environment's positions; observation: what the controller saw; measured:
    the truth; command: v (m/s), omega (rad/s) applied from each state on.
    """

    snapshot: Any
    observation: Any
    measured: Any
    command: fntg.Command


def trajectory(
    params: Params,
    scene: Any,
    env: Any,
    output: fntg.Output = "scale",
    num_steps: int = SAMPLE_STEPS[-1],
) -> Trajectory:
    """Record one trial, for pictures and replay."""

    def look(state):
        return env.snapshot(state), env.observe(state), env.measure(state)

    def control_step(state, _):
        seen = look(state)
        command = fntg.command(params, seen[1], env.limits, output)
        return env.step(state, command), (seen, command)

    state, (seen, commands) = jax.lax.scan(control_step, env.reset(scene), None, length=num_steps)
    seen = jax.tree.map(lambda xs, x: jnp.concatenate([xs, x[None]]), seen, look(state))
    return Trajectory(seen[0], seen[1], seen[2], commands)
