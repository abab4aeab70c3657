"""Pictures of a controller: its membership functions and its control surfaces.

One column of panels a controller, so that two files stand side by side on the same scales.
"""

from pathlib import Path
from typing import Any

import numpy as np

from fntg_jax.controller import labels
from fntg_jax.controller.controller import Controller
from fntg_jax.showing.plots import BLUE, GREEN, ORANGE, RC, new_grid, save

_AXES = {
    "A": "distance to the ball $d_B$ (m)",
    "B": "distance to the obstacle $d_O$ (m)",
    "C": r"direction of the ball $\theta_B$ (rad)",
    "D": r"direction of the obstacle $\theta_O$ (rad)",
}
# The obstacle of the control surfaces: none near (as far as the field allows, behind), or one
# that a robot would have to go round.
_OBSTACLES = (
    ("no obstacle near ($d_O$ = 0.9 m, behind)", 0.9, np.pi),
    (r"obstacle at 0.2 m, $\theta_O$ = +0.3 rad (left)", 0.2, 0.3),
)
_NEAR = 0.1  # m


def memberships(controllers: list[tuple[str, Controller]], field: Any, path: str | Path) -> Path:
    """Membership functions over what a field can hold; returns the PNG's path.

    Solid: share of each label in its family (what the weighted average uses); dashed: the paper's
    sigmoids themselves.

    Args:
        controllers: (title, controller), side by side on the same scales.
        field: `envs.base.Field`, for the ranges.
        path: file to write, and a PDF beside it.

    Raises OSError.
    """
    figure, axes = new_grid(4, len(controllers), 3.6 * len(controllers) + 0.4, 8.6)
    for column, (title, controller) in zip(axes.T, controllers):
        found, _ = labels.describe_labels(controller, field)
        for panel, family in zip(column, "ABCD"):
            x = np.linspace(*labels.input_range(family, field), 801)
            for n, (share, label) in enumerate(
                zip(labels.shares(controller, family, x), found[family])
            ):
                colour, letter = (BLUE, ORANGE, GREEN)[n], f"${family}_{n + 1}$"
                name = label.name.partition(" (")[0]
                panel.plot(x, share, color=colour, linewidth=1.8, label=f"{letter} {name}")
                if family != "D":
                    a = getattr(controller.params, f"a_{family}")[n]
                    c = getattr(controller.params, f"c_{family}")[n]
                    mu = 1 / (1 + np.exp(-a * (x - c)))
                    panel.plot(x, mu, color=colour, linewidth=1, linestyle="--", alpha=0.8)
            panel.set_xlabel(_AXES[family])
            panel.set_ylim(-0.03, 1.03)
            panel.set_xlim(x[0], x[-1])
            panel.legend(
                loc="lower left", bbox_to_anchor=(0, 1), ncols=3, fontsize=8, frameon=False
            )
        column[0].set_title(title, fontsize=9, loc="left", pad=20)
    for panel in axes[:, 0]:
        panel.set_ylabel("membership")
    figure.supxlabel("solid: share in the family; dashed: sigmoid before sharing", fontsize=8)
    return save(figure, path)


def surfaces(controllers: list[tuple[str, Controller]], field: Any, path: str | Path) -> Path:
    """v and omega over (d_B, theta_B), without and with an obstacle; returns the PNG's path.

    Args:
        controllers: (title, controller), side by side on the same scales.
        field: `envs.base.Field`, for the ranges.
        path: file to write, and a PDF beside it.

    Raises OSError.
    """
    import matplotlib

    rows = [(quantity, obstacle) for quantity in (0, 1) for obstacle in _OBSTACLES]
    figure, axes = new_grid(4, len(controllers), 3.9 * len(controllers) + 0.8, 10.0)
    _, far = labels.input_range("A", field)
    d_ball = np.concatenate([np.linspace(0, _NEAR, 61), np.geomspace(_NEAR, far, 91)[1:]])
    theta = np.linspace(-np.pi, np.pi, 121)
    grid = np.meshgrid(d_ball, theta)
    v_low = min(float(c.limits.v_min) for _, c in controllers)
    v_high = max(float(c.limits.v_max) for _, c in controllers)
    turn = max(float(c.limits.omega_max) for _, c in controllers)
    scales = (("viridis", v_low, v_high, "$v$ (m/s)"), ("PuOr_r", -turn, turn, r"$\omega$ (rad/s)"))
    with matplotlib.rc_context(RC):
        for row, (quantity, (words, d_obstacle, theta_obstacle)) in enumerate(rows):
            colours, low, high, name = scales[quantity]
            for panel, (title, controller) in zip(axes[row], controllers):
                z = controller(grid[0], d_obstacle, grid[1], theta_obstacle)[quantity]
                mesh = panel.pcolormesh(
                    d_ball, theta, z, cmap=colours, vmin=low, vmax=high, rasterized=True
                )
                if z.min() < z.max():
                    # Inside the limits: along a limit itself a contour is only jagged.
                    levels = np.linspace(low, high, 7)[1:-1]
                    panel.contour(d_ball, theta, z, levels, colors="black", linewidths=0.4)
                panel.set_title(f"{title}\n{words}" if row == 0 else words, fontsize=8, loc="left")
                panel.set_yticks([-np.pi, 0, np.pi], [r"$-\pi$", "0", r"$\pi$"])
                panel.set_xscale("symlog", linthresh=_NEAR, linscale=0.8)
                panel.set_xticks([0, 0.1, 0.2, 0.5, 1, 2], ["0", "0.1", "0.2", "0.5", "1", "2"])
                panel.minorticks_off()
                panel.set_xlim(0, far)
                panel.grid(False)
            axes[row, 0].set_ylabel(r"$\theta_B$ (rad)")
            figure.colorbar(mesh, ax=axes[row], label=name)
        for panel in axes[-1]:
            panel.set_xlabel("distance to the ball $d_B$ (m)")
    return save(figure, path)
