"""The Sony ERS-210 in numbers: lengths in m, angles in rad, masses in kg.

Lengths and joint limits are Sony's model information, joint speeds and PID gains Sony's as
Tekkotsu's ERS210Info.h lists them.  Masses are assumed (only the total of about 1.4 kg is known)
and so are the servos' units, torque and friction.
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
ELBOW_RADIUS = 0.014  # of elbow or knee, where a low dog's forearm meets the carpet
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
TAIL_SPEED = 4.47

# Assumed.  Trunk with battery, head, and per leg: shoulder, upper leg, lower leg.  Twelve of the
# eighteen motors sit in the legs: these have 45 % of the mass, as in models of the robot's
# successor that were calibrated on a real one.
MASS_TRUNK, MASS_NECK, MASS_HEAD, MASS_TAIL = 0.550, 0.030, 0.180, 0.010
MASS_SHOULDER, MASS_UPPER, MASS_LOWER = 0.0325, 0.0800, 0.0450
MASS = (
    MASS_TRUNK + MASS_NECK + MASS_HEAD + MASS_TAIL + 4 * (MASS_SHOULDER + MASS_UPPER + MASS_LOWER)
)  # 1.40

# Sony's PID gains in its own units, as the robot's registers take them: P, I, D of a leg's J1, J2,
# J3 (shifts 0x0E, 0x02, 0x0F) [Tekkotsu, ERS210Info.h, DefaultPIDs].
SONY_PID = ((22, 4, 8), (20, 4, 6), (35, 4, 5))
# Assumed: the unit of P, so that J1 has 8.4 N m/rad.  The ratios between the joints are Sony's.
SERVO_P = tuple(8.4 * p / SONY_PID[0][0] for p, _, _ in SONY_PID)  # N m/rad: 8.4, 7.6, 13.4
# The shifts make Sony's I 4 / 2^14 against a P of 22 / 2^2 for each frame of 8 ms: an error that
# lasts for a step of 0.5 s (62 frames) adds 0.3 % of what P gives.  So I = 0.
SERVO_I = (0.0, 0.0, 0.0)
# Assumed, N m s/rad.  Sony's D (8 / 2 against 22 / 2^2 a frame) would be 0.049 for J1; a gear's
# viscous friction is added to that.
SERVO_D = (0.137, 0.137, 0.137)
# Assumed.  Stall torque of the ERS-210: not found.  The Webots model of its successor has 5.45 N m.
SERVO_TORQUE = 1.5  # N m, most that P and D together may ask for
SERVO_FRICTION = 0.03  # N m, dry friction of the gears; assumed
SERVO_ARMATURE = 0.002  # kg m^2, the rotor's inertia behind its gear; assumed
# Head and tail, assumed.
LIGHT_GAIN, LIGHT_DAMPING, LIGHT_ARMATURE, LIGHT_TORQUE = 2.0, 0.08, 0.001, 0.6

BALL_MASS = 0.060  # assumed
FRICTION = 1.0  # rubber soles on carpet, assumed

# The point of the body's frame that is brought to the ball's centre: below the nose, where a
# lying ball touches nothing (chest at 0.10 m + ball radius 0.042 m).
CAPTURE_X = 0.145

# What the shipped walk follows within its tolerances on its servos (docs/quadruped.md).
OWN = {"v_min": 0.0, "v_max": 0.15, "omega_max": 1.0}
