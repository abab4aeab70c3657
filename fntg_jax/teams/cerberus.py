"""`cerberus`: the robots of the paper's Figure 3, which play from what they see, feel and hear.

What evolution and people change is a team file (`team_file`): the planner's genes and BIOA.
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp

from fntg_jax import robot
from fntg_jax.controller.controller import Controller
from fntg_jax.learning.play import Belief, Side, Words
from fntg_jax.robot import behaviors, colours, planner, sight, vision
from fntg_jax.robot.genes import Genes
from fntg_jax.robot.geometry import angle
from fntg_jax.teams import team_file

SHIPPED = Path(__file__).parent.parent / "data" / "cerberus.json"


def make(match: Any, side: int, path: str | Path = SHIPPED) -> Side:
    """The team of a file for a match (its bodies' tables and field) on a side, 0 home or 1 away.

    Raises ValueError (one line) when the file cannot be read or is not valid.
    """
    file = team_file.load(path)
    team = of(file.genes, file.bioa, match, side, file.goalkeeper)
    words = Words(planner.ROLES, ("", *behaviors.NAMES), tuple(planner.in_words(file.genes)))
    return Side(file.name, team, robot.begin, robot.control, believe=_believe, words=words)


def of(
    genes: Genes, bioa: Controller, match: Any, side: int, goalkeeper: bool = True
) -> robot.Team:
    """Genes and BIOA with the tables of the body that they drive and the map of the field."""
    body, field = match.bodies[side], match.field
    styles, kicks, postures = body.styles, body.kicks, body.postures.name
    # A body with fewer styles walks in its first where one of Sony's is asked for.
    rows = [styles.name.index(name) if name in styles.name else 0 for name in behaviors.STYLES]
    column = lambda values: jnp.asarray([values[row] for row in rows], jnp.float32)  # noqa: E731
    zone = jnp.asarray(kicks.zone, jnp.float32).reshape(-1, 4).T
    speed = jnp.asarray(kicks.speed, jnp.float32)
    reach = speed * speed / (2 * match.rolling.deceleration)
    posture = lambda name: jnp.int32(postures.index(name) + 1 if name in postures else 0)  # noqa: E731
    return robot.Team(
        genes=Genes(*(jnp.float32(value) for value in genes)),
        bioa=bioa,
        speeds=behaviors.Speeds(*map(column, (styles.forward, styles.lateral, styles.turn))),
        kicks=planner.Kicks(jnp.asarray(kicks.direction, jnp.float32), speed, reach, *zone),
        get_up=posture("get-up"),
        spread=posture("spread"),
        map=jnp.asarray([(mark.x, mark.y) for mark in field.landmarks], jnp.float32),
        ground=planner.Ground(
            *(jnp.float32(0.5 * x) for x in (field.length, field.width, field.goal_width))
        ),
        sizes=sight.sizes_of(
            field.ball_radius, field.landmark_foot, field.landmark_band, field.goal_height
        ),
        goalkeeper=jnp.asarray(goalkeeper),
        table=colours.load("ers210") if match.camera == "image" else None,
        bands=vision.bands(field) if match.camera == "image" else None,
        voice=jnp.int32(side) if match.sound == "audio" else None,
        places=jnp.asarray([match.rules.kickoff_own, match.rules.kickoff_theirs], jnp.float32),
    )


def _believe(team, memory) -> Belief:
    b, around = memory.belief, memory.map
    x, y = around.distance[0] * around.cos[0], around.distance[0] * around.sin[0]
    known = around.age[0] < team.genes.ball_forgotten
    ball = jnp.stack([b.x + b.cos * x - b.sin * y, b.y + b.sin * x + b.cos * y])
    return Belief(
        pose=jnp.stack([b.x, b.y, angle(b.cos, b.sin)]),
        ball=jnp.where(known, ball, jnp.nan),
        ball_age=around.age[0],
        role=memory.role,
        behavior=memory.order.behavior,
        rule=memory.rule,
    )
