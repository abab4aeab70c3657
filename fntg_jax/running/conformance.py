"""Is a world, match, task, selection operator or export what the contract says?  For members of
one's own.

Each suite yields a `Check` for everything it looked at; `wrong` is empty where that is right.
`fntg doctor --world NAME`, `--match` and `--task` print them; `tests/test_conformance.py` runs all
suites over all members of this package.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Action, Command, Environment, Senses, Task, Walk, World
from fntg_jax.controller.controller import Controller
from fntg_jax.controller.layout import LAYOUTS
from fntg_jax.export import verify
from fntg_jax.learning.ga import GAConfig
from fntg_jax.running.problem import check_genes

_STEPS = 20  # control steps


class Check(NamedTuple):
    """what: the law that was looked at.  wrong: how it is broken, "" where it holds."""

    what: str
    wrong: str


def world(world: World, num_steps: int = _STEPS) -> Iterator[Check]:
    """Laws of a world and its model: `envs.base.World`, `envs.base.Environment`.

    Args:
        world: the member.
        num_steps: control steps that it is driven for.
    """
    env = world.make()
    try:
        world.make(no_such_option=1.0)
        refused = "make(no_such_option=1) was accepted"
    except ValueError:
        refused = ""
    yield Check("make refuses an unknown option with a ValueError", refused)
    key, other = jax.random.key(1), jax.random.key(2)
    scenes = None
    for name, suite in world.suites.items():
        scenes = suite(key, 4)
        yield Check(f"suite {name}: numbers are finite", _not_finite(scenes))
        yield Check(f"suite {name}: 4 scenes", _leading(scenes, 4))
        yield Check(f"suite {name}: the same key, the same scenes", _differ(scenes, suite(key, 4)))
        if name != "paper" and not _differ(scenes, suite(other, 4)):
            yield Check(f"suite {name}: another key, other scenes", "they are equal")
    if scenes is None:
        yield Check("there are suites", "there is none")
        return
    yield from _model(env, scenes, num_steps)


def _model(env: Environment, scenes: Any, num_steps: int) -> Iterator[Check]:
    traces = 0
    v = 0.5 * float(env.limits.v_max) * jnp.asarray([1.0, 1.0, 0.0, 0.5])
    omega = float(env.limits.omega_max) * jnp.asarray([0.0, 0.5, -1.0, 0.2])

    def look(state):
        return env.observe(state), env.measure(state), env.snapshot(state), env.failed(state)

    @jax.jit
    def drive(scene, v, omega):
        nonlocal traces
        traces += 1

        def step(state, _):
            new = env.step(state, Command(v, omega))
            return new, look(new)

        start = env.reset(scene)
        end, seen = jax.lax.scan(step, start, None, length=num_steps)
        return start, look(start), end, seen

    start, end = jax.eval_shape(
        lambda s: (env.reset(s), env.step(env.reset(s), Command(v[0], omega[0]))),
        jax.tree.map(lambda x: x[0], scenes),
    )
    wrong = _shapes_differ(start, end)
    yield Check("step keeps structure, shapes and types of the state", wrong)
    if wrong:
        return
    # Jitted by itself: under vmap the function is traced once more.
    cases = [_row((scenes, v, omega), n) for n in range(4)]
    one = [drive(*case) for case in cases]
    again = drive(*cases[1])
    yield Check("a second call does not trace again", "" if traces == 1 else f"{traces} traces")
    yield Check("the same scene and commands, the same states", _differ(one[1], again))
    yield Check("no NaN, no infinity", _not_finite([x[1:] for x in one]))
    batch = jax.vmap(drive)(scenes, v, omega)
    loop = jax.tree.map(lambda *x: jnp.stack(x), *one)
    # Physics that touches the ground tells roundings apart: one step only is compared closely.
    first = [jax.tree.map(lambda x: x[:, :1], x[3]) for x in (batch, loop)]
    yield Check("vmap is a loop", _far(batch[:2], loop[:2]) or _far(*first))
    failed = np.asarray(batch[3][3]).astype(int)
    yield Check(
        "a failure is for good", "" if (np.diff(failed, axis=1) >= 0).all() else "it is not"
    )
    scene = jax.tree.map(lambda x: x[1], scenes)

    def ahead(v):
        state = env.step(env.reset(scene), Command(v, omega[1]))
        return env.measure(state).d_ball

    slope = jax.jit(jax.grad(ahead))(v[1])
    yield Check("the gradient of a step is finite", _not_finite(slope))


def task(task: Task, population: int = 4) -> Iterator[Check]:
    """Laws of a task: `envs.base.Task`.

    Args:
        task: the member.
        population: genomes that are judged.
    """
    try:
        check_genes(task)
    except ValueError as error:
        yield Check("genes", str(error))
        return
    yield Check("genes", "")
    low, high = (
        np.asarray([getattr(g, n) for g in task.genes], np.float32) for n in ("low", "high")
    )
    share = np.random.default_rng(0).uniform(size=(population, len(low)))
    theta = jnp.asarray(low + share * (high - low), jnp.float32)
    key, traces = jax.random.key(0), 0
    memory = jax.jit(task.init)(key)

    @jax.jit
    def fitness(key, theta, memory, progress):
        nonlocal traces
        traces += 1
        return task.fitness(key, theta, memory, progress)

    value, new = fitness(key, theta, memory, jnp.asarray(0.0))
    shape = (population,)
    yield Check("fitness is [P]", "" if value.shape == shape else f"it is {value.shape}")
    wrong = _shapes_differ(memory, new)
    yield Check("fitness keeps structure, shapes and types of the memory", wrong)
    again = fitness(key, theta, memory, jnp.asarray(0.0))
    yield Check("the same arguments, the same fitness and memory", _differ((value, new), again))
    if not wrong:
        later, _ = fitness(jax.random.key(1), theta, new, jnp.asarray(1.0))
        yield Check("fitness is finite at the end of a run, too", _not_finite(later))
        yield Check("a second call does not trace again", "" if traces == 1 else f"{traces} traces")
    yield Check("fitness is finite", _not_finite(value))
    negative = bool(jnp.min(jnp.where(jnp.isfinite(value), value, 0)) < 0)
    yield Check("fitness is from 0", "negative: choose rank or tournament" if negative else "")
    if task.judge is not None:
        judged = jax.jit(task.judge)(key, theta, new if not wrong else memory)
        shapes = {name: x.shape for name, x in judged.items() if x.shape != shape}
        yield Check("judge gives numbers [N] by name", str(shapes or ""))
        yield Check("one of them is the score", "" if "score" in judged else str(list(judged)))
    if task.files is not None:
        files = task.files({g.name: float(x) for g, x in zip(task.genes, theta[0])})
        plain = all(isinstance(x, str) and "/" not in n for n, x in files.items())
        yield Check("files are texts by name", "" if plain else f"they are {files!r:.80}")


def match(match: Any, num_steps: int = _STEPS) -> Iterator[Check]:
    """Laws of a match: anything with the methods of `envs.soccer.Match`.

    Args:
        match: the member.
        num_steps: control steps that are played; every robot walks.
    """
    kickoff, seeds, size = jnp.asarray([0, 1, 0, 1]), jnp.asarray([1, 1, 2, 3]), match.robots
    traces = 0

    def action(*batch):
        shape = (size, *batch)
        number, word = jnp.zeros(shape, jnp.int32), jnp.zeros((2, *shape), jnp.uint32)
        speed = jnp.full(shape, 0.1)
        walk = Walk(number, speed, 0 * speed, 0.3 * speed)
        return Action(walk, jnp.zeros((3, *shape)), number, number, word)

    @jax.jit
    def drive(kickoff, seeds):
        nonlocal traces
        traces += 1

        def step(state, _):
            new = match.step_batch(state, action(len(seeds)))
            return new, (match.sense_batch(new), match.truth_batch(new), match.score(new))

        start = match.reset(kickoff, seeds)
        end, seen = jax.lax.scan(step, start, None, length=num_steps)
        return start, end, *seen

    start = jax.eval_shape(match.reset, kickoff, seeds)
    end = jax.eval_shape(match.step_batch, start, action(4))
    wrong = _shapes_differ(start, end)
    yield Check("step keeps structure, shapes and types of the state", wrong)
    if wrong:
        return
    bad = [f"{x.shape}" for x in jax.tree.leaves(start) if x.shape[-1:] != (4,)]
    yield Check("reset of 4 kick-offs and seeds: leaves [..., 4]", ", ".join(bad[:4]))
    four = drive(kickoff, seeds)
    again = drive(kickoff, seeds)
    yield Check("a second call does not trace again", "" if traces == 1 else f"{traces} traces")
    yield Check("the same kick-offs and seeds, the same matches", _differ(four, again))
    yield Check("no NaN, no infinity", _not_finite(four[1:]))
    row = lambda n: jax.tree.map(lambda x: x[..., n], four[1:])  # noqa: E731
    for other, what in ((1, "kick-off"), (2, "seed")):
        yield Check(
            f"another {what}, another match", "" if _differ(row(0), row(other)) else "equal"
        )
    score = np.asarray(four[4])  # [steps, 2, matches]
    legal = (np.diff(score, axis=0, prepend=0) >= 0).all()
    yield Check("goals start at 0 and do not fall", "" if legal else f"{score[..., 0].T}")

    @jax.jit
    def alone(kickoff, seed):
        """One match, its robots in front."""
        acts = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), action())

        def step(state, _):
            new = match.step(state, acts)
            return new, (match.sense(new), match.truth(new))

        end, seen = jax.lax.scan(step, match.reset(kickoff, seed), None, length=num_steps)
        return end, *seen, match.snapshot(end)

    end, senses, truth, picture = alone(kickoff[3], seeds[3])
    yield Check("a batch is a loop", _far(end, jax.tree.map(lambda x: x[..., 3], four[1])))
    given = isinstance(senses, Senses)
    yield Check("sense gives envs.base.Senses", "" if given else f"it is {type(senses)}")
    last = jax.tree.map(lambda x: x[-1], (senses, truth))
    yield Check("sense and truth of one match: leaves [R, ...]", _leading(last, size))
    shapes = picture.robots.shape, picture.ball.shape
    right = shapes == ((size, 3), (2,))
    yield Check("snapshot has robots [R, 3] and ball [2]", "" if right else f"{shapes}")


def selection(operator: Callable[..., Any], num: int = 4096) -> Iterator[Check]:
    """Laws of a selection operator, `learning.ga.SELECTIONS`.

    Args:
        operator: (key, fitness [P] from 0, number of parents, GAConfig) -> indices of parents.
        num: parents that are drawn.
    """
    config, key = GAConfig(population=8), jax.random.key(3)
    value = jnp.asarray([1.0, 3.0, 2.0, 8.0, 5.0, 0.0, 7.0, 4.0])
    choose = jax.jit(lambda key, value: operator(key, value, num, config))
    found = np.asarray(choose(key, value))
    inside = found.shape == (num,) and np.issubdtype(found.dtype, np.integer)
    inside = inside and bool(((found >= 0) & (found < 8)).all())
    yield Check("indices of as many parents as asked for", "" if inside else f"{found!r:.80}")
    if not inside:
        return
    yield Check("the same key, the same parents", _differ(found, choose(key, value)))
    mean, plain = float(value[found].mean()), float(value.mean())
    # Sixfold standard error of a uniform draw.
    least = plain + 6 * float(jnp.std(value)) / np.sqrt(num)
    yield Check("the better breed more", "" if mean > least else f"mean {mean:.2f} of {plain:.2f}")
    copies = np.bincount(found, minlength=8)
    order = copies[np.argsort(-np.asarray(value))]
    fair = order[0] + 6 * np.sqrt(num / 8) >= order.max()
    yield Check("none breeds more than the best", "" if fair else f"copies, best first: {order}")
    huge = np.asarray(choose(key, 1e30 * value))
    yield Check("any scale of fitness does", "" if value[huge].mean() > least else "1e30 does not")
    zero = np.asarray(choose(key, jnp.zeros(8)))
    ok = bool(((zero >= 0) & (zero < 8)).all())
    yield Check("a population without any fitness has parents", "" if ok else f"{zero!r:.80}")


def export(
    dumps: Callable[[Controller], str],
    commands: Callable[[str, np.ndarray], np.ndarray],
    share: float = verify.FLOAT32,
) -> Iterator[Check]:
    """Laws of an export: over all layouts and both readings of the output.

    Args:
        dumps: controller -> text.
        commands: (text, observations [n, 4] in m and rad) -> v, omega [n, 2] in m/s and rad/s, as
            somebody has them who knows the text only.
        share: largest error allowed, as a share of the speed limits: `verify.FLOAT32` or `FLOAT64`.
    """
    for name, layout in LAYOUTS.items():
        theta = np.random.default_rng(7).uniform(-5, 5, layout.num_genes)
        for output in ("scale", "clip"):
            controller = Controller(layout, theta, output=output)  # type: ignore[arg-type]
            text = dumps(controller)
            what = f"{name}, {output}"
            yield Check(f"{what}: the same text twice", _differ_text(text, dumps(controller)))
            error = verify.max_error(controller, partial(commands, text))
            right = verify.within(controller, error, share)
            yield Check(f"{what}: computes the paper's equations", "" if right else f"{error}")


def _row(tree: Any, n: int) -> Any:
    return jax.tree.map(lambda x: x[n], tree)


def _differ_text(a: str, b: str) -> str:
    return "" if a == b else "they differ"


def _plain(x: Any) -> np.ndarray:
    if jnp.issubdtype(getattr(x, "dtype", float), jax.dtypes.prng_key):
        x = jax.random.key_data(x)
    return np.asarray(x)


def _leaves(tree: Any) -> list[tuple[str, np.ndarray]]:
    found = jax.tree_util.tree_flatten_with_path(tree)[0]
    return [(jax.tree_util.keystr(path), _plain(x)) for path, x in found]


def _not_finite(tree: Any) -> str:
    bad = [name for name, x in _leaves(tree) if x.dtype.kind == "f" and not np.isfinite(x).all()]
    return f"not finite: {', '.join(bad[:4])}" if bad else ""


def _leading(tree: Any, num: int) -> str:
    bad = [f"{name} {x.shape}" for name, x in _leaves(tree) if x.shape[:1] != (num,)]
    return ", ".join(bad[:4])


def _differ(a: Any, b: Any) -> str:
    pairs = zip(_leaves(a), _leaves(b))
    bad = [name for (name, x), (_, y) in pairs if not np.array_equal(x, y, equal_nan=True)]
    return f"they differ: {', '.join(bad[:4])}" if bad else ""


def _far(a: Any, b: Any) -> str:
    pairs = zip(_leaves(a), _leaves(b))
    bad = [n for (n, x), (_, y) in pairs if not np.allclose(x, y, rtol=1e-3, atol=1e-4)]
    return f"they differ: {', '.join(bad[:4])}" if bad else ""


def _shapes_differ(a: Any, b: Any) -> str:
    if str(jax.tree.structure(a)) != str(jax.tree.structure(b)):
        return f"{jax.tree.structure(a)} becomes {jax.tree.structure(b)}"
    paths = jax.tree_util.tree_flatten_with_path(a)[0]
    bad = [
        f"{jax.tree_util.keystr(path)} {x.dtype}{list(x.shape)} becomes {y.dtype}{list(y.shape)}"
        for (path, x), y in zip(paths, jax.tree.leaves(b))
        if (x.shape, x.dtype) != (y.shape, y.dtype)
    ]
    return ", ".join(bad[:4])
