"""A trained controller outside a run: what every export format is written from."""

import dataclasses
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Limits, Observation
from fntg_jax.controller import genome, network
from fntg_jax.controller.layout import SHAPES, Layout, Params

_command = jax.jit(network.command, static_argnames="output")


@dataclasses.dataclass(frozen=True)
class Controller:
    """Genes with all that is needed to run them.

    theta: [genes] float64, each in [-5, 5].  control_dt: s, the step it was trained at.
    bits: the genome it was decoded from, or None.  provenance: flat, JSON values.
    Calling it maps (d_ball, d_obstacle, theta_ball, theta_obstacle), m and rad, scalars or
    arrays, to (v, omega), m/s and rad/s, in NumPy.
    """

    layout: Layout
    theta: np.ndarray
    output: network.Output = "scale"
    limits: Limits = Limits()
    control_dt: float = 0.1
    bits: str | None = None
    provenance: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def env(self) -> str:
        """The world it was trained in; of a controller that does not say so, the paper's."""
        env = self.provenance.get("env")
        return env if isinstance(env, str) else "kinematic"

    @cached_property
    def params(self) -> Params:
        """The full parameter set, NumPy float64: exactly the genes and their negatives."""
        index, sign = np.asarray(self.layout.index), np.asarray(self.layout.sign)
        slots = self.theta[index] * sign + 0.0  # + 0.0: no negative zeros
        parts = np.split(slots, np.cumsum([int(np.prod(s)) for s in SHAPES])[:-1])
        return Params(*(p.reshape(s) for p, s in zip(parts, SHAPES)))

    @cached_property
    def _float32(self) -> Params:
        return Params(*(jnp.asarray(x, jnp.float32) for x in self.params))

    def __call__(self, d_ball, d_obstacle, theta_ball, theta_obstacle):
        inputs = np.broadcast_arrays(d_ball, d_obstacle, theta_ball, theta_obstacle)
        observation = Observation(*(np.asarray(x, np.float32) for x in inputs))
        v, omega = _command(self._float32, observation, self.limits, self.output)
        if inputs[0].ndim == 0:
            return float(v), float(omega)
        return np.asarray(v), np.asarray(omega)


def from_bits(
    layout: Layout, bits: np.ndarray, num_bits: int = 15, gray: bool = False, **fields: Any
) -> Controller:
    """The controller a genome stands for.  bits: [genes * num_bits] bool."""
    theta = np.asarray(genome.decode(bits, num_bits, gray), np.float64)
    text = "".join("1" if b else "0" for b in np.asarray(bits))
    return Controller(layout=layout, theta=theta, bits=text, **fields)
