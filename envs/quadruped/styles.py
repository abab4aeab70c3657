"""Walking styles: a gait with its calibration, and the file that holds them."""

import dataclasses
import json
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs.quadruped import calibration, measure
from envs.quadruped.environment import Quadruped
from envs.quadruped.locomotion import Gait

_steady = jax.jit(measure.steady)


def calibrate(env: Quadruped, scale: Any, rounds: int = 6) -> calibration.Calibration:
    """The calibration of a walk over an ellipsoid with half axes `scale` (m/s, m/s, rad/s).

    In every round what was asked for is corrected by what is missing, the mean of the lean model
    and the full one; of a velocity's rounds the best counts.
    """
    scale = np.asarray(scale, float)
    wanted = calibration.sites(scale)
    plain = dataclasses.replace(env, gait=dataclasses.replace(env.gait, calibration=None))
    asked = best = wanted.copy()
    least, missing = np.full(len(wanted), np.inf), np.zeros_like(wanted)
    pace = np.full(len(wanted), 0.8)
    most = 1.5 * np.abs(wanted) + 0.15 * scale
    for _ in range(rounds):
        lean = _steady(plain, jnp.asarray(asked, jnp.float32))
        full = measure.steady_native(plain, np.asarray(asked, np.float32), "full")
        off = wanted - 0.5 * (np.asarray(lean.velocity) + np.asarray(full.velocity)).astype(float)
        size = np.linalg.norm(off / scale, axis=1)
        size[np.asarray(lean.fallen) | np.asarray(full.fallen)] = np.inf
        better = size < least
        best = np.where(better[:, None], asked, best)
        missing = np.where(better[:, None], off, missing)
        least, pace = np.minimum(size, least), np.where(better, pace, 0.5 * pace)
        asked = np.clip(best + pace[:, None] * missing, -most, most)
    return calibration.fit(np.concatenate([wanted, best], axis=1), scale)


def document(gait: Gait, origin: str, **more: Any) -> str:
    """A gait as the text of its JSON file, which `locomotion.load_gait` reads.  more: further
    entries of the file."""
    values = {
        f.name: round(float(getattr(gait, f.name)), 5)
        for f in dataclasses.fields(gait)
        if f.name != "calibration"
    }
    file = {"format": "fntg-gait", "version": 3, "origin": origin, **more, "gait": values}
    if gait.calibration is not None:
        table = gait.calibration
        scale, rows = (np.round(np.asarray(x, float), 5).tolist() for x in table[:2])
        file["calibration"] = {"scale": scale, "rows": rows}
    text = json.dumps(file, indent=1, allow_nan=False)
    return re.sub(r'\[[^\[\]{}"]*\]', lambda rows: " ".join(rows[0].split()), text) + "\n"
