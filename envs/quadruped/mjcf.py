"""The ERS-210 and its field as MJCF, written from `constants`: one source, two variants.

lean: what training needs.  Head and tail are locked; the four feet and the four elbows (hind:
    knees) touch the floor and nothing touches anything else; ball and obstacles are the
    environment's, not MuJoCo's.
full: all 17 joints, a free ball, walls, obstacle robots (upright capsules, moved as
    mocap bodies), contacts of trunk, head, legs, feet and ball, sensors, and everything that is
    to be seen.  Its first 19 coordinates and 12 actuators are those of lean.
"""

from envs.field import FIELD
from envs.quadruped import constants as c

LEAN, FULL = "lean", "full"
VARIANTS = (LEAN, FULL)

_COLOURS = {
    "pink": "1 0.4 0.7 1",
    "yellow": "0.95 0.85 0.1 1",
    "green": "0.1 0.7 0.2 1",
    "skyblue": "0.3 0.7 1 1",
}
_FEET = tuple(f"{leg}_foot" for leg in c.LEGS)
_ELBOWS = tuple(f"{leg}_elbow" for leg in c.LEGS)
_SHINS = tuple(f"{leg}_shin" for leg in c.LEGS)
_BODY = ("trunk", "head", *_SHINS, *_ELBOWS, *_FEET)  # what may touch something in `full`
_WALLS = ("wall_front", "wall_back", "wall_left", "wall_right")


def mjcf(
    variant: str = LEAN,
    *,
    timestep: float = 0.004,
    iterations: int = 1,
    ls_iterations: int = 8,
    num_obstacles: int = 2,
) -> str:
    """MJCF text of a variant.  timestep in s; the rest are Newton's iterations, its line search's
    and (full only) the number of obstacle robots.

    eulerdamp and warmstart are off: with them a single Newton iteration is unstable at this
    timestep, without them it is stable and MJX agrees with MuJoCo's C code (tests/test_truth).
    Raises ValueError for an unknown variant.
    """
    if variant not in VARIANTS:
        raise ValueError(f"variant = {variant!r}: allowed are {', '.join(VARIANTS)}")
    full = variant == FULL
    flags = 'eulerdamp="disable" warmstart="disable"'
    if not full:
        flags += ' sensor="disable"'
    # Locked parts become part of the trunk, and geoms that touch nothing only count as mass.
    merge = ' fusestatic="true" discardvisual="true"'
    grass = ' material="grass"' if full else ""
    return f"""<mujoco model="ers210-{variant}">
  <compiler angle="radian" autolimits="true"{"" if full else merge}/>
  <option timestep="{timestep}" integrator="Euler" solver="Newton" cone="pyramidal"
          iterations="{iterations}" ls_iterations="{ls_iterations}">
    <flag {flags}/>
  </option>
  <default>
    <joint armature="{c.SERVO_ARMATURE}" frictionloss="{c.SERVO_FRICTION}" limited="true"/>
    <geom contype="0" conaffinity="0" group="1" rgba="0.75 0.76 0.8 1"/>
    <pair condim="3" friction="{c.FRICTION} {c.FRICTION} 0.005 0.0001 0.0001"/>
    <default class="light">
      <joint damping="{c.LIGHT_DAMPING}" armature="{c.LIGHT_ARMATURE}" frictionloss="0"/>
      <position kp="{c.LIGHT_GAIN}" forcerange="{-c.LIGHT_TORQUE} {c.LIGHT_TORQUE}"/>
    </default>
  </default>
{_LOOKS if full else ""}
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.1" contype="1"{grass}/>
{_field() if full else ""}{_LIGHT if full else ""}
    <body name="trunk" pos="0 0 0.12">
      <freejoint name="base"/>
      <site name="imu"/>
      <geom name="trunk" type="capsule" fromto="-0.06 0 0.012 0.06 0 0.012" size="0.038" mass="0"
            group="4"/>
      <geom name="trunk_box" type="box" pos="0 0 0.008" size="0.085 0.044 0.034"
            mass="{c.MASS_TRUNK}"/>
{"".join(_leg(i) for i in range(4))}{_head(full)}{_tail(full)}
    </body>
{_ball() if full else ""}{"".join(_obstacle(k) for k in range(num_obstacles)) if full else ""}
  </worldbody>
  <contact>
{_pairs(full, num_obstacles)}
  </contact>
  <actuator>
{_actuators(full)}
  </actuator>
  <sensor>
{_sensors()}
  </sensor>
</mujoco>
"""


def _range(low: float, high: float, degrees: bool = False) -> str:
    k = 3.141592653589793 / 180 if degrees else 1.0
    return f'range="{low * k:.8g} {high * k:.8g}"'


def _leg(i: int) -> str:
    """One leg: J1 swings it to the fore (hind legs: aft), J2 lifts it off the body's side, J3
    folds the shank the way J1 swings.  So elbows point aft and knees point fore, as a dog's."""
    leg, fore, side = c.LEGS[i], c.FORE[i], c.SIDE[i]
    shin = c.LOWER_LEG[i] - c.FOOT_RADIUS
    joints = [
        f'<joint name="{leg}_j{j + 1}" axis="{axis}" {_range(c.LEG_LOW[j], c.LEG_HIGH[j])}/>'
        for j, axis in enumerate((f"0 {-fore} 0", f"{side} 0 0", f"0 {-fore} 0"))
    ]
    knee = -fore * c.KNEE_OFFSET
    return f"""
      <body name="{leg}_shoulder" pos="{fore * c.SHOULDER_X} {side * c.SHOULDER_Y[i]} 0">
        {joints[0]}
        <geom type="cylinder" size="0.016 0.010" quat="0.70710678 0.70710678 0 0"
              mass="{c.MASS_SHOULDER}"/>
        <body name="{leg}_upper">
          {joints[1]}
          <geom type="capsule" fromto="0 0 0 {knee} 0 {-c.UPPER_LEG}" size="0.014"
                mass="{c.MASS_UPPER}"/>
          <body name="{leg}_lower" pos="{knee} 0 {-c.UPPER_LEG}">
            {joints[2]}
            <geom name="{leg}_shin" type="capsule" fromto="0 0 0 0 0 {-shin}" size="0.009"
                  mass="{c.MASS_LOWER}"/>
            <geom name="{leg}_elbow" type="sphere" size="{c.ELBOW_RADIUS}" mass="0"/>
            <geom name="{leg}_foot" type="sphere" pos="0 0 {-shin}" size="{c.FOOT_RADIUS}"
                  mass="0" rgba="0.25 0.25 0.28 1"/>
            <site name="{leg}_sole" pos="0 0 {-shin}" size="{1.2 * c.FOOT_RADIUS}" group="4"/>
          </body>
        </body>
      </body>"""


def _joint(name: str, axis: str, limits: tuple[float, float], on: bool) -> str:
    if not on:
        return ""
    return f'<joint class="light" name="{name}" axis="{axis}" {_range(*limits, degrees=True)}/>'


def _head(on: bool) -> str:
    tilt, pan, roll = (c.HEAD_LIMITS[k] for k in ("tilt", "pan", "roll"))
    x, y, z = c.NECK_BASE
    return f"""
      <body name="neck" pos="{x} {y} {z}">
        {_joint("head_tilt", "0 -1 0", tilt, on)}
        <geom type="capsule" fromto="0 0 0 0 0 {c.NECK[0]}" size="0.012" mass="{c.MASS_NECK}"/>
        <body name="head_pan" pos="0 0 {c.NECK[0]}">
          {_joint("head_pan", "0 0 1", pan, on)}
          <geom type="sphere" size="0.012" mass="0.001"/>
          <body name="head" pos="{c.NECK[1]} 0 0">
            {_joint("head_roll", "1 0 0", roll, on)}
            <geom name="head" type="capsule" fromto="-0.03 0 0 0.01 0 0" size="0.03"
                  mass="{c.MASS_HEAD - 0.001}"/>
            <geom type="box" pos="0.03 0 -0.008" size="0.018 0.018 0.013" mass="0"
                  rgba="0.2 0.2 0.23 1"/>
            <geom type="ellipsoid" pos="-0.02 0.033 -0.01" size="0.012 0.005 0.025" mass="0"
                  rgba="0.2 0.2 0.23 1"/>
            <geom type="ellipsoid" pos="-0.02 -0.033 -0.01" size="0.012 0.005 0.025" mass="0"
                  rgba="0.2 0.2 0.23 1"/>
            <camera name="nose" pos="0.05 0 0" xyaxes="0 -1 0 0 0 1" fovy="47.8"/>
          </body>
        </body>
      </body>"""


def _tail(on: bool) -> str:
    x, y, z = c.TAIL_BASE
    limits = (-c.TAIL_LIMIT, c.TAIL_LIMIT)
    return f"""
      <body name="tail" pos="{x} {y} {z}">
        {_joint("tail_tilt", "0 1 0", limits, on)}
        {_joint("tail_pan", "0 0 1", limits, on)}
        <geom type="capsule" fromto="0 0 0 {-0.7 * c.TAIL} 0 {0.7 * c.TAIL}" size="0.005"
              mass="{c.MASS_TAIL}"/>
      </body>"""


def _pairs(full: bool, num_obstacles: int) -> str:
    pairs = [("floor", part) for part in (*_FEET, *_ELBOWS)]
    if full:
        obstacles = [f"obstacle{k}" for k in range(num_obstacles)]
        pairs += [("floor", g) for g in ("trunk", "head", "ball")]
        pairs += [("ball", g) for g in (*_BODY, *_WALLS, *obstacles)]
        pairs += [(w, g) for w in _WALLS for g in ("trunk", "head", *_FEET)]
        pairs += [(o, g) for o in obstacles for g in _BODY]
    return "\n".join(f'    <pair geom1="{a}" geom2="{b}"/>' for a, b in pairs)


def _actuators(full: bool) -> str:
    limit = f'forcerange="{-c.SERVO_TORQUE} {c.SERVO_TORQUE}"'
    legs = [(f"{leg}_j{j + 1}", c.SERVO_P[j], c.SERVO_D[j]) for leg in c.LEGS for j in range(3)]
    light = ["head_tilt", "head_pan", "head_roll", "tail_tilt", "tail_pan"] if full else []
    return "\n".join(
        [f'    <position name="{j}" joint="{j}" kp="{p}" kv="{d}" {limit}/>' for j, p, d in legs]
        + [f'    <position class="light" name="{j}" joint="{j}"/>' for j in light]
    )


def _sensors() -> str:
    feet = "".join(f'\n    <touch name="{leg}_contact" site="{leg}_sole"/>' for leg in c.LEGS)
    return f"""    <framepos name="base_position" objtype="site" objname="imu"/>
    <framequat name="base_orientation" objtype="site" objname="imu"/>
    <gyro name="gyro" site="imu"/>
    <accelerometer name="accelerometer" site="imu"/>{feet}"""


def _ball() -> str:
    r = FIELD.ball_radius
    # Rolling resistance is a force of the world's (native.rolling_resistance): MuJoCo knows none
    # that is the same in every direction.
    return f"""    <body name="ball" pos="0.5 0 {r}">
      <joint name="ball" type="free" armature="0" frictionloss="0" limited="false"/>
      <geom name="ball" type="sphere" size="{r}" mass="{c.BALL_MASS}" rgba="1 0.45 0.05 1"/>
    </body>
"""


def _obstacle(k: int) -> str:
    return f"""    <body name="obstacle{k}" mocap="true" pos="{-1.2 + 0.4 * k} 0.7 0.12">
      <geom name="obstacle{k}" type="capsule" size="0.12 0.12" mass="0" rgba="0.75 0.2 0.2 1"/>
    </body>
"""


def _field() -> str:
    """Walls (planes that touch, low boxes to be seen), goals and landmarks."""
    half_x, half_y, mouth = 0.5 * FIELD.length, 0.5 * FIELD.width, 0.5 * FIELD.goal_width
    depth = FIELD.goal_depth
    # Contact planes close the goal mouths, as in the scenes the controllers are trained on.
    out = [
        f'<geom name="{name}" type="plane" size="0 0 0.1" pos="{x} {y} 0" xyaxes="{axes}"'
        ' group="4"/>'
        for name, x, y, axes in (
            ("wall_front", half_x, 0, "0 -1 0 0 0 1"),
            ("wall_back", -half_x, 0, "0 1 0 0 0 1"),
            ("wall_left", 0, half_y, "1 0 0 0 0 1"),
            ("wall_right", 0, -half_y, "-1 0 0 0 0 1"),
        )
    ]

    def box(x, y, half, colour, z=0.05, height=0.05):
        out.append(
            f'<geom type="box" pos="{x} {y} {z}" size="{half[0]} {half[1]} {height}"'
            f' rgba="{colour}"/>'
        )

    white = "0.95 0.95 0.95 1"
    for side in (1, -1):
        box(0, side * (half_y + 0.01), (half_x + 0.02, 0.01), white)
        goal = _COLOURS["yellow" if side > 0 else "skyblue"]
        part = 0.5 * (half_y - mouth)
        for flank in (1, -1):
            box(side * (half_x + 0.01), flank * (mouth + part), (0.01, part), white)
            box(side * (half_x + 0.5 * depth), flank * mouth, (0.5 * depth, 0.005), goal, 0.1, 0.1)
        box(side * (half_x + depth), 0, (0.005, mouth), goal, 0.1, 0.1)
    for name, x, y, lower, upper in FIELD.landmarks:
        for z, colour in ((0.15, "white"), (0.25, lower), (0.35, upper)):
            rgba = _COLOURS.get(colour, white)
            label = f'name="{name}" ' if z == 0.35 else ""
            out.append(
                f'<geom {label}type="cylinder" pos="{x} {y} {z}" size="0.05 0.05" rgba="{rgba}"/>'
            )
        box(x, y, (0.05, 0.05), white)
    return "\n".join(f"    {line}" for line in out)


_LIGHT = """
    <light directional="true" pos="0 0 3" dir="0.25 0.35 -1" diffuse="0.35 0.35 0.35"
           specular="0 0 0" castshadow="true"/>"""
_LOOKS = """  <visual>
    <global offwidth="1280" offheight="960"/>
    <quality shadowsize="4096" numslices="16" numstacks="8"/>
    <headlight ambient="0.45 0.45 0.45" diffuse="0.35 0.35 0.35" specular="0 0 0"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.7 0.8 0.9" rgb2="0.95 0.97 1"
             width="64" height="384"/>
    <texture name="grass" type="2d" builtin="checker" rgb1="0.13 0.42 0.2" rgb2="0.16 0.47 0.23"
             width="256" height="256"/>
    <material name="grass" texture="grass" texrepeat="10 10" texuniform="false" specular="0"
              shininess="0" reflectance="0"/>
  </asset>"""
