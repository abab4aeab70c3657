"""A trained controller outside a run: a function of four numbers, and what every export is
written from."""

import dataclasses
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Limits, Observation
from fntg_jax.controller import genome, network
from fntg_jax.controller.layout import HIGH, LOW, SHAPES, Layout, Params, expand

_command = jax.jit(network.command, static_argnames="output")


@jax.tree_util.register_pytree_with_keys_class
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Controller:
    """The FNTG with its genes: (d_B, d_O, theta_B, theta_O) -> (v, omega).

    A pytree whose only leaf is `theta`: `jax.jit(controller)`, `jax.vmap` over controllers stacked
    by `jax.tree.map`, `jax.grad` by the genes.  Everything else is static.  A controller that JAX
    makes (a gradient, a stack, an update) has neither `bits` nor `provenance`: it was not trained.

    Two controllers are equal, and hash alike, if they compute the same: layout, genes, output,
    limits and control step, wherever they come from.

    Attributes:
        layout: gene table.
        theta: [genes] float64, each in [-5, 5], read-only; in a stack [controllers, genes].
        output: how genes are read: "scale" (a gene of 5 is full speed) or "clip" (m/s and rad/s).
        limits: speeds it is clipped to, m/s and rad/s.
        control_dt: control step that it was trained at, s.
        bits: genome that it was decoded from, "0" and "1", or None.
        provenance: where it comes from, flat, JSON values.

    Raises ValueError when built with genes of another number than the layout's, outside of
    [-5, 5] or not a number, or with an unknown output.
    """

    layout: Layout
    theta: np.ndarray
    output: network.Output = "scale"
    limits: Limits = Limits()
    control_dt: float = 0.1
    bits: str | None = None
    provenance: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        wanted = (self.layout.num_genes,)
        if np.shape(self.theta) != wanted:
            raise ValueError(
                f"theta has shape {np.shape(self.theta)}: layout {self.layout.name!r} has {wanted}"
            )
        network.output_gains(self.limits, self.output)
        if isinstance(self.theta, jax.core.Tracer):
            return
        theta = _read_only(np.asarray(self.theta, np.float64))
        bad = ~((theta >= LOW) & (theta <= HIGH))
        if bad.any():
            n = int(np.argmax(bad))
            raise ValueError(
                f"theta: gene {n} ({self.layout.genes[n].name}) = {theta[n]}: allowed are values "
                f"in [{LOW:g}, {HIGH:g}]"
            )
        object.__setattr__(self, "theta", theta)

    def tree_flatten_with_keys(self):
        static = self.layout, self.output, self.limits, self.control_dt
        return ((jax.tree_util.GetAttrKey("theta"), self.theta),), static

    @classmethod
    def tree_unflatten(cls, static, leaves):
        # Not `__init__`: leaves may be stacked, gradients, or no arrays at all.
        new = object.__new__(cls)
        layout, output, limits, control_dt = static
        (theta,) = leaves
        if isinstance(theta, np.ndarray):
            theta = _read_only(theta)
        values = layout, theta, output, limits, control_dt, None, {}
        for field, value in zip(dataclasses.fields(cls), values):
            object.__setattr__(new, field.name, value)
        return new

    @property
    def _identity(self) -> tuple[Any, ...]:
        theta = np.asarray(self.theta, np.float64) + 0.0  # 0.0 and -0.0 are equal
        same = self.layout.name, theta.shape, theta.tobytes(), self.output
        return *same, tuple(float(x) for x in self.limits), float(self.control_dt)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Controller):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __repr__(self) -> str:
        low, high, turn = self.limits
        known = ("env", "suite", "generations", "seed", "fitness")
        origin = [f"{n}={self.provenance[n]!r}" for n in known if n in self.provenance]
        return (
            f"Controller({self.layout.name!r}, theta {list(np.shape(self.theta))}, "
            f"output={self.output!r}, v {low:g} to {high:g} m/s, omega up to {turn:g} rad/s, "
            f"control_dt={self.control_dt:g} s"
            f"{', trained with ' if origin else ''}{', '.join(origin)})"
        )

    @property
    def env(self) -> str:
        """The world it was trained in; of a controller that does not say so, the paper's."""
        env = self.provenance.get("env")
        return env if isinstance(env, str) else "kinematic"

    @cached_property
    def params(self) -> Params:
        """The full parameter set, NumPy float64, leaves as in `layout.SHAPES` with the leading
        axes of theta: exactly the genes and their negatives.  Not under a JAX transformation."""
        index, sign = np.asarray(self.layout.index), np.asarray(self.layout.sign)
        slots = np.asarray(self.theta, np.float64)[..., index] * sign + 0.0  # no negative zeros
        parts = np.split(slots, np.cumsum([int(np.prod(s)) for s in SHAPES])[:-1], axis=-1)
        return Params(*(p.reshape(*slots.shape[:-1], *s) for p, s in zip(parts, SHAPES)))

    @cached_property
    def params32(self) -> Params:
        """`params` as float32 JAX arrays, for `network.command`; traced where theta is."""
        if isinstance(self.theta, jax.core.Tracer):
            return expand(self.layout, self.theta.astype(jnp.float32))
        with jax.ensure_compile_time_eval():  # kept: must not be of a trace that is under way
            return Params(*(jnp.asarray(x, jnp.float32) for x in self.params))

    def __call__(self, d_ball, d_obstacle, theta_ball, theta_obstacle):
        """The velocities to walk at (`network.command`), float32.

        Arguments are numbers or arrays of shapes that broadcast, NumPy's or JAX's.

        Args:
            d_ball: d_B, m, reference point of the robot to the ball's centre.
            d_obstacle: d_O, m, to the nearest surface of an obstacle or wall.
            theta_ball: theta_B, rad, direction of the ball, > 0 on the left.
            theta_obstacle: theta_O, rad, direction of that nearest point.

        Returns:
            v, m/s, and omega, rad/s: floats for numbers, NumPy arrays for NumPy's, JAX arrays
            where an argument is one (or something is traced).

        Raises ValueError for a stack of controllers: `jax.vmap` over it.
        """
        if np.ndim(self.theta) != 1:
            raise ValueError(
                f"theta has shape {np.shape(self.theta)}: a stack of controllers is called under "
                "jax.vmap, as jax.vmap(lambda c: c(1.0, 0.4, 0.2, -1.5))(stack)"
            )
        inputs = (d_ball, d_obstacle, theta_ball, theta_obstacle)
        if isinstance(self.theta, jax.core.Tracer) or any(isinstance(x, jax.Array) for x in inputs):
            arrays = jnp.broadcast_arrays(*(jnp.asarray(x, jnp.float32) for x in inputs))
            return _command(self.params32, Observation(*arrays), self.limits, self.output)[:2]
        numbers = np.broadcast_arrays(*inputs)
        observation = Observation(*(np.asarray(x, np.float32) for x in numbers))
        v, omega, _ = _command(self.params32, observation, self.limits, self.output)
        if numbers[0].ndim == 0:
            return float(v), float(omega)
        return np.asarray(v), np.asarray(omega)


def _read_only(array: np.ndarray) -> np.ndarray:
    """A copy over immutable bytes, which no flag makes writable again."""
    return np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape)


def from_bits(
    layout: Layout, bits: np.ndarray, num_bits: int = 15, gray: bool = False, **fields: Any
) -> Controller:
    """The controller that a genome stands for.

    Args:
        layout: gene table.
        bits: [genes * num_bits] bool, in the genome's order, most significant first.
        num_bits: bits a gene.
        gray: the bits are reflected Gray code instead of plain binary.
        fields: further attributes of `Controller`.

    Raises ValueError where bits and layout do not fit.
    """
    theta = np.asarray(genome.decode(bits, num_bits, gray), np.float64)
    text = "".join("1" if b else "0" for b in np.asarray(bits))
    return Controller(layout=layout, theta=theta, bits=text, **fields)
