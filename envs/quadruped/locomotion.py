"""Walking: (v_x, v_y, omega) to twelve joint set-points, a pure function of phase and gait.

On the ground a foot moves against the wanted body motion at constant speed; through the air it
returns at constant speed, too, rising and sinking on ramps: of all ways back this is the one whose
fastest joint is slowest, and joints are what limits the walk (`limit`).  Diagonal feet move
together in a trot, one foot after the other in a crawl.  Leg inverse kinematics are analytic.

Arrays over legs are in the order of `constants.LEGS`; a foot is the centre of its sphere.
"""

import dataclasses
import json
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from envs.base import Scalar
from envs.field import bearing
from envs.quadruped import constants as c
from envs.quadruped.calibration import Calibration, ask, fit

FORE = np.asarray(c.FORE, np.float32)
SIDE = np.asarray(c.SIDE, np.float32)
SHOULDERS = np.stack(
    [FORE * c.SHOULDER_X, SIDE * np.asarray(c.SHOULDER_Y), np.zeros(4)], axis=1
).astype(np.float32)
SHIN = np.asarray(c.LOWER_LEG, np.float32) - np.float32(c.FOOT_RADIUS)  # knee to foot centre
LOW, HIGH = np.asarray(c.LEG_LOW, np.float32), np.asarray(c.LEG_HIGH, np.float32)
THIGH = math.hypot(c.UPPER_LEG, c.KNEE_OFFSET)
KNEE_ANGLE = math.atan2(c.KNEE_OFFSET, c.UPPER_LEG)
TROT = np.asarray([0.0, 0.5, 0.5, 0.0], np.float32)  # phase of each leg
CRAWL = np.asarray([0.0, 0.5, 0.75, 0.25], np.float32)  # fore left, hind right, ...
SPEED = np.tile(np.asarray(c.LEG_SPEED, np.float32), 4)  # rad/s, order of the actuators
_POSITIVE = ("period", "duty", "height", "ramp", "v_rate", "omega_rate", "full_lift")
DEFAULT_GAIT = Path(__file__).parent / "data" / "trot.json"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gait:
    """Parameters of a walk.  Every field is traced, so that gaits can be evolved.

    period: s.  duty: share of it on the ground.  lift: height of a step, m.  ramp: share of the
    way through the air on which a foot rises, and sinks.  crawl: 0 diagonal feet together, 1 one
    foot after the other.  height: shoulders above the floor, m.  fore_x, hind_x: where the feet
    stand ahead of their shoulder, m.  fore_y, hind_y: how far outside, m.  tilt: by how much the
    fore shoulders are lower, m.
    gain_*: stride per wanted displacement.  calibration: what to ask for so that the dog walks as
    wanted; None: what is wanted.
    v_rate, omega_rate: how fast strides may change, m/s^2 and rad/s^2.
    full_lift: speed of a foot from which on steps have their full height, m/s: below it the dog
    treads less, and without a command it stands.
    """

    period: Scalar = 0.30
    duty: Scalar = 0.53
    lift: Scalar = 0.024
    ramp: Scalar = 0.3
    crawl: Scalar = 0.0
    height: Scalar = 0.105
    tilt: Scalar = 0.0
    fore_x: Scalar = 0.0
    hind_x: Scalar = 0.0
    fore_y: Scalar = 0.0
    hind_y: Scalar = 0.0
    gain_x: Scalar = 1.0
    gain_y: Scalar = 1.0
    gain_omega: Scalar = 1.0
    calibration: Calibration | None = None
    v_rate: Scalar = 2.0
    omega_rate: Scalar = 15.0
    full_lift: Scalar = 0.02


def load_gait(path: Path | str = DEFAULT_GAIT) -> Gait:
    """A gait from its JSON file (names and values of `Gait`; those not named keep defaults).

    Raises ValueError (one line) where the file, a name or a value is not what is allowed.
    """
    try:
        file = json.loads(Path(path).read_text(encoding="utf-8"))
        values = {name: np.asarray(value, float) for name, value in file["gait"].items()}
        table = file.get("calibration")
        table = table and {n: np.asarray(table[n], float) for n in ("scale", "rows")}
    except OSError as error:
        raise ValueError(f"gait = {path}: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError, AttributeError):
        raise ValueError(
            f"gait = {path}: allowed is a JSON file with numbers by name under 'gait'"
        ) from None
    known = {f.name for f in dataclasses.fields(Gait)} - {"calibration"}
    if unknown := sorted(set(values) - known):
        raise ValueError(f"gait {path}: unknown {unknown}; allowed are {sorted(known)}")
    for name, value in values.items():
        if value.shape != () or not np.isfinite(value):
            raise ValueError(f"gait {path}: {name} = {value}; allowed are finite numbers")
        if name in _POSITIVE and value <= 0:
            raise ValueError(f"gait {path}: {name} = {value}; allowed are numbers above 0")
    if table is not None:
        scale, rows = table["scale"], table["rows"]
        if scale.shape != (3,) or not (scale > 0).all():
            raise ValueError(f"gait {path}: calibration.scale = {scale}; allowed are three above 0")
        if rows.ndim != 2 or rows.shape[1] != 6 or len(rows) < 4 or not np.isfinite(rows).all():
            raise ValueError(
                f"gait {path}: calibration.rows: allowed are rows of six finite numbers"
            )
    calibration = fit(table["rows"], table["scale"]) if table else None
    return Gait(**{name: float(value) for name, value in values.items()}, calibration=calibration)


def leg_forward(q: Float[Array, "*b 4 3"]) -> Float[Array, "*b 4 3"]:
    """Foot positions in the body's frame (m) from joint angles J1, J2, J3 (rad).

    In the leg's own frame (x fore, y outward): knee at (-offset, -upper), foot at the shin's
    length below it, turned by J3; then turned by J2 about x and by J1 about y.
    """
    q1, q2, q3 = q[..., 0], q[..., 1], q[..., 2]
    px = -c.KNEE_OFFSET + SHIN * jnp.sin(q3)
    pz = -c.UPPER_LEG - SHIN * jnp.cos(q3)
    y, z = -pz * jnp.sin(q2), pz * jnp.cos(q2)
    x, z = px * jnp.cos(q1) - z * jnp.sin(q1), px * jnp.sin(q1) + z * jnp.cos(q1)
    return jnp.asarray(SHOULDERS) + jnp.stack([x * FORE, y * SIDE, z], axis=-1)


def leg_inverse(foot: Float[Array, "*b 4 3"], xp=jnp) -> Float[Array, "*b 4 3"]:
    """Joint angles J1, J2, J3 (rad) that put the feet there (m, body's frame).

    The knee folds to its positive side.  A target out of reach is pulled to the nearest point
    of its ray from the shoulder that can be reached; then joint limits clamp.  Finite, with a
    finite gradient, for every input.  xp: jax.numpy, or numpy to stay out of JAX.
    """
    angle = bearing if xp is jnp else lambda x, y: np.arctan2(y, x)
    local = foot - SHOULDERS
    x, y, z = local[..., 0] * FORE, local[..., 1] * SIDE, local[..., 2]
    squared = xp.maximum(x * x + y * y + z * z, 1e-8)
    # |foot|^2 = thigh^2 + shin^2 + 2 thigh shin cos(J3 + knee angle)
    cos_knee = (squared - THIGH**2 - SHIN**2) / (2 * THIGH * SHIN)
    straight = 1 - 1e-6
    folded = math.cos(c.LEG_HIGH[2] + KNEE_ANGLE)
    cos_knee = xp.clip(cos_knee, folded, straight)
    sin_knee = xp.sqrt(1 - cos_knee * cos_knee)
    q3 = angle(cos_knee, sin_knee) - KNEE_ANGLE
    reached = THIGH**2 + SHIN**2 + 2 * THIGH * SHIN * cos_knee
    shrink = xp.sqrt(reached / squared)
    x, y, z = x * shrink, y * shrink, z * shrink
    # sin and cos of J3 by the angle difference: no further transcendental function
    cos_a, sin_a = math.cos(KNEE_ANGLE), math.sin(KNEE_ANGLE)
    px = -c.KNEE_OFFSET + SHIN * (sin_knee * cos_a - cos_knee * sin_a)
    pz = -c.UPPER_LEG - SHIN * (cos_knee * cos_a + sin_knee * sin_a)
    sin_out = xp.clip(-y / xp.minimum(pz, -1e-3), -straight, straight)
    cos_out = xp.sqrt(1 - sin_out * sin_out)
    q2 = angle(cos_out, sin_out)
    down = -pz * cos_out
    # J1 turns (px, down) into (x, -z): one bearing of their quotient as complex numbers.
    q1 = angle(-z * down + x * px, x * down + z * px)
    return xp.clip(xp.stack([q1, q2, q3], axis=-1), LOW, HIGH)


def stance(gait: Gait, xp=jnp) -> Float[Array, "4 3"]:
    """Where the feet stand in the body's frame, m."""
    hind = np.asarray([0.0, 0.0, 1.0, 1.0], np.float32)
    x = SHOULDERS[:, 0] + gait.fore_x + hind * (gait.hind_x - gait.fore_x)
    y = SHOULDERS[:, 1] + SIDE * (gait.fore_y + hind * (gait.hind_y - gait.fore_y))
    z = c.FOOT_RADIUS - gait.height + gait.tilt * (0.5 * FORE)
    return xp.stack([x, y, z * xp.ones(4)], axis=-1)


def foot_targets(
    gait: Gait, phase: Float[Array, "*b"], velocity: Float[Array, "3"]
) -> Float[Array, "*b 4 3"]:
    """Wanted feet (m, body's frame) at a phase in turns, for a velocity (v_x, v_y, omega).

    On the ground, share s of it past: stand + stride (1/2 - s); the stride is the body's velocity
    at the foot times the time on the ground.
    """
    stand = stance(gait)
    if gait.calibration is not None:
        velocity = ask(gait.calibration, velocity)
    vx = gait.gain_x * velocity[0] - gait.gain_omega * velocity[2] * stand[:, 1]
    vy = gait.gain_y * velocity[1] + gait.gain_omega * velocity[2] * stand[:, 0]
    on_ground = gait.duty * gait.period
    turn = phase[..., None] + TROT + gait.crawl * (CRAWL - TROT)
    turn = turn - jnp.floor(turn)
    u = jnp.clip((turn - gait.duty) / (1 - gait.duty), 0.0, 1.0)
    along = jnp.where(turn < gait.duty, 0.5 - turn / gait.duty, u - 0.5)
    bump = jnp.minimum(jnp.minimum(u, 1 - u) / gait.ramp, 1.0)
    pace = jnp.sqrt(jnp.max(vx * vx + vy * vy) + 1e-12)
    rise = gait.lift * jnp.minimum(1.0, pace / gait.full_lift)
    dx, dy, dz = along * (vx * on_ground), along * (vy * on_ground), rise * bump
    return stand + jnp.stack([dx, dy, dz], axis=-1)


def set_points(
    gait: Gait, phase: Float[Array, "*b"], velocity: Float[Array, "3"]
) -> Float[Array, "*b 12"]:
    """Twelve joint set-points (rad, order of the actuators) at a phase (turns)."""
    q = leg_inverse(foot_targets(gait, phase, velocity))
    return q.reshape(*q.shape[:-2], 12)


def follow(gait: Gait, velocity: Float[Array, "3"], wanted: Float[Array, "3"], dt: Scalar):
    """The stride velocity after dt (s): towards the wanted one, no faster than the gait's rates."""
    rate = jnp.stack([jnp.asarray(r) for r in (gait.v_rate, gait.v_rate, gait.omega_rate)]) * dt
    return velocity + jnp.clip(wanted - velocity, -rate, rate)


def limit(
    targets: Float[Array, "N 12"], last: Float[Array, "12"], most: Float[Array, "12"]
) -> Float[Array, "N 12"]:
    """Set-points that follow targets (rad) from the last ones, each joint by at most `most` (rad)
    from one to the next."""

    def follow_target(at, target):
        at = at + jnp.clip(target - at, -most, most)
        return at, at

    return jax.lax.scan(follow_target, last, targets)[1]
