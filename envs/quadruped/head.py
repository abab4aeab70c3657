"""The head's three joints: where it looks, the way back from a point, speed limits, scans.

Tilt sits below pan, pan below roll; positive tilt looks up, positive pan left.  Points are in the
body's frame with z above the floor; the dog stands.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.base import Head, Scalar
from envs.field import bearing

# Scan patterns: amplitude of pan and tilt (rad), the tilt's middle (rad), seconds for a whole sweep
# to and fro.  No joint is asked for more than its speed (Head.speed).
SCANS = {
    "wide": (1.5, 0.0, -0.15, 3.0),
    "near": (1.5, 0.0, -0.75, 3.0),
    "landmarks": (1.5, 0.0, 0.10, 3.0),
    "both": (1.5, 0.3, -0.35, 4.0),
}


def camera(head: Float[Array, "3"], neck: Head = Head()):
    """Where the camera is (m) and its axis (unit vector) at tilt, pan, roll (rad)."""
    tilt, pan = head[0], head[1]
    ct, st, cp, sp = jnp.cos(tilt), jnp.sin(tilt), jnp.cos(pan), jnp.sin(pan)
    axis = jnp.stack([ct * cp, sp, st * cp])
    pan_joint = jnp.stack([-neck.neck * st, jnp.zeros_like(st), neck.neck * ct])
    return jnp.asarray(neck.base) + pan_joint + neck.nose * axis, axis


def look_to(point: Float[Array, "3"], neck: Head = Head()) -> Float[Array, "3"]:
    """Tilt, pan, roll (rad) whose camera axis goes through a point (m), exactly where the joints
    can; else the limits nearest to it.

    The axis lies in the plane of the tilted pan joint, `neck` above the tilt axis: with the point
    at (x, z) from there, r sin(phi - tilt) = neck, r and phi its polar coordinates.
    """
    x, y, z = point[0] - neck.base[0], point[1], point[2] - neck.base[2]
    r = jnp.sqrt(x * x + z * z + 1e-12)
    lean = jnp.minimum(neck.neck / r, 1.0)
    phi = bearing(x, z)
    lifted = bearing(jnp.sqrt(1 - lean * lean + 1e-12), lean)
    ahead = phi - lifted
    # Behind the pan joint the other solution looks over the shoulder, with the neck less bent.
    back = phi + lifted
    back = jnp.where(back > 0, back - jnp.pi, back + jnp.pi)
    tilt = jnp.where(x >= 0, ahead, back)
    tilt = jnp.clip(tilt, neck.low[0], neck.high[0])
    along = x * jnp.cos(tilt) + z * jnp.sin(tilt)
    pan = jnp.clip(bearing(along, y), neck.low[1], neck.high[1])
    return jnp.stack([tilt, pan, jnp.zeros_like(tilt)])


def follow(
    head: Float[Array, "3"], wanted: Float[Array, "3"], dt: Scalar, neck: Head = Head()
) -> Float[Array, "3"]:
    """The set-points dt (s) later: towards the wanted ones, within limits and speeds."""
    most = jnp.asarray(neck.speed) * dt
    wanted = jnp.clip(wanted, jnp.asarray(neck.low), jnp.asarray(neck.high))
    return head + jnp.clip(wanted - head, -most, most)


def scan(time: Scalar, pattern: str = "wide") -> Float[Array, "3"]:
    """Set-points (rad) of a scan pattern at a time (s): triangle waves.

    Raises ValueError for an unknown pattern.
    """
    if pattern not in SCANS:
        raise ValueError(f"scan = {pattern!r}: allowed are {', '.join(SCANS)}")
    pan, tilt, middle, period = SCANS[pattern]

    def wave(turns):
        return 4 * jnp.abs(turns - jnp.floor(turns + 0.5)) - 1

    turns = time / period
    return jnp.stack(
        [middle + tilt * wave(2 * turns + 0.25), pan * wave(turns + 0.25), jnp.zeros_like(turns)]
    )
