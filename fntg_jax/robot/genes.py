"""The numbers that a team is made of: what a person can change, and what evolution does.

A table of name, unit, range, default and meaning.  A genome codes each gene as the paper does, 15
bits over its range (`fntg_jax.controller.genome`, whose (-5, 5) is mapped onto low .. high).
"""

from typing import NamedTuple

from jaxtyping import Array, Float


class Gene(NamedTuple):
    """A line of the table; low, high and default in the unit."""

    name: str
    unit: str
    low: float
    high: float
    default: float
    meaning: str


# Defaults are by hand (assumed), before any evolution.
GENES = (
    Gene("ball_forgotten", "s", 0.5, 15.0, 5.0, "age from which the ball counts as lost"),
    Gene("word_trusted", "s", 0.0, 10.0, 4.0, "age up to which a teammate's ball is believed"),
    Gene("mate_forgotten", "s", 0.5, 20.0, 6.0, "silence after which a teammate is not counted"),
    Gene("search_turn", "rad", 0.0, 1.5, 0.6, "how far off a ball is sought when it is lost"),
    Gene("near", "m", 0.15, 0.8, 0.32, "distance from which the ball is aligned with the goal"),
    Gene("behind", "m", 0.05, 0.6, 0.28, "how far behind the ball it is approached"),
    Gene("straight_on", "rad", 0.05, 1.5, 0.5, "misalignment below which the ball is gone for"),
    Gene("aligned", "rad", 0.05, 1.2, 0.30, "misalignment below which the ball is pushed on"),
    Gene("kick_gain", "m", 0.0, 3.0, 0.5, "way to the goal that a kick has to save"),
    Gene("post", "m", 0.0, 0.3, 0.08, "distance from the posts at which a shot is aimed"),
    Gene("lane", "m", 0.0, 0.5, 0.15, "room beside a shot's way that makes a goal open"),
    Gene("at_wall", "m", 0.05, 0.3, 0.12, "distance within which the ball lies at a wall"),
    Gene("wall_angle", "rad", 0.0, 1.5, 0.8, "how far into the wall it is kicked there"),
    Gene("wall_loss", "m", 0.0, 2.0, 0.4, "way to the goal that such a kick may lose"),
    Gene("hold", "s", 0.5, 5.0, 2.4, "time at the chest after which a ball is left"),
    Gene("kickoff", "m", 0.3, 1.0, 0.48, "distance at which the others' kick-off is awaited"),
    Gene("dribble", "m", 0.1, 2.0, 0.6, "distance that the ball is pushed at a time"),
    Gene("commit", "m", 0.0, 1.0, 0.25, "lead that an attacker keeps over a teammate"),
    Gene("turn_cost", "m/rad", 0.0, 1.0, 0.12, "what a misalignment costs in the choice of roles"),
    Gene("support_behind", "m", -0.5, 1.5, 0.55, "how far behind the ball the supporter waits"),
    Gene("support_aside", "m", 0.0, 1.0, 0.45, "how far to the side of it"),
    Gene("support_near", "m", 0.05, 0.6, 0.20, "distance from its place within which it stands"),
    Gene("keeper_line", "m", 0.05, 0.8, 0.16, "distance of the goalkeeper from its goal line"),
    Gene("keeper_side", "1", 0.0, 1.5, 0.35, "share of the ball's side that it follows"),
    Gene("keeper_near", "m", 0.02, 0.5, 0.10, "distance from its place within which it stands"),
    Gene("keeper_out", "m", 0.1, 1.5, 0.55, "distance of the ball at which it comes out"),
    Gene("keeper_home", "m", 0.2, 1.5, 0.75, "distance from the own goal within which it does"),
    Gene("save_speed", "m/s", 0.02, 1.5, 0.15, "speed of the ball towards it at which it saves"),
    Gene("spread_time", "s", 0.0, 2.0, 0.7, "time to the ball's arrival at which it spreads"),
    Gene("obstacle_cap", "m", 0.15, 2.0, 0.6, "distance from which obstacles are left out"),
    Gene("obstacle_side", "m", 0.05, 1.0, 0.24, "how far beside the way an obstacle counts"),
    Gene("obstacle_trust", "s", 0.1, 10.0, 3.0, "age up to which a robot on the map is avoided"),
    Gene("wall", "m", 0.05, 0.4, 0.16, "distance from the wall that a place to go to keeps"),
    Gene("glance", "s", 0.5, 10.0, 2.5, "time between glances at landmarks"),
)


class Genes(NamedTuple):
    """Values of `GENES`, in the table's units."""

    ball_forgotten: Float[Array, ""] | float
    word_trusted: Float[Array, ""] | float
    mate_forgotten: Float[Array, ""] | float
    search_turn: Float[Array, ""] | float
    near: Float[Array, ""] | float
    behind: Float[Array, ""] | float
    straight_on: Float[Array, ""] | float
    aligned: Float[Array, ""] | float
    kick_gain: Float[Array, ""] | float
    post: Float[Array, ""] | float
    lane: Float[Array, ""] | float
    at_wall: Float[Array, ""] | float
    wall_angle: Float[Array, ""] | float
    wall_loss: Float[Array, ""] | float
    hold: Float[Array, ""] | float
    kickoff: Float[Array, ""] | float
    dribble: Float[Array, ""] | float
    commit: Float[Array, ""] | float
    turn_cost: Float[Array, ""] | float
    support_behind: Float[Array, ""] | float
    support_aside: Float[Array, ""] | float
    support_near: Float[Array, ""] | float
    keeper_line: Float[Array, ""] | float
    keeper_side: Float[Array, ""] | float
    keeper_near: Float[Array, ""] | float
    keeper_out: Float[Array, ""] | float
    keeper_home: Float[Array, ""] | float
    save_speed: Float[Array, ""] | float
    spread_time: Float[Array, ""] | float
    obstacle_cap: Float[Array, ""] | float
    obstacle_side: Float[Array, ""] | float
    obstacle_trust: Float[Array, ""] | float
    wall: Float[Array, ""] | float
    glance: Float[Array, ""] | float


DEFAULTS = Genes(*(gene.default for gene in GENES))


def check(genes: Genes) -> None:
    """Raises ValueError naming the gene, its value and its range."""
    for gene, value in zip(GENES, genes):
        if not gene.low <= float(value) <= gene.high:
            raise ValueError(
                f"gene {gene.name} = {value}: allowed are {gene.low} to {gene.high} {gene.unit}"
            )
