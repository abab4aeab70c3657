"""brax's trainers on our world: the FNTG's genes and a network, as policies of brax.training.

brax's trainers take the reward of `envs.brax`, which is the smooth objective spread over time, and
its scenes.  At a checkpoint brax's own evaluator runs the unseen scenes.
"""

import statistics
import traceback
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Observation
from experiments.optimizers_fntg import Checkpoint, Task, partitions
from fntg_jax.controller import network
from fntg_jax.controller.layout import HIGH, LOW, expand, get_layout

NAMES = ("brax-es-fntg", "brax-es-mlp", "brax-ppo-mlp", "brax-apg-fntg")


class LeftOut(Exception):
    """A released trainer does not run with the installed jax: which one, and its error."""


class _Deterministic:
    """An action distribution of one action, for policies that are what they are."""

    param_size = 2

    def sample(self, parameters, seed):
        del seed
        return parameters

    def mode(self, parameters):
        return parameters


def fntg_networks(make: Any, env: Any, output: network.Output, **_: Any) -> Any:
    """The FNTG's 31 genes as brax networks (a network factory once the first three are given):
    parameters [31], read as `output` says, a random fuzzy partition at the start and clipped to
    (-5, 5) in use."""
    from brax.training.networks import FeedForwardNetwork

    layout = get_layout("paper-31")

    def init(key):
        return partitions(key, 1, layout)[0]

    def apply(normalizer, theta, observation):
        del normalizer  # metres and radians are what the genes mean
        params = expand(layout, jnp.clip(theta, LOW, HIGH))
        seen = Observation(*jnp.moveaxis(observation, -1, 0))
        return env.action(network.command(params, seen, env.env.limits, output))

    return make(
        policy_network=FeedForwardNetwork(init, apply),
        parametric_action_distribution=_Deterministic(),
    )


def _trainer(
    name: str,
    env: Any,
    output: network.Output,
    budget: int,
    seed: int,
    checkpoints: int,
    length: int,
) -> Any:
    """A call of brax's trainer that lacks only its progress_fn and eval_env."""
    common: dict[str, Any] = {
        "environment": env,
        "episode_length": length,
        "seed": seed,
        "num_evals": checkpoints + 1,
        "deterministic_eval": True,
    }
    if name.startswith("brax-es"):
        from brax.training.agents.es import networks, train

        common |= {
            "num_timesteps": budget,
            "population_size": 256,
            "fitness_shaping": train.FitnessShaping.CENTERED_RANK,
        }
        if name == "brax-es-mlp":
            options: dict[str, Any] = {
                "learning_rate": 0.01,
                "perturbation_std": 0.05,
                "normalize_observations": True,
            }
            return partial(train.train, **common, **options)
        factory = partial(_factory, networks.ESNetworks, env, output)
        options = {"learning_rate": 0.05, "perturbation_std": 0.3, "network_factory": factory}
        return partial(train.train, **common, **options)
    if name == "brax-ppo-mlp":
        from brax.training.agents.ppo import networks as ppo_networks
        from brax.training.agents.ppo import train as ppo

        # brax's own defaults are made for GPUs: its critic of 5 x 256 takes most of a CPU's time.
        plain = partial(
            ppo_networks.make_ppo_networks,
            policy_hidden_layer_sizes=(64, 64),
            value_hidden_layer_sizes=(64, 64),
        )
        return partial(
            ppo.train, **common, num_timesteps=budget, num_envs=1024, batch_size=256,
            num_minibatches=16, unroll_length=20, num_updates_per_batch=4, learning_rate=1e-3,
            entropy_cost=1e-3, discounting=0.98, normalize_observations=True,
            num_resets_per_eval=1, network_factory=plain,
        )  # fmt: skip
    from brax.training.agents.apg import networks as apg_networks
    from brax.training.agents.apg import train as apg

    num_envs, horizon = 256, 55
    return partial(
        apg.train, **common, num_envs=num_envs, horizon_length=horizon, learning_rate=0.03,
        use_schedule=False, policy_updates=max(checkpoints, budget // (3 * num_envs * horizon)),
        network_factory=partial(_factory, apg_networks.APGNetworks, env, output),
    )  # fmt: skip


def _factory(make, env, output, observation_size, action_size, **options):
    del observation_size, action_size
    return fntg_networks(make, env, output, **options)


def train(name: str, task: Task, seed: int, budget: int, checkpoints: int):
    """Yield a `Checkpoint` after each share of the budget, and the number of policy parameters
    last.  brax's clock counts compilation with the first share: it is taken to have run at the
    median speed of the others.  Raises `LeftOut`.
    """
    import brax

    from envs.brax import EPISODE_LENGTH, Bioa
    from envs.mix import concatenate

    env = Bioa(task.traced.env, task.traced.scenes)
    eval_env = Bioa(task.traced.env, concatenate(task.held_out))
    seen: list[tuple[int, float, float]] = []

    def progress_fn(steps, metrics):
        success = float(metrics["eval/episode_success"])
        seen.append((int(steps), float(metrics.get("training/walltime", 0.0)), success))

    try:
        run = _trainer(name, env, task.output, budget, seed, checkpoints, EPISODE_LENGTH)
        _, params, _ = run(
            eval_env=eval_env, num_eval_envs=2 * task.eval_scenes, progress_fn=progress_fn
        )
    except (AttributeError, TypeError, NotImplementedError) as error:
        # brax's own call must have failed: mistakes of ours are not to pass for its.
        files = [Path(frame.filename) for frame in traceback.extract_tb(error.__traceback__)]
        if "brax" not in [f.parts for f in files if "jax" not in f.parts][-1]:
            raise
        text = " ".join(str(error).split())
        raise LeftOut(
            f"{name}: brax {brax.__version__} with jax {jax.__version__}: "
            f"{type(error).__name__}: {text}"
        ) from error
    seen = [s for s in seen if s[1] > 0]  # the evaluation before training
    if name == "brax-apg-fntg":
        # It counts checkpoints, not steps.
        seen = [(budget * n // len(seen), *s[1:]) for n, s in enumerate(seen, 1)]
    pace = [(b[1] - a[1]) / max(b[0] - a[0], 1) for a, b in zip(seen, seen[1:])]
    first = seen[0][0] * statistics.median(pace) if pace else seen[0][1]
    for steps, wall, success in seen:
        yield Checkpoint(steps, first + wall - seen[0][1], np.full(2, success))
    yield sum(x.size for x in jax.tree.leaves(params[1]))
