"""Recorded trials as one self-contained HTML page, or as an animated picture.

`record` turns trials into panels: plain lists of positions and values over time, which know
nothing of how they came about.  `page` and `animation` draw panels.
"""

import html
import io
import math
import re
import textwrap
from functools import partial
from importlib import resources
from typing import Any

import jax
import numpy as np

from envs.base import Environment, World
from fntg_jax.controller import labels, layout, network
from fntg_jax.controller.controller import Controller
from fntg_jax.files import inert_json
from fntg_jax.learning import fitness
from fntg_jax.learning.rollout import outcome_of, trajectory
from fntg_jax.running.evaluation import environment_for, held_out_scenes
from fntg_jax.showing import rules

MAX_BYTES = 1_000_000  # of a page: it can be sent by mail

_FAMILIES = {
    "A": "distance to the ball",
    "B": "distance to the obstacle",
    "C": "direction of the ball",
    "D": "direction of the obstacle",
}


def record(
    title: str,
    controller: Controller,
    world: World,
    suite: str,
    indices: tuple[int, ...],
    seed: int = 0,
) -> list[dict[str, Any]]:
    """One panel for each held-out scene (numbered from 0 as `fntg evaluate` draws them).

    Args:
        title: of the panels.
        controller: who drives.
        world: `envs.base.World`.
        suite: of scenes.
        indices: numbers of the scenes.
        seed: of the scenes.

    Returns:
        Panels: title, scene, result (words), dt (s), footprint and field (m); over the time steps
        robot [x, y, heading], ball [x, y] and obstacles [[x, y, radius], ...] (m, rad; a list of
        one entry stands still); signals, inputs and bars, each with its name and values; in the
        kinematic world play, by which the page simulates again what one drags.

    Raises ValueError on an unknown suite or a negative scene.
    """
    check_scenes(indices)
    scenes = held_out_scenes(world, suite, max(indices) + 1, seed)
    scenes = jax.tree.map(lambda x: x[np.asarray(indices)], scenes)
    env = environment_for(controller, world)
    params = controller.params32
    trials = _record(params, scenes, env, controller.output)
    outcomes = jax.vmap(outcome_of)(trials.measured, trials.command, trials.failed)
    strengths = np.asarray(rules.rule_strengths(controller, trials.observation))
    trials, outcomes = jax.tree.map(np.asarray, (trials, outcomes))
    names, _ = labels.describe_labels(controller, world.field)
    panels = []
    for n, index in enumerate(indices):
        trial, outcome = jax.tree.map(lambda x, n=n: x[n], (trials, outcomes))
        panels.append(
            {
                "title": title,
                "scene": f"{suite} scene {index}",
                "result": describe_result(outcome),
                "dt": controller.control_dt,
                "footprint": list(world.footprint),
                "field": {k: v for k, v in world.field._asdict().items() if isinstance(v, float)},
                "robot": _over_time(trial.snapshot.robot),
                "ball": _over_time(trial.snapshot.ball),
                "obstacles": _over_time(trial.snapshot.obstacles),
                "signals": _signals(controller, trial.command),
                "inputs": _inputs(trial.observation),
                "bars": _bars(controller, names, trial.observation, strengths[n]),
                **_play(controller, env, jax.tree.map(lambda x, n=n: np.asarray(x[n]), scenes)),
            }
        )
    return panels


def _play(controller: Controller, env: Environment, scene: Any) -> dict[str, Any]:
    """What the page needs to simulate the trial itself, where the world is simple enough."""
    motion = getattr(env, "unicycle", None)
    if motion is None:
        return {}
    gains = network.output_gains(controller.limits, controller.output)
    params = {name: np.asarray(x).tolist() for name, x in controller.params._asdict().items()}
    play = {
        "params": params,
        "gains": [float(x) for x in gains],
        "limits": [float(x) for x in controller.limits],
        "rules": [list(rule) for rule in layout.rules(controller.layout)],
        "scene": plain_scene(scene),
        **motion,
    }
    return {"play": play}


def plain_scene(scene: Any) -> dict[str, list]:
    """One scene as the page takes it.

    Args:
        scene: `envs.base.Scene`, not batched.

    Returns:
        start [x, y, heading], ball [x, y, vx, vy], obstacles [[x, y, radius, vx, vy], ...]; m, rad
        and m/s.
    """
    still = np.zeros(2)
    ball = still if scene.ball_velocity is None else scene.ball_velocity
    walk = scene.obstacle_velocity
    walk = np.zeros((len(scene.obstacles), 2)) if walk is None else walk
    return {
        "start": np.asarray(scene.start, float).tolist(),
        "ball": np.concatenate([scene.ball, ball]).astype(float).tolist(),
        "obstacles": np.concatenate([scene.obstacles, walk], axis=1).astype(float).tolist(),
    }


def choice(world: World, suite: str, seed: int = 0, num: int = 24) -> list[dict[str, Any]]:
    """The first scenes of a suite with their names, for the page's scene picker.

    Args:
        world: `envs.base.World`.
        suite: of scenes.
        seed: of the scenes.
        num: how many.
    """
    scenes = jax.tree.map(np.asarray, held_out_scenes(world, suite, num, seed))
    return [
        {"name": f"{suite} scene {n}", **plain_scene(jax.tree.map(lambda x, n=n: x[n], scenes))}
        for n in range(num)
    ]


@partial(jax.jit, static_argnames="output")
def _record(params, scenes, env, output):
    return jax.vmap(lambda s: trajectory(params, s, env, output))(scenes)


def check_scenes(indices: tuple[int, ...]) -> None:
    """Raises ValueError unless these are numbers of scenes.

    Args:
        indices: from 0, at least one.
    """
    if not indices or min(indices) < 0 or max(indices) > 100_000:
        raise ValueError(f"scene = {list(indices)}: allowed are whole numbers from 0 to 100000")


def _over_time(values: np.ndarray) -> list:
    """Rounded to mm and mrad; one entry if nothing moves."""
    values = np.round(np.asarray(values, float), 3) + 0.0
    return (values[:1] if np.all(values == values[0]) else values).tolist()


def describe_result(outcome: Any) -> str:
    """How a trial went, in words.

    Args:
        outcome: `rollout.Outcome` of one trial.
    """
    parts = fitness.success(outcome)
    distance, clearance = float(outcome.distance[1]), float(outcome.clearance)
    speed = float(np.mean(np.abs(outcome.v)))
    near = "safe" if parts.safe else "fell" if outcome.failed else "too near an obstacle"
    return ", ".join(
        [
            f"{'success' if parts.success else 'no success'}: "
            f"ball {'reached' if parts.reach else 'not reached'} ({distance:.2f} m at step 200)",
            f"{near} ({clearance:.2f} m at least)",
            f"{'stopped' if parts.stop else 'not stopped'} ({speed:.3f} m/s)",
        ]
    )


def _signals(controller: Controller, command: Any) -> list[dict]:
    limits = controller.limits
    return [
        {"name": name, "unit": unit, "low": float(low), "high": float(high), "values": values}
        for name, unit, low, high, values in (
            ("v", "m/s", limits.v_min, limits.v_max, _over_time(command.v)),
            ("ω", "rad/s", -limits.omega_max, limits.omega_max, _over_time(command.omega)),
        )
    ]


def _inputs(seen: Any) -> list[dict]:
    rows = (("d_B", "m"), ("d_O", "m"), ("θ_B", "rad"), ("θ_O", "rad"))
    return [{"name": n, "unit": u, "values": _over_time(x)} for (n, u), x in zip(rows, seen)]


def _bars(controller: Controller, names: dict, seen: Any, strengths: np.ndarray) -> list[dict]:
    """Groups of bars in percent: four families of labels, then the rules."""

    def row(name: str, hint: str, values: np.ndarray) -> dict:
        percent = np.round(100 * np.asarray(values, float)).astype(int)
        return {"name": name, "hint": hint, "values": percent.tolist()}

    groups = []
    for (family, title), x in zip(_FAMILIES.items(), (seen[0], seen[1], seen[2], seen[3])):
        values = labels.shares(controller, family, np.asarray(x))
        rows = [row(f"{k.symbol} {k.name}", k.where, y) for k, y in zip(names[family], values)]
        groups.append({"name": title, "rows": rows})
    found = rules.rules_of(controller, names)
    rows = [
        row(
            f"{r.name} {' · '.join(_short(k.name) for k in r.labels)}",
            rules.sentence(r, controller.limits),
            strengths[:, n],
        )
        for n, r in enumerate(found)
    ]
    return [*groups, {"name": "rules (distance · obstacle · direction · side)", "rows": rows}]


def _short(name: str) -> str:
    return "any" if name.startswith("any ") else "clear" if name == "not in the way" else name


def page(
    panels: list[dict[str, Any]], title: str, scenes: list[dict[str, Any]] | None = None
) -> str:
    """The HTML page.

    Args:
        panels: of `record`, side by side.
        title: of the page.
        scenes: what its picker offers (`choice`); None for nothing.

    Raises ValueError when it would exceed `MAX_BYTES`.
    """
    template = resources.files("fntg_jax.showing").joinpath("replay.html").read_text("utf-8")
    parts = {
        "@TITLE@": html.escape(title.encode("utf-8", "replace").decode()),
        "@DATA@": inert_json({"panels": panels} | ({"scenes": scenes} if scenes else {})),
    }
    # In one pass: a title that looks like a mark stays a title.
    text = re.sub("@(TITLE|DATA)@", lambda mark: parts[mark[0]], template)
    if len(text.encode()) > MAX_BYTES:
        size = len(text.encode())
        raise ValueError(f"{len(panels)} trials make a page of {size} bytes: allowed {MAX_BYTES}")
    return text


SPEED = 4  # an animated picture runs this many times as fast as the robot
_STRIDE = 2  # every second control step is a frame


def animation(panels: list[dict[str, Any]], image_format: str, width: int = 0) -> bytes:
    """The panels as an animated picture, which ends with how the trials went.

    Args:
        panels: of `record`, side by side.
        image_format: GIF or WEBP.
        width: pixels; 0 for 420 a column.
    """
    from PIL import Image

    from fntg_jax.showing import plots

    columns = min(len(panels), math.ceil(math.sqrt(len(panels))))
    num_rows = math.ceil(len(panels) / columns)
    figure, axes = plots.new_grid(num_rows, columns, 4.2 * columns, 3.1 * num_rows)
    views = [_View(axes.flat[n], panel) for n, panel in enumerate(panels)]
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    dt = min(panel["dt"] for panel in panels)
    end = max(panel["dt"] * (len(panel["robot"]) - 1) for panel in panels)
    figure.set_dpi(100 if width == 0 else width / (4.2 * columns))
    figure.canvas.draw()
    figure.set_layout_engine("none")  # or every frame is laid out anew, ten times slower
    frames = []
    for time in [*np.arange(0, end + dt / 2, dt * _STRIDE), None]:
        for view in views:
            view.conclude() if time is None else view.show(time)
        figure.canvas.draw()
        frames.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()))
    return encode(frames, dt * _STRIDE / SPEED, image_format)


MOST_FILM_BYTES = 3_000_000


def encode(frames: list[Any], dt: float, image_format: str) -> bytes:
    """Pictures as an endless animation.

    Args:
        frames: PIL pictures.
        dt: s, of each.
        image_format: GIF or WEBP.
    """
    for stride, scale in ((1, 1.0), (2, 1.0), (3, 1.0), (3, 0.75), (4, 0.5), (6, 0.35)):
        data = _encoded([*frames[:-1:stride], frames[-1]], dt * stride, image_format, scale)
        if len(data) <= MOST_FILM_BYTES:
            break
    return data


def _encoded(frames: list[Any], dt: float, image_format: str, scale: float) -> bytes:
    if scale < 1:
        size = tuple(round(scale * side) for side in frames[0].size)
        frames = [frame.resize(size) for frame in frames]
    if image_format == "GIF":
        frames = [frame.quantize(64) for frame in frames]
    out = io.BytesIO()
    frames[0].save(
        out,
        format=image_format,
        save_all=True,
        append_images=frames[1:],
        duration=[round(1000 * dt)] * (len(frames) - 1) + [2000],
        loop=0,
    )
    return out.getvalue()


class _View:
    """One panel on matplotlib axes; `show` moves what moves."""

    def __init__(self, axes: Any, panel: dict[str, Any]):
        from matplotlib.patches import Circle, Polygon

        from fntg_jax.showing import plots

        self.panel = panel
        field = panel["field"]
        plots.draw_field(axes, type("Field", (), field))
        self.robots = np.asarray(panel["robot"])
        axes.plot(*self.robots[:, :2].T, color="0.8", linewidth=1, linestyle=":")
        (self.path,) = axes.plot([], [], color=plots.BLUE, linewidth=1.8)
        self.body = axes.add_patch(Polygon(np.zeros((5, 2)), color=plots.BLUE, alpha=0.8))
        self.ball = axes.add_patch(Circle((0, 0), field["ball_radius"], color=plots.RED, zorder=5))
        self.discs = []
        for _, _, radius in panel["obstacles"][0]:
            disc = axes.add_patch(Circle((0, 0), radius, color="0.45"))
            ring = Circle(
                (0, 0), radius + fitness.CLEARANCE, fill=False, color="0.6", linestyle=":"
            )
            self.discs.append((disc, axes.add_patch(ring)))
        axes.set_title(f"{panel['title'][-40:]}\n{panel['scene']}", fontsize=8, loc="left")
        # A bar of half a metre instead of axes: their text would cost most of a frame's time.
        axes.set_axis_off()
        reach, half = field["length"] / 2 + field["goal_depth"], field["width"] / 2
        axes.set(xlim=(-reach - 0.05, reach + 0.05), ylim=(-half - 0.35, half + 0.05))
        axes.plot([reach - 0.5, reach], [-half - 0.1] * 2, color="0.3", linewidth=2)
        axes.text(reach - 0.25, -half - 0.3, "0.5 m", fontsize=8, ha="center")
        self.words = axes.text(-reach, -half - 0.34, "", fontsize=8, va="bottom")

    def conclude(self) -> None:
        """How it went, instead of the numbers of a step."""
        result = self.panel["result"]
        self.words.set_text(textwrap.fill(result, 52))
        self.words.set_color("#006b4f" if result.startswith("success") else "#a03c00")

    def show(self, time: float) -> None:
        step = min(round(time / self.panel["dt"]), len(self.robots) - 1)
        x, y, heading = self.robots[step]
        self.path.set_data(*self.robots[: step + 1, :2].T)
        half, width = (x / 2 for x in self.panel["footprint"])
        nose = half / 2
        outline = [(-half, -width), (nose, -width), (half, 0), (nose, width), (-half, width)]
        c, s = math.cos(heading), math.sin(heading)
        self.body.set_xy(np.array(outline) @ np.array([[c, s], [-s, c]]) + (x, y))
        ball, obstacles = self.panel["ball"], self.panel["obstacles"]
        self.ball.center = tuple(ball[min(step, len(ball) - 1)])
        for pair, (ox, oy, _) in zip(self.discs, obstacles[min(step, len(obstacles) - 1)]):
            for circle in pair:
                circle.center = (ox, oy)
        v, omega = (s["values"][min(step, len(s["values"]) - 1)] for s in self.panel["signals"])
        words = f"{time:4.1f} s    v = {v:.2f} m/s    ω = {omega:+.2f} rad/s    ({SPEED}x)"
        self.words.set_text(words)
