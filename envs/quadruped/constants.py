"""The Sony ERS-210 in numbers: lengths in m, angles in rad, masses in kg.

Lengths, joint limits and joint speeds are Sony's model information.  Masses are assumed
(only the total of about 1.4 kg is known) and so is everything about the servos.
"""

import math

# Legs in MuJoCo's order.  FORE and SIDE say where each one sits; a leg's own frame is mirrored by
# them, so that one set of equations and one set of joint limits serves all four (see locomotion).
LEGS = ("lf", "rf", "lh", "rh")  # left/right, fore/hind
FORE = (1.0, 1.0, -1.0, -1.0)
SIDE = (1.0, -1.0, 1.0, -1.0)

LENGTH, WIDTH = 0.289, 0.152
SHOULDER_X = 0.0595  # shoulder axes fore and aft of the body's centre
SHOULDER_Y = (0.0592, 0.0592, 0.0597, 0.0597)  # half the lateral distance of the feet
UPPER_LEG = 0.064
KNEE_OFFSET = 0.0128  # of the knee axis, towards the side the knee points to
LOWER_LEG = (0.0649, 0.0649, 0.0749, 0.0749)  # knee axis to sole
FOOT_RADIUS = 0.010
NECK = (0.048, 0.050)  # tilt axis to pan axis, pan axis to the head's centre
NECK_BASE = (0.070, 0.0, 0.025)
TAIL_BASE = (-0.095, 0.0, 0.035)
TAIL = 0.055

LEG_LOW = tuple(math.radians(a) for a in (-117, -11, -27))  # J1, J2, J3
LEG_HIGH = tuple(math.radians(a) for a in (117, 89, 147))
HEAD_LIMITS = {"tilt": (-82, 43), "pan": (-89.6, 89.6), "roll": (-29, 29)}  # degrees
TAIL_LIMIT = 22  # degrees, both joints
LEG_SPEED = (2.81, 2.50, 2.84)  # rad/s, J1, J2, J3
HEAD_SPEED = (2.11, 3.01, 3.01)

# Assumed.  Trunk with battery, head, and per leg: shoulder, upper leg, lower leg.
MASS_TRUNK, MASS_NECK, MASS_HEAD, MASS_TAIL = 0.760, 0.030, 0.180, 0.010
MASS_SHOULDER, MASS_UPPER, MASS_LOWER = 0.020, 0.055, 0.030
MASS = (
    MASS_TRUNK + MASS_NECK + MASS_HEAD + MASS_TAIL + 4 * (MASS_SHOULDER + MASS_UPPER + MASS_LOWER)
)  # 1.40

# Assumed.  A position servo: gain in N m/rad, damping in N m s/rad, rotor inertia in kg m^2.
SERVO_GAIN, SERVO_DAMPING, SERVO_ARMATURE = 8.4, 0.137, 0.002
LIGHT_GAIN, LIGHT_DAMPING, LIGHT_ARMATURE = 2.0, 0.08, 0.001  # head and tail

BALL_MASS = 0.060  # assumed
FRICTION = 1.0  # rubber soles on carpet, assumed

# The point of the body's frame that is brought to the ball's centre: below the nose, where a
# lying ball touches nothing (chest at 0.10 m + ball radius 0.042 m).
CAPTURE_X = 0.145
