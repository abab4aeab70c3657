"""Evolve a kick's key frames with our genetic algorithm.

    python -m experiments.evolve_motion forward --generations 60 --out forward.json

A kick is a few poses; set-points go from one to the next as fast as Sony's joint speeds allow,
wait there, and come back to a stand.  Fitness, in MuJoCo's C code and the full model: the ball's
speed in the wanted direction over places up to 2 cm and 0.2 rad off, what it strays to the side, a
dog that does not stand at the end.  Right is the mirror image of left.
"""

import dataclasses
import json
import math
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.running import xla


class Kind(NamedTuple):
    """What a kick is made of.  angle: wanted direction, rad.  poses: how many.  joints: genes of a
    pose; an entry of several names is one gene for all of them (a pair of legs).  base: joint ->
    angle (rad) in each pose, the middle of the first population.  ball: x, y (m) and how far genes
    may move it."""

    angle: float
    poses: int
    joints: tuple[tuple[str, ...], ...]
    base: dict[str, tuple[float, ...]]
    ball: tuple[float, float, float, float]


_PAIRS = tuple((f"l{end}_j{j}", f"r{end}_j{j}") for end in "fh" for j in (1, 2, 3))
_EACH = tuple((f"{leg}_j{j}",) for leg in ("lf", "rf", "lh", "rh") for j in (1, 2, 3))
_HEAD = (("head_tilt",), ("head_pan",))
KINDS = {
    "forward": Kind(
        0.0,
        3,
        (*_PAIRS, ("head_tilt",)),
        {
            "lf_j1": (0.7, 0.7, 1.5),
            "lf_j2": (-0.19, -0.19, -0.19),
            "lf_j3": (0.6, 0.3, -0.3),
            "lh_j1": (-1.0, -1.0, -1.25),
            "lh_j3": (1.3, 1.3, 1.9),
        },
        (0.165, 0.0, 0.03, 0.0),
    ),
    "left": Kind(
        math.pi / 2,
        2,
        (*_EACH, *_HEAD),
        {
            "rf_j1": (1.3, 1.3),
            "rf_j2": (0.5, -0.19),
            "rf_j3": (0.0, 0.0),
            "lf_j1": (0.3, 0.3),
            "lf_j3": (0.8, 0.8),
        },
        (0.15, -0.02, 0.04, 0.05),
    ),
    "head": Kind(
        math.pi / 2,
        2,
        (*_PAIRS, *_HEAD),
        {
            "head_tilt": (-1.3, -1.3),
            "head_pan": (-1.2, 1.2),
            "lf_j1": (-0.6, -0.6),
            "lf_j3": (1.5, 1.5),
        },
        (0.17, 0.02, 0.03, 0.05),
    ),
}
SIGMA = 0.8  # of the first population's genes, which live in [-5, 5]
PLACES = 5  # of the ball for a genome


@dataclasses.dataclass(frozen=True)
class Config:
    """What to evolve.

    Attributes:
        kick: which.
        generations: of them.
        population: genomes; even.
        seed: of everything random.
        out: the motion's JSON.
    """

    kick: tyro.conf.Positional[Literal["forward", "left", "head"]] = "forward"
    generations: int = 60
    population: int = 48
    seed: int = 0
    out: Path = Path("motion.json")


def num_genes(kind: Kind) -> int:
    """Genes: poses, a wait after the first and after the last, the ball's place."""
    return kind.poses * len(kind.joints) + 4


def start_of(kind: Kind, standing: np.ndarray) -> np.ndarray:
    """The genes of `Kind.base`."""
    from envs.quadruped import motions

    genes = np.zeros(num_genes(kind))
    for pose in range(kind.poses):
        for n, names in enumerate(kind.joints):
            j = motions.JOINTS.index(names[0])
            angle = kind.base[names[0]][pose] if names[0] in kind.base else standing[j]
            share = (angle - motions.LOW[j]) / (motions.HIGH[j] - motions.LOW[j])
            genes[pose * len(kind.joints) + n] = 10 * share - 5
    return np.clip(genes, -5, 5)


def decode(kind: Kind, genes: np.ndarray, standing: np.ndarray):
    """Frames [(time, point [17])], the time at which the last pose is reached, the ball's place."""
    from envs.quadruped import motions

    share = (np.asarray(genes, float) + 5) / 10
    point, time, frames = standing.copy(), 0.0, []
    waits = np.zeros(kind.poses)
    waits[0], waits[-1] = 0.05 + 0.4 * share[-4], 0.1 + 0.2 * share[-3]
    strike = 0.0
    for pose in range(kind.poses):
        new = point.copy()
        for n, names in enumerate(kind.joints):
            for name in names:
                j = motions.JOINTS.index(name)
                low, high = motions.LOW[j], motions.HIGH[j]
                new[j] = low + share[pose * len(kind.joints) + n] * (high - low)
        took = max(0.02, float(np.max(np.abs(new - point) / motions.SPEED))) * 1.01
        # Rounded as in the file, times up.
        inside = np.ceil(motions.LOW * 1e4) / 1e4, np.floor(motions.HIGH * 1e4) / 1e4
        time, point = math.ceil((time + took) * 1000) / 1000, np.clip(np.round(new, 4), *inside)
        strike = time
        frames.append((time, point))
        if waits[pose]:
            time = round(time + waits[pose], 3)
            frames.append((time, point))
    took = 1.5 * float(np.max(np.abs(standing - point) / motions.SPEED)) + 0.3
    frames.append((math.ceil((time + took) * 1000) / 1000, standing))
    x, y, dx, dy = kind.ball
    ball = np.array([x + dx * (2 * share[-2] - 1), y + dy * (2 * share[-1] - 1)])
    return frames, strike, np.round(ball, 4)


def document(kind: Kind, genes: np.ndarray, standing: np.ndarray, origin: str) -> str:
    """The motion's file."""
    from envs.quadruped import motions

    frames, strike, ball = decode(kind, genes, standing)
    rows = [
        {
            "time": time,
            "joints": {
                name: round(float(point[motions.JOINTS.index(name)]), 4)
                for names in kind.joints
                for name in names
            },
        }
        for time, point in frames[:-1]
    ]
    rows.append({"time": frames[-1][0], "joints": {}})
    file = {"format": "fntg-motion", "version": 1, "kind": "kick", "origin": origin}
    file |= {"ball": ball.tolist(), "strike": strike, "frames": rows}
    return json.dumps(file, indent=1, allow_nan=False) + "\n"


def costs(env, kind: Kind, population: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Costs [P], in m/s, of genomes."""
    from envs.quadruped import motions

    standing = motions.standing(env)
    decoded = [decode(kind, genes, standing) for genes in population]
    paths = []
    for frames, strike, _ in decoded:
        times = np.array([0.0, *(t for t, _ in frames)])
        path = np.array([standing, *(p for _, p in frames)])
        paths.append(
            motions.set_points(motions.Motion("", times, path, strike), env.solver.timestep)
        )
    length = max(map(len, paths))
    points = np.array([np.pad(p, ((0, length - len(p)), (0, 0)), "edge") for p in paths])
    points = np.repeat(points, PLACES, axis=0)
    noise = np.random.default_rng(rng.integers(2**31))
    balls = np.concatenate([motions.displaced(noise, ball, PLACES) for *_, ball in decoded])
    still = np.repeat(points[:, -1:], 2 * env.solver.substeps, axis=1)
    found = motions.play(
        env, np.concatenate([points, still], axis=1), motions.start(env, len(balls), balls)
    )
    end, v = found.qpos[-1], found.qvel[-1][:, motions.BALL_V : motions.BALL_V + 2]
    along = v @ [math.cos(kind.angle), math.sin(kind.angle)]
    across = v @ [-math.sin(kind.angle), math.cos(kind.angle)]
    fell = (1 - 2 * (end[:, 4] ** 2 + end[:, 5] ** 2) < 0.8) | ~(end[:, 2] > 0.06)
    cost = -along + 0.5 * np.abs(across) + 1.0 * fell + np.maximum(found.speed - 1.2, 0)
    cost = np.nan_to_num(cost, nan=9.0).reshape(len(population), PLACES)
    # Nine of ten shall be good, not the mean.
    return cost.mean(1) + 0.5 * cost.std(1)


def evolve(env, config: Config) -> tuple[np.ndarray, float]:
    """The best genes of the last population, judged on 30 places, and their cost."""
    from envs.quadruped import motions
    from fntg_jax.learning.ask_tell import GeneticAlgorithm
    from fntg_jax.learning.ga import GAConfig

    kind = KINDS[config.kick]
    genes = num_genes(kind)
    settings = GAConfig(
        selection="tournament", tournament_size=3, gray=True, mutation_rate=0.01, num_elites=2
    )
    ga = GeneticAlgorithm(config.population, jnp.zeros(genes), settings, config.generations)
    rng = np.random.default_rng(config.seed)
    base = start_of(kind, motions.standing(env))
    first = base + SIGMA * rng.normal(size=(config.population, genes))
    first[0] = base
    population = jnp.asarray(np.clip(first, -5, 5), jnp.float32)
    key = jax.random.key(config.seed)
    params = ga.default_params
    value = partial(costs, env, kind, rng=rng)
    state = ga.init(key, population, jnp.asarray(value(np.asarray(population))), params)
    for n in range(config.generations):
        k_ask, k_tell = jax.random.split(jax.random.fold_in(key, n))
        population, state = ga.ask(k_ask, state, params)
        found = value(np.asarray(population))
        state, _ = ga.tell(k_tell, population, jnp.asarray(found), state, params)
        print(f"generation {n + 1}/{config.generations}  best {-found.min():.3f} m/s", flush=True)
    last = np.asarray(population)
    best = last[np.argsort(found)[:8]]
    again = np.mean([value(best) for _ in range(6)], axis=0)
    return best[np.argmin(again)], float(again.min())


def main(argv: list[str] | None = None) -> None:
    config = script.options(Config, Config.__doc__, "experiments/evolve_motion.py", argv)
    try:
        script.check_files(config, "out")
        script.check_least(config, generations=1, population=2, seed=0)
        xla.configure()
        from envs.quadruped import make, motions

        env = make()
        genes, cost = evolve(env, config)
        origin = (
            f"experiments.evolve_motion {config.kick} --generations {config.generations}"
            f" --population {config.population} --seed {config.seed}"
        )
        text = document(KINDS[config.kick], genes, motions.standing(env), origin)
        config.out.write_text(text, encoding="utf-8")
        print(f"{config.out}: cost {cost:.3f} m/s")
    except ValueError as error:
        refuse(str(error))


if __name__ == "__main__":
    main()
