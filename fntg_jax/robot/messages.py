"""The arrows of the paper's Figure 3: what one box of the control system tells another.

Shapes are those of one robot.  Axes of objects (K, in the order of `envs.base.SEEN`), mates and
landmarks come first, so that every function also takes batches in trailing axes, where XLA turns
it into straight vector code.  Directions are unit vectors (cos, sin) in the robot's frame (x ahead,
y left), because sine, cosine and arc tangent are dear on a CPU.
"""

from typing import NamedTuple

from jaxtyping import Array, Bool, Float, Int

Scalar = Float[Array, ""]


class Seen(NamedTuple):
    """Vision -> Planner, Localization: objects in the last picture, in the robot's frame.

    distance: m, from the robot's centre along the floor; cos, sin: direction; visible: it was
    found, else the rest means nothing; spread: standard deviation of the distance as a share of it.
    """

    distance: Float[Array, " K"]
    cos: Float[Array, " K"]
    sin: Float[Array, " K"]
    visible: Bool[Array, " K"]
    spread: Float[Array, " K"]


class Pose(NamedTuple):
    """Localization -> Planner: where the robot believes it stands, in its team's frame (x from the
    own goal to the opponents', y left, m; heading as a unit vector), and how far that may be off.

    sd: m, standard deviation of the position; sd_heading: rad.
    """

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    sd: Scalar
    sd_heading: Scalar


class Displacement(NamedTuple):
    """Locomotion -> Planner, Localization: the way since the last step, in the robot's frame before
    it: x, y in m, turn in rad."""

    x: Scalar
    y: Scalar
    turn: Scalar


class LocalMap(NamedTuple):
    """The Planner's memory: all objects around the robot in polar coordinates.

    distance: m; cos, sin: direction; age: s since it was last seen; sd: m, standard deviation of
    the place.  velocity: of the ball over the floor, in the robot's frame, m/s.
    """

    distance: Float[Array, " K"]
    cos: Float[Array, " K"]
    sin: Float[Array, " K"]
    age: Float[Array, " K"]
    sd: Float[Array, " K"]
    velocity: Float[Array, "2"]


class Heard(NamedTuple):
    """Communication -> Planner: what each teammate last said, in the team's frame.

    x, y: its place, m; ball_x, ball_y: its ball, m; ball_age: s since it saw the ball, when it
    spoke; role: index into `planner.ROLES`; age: s since the message.
    """

    x: Float[Array, " M"]
    y: Float[Array, " M"]
    ball_x: Float[Array, " M"]
    ball_y: Float[Array, " M"]
    ball_age: Float[Array, " M"]
    role: Int[Array, " M"]
    age: Float[Array, " M"]


class Need(NamedTuple):
    """Planner -> Behaviors: the data of Table 1.

    distance: D of rows 2, 4 and 5, m.  d_ball, ball: distance to the ball (m) and its direction
    (rad).  goal: theta_g, direction of the goal (rad).  d_obstacle, obstacle: the nearest obstacle.
    kick: index into the body's table of kicks.
    """

    distance: Scalar
    d_ball: Scalar
    ball: Scalar
    goal: Scalar
    d_obstacle: Scalar
    obstacle: Scalar
    kick: Int[Array, ""]


class Order(NamedTuple):
    """Planner -> Behaviors: which behaviour of Table 1 (1 to 9), and its data."""

    behavior: Int[Array, ""]
    need: Need


class Motion(NamedTuple):
    """Behaviors -> Locomotion: velocities (m/s ahead, m/s to the left, rad/s), walking style, and a
    kick or a posture (0 for none, else 1 + index into the body's tables)."""

    v: Scalar
    v_y: Scalar
    omega: Scalar
    style: Int[Array, ""]
    kick: Int[Array, ""]
    posture: Int[Array, ""]
