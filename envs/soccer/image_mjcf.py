"""The field of `envs.soccer.image` for MuJoCo: the same parts, drawn by a renderer of others.

Text only: whoever calls this brings MuJoCo.
"""

import math

from envs.base import Camera, Field
from envs.field import FIELD
from envs.soccer import image


def _colour(paint: str) -> str:
    return " ".join(f"{c:.4f}" for c in image.PAINT[paint]) + " 1"


def _geom(name: str, kind: str, place, size, paint: str) -> str:
    words = (" ".join(f"{v:.6f}" for v in values) for values in (place, size))
    place, size = words
    return (
        f'<geom name="{name}" type="{kind}" pos="{place}" size="{size}" rgba="{_colour(paint)}"/>'
    )


def mjcf(num_robots: int, camera: Camera = Camera(), field: Field = FIELD) -> str:
    """A model with movable `ball`, `robot0` ... and camera `eye` (mocap bodies in this order).

    A geom's name is its object's name in `image.NAMES` (or robot0, ...), a colon and a number.
    """
    geoms: list[str] = []

    def add(owner: str, *rest) -> None:
        geoms.append(_geom(f"{owner}:{len(geoms)}", *rest))

    x, y = 0.5 * field.length, 0.5 * field.width
    # Flat parts lie a fraction of a millimetre above each other.
    add("floor", "plane", (0, 0, -0.001), (image.HALL, image.HALL, 1), "ground")
    add("floor", "box", (0, 0, -0.0005), (x, y, 0.0005), "carpet")
    for s in (-1, 1):
        middle = (s * (x + 0.5 * field.goal_depth), 0, -0.0005)
        add(
            "floor",
            "box",
            middle,
            (0.5 * field.goal_depth, 0.5 * field.goal_width, 0.0005),
            "carpet",
        )
    for (cx, cy), (hx, hy) in image.lines(field):
        add("floor", "box", (cx, cy, 0.0), (hx, hy, 0.0003), "line")
    chords = 48
    for n in range(chords):
        angle = 2 * math.pi * n / chords
        half = image.CIRCLE * math.tan(math.pi / chords)
        place = f"{image.CIRCLE * math.cos(angle):.6f} {image.CIRCLE * math.sin(angle):.6f} 0"
        geoms.append(
            f'<geom name="floor:{len(geoms)}" type="box" pos="{place}" rgba="{_colour("line")}"'
            f' euler="0 0 {angle:.6f}" size="{0.5 * field.line_width} {half:.6f} 0.0003"/>'
        )
    paints = dict(zip(("goal-", "goal+"), field.goal_colours))
    for name, low, high in image.boxes(field):
        centre = [0.5 * (a + b) for a, b in zip(low, high)]
        half_sizes = [0.5 * (b - a) for a, b in zip(low, high)]
        add(name, "box", centre, half_sizes, paints.get(name, "wall"))
    foot, band = field.landmark_foot, field.landmark_band
    for n, mark in enumerate(field.landmarks):
        bands = ((0.0, foot, "white"), (foot, foot + band, mark.lower))
        for bottom, top, paint in (*bands, (foot + band, foot + 2 * band, mark.upper)):
            spot = (mark.x, mark.y, 0.5 * (bottom + top))
            size = (field.landmark_radius, 0.5 * (top - bottom))
            add(f"landmark{n}", "cylinder", spot, size, paint)
    world = "\n".join(geoms)
    bodies = [
        f'<body name="ball" mocap="true">'
        f"{_geom('ball:0', 'sphere', (0, 0, 0), (field.ball_radius,), 'ball')}</body>"
    ]
    for n in range(num_robots):
        parts = "".join(
            _geom(f"robot{n}:{k}", "box", centre, half, "red" if uniform else "silver")
            for k, (centre, half, uniform) in enumerate(image.ROBOT)
        )
        bodies.append(f'<body name="robot{n}" mocap="true">{parts}</body>')
    across = 0.5 * camera.width / math.tan(camera.horizontal / 2)
    down = 0.5 * camera.height / math.tan(camera.vertical / 2)
    # Pixels that are not square: focal lengths of their own, on a sensor of one unit a pixel.
    lens = (
        f'resolution="{camera.width} {camera.height}" focalpixel="{across:.5f} {down:.5f}"'
        f' sensorsize="{camera.width / 1000} {camera.height / 1000}"'
    )
    sun = " ".join(str(-v) for v in image.SUN)
    ambient = " ".join([str(image.AMBIENT)] * 3)
    diffuse = " ".join([f"{1 - image.AMBIENT:.4f}"] * 3)
    room = " ".join(str(c) for c in image.PAINT["room"])
    return f"""<mujoco model="field">
  <compiler angle="radian"/>
  <visual>
    <global offwidth="640" offheight="480"/>
    <headlight ambient="{ambient}" diffuse="0 0 0" specular="0 0 0"/>
    <map znear="0.005" zfar="60"/>
    <quality shadowsize="2048"/>
  </visual>
  <statistic extent="1" center="0 0 0"/>
  <asset>
    <texture name="room" type="skybox" builtin="flat" width="64" height="64"
      rgb1="{room}" rgb2="{room}"/>
  </asset>
  <worldbody>
    <light name="sun" directional="true" dir="{sun}" pos="1 0.7 2.5" castshadow="true"
      ambient="0 0 0" specular="0 0 0" diffuse="{diffuse}"/>
    {world}
    {"".join(bodies)}
    <body name="eye" mocap="true"><camera name="eye" {lens}/></body>
  </worldbody>
</mujoco>"""
