"""Configuration of a learning run: fields, presets, checks.

What its names stand for (world, suite, task) is looked up in `problem.resolve`.
"""

import dataclasses
from typing import Any, Literal

from fntg_jax.controller import network
from fntg_jax.controller.layout import get_layout
from fntg_jax.learning import bounds, ga
from fntg_jax.learning.bounds import bounded
from fntg_jax.learning.fitness import PaperWeights, SmoothWeights
from fntg_jax.learning.ga import GAConfig
from fntg_jax.learning.objective import POOL

MOST_SCENES = 1_000_000  # 0.1 GB; a pool of a few thousand does


class Options(dict[str, float]):
    """Options by name that cannot be changed: with them a configuration has a hash, and copies of
    it share nothing that moves."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise TypeError(
            "options of a configuration do not change: dataclasses.replace makes another"
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple:  # copies and pickles are made at once, not item by item
        return Options, (dict(self),)

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """One learning run, or several that differ in their seed.

    Those from env to objective, the weights, refine_scenes, refine_rate and refine_top are of task
    bioa alone.

    Attributes:
        task: what is learnt, by its entry point name: bioa (the paper's), gait, ...
        task_options: options of that task by name.
        env: world, by its entry point name.
        env_options: options of that world by name, e.g. dt 0.05 v_max 0.25.
        layout: gene table: paper-31, three-sigma-31, two-sigma-31, mirror-28, reduced-47,
            full-63.
        output: "scale": a gene of 5 is full speed; "clip": genes are m/s and rad/s.
        suite: training scenes: a suite, or several with their shares, open:2,blocked:3.
        num_scenes: trials of a genome; their average counts.
        scene_pool: 0: the same scenes in every generation; else as many scenes are drawn and
            every generation takes num_scenes of them at random.
        objective: "paper": the paper's fitness; "smooth": log-scaled and gated.
        seeds: number of independent runs.
        first_seed: seed of the first; the others follow.
        generations: populations evaluated.
        warm_start: run folder or parameter file with the same genes to start from instead of random
            populations (of bioa: with the same layout, of any world).
        initial: first population: "uniform": any genome; "partition": where the genes say:
            membership functions that divide the range of their input, as fuzzy tools start from; a
            team's genes near those by hand.
        ga: genetic algorithm.
        refine_steps: steps of refinement after evolution; 0 for none.
        refine_method: "gradient": reverse mode and Adam; "cma": covariance matrix adaptation.
        refine_scenes: scenes of a step, where scenes are fresh; 0 for num_scenes.
        refine_rate: learning rate of the gradient (Adam, cosine decay), genes a step.
        refine_top: individuals of a seed that are refined; the best validated one is kept (cma:
            goes on after a third of the steps).
        fitness: weights of the paper's fitness.
        smooth: weights of the smooth objective.
    """

    task: str = "bioa"
    task_options: dict[str, float] = dataclasses.field(default_factory=Options)
    env: str = "kinematic"
    env_options: dict[str, float] = dataclasses.field(default_factory=Options)
    layout: str = "paper-31"
    output: network.Output = "scale"
    suite: str = "paper"
    num_scenes: int = bounded(4, 1, MOST_SCENES)
    scene_pool: int = bounded(0, 0, MOST_SCENES)
    objective: Literal["paper", "smooth"] = "paper"
    seeds: int = bounded(1, 1, 2**32)
    first_seed: int = bounded(0, 0, 2**32 - 1)
    generations: int = bounded(95, 1, 1_000_000)
    warm_start: str = ""
    initial: Literal["uniform", "partition"] = "uniform"
    ga: GAConfig = GAConfig()
    refine_steps: int = bounded(0, 0, 1_000_000)
    refine_method: Literal["gradient", "cma"] = "gradient"
    refine_scenes: int = bounded(0, 0, MOST_SCENES)
    refine_rate: float = bounded(0.003, 0, 1, above=True)
    refine_top: int = bounded(4, 1, 16)
    fitness: PaperWeights = PaperWeights()
    smooth: SmoothWeights = SmoothWeights()

    def __post_init__(self) -> None:
        for name in ("task_options", "env_options"):
            if isinstance(value := getattr(self, name), dict):  # else refused later, by name
                object.__setattr__(self, name, Options(value))


PRESETS = {
    # Faithful to the paper, Section "Genetic learning".
    "paper": TrainConfig(),
    # For scenes never seen in training, with balls at walls and near obstacles: a controller
    # trained at 0.30 and 0.35 m comes to 78 % of moving-anywhere, this to 98 % (docs/suites.md).
    "robust": TrainConfig(
        output="clip",
        suite=(
            "open/wall=0.06/obstacle=0.2:1,blocked/wall=0.06/obstacle=0.2:2,"
            "moving-ball/wall=0.06/obstacle=0.2:2"
        ),
        num_scenes=32,
        scene_pool=POOL,
        objective="smooth",
        generations=200,
        initial="partition",
        ga=GAConfig(
            population=512,
            gray=True,
            selection="tournament",
            tournament_size=4,
            num_islands=8,
            mutation_rate=0.015,
            mutation_decay=0.13,
            crossover_rate=0.9,
            num_elites=2,
        ),
        refine_steps=1000,
        refine_method="cma",
        refine_scenes=64,
        refine_top=2,
    ),
    # The paper's population and generations on whole matches (docs/team.md).
    "team": TrainConfig(
        task="team",
        initial="partition",
        ga=GAConfig(
            gray=True,
            selection="tournament",
            tournament_size=3,
            mutation_rate=0.01,
            mutation_decay=0.3,
            crossover_rate=0.9,
            num_elites=2,
        ),
        refine_method="cma",
    ),
}


def validate(config: TrainConfig) -> None:
    """Check a configuration's values at the edge; names of members are not looked up here.

    Args:
        config: of a run.

    Raises ValueError: field, value, what is allowed.
    """
    bounds.check(config)
    for name in ("task_options", "env_options"):
        for key, value in getattr(config, name).items():
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise ValueError(f"{name}.{key} = {value!r}: allowed are numbers")
    if config.first_seed + config.seeds > 2**32:
        raise ValueError(
            f"first_seed = {config.first_seed}: allowed are 0 to {2**32 - config.seeds} for "
            f"{config.seeds} seeds"
        )
    get_layout(config.layout)
    ga.validate(config.ga)
    bounds.check(config.fitness, "fitness")
    bounds.check(config.smooth, "smooth")
    if 0 < config.scene_pool < config.num_scenes:
        raise ValueError(
            f"scene_pool = {config.scene_pool}: allowed are 0 and numbers from num_scenes = "
            f"{config.num_scenes} to {MOST_SCENES}"
        )
    if config.refine_steps and config.refine_top > min(16, config.ga.population):
        raise ValueError(
            f"refine_top = {config.refine_top}: allowed are 1 to {min(16, config.ga.population)}"
        )


def from_dict(data: Any) -> TrainConfig:
    """A checked configuration from plain values.

    Args:
        data: nested as `dataclasses.asdict` nests; what is left out has its default.

    Raises ValueError: field, value, what is allowed.
    """
    config = _from_dict(TrainConfig(), data)
    validate(config)
    return config


def _from_dict(default: Any, data: Any) -> Any:
    name = type(default).__name__
    if isinstance(data, type(default)):
        return data
    if not isinstance(data, dict):
        raise ValueError(
            f"{name} is {type(data).__name__}: allowed is {name} or its fields by name"
        )
    unknown = sorted(set(data) - {f.name for f in dataclasses.fields(default)})
    if unknown:
        known = ", ".join(f.name for f in dataclasses.fields(default))
        raise ValueError(f"{unknown[0]!r}: unknown; known are {known}")
    values = {}
    for field, value in data.items():
        before = getattr(default, field)
        if dataclasses.is_dataclass(before):
            value = _from_dict(before, value)
        elif not isinstance(value, _kind(before)) or isinstance(value, bool) != isinstance(
            before, bool
        ):
            raise ValueError(f"{field} = {value!r}: allowed is {_kind(before)[0].__name__}")
        values[field] = value
    return dataclasses.replace(default, **values)


def _kind(value: Any) -> tuple[type, ...]:
    """What may stand in place of a value."""
    if isinstance(value, dict):
        return (dict,)
    return (float, int) if isinstance(value, float) else (type(value),)
