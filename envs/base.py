"""The contract between a world and whoever drives it, written once.

A world is any object with the methods of `Environment`; nothing inherits from it.  All
memory of an episode (gait phase, delayed observations, noise seeds) sits in the state it
returns; there is no hidden state, no auto-reset and no episode counter.

Frames and signs: x forward, y left, angles counter-clockwise in (-pi, pi]; an angle > 0
means "on the left".  SI units throughout.
"""

import math
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
    """Velocity command: v in m/s along the robot's x axis, omega in rad/s, v_y in m/s to its left
    (None: no sideways motion; BIOA has none)."""

    v: Scalar
    omega: Scalar
    v_y: Scalar | None = None


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


class Landmark(NamedTuple):
    """A two-coloured pole beside the field: name "lower/upper", foot (m, field's frame), colours
    of the two bands from below (pink, yellow, green, skyblue)."""

    name: str
    x: float
    y: float
    lower: str
    upper: str


class Field(NamedTuple):
    """The field's map, lengths in m: x from the own goal to the opponents', y to the left.

    goal_colours: of the goal at -x and of that at +x.  wall_height and line_width: assumed.
    A landmark is a pole of `landmark_radius` whose bands, `landmark_band` high each, begin at
    `landmark_foot` above the floor.
    """

    length: float
    width: float
    goal_width: float
    goal_depth: float
    ball_radius: float
    landmarks: tuple[Landmark, ...]
    goal_colours: tuple[str, str] = ("skyblue", "yellow")
    goal_height: float = 0.3
    wall_height: float = 0.1
    line_width: float = 0.025
    landmark_radius: float = 0.05
    landmark_foot: float = 0.2
    landmark_band: float = 0.1


class Camera(NamedTuple):
    """A pinhole camera: pixels and openings in rad.  Defaults: ERS-210 (Tekkotsu,
    CommonERSInfo.h); pictures are 144 rows of 176 pixels, 25 a second."""

    width: int = 176
    height: int = 144
    horizontal: float = math.radians(57.6)
    vertical: float = math.radians(47.8)


class Head(NamedTuple):
    """Where the camera sits: a neck of three joints, tilt, pan, roll (rad), each with low and high
    limit (rad) and speed (rad/s).

    base: m, tilt axis in the body's frame when the dog stands (z above the floor); neck: m, tilt
    axis to pan axis (upwards at tilt 0); nose: m, pan axis to the camera (ahead at tilt, pan 0).
    Positive tilt looks up, positive pan looks left.  Defaults: ERS-210 (Sony model information).
    """

    base: tuple[Any, Any, Any] = (0.070, 0.0, 0.130)
    neck: float = 0.048
    nose: float = 0.050
    low: tuple[float, float, float] = (math.radians(-82), math.radians(-89.6), math.radians(-29))
    high: tuple[float, float, float] = (math.radians(43), math.radians(89.6), math.radians(29))
    speed: tuple[float, float, float] = (2.105, 3.011, 3.011)


# What a robot's Vision can name, in the order of every axis K: a static count, so that no shape
# depends on what is in sight.  Landmarks in the order of `Field.landmarks`; goals: own, theirs.
SEEN = (
    "ball",
    *(f"landmark{n}" for n in range(6)),
    "goal-own",
    "goal-theirs",
    "mate0",
    "mate1",
    "opponent0",
    "opponent1",
    "opponent2",
)


class Walk(NamedTuple):
    """What Locomotion asks of the body: `Command` with a walking style and a lateral speed.

    style: index into the body's table of styles; v, v_y: m/s ahead and to the left; omega: rad/s.
    """

    style: Int[Array, ""] | int
    v: Scalar
    v_y: Scalar
    omega: Scalar


class Action(NamedTuple):
    """All that one robot does in a control step.

    walk: see `Walk`.  head: tilt, pan, roll wanted, rad.  kick: 0 for none, else 1 + index into the
    body's table of kicks.  posture: 0 for none, else 1 + index into the body's table of postures.
    say: the 64 bits of an acoustic message as two uint32, both 0 for silence (at the audio level
    3200 samples at 8 kHz of what a robot begins to say, -1 to 1, instead).
    """

    walk: Walk
    head: Float[Array, "3"]
    kick: Int[Array, ""] | int
    posture: Int[Array, ""] | int
    say: Any


class Frame(NamedTuple):
    """One camera picture at the objects level, in the camera's own frame, in the order of `SEEN`.

    bearing: rad, left positive, from the camera's axis; elevation: rad, up positive; size: rad,
    apparent width (ball, robots) or height (landmarks: both bands; goals); visible: it was found.
    Values of what is not visible are 0.
    """

    bearing: Float[Array, " K"]
    elevation: Float[Array, " K"]
    size: Float[Array, " K"]
    visible: Bool[Array, " K"]


class Senses(NamedTuple):
    """All that one robot knows of the world in a control step.

    frame: `Frame`, or a picture uint8 [144, 176, 3].  head: the neck's joints, rad.  displacement:
    dx, dy (m, in the robot's frame before the step) and turn (rad) since the last step, as odometry
    has it.  proximity: the head's infrared distance, m, 0.1 to 0.9.  gyro: rad/s.  acceleration:
    m/s^2, gravity included (body frame).  heard: a message by sender's shirt (own team, N robots),
    two uint32 each (at the audio level samples [channels, samples] instead); heard_valid: it
    arrived whole.  signal: the referee's state of play, an index into `SIGNALS`.
    """

    frame: Any
    head: Float[Array, "3"]
    displacement: Float[Array, "3"]
    proximity: Scalar
    gyro: Float[Array, "3"]
    acceleration: Float[Array, "3"]
    heard: Any
    heard_valid: Bool[Array, " N"]
    signal: Int[Array, ""]


class Truth(NamedTuple):
    """What is so, in the frame of the robot's team (x towards the opponents' goal): for teams that
    need no perception.

    pose: x, y (m), heading (rad).  ball: x, y, vx, vy (m, m/s).  robots: x, y (m) of all
    R robots, own team by shirt, then the opponents; on: which of them are on the field.
    upright: it has not fallen.  head: the neck's joints, rad.  signal: as in `Senses`.
    """

    pose: Float[Array, "3"]
    ball: Float[Array, "4"]
    robots: Float[Array, "R 2"]
    on: Bool[Array, " R"]
    upright: Bool[Array, ""]
    head: Float[Array, "3"]
    signal: Int[Array, ""]


SIGNALS = ("play", "kick-off own", "kick-off theirs", "penalised", "half-time", "finished")


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
    field: its map, for pictures.  footprint: length and width of the robot, m, for pictures
    (default: ERS-210).
    film: (environment, batched scenes, observation -> command, whether in a window) -> Film, or
    None; ValueError at once where nothing can be drawn.
    differentiable: whether a gradient through its trials is worth following.
    """

    make: Callable[..., Any]
    suites: dict[str, Callable[..., Scene]]
    mix: Callable[..., Callable[..., Scene]]
    field: Field
    film: Callable[[Any, Scene, Callable[[Any], Any], bool], Film] | None = None
    differentiable: bool = True
    footprint: tuple[float, float] = (0.289, 0.152)


class Gene(NamedTuple):
    """One number that a task learns: name, unit, least and largest value."""

    name: str
    unit: str = ""
    low: float = -5.0
    high: float = 5.0


class Task(NamedTuple):
    """What can be learnt: pure functions that run inside jit.

    An entry point of the group "fntg_jax.tasks" names a function of options by name (floats) that
    gives one.

    name: in tables and files.  genes: anything with the fields of `Gene`, one a gene; theta is in
    their units.
    fitness: (key, theta [P, genes], memory, progress) -> (F [P], memory).  F is maximised, and
    from 0 where selection goes by shares (roulette, sus); what is not finite counts as 0.  progress
    runs from 0 in the first generation to 1 in the last.
    init: key -> memory, a pytree of arrays: what fitness remembers from generation to generation (a
    hall of fame, a curriculum).  Its structure and shapes never change; it is checkpointed.
    judge: (key, theta [N, genes], memory) -> {name: numbers [N]}, on what no fitness was computed
    from; where chance plays a part, rows best draw apart: the result is reported as the mean over
    as many rows as a population has.  The last population's individual with the largest number
    "score" is the result; without `judge` it is the best of all generations, which fits a fitness
    that does not change.
    files: {gene: value} -> {file name: text}, the result in the task's own format, or None.
    shares: population -> how many devices can share a generation or a judgement, along the axis
    "genome" of `jax.shard_map`; None: all devices of it compute the same.
    relative: fitness is against a field that moves; Fig. 5 then shows the champions' "score", too.
    """

    name: str
    genes: tuple[Any, ...]
    fitness: Callable[[Any, Any, Any, Any], tuple[Any, Any]]
    init: Callable[[Any], Any] = lambda key: ()
    judge: Callable[[Any, Any, Any], dict[str, Any]] | None = None
    files: Callable[[dict[str, float]], dict[str, str]] | None = None
    shares: Callable[[int], int] | None = None
    relative: bool = False


class Refusal(ValueError):
    """What a world raises where a setting cannot work, in one line: no failure of its code."""


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


# arctan(t) = t P(t^2) on [0, 1], minimax fit.
_ARCTAN = (
    0.999999336,
    -0.333298608,
    0.199465656,
    -0.139086292,
    0.0964219645,
    -0.0559123151,
    0.02186295,
    -0.0040545651,
)


def arctan(t: Any) -> Any:
    """Arctangent in rad as a polynomial, which XLA vectorises on a CPU (`jnp.arctan2` it does not);
    error below 3.8e-8 rad, and the rounding of float32.

    Args:
        t: in [0, 1], of any shape.
    """
    square = t * t
    value = square * _ARCTAN[-1] + _ARCTAN[-2]
    for coefficient in _ARCTAN[-3::-1]:
        value = value * square + coefficient
    return value * t
