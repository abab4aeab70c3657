"""A localized path over the field's landmarks, with the ellipses of its uncertainty."""

from pathlib import Path

import numpy as np

from fntg_jax.running.localize import Poses
from fntg_jax.showing import plots

ELLIPSES = 40  # of 95 % each, spread evenly over the path
_RADIUS = 2.4477  # of an ellipse that holds 95 % of a Gaussian, in standard deviations


def ellipse(covariance: np.ndarray, num_points: int = 48) -> np.ndarray:
    """The ellipse that holds 95 % of a Gaussian.

    Args:
        covariance: [2, 2], m^2.
        num_points: of its outline.

    Returns:
        [num_points, 2], m from its middle.
    """
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, num_points)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return (_RADIUS * axes @ (np.sqrt(np.maximum(values, 0))[:, None] * circle)).T


def plot(
    poses: Poses, landmarks: dict[str, tuple[float, float]], truth: np.ndarray | None, path: Path
) -> Path:
    """The estimated path, ellipses of 95 %, landmarks, and the true path if known.

    Where the robot is more likely lost than not nothing is drawn.  Returns the PNG's path.

    Args:
        poses: of `localize.localize`.
        landmarks: name to x, y, m.
        truth: [N, 4]: time (s), x, y (m), heading (rad); None where it is not known.
        path: file to write, and a PDF beside it.

    Raises OSError.
    """
    figure, axes = plots.new_grid(1, 1, 7.5, 5.2)
    axis = axes[0, 0]
    if truth is not None:
        # A jump is a robot that was lifted: no line.
        jump = np.hypot(*np.diff(truth[:, 1:3], axis=0).T) > 0.2
        cut = np.insert(truth[:, 1:3], np.flatnonzero(jump) + 1, np.nan, axis=0)
        axis.plot(*cut.T, color="0.55", lw=1.6, label="truth")
    known = poses.lost < 0.5
    line = np.where(known[:, None], poses.pose[:, :2], np.nan)
    axis.plot(*line.T, color=plots.BLUE, lw=1.0, label="estimate")
    for n in np.unique(np.linspace(0, len(poses.time) - 1, ELLIPSES).astype(int)):
        if known[n]:
            ring = poses.pose[n, :2] + ellipse(poses.covariance[n, :2, :2])
            axis.plot(*ring.T, color=plots.ORANGE, lw=0.8)
    axis.plot([], [], color=plots.ORANGE, lw=0.8, label="95 % ellipse")
    x, y = np.array(list(landmarks.values())).T
    axis.plot(x, y, "^", color=plots.GREEN, ms=7, label="landmark")
    for name, (mx, my) in landmarks.items():
        offset = (0, 7) if my >= np.mean(y) else (0, -13)
        axis.annotate(
            name, (mx, my), textcoords="offset points", xytext=offset, ha="center", fontsize=8
        )
    axis.set_aspect("equal")
    axis.margins(0.08)
    axis.set_xlabel("x, m")
    axis.set_ylabel("y, m")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncol=4)
    return plots.save(figure, path)
