"""Evolve the trot's parameters with our own genetic algorithm, and print what a gait does.

python -m experiments.tune_gait evolve --out gait.json     about two minutes on two cores
python -m experiments.tune_gait evolve --goal speed --out fast.json
python -m experiments.tune_gait table [--gait gait.json] [--csv table.csv] [--variant full]
python -m experiments.tune_gait speed [--gait gait.json]   forward speed against command
python -m experiments.tune_gait falls [--gait gait.json]   100 random command sequences
"""

import csv
import dataclasses
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments import script
from fntg_jax.commands.cli import refuse
from fntg_jax.controller import genome
from fntg_jax.learning import ga
from fntg_jax.running import xla

# Gene -> (least, largest) value.
GENES = {
    "period": (0.22, 0.50),
    "duty": (0.50, 0.70),
    "lift": (0.006, 0.030),
    "height": (0.090, 0.120),
    "tilt": (-0.012, 0.012),
    "fore_x": (-0.030, 0.030),
    "hind_x": (-0.040, 0.030),
    "fore_y": (0.0, 0.030),
    "hind_y": (0.0, 0.030),
    "gain_x": (0.7, 1.3),
    "gain_y": (0.7, 1.3),
    "gain_omega": (0.7, 1.3),
    "full_lift": (0.005, 0.100),
}
# v_x, v_y (m/s), omega (rad/s): forward, backward, sideways, turning, combined.
COMMANDS = np.array(
    [[v, 0, 0] for v in (0.05, 0.10, 0.15, 0.20, 0.25, -0.05, -0.10, -0.15, -0.20)]
    + [[0, v, 0] for v in (0.05, 0.10, -0.05, -0.10)]
    + [[0, 0, w] for w in (0.3, 0.7, 1.1, 1.5, -0.3, -0.7, -1.1, -1.5)]
    + [[0.05, 0, 1.0], [0.10, 0, -1.0], [0.15, 0, 0.5], [0.20, 0, -0.5], [0.25, 0, 1.5]]
    + [[0.20, 0, -1.5], [0.10, 0.05, 0.0], [0.15, -0.05, 0.3], [-0.10, 0, 0.5]],
    np.float32,
)
SETTLE, MEASURE = 20, 60  # control steps of 0.1 s before and while measuring


class Walk(NamedTuple):
    """A command with all three velocities: m/s, rad/s, m/s."""

    v: Any
    omega: Any
    v_y: Any


class Track(NamedTuple):
    """What a walk came to: mean v_x, v_y, omega in the body's frame; whether the dog fell; swing
    of the heading about its mean course (rad, standard deviation); lowest uprightness; largest
    joint speed at the ends of control steps (rad/s)."""

    velocity: Any
    fallen: Any
    swing: Any
    upright: Any
    joint_speed: Any


def walk(env, commands) -> Track:
    """Drive the dog with commands [n, 3] from a stand at the field's centre."""
    from envs.base import Scene

    zero = jnp.zeros(3)
    start = env.reset(Scene(zero, zero[:2], jnp.zeros((0, 3))))

    def control_step(state, u):
        new = env.step(state, Walk(u[0], u[2], u[1]))
        return new, (new.qpos, jnp.abs(new.qvel[6:]).max())

    state, (path, speed) = jax.lax.scan(control_step, start, commands)
    return track(jnp.concatenate([start.qpos[None], path]), state.fallen, jnp.max(speed), env.dt)


def track(path, fallen, joint_speed, dt) -> Track:
    """What a walk came to.  path: the dog's coordinates [steps + 1, 19 or more], dt (s) apart."""
    from envs.quadruped.environment import heading

    c, s = map(jnp.asarray, jax.vmap(heading)(path))
    turn = jnp.arcsin(jnp.clip(c[:-1] * s[1:] - s[:-1] * c[1:], -1, 1))
    dx, dy = jnp.diff(path[:, 0]), jnp.diff(path[:, 1])
    c, s = c[:-1] + c[1:], s[:-1] + s[1:]  # along the middle of both headings
    norm = jnp.maximum(jnp.hypot(c, s), 1e-6)
    moved = jnp.stack([c * dx + s * dy, c * dy - s * dx]) / norm
    moved, turn = moved[:, SETTLE:], turn[SETTLE:]
    velocity = jnp.append(jnp.mean(moved, 1), jnp.mean(turn)) / dt
    swing = jnp.std(jnp.cumsum(turn - jnp.mean(turn)))
    upright = jnp.min(1 - 2 * jnp.sum(path[1:, 4:6] ** 2, axis=1))
    return Track(velocity, fallen, swing, upright, joint_speed)


def steady(env, commands=COMMANDS) -> Track:
    """One walk for every command, held all the time.  Leaves [commands]."""
    held = jnp.repeat(jnp.asarray(commands)[:, None], SETTLE + MEASURE, axis=1)
    return jax.vmap(partial(walk, env))(held)


def _run_full(env, start, commands) -> Any:
    """Commands [num, num_steps, 3] from poses start [num, 3] in the full model, in MuJoCo's C code,
    with the ball in a corner."""
    from envs.base import Scene
    from envs.quadruped import native

    num = len(start)
    ball = np.tile(np.array([1.2, 0.75], np.float32), (num, 1))
    scenes = Scene(start, ball, np.zeros((num, 0, 3), np.float32), seed=np.zeros(num, int))  # type: ignore[arg-type]

    def control(_, n):
        v_x, v_y, omega = commands[:, n].T
        return Walk(v_x, omega, v_y)

    return native.run(env, scenes, control, "full", num_steps=commands.shape[1])


def steady_full(env) -> Track:
    """`steady` of all `COMMANDS` in the full model, in MuJoCo's C code: joint limits, a head and a
    tail that move, everything touches.  Joint speeds are not recorded (NaN)."""
    num, steps = len(COMMANDS), SETTLE + MEASURE
    # Start so that the walk stays in the middle of the field, clear of walls and ball.
    angle = COMMANDS[:, 2:] * env.dt * np.arange(steps)
    v_x, v_y = COMMANDS[:, :1], COMMANDS[:, 1:2]
    ahead = np.stack([v_x * np.cos(angle) - v_y * np.sin(angle), v_x * np.sin(angle)], -1)
    ahead[..., 1] += v_y * np.cos(angle)
    ideal = np.cumsum(ahead * env.dt, axis=1)
    start = np.zeros((num, 3), np.float32)
    start[:, :2] = -0.5 * (ideal.min(1) + ideal.max(1))
    run = _run_full(env, start, jnp.repeat(jnp.asarray(COMMANDS)[:, None], steps, axis=1))
    path = jnp.asarray(run.qpos.swapaxes(0, 1), jnp.float32)
    return jax.vmap(partial(track, joint_speed=jnp.nan, dt=env.dt))(path, run.fallen[-1])


def random_sequences(key, num: int, num_steps: int):
    """Commands [num, num_steps, 3] that jump every 0.4 s over the whole range."""
    high = jnp.asarray([0.25, 0.10, 1.5])
    low = jnp.asarray([-0.20, -0.10, -1.5])
    jumps = jax.random.uniform(key, (num, -(-num_steps // 4), 3), minval=low, maxval=high)
    return jnp.repeat(jumps, 4, axis=1)[:, :num_steps]


def falls(env, key, num: int = 100, num_steps: int = 220) -> Track:
    """Random command sequences of 22 s.  Leaves [num]."""
    return jax.vmap(partial(walk, env))(random_sequences(key, num, num_steps))


def falls_full(env, key, num: int = 100, num_steps: int = 220) -> np.ndarray:
    """`falls` in the full model, from the field's centre, walls around and the ball in a corner:
    who fell [num]."""
    commands = random_sequences(key, num, num_steps)
    return _run_full(env, np.zeros((num, 3), np.float32), commands).fallen[-1]


def errors(walks: Track, commands) -> tuple[Any, Any]:
    """Errors of velocity (m/s, both axes together) and of turning (rad/s), [commands]."""
    off = walks.velocity - commands
    return jnp.hypot(off[..., 0], off[..., 1]), jnp.abs(off[..., 2])


def gait_of(base, theta):
    """A gait from genes in (-5, 5): linear in the ranges of `GENES`."""
    share = (theta + 5) / 10
    values = {n: lo + share[i] * (hi - lo) for i, (n, (lo, hi)) in enumerate(GENES.items())}
    return dataclasses.replace(base, **values)


def tracking_fitness(env, key, theta):
    """10 / (0.1 + cost): errors in units of the tolerances 0.01 m/s and 0.05 rad/s, swing of
    the heading in units of 0.03 rad, a fall 20.  A few jumping commands guard against falls."""
    own = dataclasses.replace(env, gait=gait_of(env.gait, theta))
    walks = steady(own)
    v, omega = errors(walks, COMMANDS)
    cost = jnp.mean(v / 0.01 + omega / 0.05 + walks.swing / 0.03 + 20.0 * walks.fallen)
    jumpy = falls(own, key, 6, SETTLE + MEASURE)
    cost += jnp.mean(20.0 * jumpy.fallen + 10 * jax.nn.relu(0.95 - jumpy.upright))
    return 10 / (0.1 + cost)


def speed_fitness(env, key, theta):
    """Forward speed (m/s, times ten) over 8 s at the best of five commands, if the dog keeps
    its course and does not fall."""
    own = dataclasses.replace(env, gait=gait_of(env.gait, theta))
    commands = jnp.asarray([[v, 0, 0] for v in (0.3, 0.4, 0.5, 0.6, 0.7)])
    walks = steady(own, commands)
    good = ~walks.fallen & (jnp.abs(walks.velocity[:, 2]) < 0.2)
    return 10 * jnp.max(jnp.where(good, jnp.maximum(walks.velocity[:, 0], 0), 0.0))


@dataclasses.dataclass(frozen=True)
class Config:
    """Gait tuning.

    Attributes:
        what: evolve, table, speed or falls.
        goal: what to evolve: tracking of commands, or forward speed.
        gait: gait to look at, and where an evolved one has what does not evolve from (v_rate,
            omega_rate); default the shipped one.
        out: where the evolved gait goes.
        csv: where the table goes, too.
        variant: model of the table and of falls.
        population, generations, seed: of the genetic algorithm.
    """

    what: tyro.conf.Positional[Literal["evolve", "table", "speed", "falls"]] = "table"
    goal: Literal["tracking", "speed"] = "tracking"
    gait: Path | None = None
    out: Path = Path("gait.json")
    csv: Path | None = None
    variant: Literal["lean", "full"] = "lean"
    population: int = 40
    generations: int = 40
    seed: int = 0


def run(config: Config, env) -> tuple[ga.State, ga.Record]:
    """Evolve a gait; rank selection, since fitness differences get small."""
    settings = ga.GAConfig(
        population=config.population, selection="rank", mutation_rate=0.01, num_elites=2
    )
    fitness = {"tracking": tracking_fitness, "speed": speed_fitness}[config.goal]

    def fitness_fn(key, theta):
        return jax.vmap(partial(fitness, env, key))(theta)

    advance = jax.jit(partial(ga.generation, fitness_fn=fitness_fn, config=settings))
    state = ga.init(jax.random.key(config.seed), len(GENES), settings)
    records = []
    for n in range(config.generations):
        state, record = advance(state)
        records.append(record)
        print(f"generation {n + 1}: best {record.best:.3f} mean {record.mean:.3f}", file=sys.stderr)
    return state, jax.tree.map(lambda *x: np.stack(x), *records)


def table(env, variant: str = "lean") -> list[dict[str, float]]:
    """Commanded against achieved, one row a command."""
    walks = steady_full(env) if variant == "full" else jax.jit(steady)(env)
    v, omega = errors(walks, COMMANDS)
    rows = []
    for i, (vx, vy, w) in enumerate(COMMANDS.tolist()):
        got = [float(x) for x in walks.velocity[i]]
        rows.append(
            {"v_x": vx, "v_y": vy, "omega": w, "got_v_x": got[0], "got_v_y": got[1]}
            | {"got_omega": got[2], "v_error": float(v[i]), "omega_error": float(omega[i])}
            | {"heading_swing": float(walks.swing[i]), "fell": int(walks.fallen[i])}
        )
    return [{k: round(x, 4) for k, x in row.items()} for row in rows]


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(Config, args=argv)
    try:
        _main(config)
    except ValueError as error:
        refuse(str(error))


def _check(config: Config) -> None:
    script.check_least(config, population=4, generations=1, seed=0)
    if config.what in ("evolve", "speed") and config.variant == "full":
        raise ValueError(f"variant = 'full': allowed with {config.what} is lean")
    script.check_files(config, "out", "csv")


def _main(config: Config) -> None:
    _check(config)
    xla.configure()
    from envs.quadruped.environment import Quadruped
    from envs.quadruped.locomotion import DEFAULT_GAIT, load_gait

    gait = load_gait(config.gait or DEFAULT_GAIT)
    env = Quadruped(gait=gait)
    if config.what == "evolve":
        state, _ = run(config, env)
        theta = genome.decode(state.best_bits, 15, False)
        best = gait_of(gait, theta)
        values = {f.name: round(float(getattr(best, f.name)), 5) for f in dataclasses.fields(best)}
        origin = f"experiments.tune_gait --goal {config.goal} --population {config.population}"
        origin += f" --generations {config.generations} --seed {config.seed}"
        document = {"format": "fntg-gait", "version": 1, "origin": origin, "gait": values}
        config.out.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
        print(f"fitness {float(state.best_fitness):.3f}, written to {config.out}")
    elif config.what == "table":
        rows = table(env, config.variant)
        print(" ".join(f"{k:>13s}" for k in rows[0]))
        for row in rows:
            print(" ".join(f"{x:13.4g}" for x in row.values()))
        mean = {k: float(np.mean([r[k] for r in rows])) for k in ("v_error", "omega_error")}
        print(f"mean error {mean['v_error']:.4f} m/s, {mean['omega_error']:.4f} rad/s")
        if config.csv is not None:
            with config.csv.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, rows[0])
                writer.writeheader()
                writer.writerows(rows)
    elif config.what == "speed":
        commands = np.array([[v, 0, 0] for v in np.arange(0.10, 0.81, 0.05)], np.float32)
        walks = jax.jit(steady)(env, commands)
        for command, got, fell, joint in zip(
            commands, walks.velocity, walks.fallen, walks.joint_speed
        ):
            print(
                f"{command[0]:.2f} m/s: v_x {got[0]:.3f} v_y {got[1]:.3f} m/s, omega {got[2]:.3f}"
                f" rad/s, joints up to {joint:.1f} rad/s{', fell' if fell else ''}"
            )
    else:
        key = jax.random.key(config.seed)
        full = config.variant == "full"
        fallen = falls_full(env, key) if full else jax.jit(falls)(env, key).fallen
        print(f"{int(fallen.sum())} falls in {len(fallen)} sequences of 22 s, {config.variant}")


if __name__ == "__main__":
    main()
