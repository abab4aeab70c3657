"""Six dogs, ball, walls and goals in one MuJoCo model.

Every dog is the full variant of `envs.quadruped.mjcf`, 17 joints, attached under a prefix.
Contacts are named pairs, as there: feet and trunks with the floor, everything with the ball and the
walls, and between dogs trunk and head against trunk, head and fore feet.
"""

from itertools import combinations

import mujoco

from envs.base import Field
from envs.quadruped import constants as c
from envs.quadruped import mjcf

_TEAMS = ("0.85 0.2 0.2 1", "0.2 0.35 0.9 1")  # uniforms, home and away
_FEET = tuple(f"{leg}_foot" for leg in c.LEGS)
_SHINS = tuple(f"{leg}_shin" for leg in c.LEGS)
_ELBOWS = tuple(f"{leg}_elbow" for leg in c.LEGS)
_THICK = 0.02  # m, half of a wall's thickness
_ITERATIONS = 4  # of the solver: collisions want more than the feet's one
_UNDER = "0.95 0.95 0.95 1"


def prefix(robot: int) -> str:
    """Of the names of a robot's joints, geoms, actuators."""
    return f"robot{robot}_"


def build(field: Field, robots: int, timestep: float) -> mujoco.MjModel:
    """The compiled model.  robots: of both teams, the home team first."""
    spec = mujoco.MjSpec.from_string(_world(field, timestep))
    for robot in range(robots):
        dog = mujoco.MjSpec.from_string(_dog(timestep))
        for element in [*dog.pairs, *dog.sensors]:
            dog.delete(element)
        uniform = [float(x) for x in _TEAMS[robot >= robots // 2].split()]
        dog.geom("trunk_box").rgba = uniform
        dog.geom("head").rgba = [0.6 + 0.4 * x for x in uniform[:3]] + [1.0]
        spec.worldbody.add_frame().attach_body(dog.body("trunk"), prefix(robot), "")
    walls = [geom.name for geom in spec.geoms if geom.name.startswith("wall")]
    for name in ("floor", *walls):
        _pair(spec, "ball", name)
    for robot in range(robots):
        own = lambda part, robot=robot: prefix(robot) + part  # noqa: E731
        for part in (*_FEET, *_ELBOWS, "trunk", "head"):
            _pair(spec, "floor", own(part))
        for part in ("trunk", "head", *_SHINS, *_ELBOWS, *_FEET):
            _pair(spec, "ball", own(part))
        for part in ("trunk", "head"):
            for wall in walls:
                _pair(spec, wall, own(part))
    body = ("trunk", "head")
    for a, b in combinations(range(robots), 2):
        pairs = {(p, q) for p in body for q in (*body, *_FEET[:2])}
        pairs |= {(p, q) for q in body for p in _FEET[:2]}
        for p, q in sorted(pairs):
            _pair(spec, prefix(a) + p, prefix(b) + q)
    return spec.compile()


def _dog(timestep: float) -> str:
    return mjcf.mjcf(
        mjcf.FULL, timestep=timestep, iterations=_ITERATIONS, ls_iterations=10, num_obstacles=0
    )


def _pair(spec: mujoco.MjSpec, a: str, b: str) -> None:
    friction = [c.FRICTION, c.FRICTION, 0.005, 0.0001, 0.0001]
    spec.add_pair(geomname1=a, geomname2=b, condim=3, friction=friction)


def _world(field: Field, timestep: float) -> str:
    """Floor, walls with their goal mouths open, goals, landmarks, ball, light."""
    half_x, half_y = 0.5 * field.length, 0.5 * field.width
    mouth, depth, high = 0.5 * field.goal_width, field.goal_depth, field.wall_height
    out: list[str] = []

    def box(name, x, y, hx, hy, rgba=_UNDER, z=0.0, tall=high):
        named = f'name="{name}" ' if name else ""
        out.append(
            f'<geom {named}type="box" pos="{x} {y} {z + tall / 2}" size="{hx} {hy} {tall / 2}" '
            f'rgba="{rgba}"/>'
        )

    for side in (1, -1):
        box(f"wall_y{side}", 0, side * (half_y + _THICK), half_x + 2 * _THICK, _THICK)
        colour = mjcf._COLOURS[field.goal_colours[side > 0]]
        part = 0.5 * (half_y - mouth)
        for flank in (1, -1):
            y = flank * (mouth + part)
            box(f"wall_x{side}{flank}", side * (half_x + _THICK), y, _THICK, part)
            x = side * (half_x + 0.5 * depth)
            y = flank * (mouth + 0.01)
            box(f"wall_goal{side}{flank}", x, y, 0.5 * depth, 0.01, colour, tall=field.goal_height)
        x = side * (half_x + depth + 0.01)
        box(f"wall_back{side}", x, 0, 0.01, mouth + 0.02, colour, tall=field.goal_height)
    for mark in field.landmarks:
        foot, band = field.landmark_foot, field.landmark_band
        for z, tall, name in (
            (0.0, foot, ""),
            (foot, band, mark.lower),
            (foot + band, band, mark.upper),
        ):
            rgba = mjcf._COLOURS.get(name, _UNDER)
            out.append(
                f'<geom type="cylinder" pos="{mark.x} {mark.y} {z + tall / 2}" '
                f'size="{field.landmark_radius} {tall / 2}" rgba="{rgba}"/>'
            )
    lines = "\n".join(out)
    return f"""<mujoco model="match">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{timestep}" integrator="Euler" solver="Newton" cone="pyramidal"
          iterations="{_ITERATIONS}" ls_iterations="10">
    <flag eulerdamp="disable" warmstart="disable"/>
  </option>
  <default><geom contype="0" conaffinity="0" group="1"/></default>
{mjcf._LOOKS}
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.1" material="grass"/>
    <light directional="true" pos="0 0 3" dir="0.25 0.35 -1" diffuse="0.35 0.35 0.35"
           specular="0 0 0" castshadow="true"/>
{lines}
{mjcf._ball()}
  </worldbody>
</mujoco>
"""
