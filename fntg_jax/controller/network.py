"""The fuzzy-neural trajectory generator: one function per equation of the paper.

Pure functions of scalars; batches are made with `jax.vmap`.  They work in float32 and
float64, have finite values and gradients for all genes in [-5, 5] and all observations, and
index parameters as `p.V[i][j][k][l]`, so that `Params` may hold arrays (`layout.expand`) or
nested tuples of scalars (`layout.expand_scalars`).
"""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import Command, Limits, Scalar
from fntg_jax.controller.layout import HIGH, Params

Output = Literal["scale", "clip"]

# Keeps exp finite in float32.  |a (x - c)| stays below 42 on the field, so this only acts on
# observations that no field holds.
_EXPONENT = 60.0


def sigmoid(x: Scalar, a: Scalar, c: Scalar) -> Scalar:
    """mu(x) = 1 / (1 + exp(-a (x - c))): membership in A_i, B_j or C_k, in (0, 1).

    Paper: C_k is printed with d_O inside; it must be theta_B, else the controller never sees
    in which direction the ball lies.

    Args:
        x: d_B, d_O (m) or theta_B (rad).
        a: slope, 1/m or 1/rad.
        c: centre, m or rad.
    """
    return 1 / (1 + _exp_minus(x, a, c))


def sigmoid_share(x: Scalar, a: Any, c: Any) -> Scalar:
    """mu_1 / (mu_1 + mu_2) of a family of two sigmoids, in (0, 1); the other share is 1 - it.

    Written as (1 + e_2) / (2 + e_1 + e_2) with e = exp(-a (x - c)): one division, and no sum
    of two underflown memberships can give 0/0.

    Args:
        x: d_B, d_O (m) or theta_B (rad).
        a: [2], slopes, 1/m or 1/rad.
        c: [2], centres, m or rad.
    """
    e1, e2 = _exp_minus(x, a[0], c[0]), _exp_minus(x, a[1], c[1])
    return (1 + e2) / (2 + e1 + e2)


def _exp_minus(x, a, c):
    return jnp.exp(jnp.minimum(a * c - a * x, _EXPONENT))


def obstacle_side(theta: Scalar, sigma: Any) -> tuple[Scalar, Scalar, Scalar]:
    """mu_D of "left", "right" and "not influencing" for the obstacle's angle.

    D_1 = exp(-theta^2 / 2 sigma_1^2) for theta > 0, else 0; D_2 the same with sigma_2 for
    theta <= 0; D_3 = 1 - exp(-theta^2 / 2 sigma_3^2).  With one sigma the three sum to 1.

    Args:
        theta: theta_O, rad, > 0 on the left.
        sigma: [3], or [1] where the labels share it, rad, sign irrelevant, below 1e-5 rad taken
            as 1e-5 rad.
    """
    bells = [_bell(theta, width) for width in sigma]
    g1, g2, g3 = bells if len(bells) == 3 else 3 * bells
    zero = jnp.zeros_like(g1)
    left = theta > 0
    return jnp.where(left, g1, zero), jnp.where(left, zero, g2), 1 - g3


def _bell(theta, sigma):
    return jnp.exp(-theta * theta * (0.5 / jnp.maximum(sigma * sigma, 1e-10)))


def obstacle_side_shares(theta: Scalar, sigma: Any) -> tuple[Scalar, Scalar, Scalar]:
    """`obstacle_side` divided by its sum.

    With three sigmas all memberships can vanish at once (sigma_1 << |theta| << sigma_3); the
    shares are then (0, 0, 1), "not influencing".

    Args:
        theta: theta_O, rad, > 0 on the left.
        sigma: as of `obstacle_side`.
    """
    d1, d2, d3 = obstacle_side(theta, sigma)
    if len(sigma) == 1:
        return d1, d2, d3  # they sum to 1
    # A floor, not a summand: compilers reorder (1 - g) + 1e-16 into 0.  Acts only where the sum
    # could be 0; the square of 1e-16 is still a float32.
    d3 = jnp.maximum(d3, 1e-16)
    total = 1 / (d1 + d2 + d3)
    return d1 * total, d2 * total, d3 * total


def firing_strengths(params: Params, observation: Any) -> Float[Array, "2 2 2 3"]:
    """mu_ijkl = mu_Ai(d_B) mu_Bj(d_O) mu_Ck(theta_B) mu_Dl(theta_O), each family normalised.

    In the 16-rule layouts the three l of j = 2 ("far") belong to one rule: sum them for its
    strength.

    Args:
        params: full parameter set, leaves as in `layout.SHAPES`.
        observation: d_B, d_O (m), theta_B, theta_O (rad), scalars.

    Returns:
        [2, 2, 2, 3], indexed i, j, k, l; they sum to 1.
    """
    o = observation
    a = sigmoid_share(o.d_ball, params.a_A, params.c_A)
    b = sigmoid_share(o.d_obstacle, params.a_B, params.c_B)
    c = sigmoid_share(o.theta_ball, params.a_C, params.c_C)
    d = jnp.stack(obstacle_side_shares(o.theta_obstacle, params.sigma))
    pair = lambda share: jnp.stack([share, 1 - share])  # noqa: E731
    return jnp.einsum("i,j,k,l->ijkl", pair(a), pair(b), pair(c), d)


def weighted_averages(params: Params, observation: Any) -> tuple[Scalar, Scalar]:
    """sum(mu f) / sum(mu) over the rules, for V and for Omega.

    The rule base is a product grid, so the average factorises: each family is divided by its
    own sum (D inside "near") and the tables are contracted one family after the other.

    Args:
        params: full parameter set: arrays, or nested tuples of scalars (`layout.expand_scalars`).
        observation: d_B, d_O (m), theta_B, theta_O (rad), scalars.

    Returns:
        Two averages in gene units, within [-5, 5].
    """
    o = observation
    a = sigmoid_share(o.d_ball, params.a_A, params.c_A)
    b = sigmoid_share(o.d_obstacle, params.a_B, params.c_B)
    c = sigmoid_share(o.theta_ball, params.a_C, params.c_C)
    d1, d2, _ = obstacle_side_shares(o.theta_obstacle, params.sigma)

    def average(f):
        def over_d(i, j, k):
            if len(f[i][j][k]) == 1:  # far, in layouts of 16 rules
                return f[i][j][k][0]
            left, right, neither = f[i][j][k]
            # Differences of genes leave the loop over control steps.
            return neither + d1 * (left - neither) + d2 * (right - neither)

        def over_bd(i, k):
            return _mix(b, over_d(i, 0, k), over_d(i, 1, k))

        return _mix(a, _mix(c, over_bd(0, 0), over_bd(0, 1)), _mix(c, over_bd(1, 0), over_bd(1, 1)))

    return average(params.V), average(params.Omega)


def _mix(share, first, second):
    return second + share * (first - second)


def command(
    params: Params, observation: Any, limits: Any = Limits(), output: Output = "scale"
) -> Command:
    """(d_B, d_O, theta_B, theta_O) -> (v, omega): the whole FNTG.

    output="scale": v = v_max / 5 (average + b_21) and omega = omega_max / 5 (average + b_22);
    output="clip": the averages are m/s and rad/s as they are.  Both are then clipped to
    [v_min, v_max] and [-omega_max, omega_max].

    Args:
        params: full parameter set: arrays, or nested tuples of scalars (`layout.expand_scalars`).
        observation: d_B, d_O (m), theta_B, theta_O (rad), scalars.
        limits: anything with v_min, v_max (m/s) and omega_max (rad/s).
        output: "scale" or "clip".

    Returns:
        v, m/s, and omega, rad/s.

    Raises ValueError on an unknown output.
    """
    v, omega = weighted_averages(params, observation)
    gain_v, gain_omega = output_gains(limits, output)
    return Command(
        v=jnp.clip(gain_v * (v + params.bias[0]), limits.v_min, limits.v_max),
        omega=jnp.clip(gain_omega * (omega + params.bias[1]), -limits.omega_max, limits.omega_max),
    )


def output_gains(limits: Any, output: Output) -> tuple[Scalar, Scalar]:
    """Speed per gene unit.

    Args:
        limits: anything with v_max (m/s) and omega_max (rad/s).
        output: "scale" or "clip".

    Returns:
        m/s and rad/s.

    Raises ValueError on an unknown output.
    """
    if output == "scale":
        return limits.v_max / HIGH, limits.omega_max / HIGH
    if output == "clip":
        return 1.0, 1.0
    raise ValueError(f"output = {output!r}: allowed are 'scale' and 'clip'")
