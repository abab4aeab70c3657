"""Fitness of controllers from the outcomes of their trials: maximised, finite, NaN counts 0.

Floats of the weights are traced: a sweep over them is one vmap.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from fntg_jax.learning.bounds import bounded
from fntg_jax.learning.rollout import Outcome

CLEARANCE = 0.145  # m, paper: "the minimal allowed distance between the robot and the obstacle"
REACH = 0.10  # m, success: nearer than this after step 200
STOP = 0.03  # m/s, success: slower than this, averaged over steps 170, 200, 220
GAMMA = 0.1  # of the smooth objective, so that F is at most 100


def from_cost(cost: Any, gamma: Any = GAMMA) -> Any:
    """F = 10 / (gamma + cost), the paper's form: what is maximised, from what is minimised.

    Args:
        cost: >= 0, of any shape.
        gamma: > 0 where the cost can be 0.
    """
    return 10 / (gamma + cost)


def to_cost(value: Any, gamma: Any = GAMMA) -> Any:
    """The inverse of `from_cost`.

    Args:
        value: fitness F > 0, of any shape.
        gamma: as there; with 0, all that stands under the fraction line.
    """
    return 10 / value - gamma


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PaperWeights:
    """Coefficients of the paper's F.

    Attributes:
        gamma: small positive constant.
        distance: factor of the squared distance after step 200, 1/m.
        v: weight of v_fit.
        omega: weight of omega_fit.
        clearance: factor of the squared lack of clearance, 1/m.
        still: weight of phi, not having moved.
        v_moved: the paper's "fixed minimal value" of v, m/s, which it does not give.
    """

    gamma: float = bounded(0.001, 0, above=True)
    distance: float = bounded(6.0, 0)
    v: float = bounded(2.0, 0)
    omega: float = bounded(0.5, 0)
    clearance: float = bounded(20.0, 0)
    still: float = bounded(60.0, 0)
    v_moved: float = bounded(0.05, 0)


def paper_fitness(outcome: Outcome, weights: PaperWeights = PaperWeights()) -> Float[Array, " P"]:
    """F = 10 / (gamma + (6 d)^2 + d_1 + d_2 + 2 v_fit + 0.5 omega_fit + delta + 60 phi).

    d, d_1, d_2: mean distance to the ball after steps 200, 170, 220; v_fit, omega_fit: mean |v|,
    |omega| there; delta = (20 (0.145 - min(h, 0.145)))^2 and phi (1 unless v ever exceeded
    v_moved) per trial, then averaged.  A fall counts as standing still (phi = 1) on top.

    Paper: v is printed without bars.  With backward motion allowed that lets the denominator
    reach zero; with v_min = 0 both readings agree.

    Args:
        outcome: of T trials a genome, leaves [..., T, 3] and [..., T].
        weights: coefficients.

    Returns:
        Fitness [...], maximised.
    """
    w = weights
    d1, d, d2 = jnp.moveaxis(jnp.mean(outcome.distance, axis=-2), -1, 0)
    v_fit = jnp.mean(jnp.abs(outcome.v), axis=(-2, -1))
    omega_fit = jnp.mean(jnp.abs(outcome.omega), axis=(-2, -1))
    short = CLEARANCE - jnp.minimum(outcome.clearance, CLEARANCE)
    delta = jnp.mean((w.clearance * short) ** 2, axis=-1)
    still = (outcome.v_peak <= w.v_moved) | outcome.failed
    phi = jnp.mean(still.astype(d.dtype), axis=-1)
    cost = (w.distance * d) ** 2 + d1 + d2 + w.v * v_fit + w.omega * omega_fit + delta
    return 10 / (w.gamma + cost + w.still * phi)


class Success(NamedTuple):
    """Success of trials and its parts; shapes as the outcome's leading axes."""

    reach: Bool[Array, "..."]
    safe: Bool[Array, "..."]
    stop: Bool[Array, "..."]

    @property
    def success(self) -> Bool[Array, "..."]:
        return self.reach & self.safe & self.stop


def success(outcome: Outcome) -> Success:
    """reach: d < 0.10 m after step 200; safe: d_O never under 0.145 m and no fall; stop: |v|
    below 0.03 m/s, averaged over steps 170, 200, 220.  A NaN anywhere is no success.

    Args:
        outcome: of trials, leaves [..., 3] and [...].

    Returns:
        Each part, bool [...]; `success` is all of them.
    """
    return Success(
        reach=outcome.distance[..., 1] < REACH,
        safe=(outcome.clearance >= CLEARANCE) & ~outcome.failed,
        stop=jnp.mean(jnp.abs(outcome.v), axis=-1) < STOP,
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SmoothWeights:
    """Weights of `smooth_cost`.

    The thresholds (reach, arrived, slow, margin) lie a little inside what counts as success.

    Attributes:
        near: scale of the logarithms of distance, m.
        reach: nearer than this after step 200 costs nothing, m.
        arrival: weight of the distance after step 170, which asks for haste.
        arrived: nearer than this after step 170 costs nothing, m.
        stop: weight of the speed at the end.
        slow: slower than this costs nothing, m/s.
        still: scale of the speed beyond, m/s.
        gate: only within about this distance of the ball does stopping count, m.
        margin: clearance that is asked for, m: more than the 0.145 m that count.
        clearance: weight of falling short of it, per 0.1 m.
    """

    near: float = bounded(0.05, 0, above=True)
    reach: float = bounded(0.06, 0)
    arrival: float = bounded(0.5, 0)
    arrived: float = bounded(0.08, 0)
    stop: float = bounded(1.0, 0)
    slow: float = bounded(0.02, 0)
    still: float = bounded(0.01, 0, above=True)
    gate: float = bounded(0.4, 0, above=True)
    margin: float = bounded(0.16, 0)
    clearance: float = bounded(10.0, 0, above=True)


def smooth_cost(outcome: Outcome, weights: SmoothWeights = SmoothWeights()) -> Float[Array, "..."]:
    """Cost of each trial, >= 0, for learning on scenes that change: log-scaled, gated, and 0
    for a trial that succeeds with a little to spare.

    L(d - reach, near) + arrival L(d_1 - arrived, near)
    + stop L(v_fit - slow, still) / (1 + (d/gate)^2) + clearance max(margin - h, 0) / 0.1 m,
    L(x, scale) = log(1 + (max(x, 0) / scale)^2), with d, d_1 after steps 200, 170.

    The logarithms let no single lost scene outweigh the rest, and what is good enough weighs
    nothing: selection then looks at the scenes that fail.  The gate is what makes it work:
    where stopping always counts, standing still is a local optimum that populations do not
    leave.

    Args:
        outcome: of trials, leaves [..., 3] and [...].
        weights: scales, thresholds and weights.

    Returns:
        Cost [...].
    """
    w = weights

    def beyond(x, enough, scale):
        return jnp.log1p((jnp.maximum(x - enough, 0) / scale) ** 2)

    d1, d = outcome.distance[..., 0], outcome.distance[..., 1]
    v_fit = jnp.mean(jnp.abs(outcome.v), axis=-1)
    short = jnp.maximum(w.margin - outcome.clearance, 0)
    cost = beyond(d, w.reach, w.near) + w.arrival * beyond(d1, w.arrived, w.near)
    cost += w.stop * beyond(v_fit, w.slow, w.still) / (1 + (d / w.gate) ** 2)
    # A fall costs as much as any trial can.
    return cost + w.clearance * short / 0.1 + jnp.where(outcome.failed, 30.0, 0.0)


def smooth_fitness(
    outcome: Outcome, weights: SmoothWeights = SmoothWeights()
) -> Float[Array, " P"]:
    """`from_cost` of the mean `smooth_cost` over the trials: at most 100.

    Args:
        outcome: of T trials a genome, leaves [..., T, 3] and [..., T].
        weights: of `smooth_cost`.

    Returns:
        Fitness [...], maximised.
    """
    return from_cost(jnp.mean(smooth_cost(outcome, weights), axis=-1))
