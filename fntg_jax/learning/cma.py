"""Refinement by covariance matrix adaptation (CMA-ES), for costs whose gradient misleads.

The roll-out jumps where "left" and "right" swap and where another obstacle becomes the nearest.
A pathwise gradient knows nothing of these jumps (see `refine`); a cloud of samples does, and
learns which genes have to move together.  Equations and constants: N. Hansen, "The CMA Evolution
Strategy: A Tutorial", arXiv:1604.00772 (numbers in brackets below; evosax 0.3 and cmaes 0.13 carry
the same ones), with rank-one and rank-mu updates and no negative weights.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from fntg_jax.controller.layout import HIGH, LOW

# (theta [P, genes], scenes) -> mean cost [P].
CostsFn = Callable[[Float[Array, "P genes"], Any], Float[Array, " P"]]

# Samples a step, and first step size in genes, of a search that leaves local optima: of as many
# roll-outs, few steps of many samples came further than many steps of few.
POPULATION = 192
SIGMA = 0.5

# Cost of a squared gene outside of the bounds, where a sample is judged on the bound.
_OUTSIDE = 0.05


class Adapted(NamedTuple):
    """theta: best validated mean; cost: its validation cost; history: [validations] validation
    costs, the first that of the start; num_skipped: samples without finite cost, which count as
    the worst."""

    theta: Float[Array, " genes"]
    cost: Float[Array, ""]
    history: Float[Array, " validations"]
    num_skipped: Int[Array, ""]


class Search(NamedTuple):
    """State of the search; names as in the tutorial."""

    mean: Array
    sigma: Array
    C: Array
    p_sigma: Array
    p_c: Array


class Course(NamedTuple):
    """A search under way: its state, steps so far, the best validated mean with its cost, samples
    without finite cost so far."""

    search: Search
    num_steps: Int[Array, ""]
    theta: Float[Array, " genes"]
    cost: Float[Array, ""]
    num_skipped: Int[Array, ""]


def adapt(
    key: Key[Array, ""],
    theta: Float[Array, " genes"],
    costs_fn: CostsFn,
    draw: Callable[[Key[Array, ""]], Any],
    validation: Any,
    num_steps: int,
    sigma: float = SIGMA,
    population: int = POPULATION,
    validate_every: int = 20,
) -> Adapted:
    """Search around theta; the best validated mean is returned, so that the result is never worse
    than the start.

    Samples outside of [-5, 5] are judged on the bound and pay for the way there.

    Args:
        key: random key, of scenes and samples.
        theta: [genes], where to start.
        costs_fn: (theta [P, genes], scenes) -> mean cost [P].
        draw: key -> a batch of training scenes, the same for all samples of a step.
        validation: scenes for the choice of the mean.
        num_steps: samplings.
        sigma: first step size, in genes.
        population: samples of a step.
        validate_every: steps between two validations.
    """

    def round_(course, n):
        num = jnp.minimum(validate_every, num_steps - n * validate_every)
        return advance(key, course, costs_fn, draw, validation, num, population)

    first = costs_fn(inside(theta)[None], validation)[0]
    start = begin(theta, first, sigma)
    course, history = jax.lax.scan(round_, start, jnp.arange(-(-num_steps // validate_every)))
    history = jnp.concatenate([start.cost[None], history])
    return Adapted(course.theta, course.cost, history, course.num_skipped)


def begin(theta: Float[Array, " genes"], cost: Float[Array, ""], sigma: float = SIGMA) -> Course:
    """Before the first step.

    Args:
        theta: [genes], where to start.
        cost: that of theta on the validation scenes; what is not finite counts as infinite.
        sigma: first step size, in genes.
    """
    cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf)
    zero = jnp.zeros((), int)
    return Course(init(theta, sigma), zero, theta, cost, zero)


def advance(
    key: Key[Array, ""],
    course: Course,
    costs_fn: CostsFn,
    draw: Callable[[Key[Array, ""]], Any],
    validation: Any,
    num_steps: int | Int[Array, ""],
    population: int = POPULATION,
) -> tuple[Course, Float[Array, ""]]:
    """Some more samplings, then the mean is validated.  In parts or in one go, the same key gives
    the same samples.

    Args:
        key: random key, the same in all calls.
        course: the search so far.
        costs_fn: as of `adapt`.
        draw: as of `adapt`.
        validation: as of `adapt`.
        num_steps: samplings; may be traced.
        population: samples of a step.

    Returns:
        The course after them, and the cost of its mean on the validation scenes.
    """
    step = make_step(course.theta.shape[0], population, costs_fn)

    def inner(m, carry):
        search, skipped = carry
        count = course.num_steps + m
        k_scenes, k_samples = jax.random.split(jax.random.fold_in(key, count))
        search, num = step(k_samples, search, draw(k_scenes), count)
        return search, skipped + num

    search, skipped = jax.lax.fori_loop(0, num_steps, inner, (course.search, course.num_skipped))
    mean = inside(search.mean)
    cost = costs_fn(mean[None], validation)[0]
    better = cost < course.cost  # never with NaN
    theta = jnp.where(better, mean, course.theta)
    best = jnp.where(better, cost, course.cost)
    return Course(search, course.num_steps + num_steps, theta, best, skipped), cost


def inside(theta):
    """On the bounds of the genes where it is outside.

    Args:
        theta: [..., genes].
    """
    return jnp.clip(theta, LOW, HIGH)


def init(theta: Float[Array, " genes"], sigma: float) -> Search:
    """A search with the same step size in all directions.

    Args:
        theta: [genes], its mean.
        sigma: step size, in genes.
    """
    size = theta.shape[0]
    return Search(theta, jnp.asarray(sigma), jnp.eye(size), jnp.zeros(size), jnp.zeros(size))


def make_step(n: int, population: int, costs_fn: CostsFn):
    """One sampling and update, equations (38) to (47).

    Args:
        n: genes.
        population: samples.
        costs_fn: as of `adapt`.

    Returns:
        (key, search, scenes, number of the step from 0) -> search, samples without finite cost.
    """
    num = population // 2
    weights = np.log((population + 1) / 2) - np.log(np.arange(1, num + 1))  # (49)
    weights /= weights.sum()  # (53)
    mu = 1 / np.sum(weights**2)  # (8)
    c_c = (4 + mu / n) / (n + 4 + 2 * mu / n)  # (56)
    c_sigma = (mu + 2) / (n + mu + 5)  # (55), with the damping
    c_1 = 2 / ((n + 1.3) ** 2 + mu)  # (57)
    c_mu = min(1 - c_1, 2 * (mu - 2 + 1 / mu) / ((n + 2) ** 2 + mu))  # (58)
    damping = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (n + 1)) - 1) + c_sigma
    chi = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))  # expected length of N(0, I)
    weights = jnp.asarray(weights, jnp.float32)

    def step(key, search: Search, scenes, count):
        mean, sigma, C, p_sigma, p_c = search
        eigenvalues, B = jnp.linalg.eigh(C)
        D = jnp.sqrt(jnp.maximum(eigenvalues, 1e-10))
        y = (jax.random.normal(key, (population, n)) * D) @ B.T  # (38), (39)
        x = mean + sigma * y  # (40)
        cost = costs_fn(inside(x), scenes)
        finite = jnp.isfinite(cost)
        outside = jnp.sum((x - inside(x)) ** 2, axis=1)
        order = jnp.argsort(jnp.where(finite, cost + _OUTSIDE * outside, jnp.inf))[:num]
        y = y[order]
        y_mean = weights @ y  # (41)
        p_sigma = (1 - c_sigma) * p_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mu) * (
            B @ ((B.T @ y_mean) / D)
        )  # (43)
        length = jnp.linalg.norm(p_sigma) / chi
        settled = jnp.sqrt(1 - (1 - c_sigma) ** (2.0 * (count + 1)))
        h = (length / settled < 1.4 + 2 / (n + 1)).astype(C.dtype)
        p_c = (1 - c_c) * p_c + h * np.sqrt(c_c * (2 - c_c) * mu) * y_mean  # (45)
        C = (  # (47), without negative weights
            (1 - c_1 - c_mu) * C
            + c_1 * (jnp.outer(p_c, p_c) + (1 - h) * c_c * (2 - c_c) * C)
            + c_mu * (weights * y.T) @ y
        )
        # (44), with a bound of our own: no step is longer than the genes' range.
        sigma = jnp.minimum(sigma * jnp.exp((c_sigma / damping) * (length - 1)), HIGH - LOW)
        # (42) with c_m = 1, equation (54).
        return Search(mean + search.sigma * y_mean, sigma, C, p_sigma, p_c), jnp.sum(~finite)

    return step
