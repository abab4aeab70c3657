"""The contract between a world and whoever drives it, written once.

A world is any object with the methods of `Environment`; nothing inherits from it.  All
memory of an episode (gait phase, delayed observations, noise seeds) sits in the state it
returns; there is no hidden state, no auto-reset and no episode counter.

Frames and signs: x forward, y left, angles counter-clockwise in (-pi, pi]; an angle > 0
means "on the left".  SI units throughout.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, TypeVar

from jaxtyping import Array, Bool, Float, Int

Scalar = Float[Array, ""] | float


class Limits(NamedTuple):
    """What the robot can do: speeds in m/s and rad/s (design values for an ERS-210 walk)."""

    v_min: Scalar = 0.0
    v_max: Scalar = 0.20
    omega_max: Scalar = 1.5


class Command(NamedTuple):
    """Velocity command: v in m/s along the robot's x axis, omega in rad/s."""

    v: Scalar
    omega: Scalar


class Observation(NamedTuple):
    """The four inputs of the BIOA behaviour (paper, Table 1, row 7).

    d_ball: m, robot's reference point to ball centre.  d_obstacle: m, robot centre to the
    nearest obstacle *surface* (disc or wall); negative when inside.  theta_ball,
    theta_obstacle: rad, direction of the ball and of that nearest point, relative to the
    robot's heading.
    """

    d_ball: Scalar
    d_obstacle: Scalar
    theta_ball: Scalar
    theta_obstacle: Scalar


class Scene(NamedTuple):
    """One start situation, as data.  Batched scenes carry a leading axis on every field.

    Velocities are None where nothing moves; the model then carries no moving state at all.
    """

    start: Float[Array, "3"]  # x, y (m), heading (rad)
    ball: Float[Array, "2"]  # x, y (m)
    obstacles: Float[Array, "K 3"]  # x, y, radius (m)
    ball_velocity: Float[Array, "2"] | None = None  # m/s
    obstacle_velocity: Float[Array, "K 2"] | None = None  # m/s
    seed: Int[Array, ""] | int = 0  # of the trial's sensor noise


class Snapshot(NamedTuple):
    """Where everything is, for pictures: m and rad in the field's frame."""

    robot: Float[Array, "3"]  # x, y, heading
    ball: Float[Array, "2"]
    obstacles: Float[Array, "K 3"]  # x, y, radius


State = TypeVar("State")


class Environment(Protocol[State]):
    """What a roll-out needs of a world.  Every method is pure and takes one scene or state:
    batches are made with `jax.vmap`."""

    dt: Scalar  # control step, s
    limits: Any  # anything with v_min, v_max, omega_max

    def reset(self, scene: Scene) -> State:
        """The state at the start of a scene."""
        ...

    def step(self, state: State, command: Any) -> State:
        """Advance one control step under a command with fields v (m/s) and omega (rad/s)."""
        ...

    def observe(self, state: State) -> Observation:
        """What the controller sees: noisy and delayed where the world has sensors."""
        ...

    def measure(self, state: State) -> Observation:
        """The truth behind `observe`: what fitness and success are judged on."""
        ...

    def failed(self, state: State) -> Bool[Array, ""]:
        """True once the episode is lost for good (the robot fell)."""
        ...

    def snapshot(self, state: State) -> Snapshot:
        """Positions for pictures."""
        ...


class Film(Protocol):
    """Recorded trials of a world that can draw itself.

    measured: true observations, command: the controller's, leaves [steps + 1, trials] and
    [steps, trials]; failed: [trials]; dt: s between pictures.
    """

    measured: Observation
    command: Any
    failed: Any
    dt: float

    def pictures(self, trial: int, width: int, height: int) -> list[Any]:
        """Pictures of a trial, uint8 [height, width, 3]."""
        ...

    def view(self, trial: int) -> None:
        """Play a trial in a window until that is closed."""
        ...


class World(NamedTuple):
    """What an entry point of the group "fntg_jax.worlds" names: a model and its scenes.

    make: options by name (floats) -> Environment; ValueError on an unknown name or value.
    suites: name -> (key, num_scenes) -> Scene.  mix: ((suite, share), ...) -> the same.
    field: anything with length, width, goal_width, goal_depth, ball_radius (m), for pictures.
    film: (environment, batched scenes, observation -> command, whether in a window) -> Film, or
    None; ValueError at once where nothing can be drawn.
    """

    make: Callable[..., Any]
    suites: dict[str, Callable[..., Scene]]
    mix: Callable[..., Callable[..., Scene]]
    field: Any
    film: Callable[[Any, Scene, Callable[[Any], Any], bool], Film] | None = None


def check_options(options: dict[str, float], known: Mapping[str, tuple[float, float]]) -> None:
    """Refuse an option that a world does not know or whose value is out of range.

    known: name -> (least, largest) value.  Raises ValueError: option, value, what is allowed.
    """
    for name, value in options.items():
        if name not in known:
            raise ValueError(f"env option {name!r}: known are {', '.join(known)}")
        low, high = known[name]
        if not low <= value <= high:
            raise ValueError(f"env option {name} = {value}: allowed are {low} to {high}")
