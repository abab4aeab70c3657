"""A differential-drive soccer robot as MJCF: two driven wheels, two casters, a kicker, a camera.

All numbers are assumed, in the range of small hobby robots; the body is no longer than the dog, and
its front is where the dog's chest is, so that the ball is met at the same point.
"""

MASS = 1.2  # kg, all of it
LENGTH, WIDTH, HEIGHT = 0.20, 0.16, 0.09  # m, of the chassis
WHEEL_RADIUS, WHEEL_MASS, TRACK = 0.030, 0.050, 0.14  # m, kg, m between the wheels
CLEARANCE = 0.012  # m, below the chassis
GAIN, TORQUE = 0.05, 0.10  # of a wheel's speed servo: N m s/rad, and N m at most
DAMPING = 0.0005  # N m s/rad, of a wheel's bearing
NO_LOAD = 20.0  # rad/s, most that a wheel's motor turns
CAPTURE_X = 0.145  # m, where the ball's centre lies before the front
KICK_FORCE, KICK_TRAVEL, KICKER_MASS = 30.0, 0.030, 0.10  # N, m, kg, of the solenoid
BALL_MASS = 0.060  # kg, as the dog's ball
CAMERA_HEIGHT = 0.15  # m

# Moments of inertia about the vertical through the middle, and of a wheel about its axis, kg m^2.
CHASSIS_MASS = MASS - 2 * WHEEL_MASS - KICKER_MASS
WHEEL_INERTIA = 0.5 * WHEEL_MASS * WHEEL_RADIUS**2
_WHEEL_Z = 0.25 * WHEEL_MASS * WHEEL_RADIUS**2
INERTIA = (
    CHASSIS_MASS * (LENGTH**2 + WIDTH**2) / 12
    + 2 * (_WHEEL_Z + WHEEL_MASS * (0.5 * TRACK) ** 2)
    + KICKER_MASS * (0.5 * LENGTH - 0.005) ** 2
)


def mjcf(timestep: float = 0.004, num_obstacles: int = 0, ball: bool = True) -> str:
    """MJCF text.  timestep: s; num_obstacles: upright cylinders, moved as mocap bodies."""
    floor = WHEEL_RADIUS
    middle = CLEARANCE + 0.5 * HEIGHT - floor
    wheels = "".join(
        f"""
      <body name="{name}" pos="0 {side * TRACK / 2} 0">
        <joint name="{name}" axis="0 1 0" damping="{DAMPING}"/>
        <inertial pos="0 0 0" mass="{WHEEL_MASS}"
                  diaginertia="{_WHEEL_Z} {WHEEL_INERTIA} {_WHEEL_Z}"/>
        <geom name="{name}" type="sphere" size="{WHEEL_RADIUS}" rgba="0.15 0.15 0.15 1"/>
      </body>"""
        for name, side in (("left", 1), ("right", -1))
    )
    casters = "".join(
        f'<geom name="caster{n}" type="sphere" size="0.01" pos="{x} 0 {0.0101 - floor}" mass="0"/>'
        for n, x in enumerate((0.075, -0.075))
    )
    obstacles = "".join(
        f"""
    <body name="obstacle{k}" mocap="true" pos="{-1.2 + 0.4 * k} 3 0.1">
      <geom name="obstacle{k}" type="cylinder" size="0.12 0.1" rgba="0.75 0.2 0.2 1"/>
    </body>"""
        for k in range(num_obstacles)
    )
    pairs = [("floor", "left", 3, 1.0), ("floor", "right", 3, 1.0)]
    pairs += [("floor", f"caster{n}", 1, 0.0) for n in (0, 1)]
    if ball:
        pairs += [("ball", part, 3, 0.5) for part in ("floor", "chassis", "kicker")]
    for k in range(num_obstacles):
        pairs += [(f"obstacle{k}", part, 3, 0.5) for part in ("chassis", "left", "right")]
    contacts = "\n".join(
        f'    <pair geom1="{a}" geom2="{b}" condim="{dim}" '
        f'friction="{mu} {mu} 0.005 0.0001 0.0001"/>'
        for a, b, dim, mu in pairs
    )
    balls = (
        f"""
    <body name="ball" pos="1 0 0.042"><freejoint name="ball"/>
      <geom name="ball" type="sphere" size="0.042" mass="{BALL_MASS}" rgba="1 0.45 0.05 1"/>
    </body>"""
        if ball
        else ""
    )
    return f"""<mujoco model="wheeled">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{timestep}" integrator="implicitfast" cone="elliptic"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.1" rgba="0.13 0.42 0.2 1"/>
    <light directional="true" pos="0 0 3" dir="0.2 0.3 -1"/>
    <body name="chassis" pos="0 0 {floor}">
      <freejoint name="base"/>
      <geom name="chassis" type="box" pos="0 0 {middle}" mass="{CHASSIS_MASS}"
            size="{LENGTH / 2} {WIDTH / 2} {HEIGHT / 2}" rgba="0.2 0.35 0.9 1"/>
      {casters}
      <camera name="nose" pos="0.08 0 {CAMERA_HEIGHT - floor}" xyaxes="0 -1 0 0 0 1" fovy="47.8"/>
      <body name="kicker" pos="{LENGTH / 2 - 0.005} 0 {0.042 - floor}">
        <joint name="kicker" type="slide" axis="1 0 0" range="0 {KICK_TRAVEL}" stiffness="120"
               damping="0.3" springref="-0.005"/>
        <geom name="kicker" type="box" size="0.005 0.05 0.012" mass="{KICKER_MASS}"
              rgba="0.9 0.9 0.9 1"/>
      </body>{wheels}
    </body>{balls}{obstacles}
  </worldbody>
  <contact>
{contacts}
  </contact>
  <actuator>
    <velocity name="left" joint="left" kv="{GAIN}" forcerange="{-TORQUE} {TORQUE}"
              ctrlrange="{-NO_LOAD} {NO_LOAD}"/>
    <velocity name="right" joint="right" kv="{GAIN}" forcerange="{-TORQUE} {TORQUE}"
              ctrlrange="{-NO_LOAD} {NO_LOAD}"/>
    <motor name="kicker" joint="kicker" ctrlrange="0 {KICK_FORCE}"/>
  </actuator>
</mujoco>
"""
