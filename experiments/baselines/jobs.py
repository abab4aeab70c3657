"""The contestants by name.

Every contestant is a function of a job that prepares (compiles, allocates) and returns what is
timed: a function of the repetition's number.
"""

import dataclasses
import importlib.util
import shutil
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from experiments.baselines.job import Job, Run


def ours(job: Job) -> Run:
    """The library; a generation's genomes are spread over the devices.

    One device computes on one core: XLA does not split these loops among its threads (ours with
    one device was no faster on two cores).  Two devices pay from a few thousand trials on, not for
    the paper's 240, whose 1 ms is about what starting two devices costs.
    """
    import jax
    import jax.numpy as jnp
    from jax.sharding import Mesh
    from jax.sharding import PartitionSpec as P

    from fntg_jax.learning import objective
    from fntg_jax.running import problem, runner, settings

    config = dataclasses.replace(
        settings.PRESETS["paper"],
        num_scenes=len(job.scenes.start),
        seeds=job.seeds,
        generations=job.generations,
    )
    run = runner.Run(problem.resolve(config))
    if job.theta is None:
        run.compile()
        start = run.now.population

        def learn(number):
            del number
            run.now = run.now._replace(population=start, records=())
            while not run.done:
                run.advance()  # returns NumPy: nothing is left in flight
            return np.median(run.now.population.best_fitness)

        return learn
    # Copied: the run's arrays lie on a mesh of its own.
    copied = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)), (run.problem.traced(), run.scenes))
    traced, scenes = copied
    score = jax.shard_map(
        lambda theta: objective.score(run.problem.static, traced, theta, scenes),
        mesh=Mesh(np.asarray(jax.local_devices()), ("genome",)),
        in_specs=P("genome"),
        out_specs=P("genome"),
        check_vma=False,
    )
    theta = jnp.asarray(job.theta)
    compiled = jax.jit(score).lower(theta).compile()
    return lambda number: np.asarray(compiled(theta))


def naive(job: Job) -> Run:
    """The naively written fitness."""
    import jax
    import jax.numpy as jnp

    from experiments.baselines import naive_jax

    scenes = jax.tree.map(jnp.asarray, job.scenes)
    theta = jnp.asarray(job.theta)
    compiled = jax.jit(naive_jax.fitness).lower(theta, scenes).compile()
    return lambda number: np.asarray(compiled(theta, scenes))


def plain_numpy(job: Job) -> Run:
    from experiments.baselines import plain_numpy

    theta = np.asarray(job.theta)
    return lambda number: plain_numpy.fitness(theta, job.scenes)


def plain_c(job: Job, threads: int) -> Run:
    from experiments.baselines import c_rollout

    rollout = c_rollout.Rollout(c_rollout.library(), threads)
    theta, scenes = np.asarray(job.theta), c_rollout.flat_scenes(job.scenes)
    return lambda number: rollout.fitness(theta, scenes)


def learner(job: Job, name: str) -> Run:
    from experiments.baselines import learners

    return getattr(learners, name)(job)


class Contestant(NamedTuple):
    """cores: it is confined to; prepare: see above; needs: a program or package that may be
    missing; flags: whether the library's XLA flags are set; devices: of XLA on CPU."""

    name: str
    cores: int
    prepare: Callable[[Job], Run]
    needs: str | None = None
    flags: bool = False
    devices: int = 1

    @property
    def missing(self) -> bool:
        if self.needs is None:
            return False
        return not (shutil.which(self.needs) or importlib.util.find_spec(self.needs))


OURS_1 = Contestant("ours", 1, ours, flags=True)
OURS_2 = Contestant("ours, two devices", 2, ours, flags=True, devices=2)
NO_FLAGS = Contestant("ours without XLA flags", 1, ours)
C_1 = Contestant("C", 1, partial(plain_c, threads=1), "gcc")
C_2 = Contestant("C, two threads", 2, partial(plain_c, threads=2), "gcc")
NAIVE_1 = Contestant("naive JAX", 1, naive)
NAIVE_2 = Contestant("naive JAX", 2, naive)
NUMPY = Contestant("NumPy", 1, plain_numpy)
_GA, _CMA = partial(learner, name="simple_ga"), partial(learner, name="cma_es")
GENERATION = (OURS_1, OURS_2, C_1, C_2, NAIVE_1, NAIVE_2, NUMPY)
LEARNING = (
    OURS_1,
    NO_FLAGS,
    Contestant("evosax SimpleGA, naive JAX", 1, _GA, "evosax"),
    Contestant("evosax SimpleGA, naive JAX", 2, _GA, "evosax"),
    Contestant("evosax CMA-ES, naive JAX", 1, _CMA, "evosax"),
    Contestant("DEAP, NumPy", 1, partial(learner, name="deap"), "deap"),
    Contestant("pygad, NumPy", 1, partial(learner, name="pygad"), "pygad"),
)
