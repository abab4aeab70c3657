"""Our worlds as `brax.envs.Env`, for brax's wrappers and trainers (the only file that needs brax).

    import brax.envs, envs.brax  # registers bioa_kinematic and bioa_quadruped

    env = brax.envs.get_environment("bioa_kinematic", latency=2)

Observation [4]: d_B, d_O (m), theta_B, theta_O (rad), the inputs of the FNTG.  Action [2] in
[-1, 1]: v from v_min to v_max, omega from -omega_max to omega_max; beyond, it is clipped.
Episodes are 220 control steps (`EPISODE_LENGTH`); `done` is a fall, brax's EpisodeWrapper adds the
time limit.

The reward of a step depends on what the policy sees and does, and on nothing it cannot know:

    progress   1.3 (L(d_B before) - L(d_B after)),  L(d) = log(1 + (d / 0.05 m)^2)
    stop     - 0.014 log(1 + (v / 0.01 m/s)^2) / (1 + (d_B / 0.4 m)^2)
    clearance  - max(0.16 m - d_O, 0) / 0.1 m,  and 30 for a fall

It is the trainer's smooth objective spread over time: the first part sums up to that objective's
two distances, stopping counts at every step near the ball instead of at three, and too little
clearance at every step instead of at the worst.

Metrics, which brax sums over an episode: the three parts, and `reach`, `safe`, `stop`, `success`,
which are 0 until step 220 and then 0 or 1: nearer than 0.10 m after step 200; never nearer than
0.145 m to an obstacle; below 0.03 m/s, averaged over steps 170, 200 and 220; all three.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from envs import kinematic, quadruped
from envs.base import Command, Observation, Scene, World

try:
    from brax.envs import register_environment
    from brax.envs.base import Env, State
except ModuleNotFoundError as error:
    if (error.name or "").split(".")[0] != "brax":
        raise
    raise ModuleNotFoundError(
        "envs.brax needs brax: pip install 'fntg-jax[compare]'", name="brax"
    ) from None

EPISODE_LENGTH = 220  # control steps (paper)
_PROGRESS, _STOP, _CLEARANCE, _FALL = 1.3, 0.7 / 50, 1.0, 30.0
_NEAR, _STILL, _GATE, _MARGIN = 0.05, 0.01, 0.4, 0.16  # m, m/s, m, m


class Episode(NamedTuple):
    """A world's state and what success is judged by: control steps so far, d_B after step 200 (m),
    sum of |v| at steps 170, 200, 220 (m/s), smallest d_O (m)."""

    world: Any
    time: Int[Array, ""]
    distance: Float[Array, ""]
    v_sum: Float[Array, ""]
    clearance: Float[Array, ""]


class Bioa(Env):
    """Ball interception and obstacle avoidance in any of our environments.

    env: an environment (contract: `envs.base.Environment`).  scenes: a batch; every reset starts
    in one of them at random.  brax's AutoResetWrapper goes back to the scene that the last true
    reset drew, so the number of parallel environments is the number of scenes between resets.
    """

    def __init__(self, env: Any, scenes: Scene):
        self.env = env
        self.scenes = scenes

    def reset(self, rng: Any) -> State:
        """A start in a random scene.  rng: a key; brax's wrappers want `jax.random.PRNGKey`s."""
        pick = jax.random.randint(rng, (), 0, jax.tree.leaves(self.scenes)[0].shape[0])
        return self.start(jax.tree.map(lambda x: jnp.asarray(x)[pick], self.scenes))

    def start(self, scene: Scene) -> State:
        """The start in a given scene."""
        world = self.env.reset(scene)
        zero = jnp.zeros(())
        clearance = self.env.measure(world).d_obstacle
        episode = Episode(world, jnp.zeros((), jnp.int32), zero, zero, clearance)
        metrics = dict.fromkeys(METRICS, zero)
        return State(episode, self._observe(world), zero, zero, metrics, {})

    def step(self, state: State, action: Float[Array, "2"]) -> State:
        """One control step."""
        episode: Episode = state.pipeline_state
        command = self.command(action)
        before = self.env.measure(episode.world)
        world = self.env.step(episode.world, command)
        after = self.env.measure(world)
        failed = self.env.failed(world).astype(jnp.float32)

        gate = 1 / (1 + (after.d_ball / _GATE) ** 2)
        parts = {
            "reward_progress": _PROGRESS * (_log_distance(before) - _log_distance(after)),
            "reward_stop": -_STOP * jnp.log1p((command.v / _STILL) ** 2) * gate,
            "reward_clearance": -_CLEARANCE * jnp.maximum(_MARGIN - after.d_obstacle, 0) / 0.1
            - _FALL * failed,
        }
        time = episode.time + 1
        sampled = (time == 170) | (time == 200) | (time == 220)
        episode = Episode(
            world,
            time,
            jnp.where(time == 200, after.d_ball, episode.distance),
            episode.v_sum + jnp.where(sampled, jnp.abs(command.v), 0),
            jnp.minimum(episode.clearance, after.d_obstacle),
        )
        success = {
            "reach": episode.distance < 0.10,
            "safe": (episode.clearance >= 0.145) & (failed == 0),
            "stop": episode.v_sum / 3 < 0.03,
        }
        success["success"] = success["reach"] & success["safe"] & success["stop"]
        over = time == EPISODE_LENGTH
        judged = {k: (v & over).astype(jnp.float32) for k, v in success.items()}
        return state.replace(
            pipeline_state=episode,
            obs=self._observe(world),
            reward=sum(parts.values()),
            done=failed,
            # Wrappers put entries of their own beside ours.
            metrics={**state.metrics, **parts, **judged},
        )

    def command(self, action: Float[Array, "2"]) -> Command:
        """m/s and rad/s of an action in [-1, 1]."""
        limits = self.env.limits
        a = jnp.clip(action, -1, 1)
        v = limits.v_min + 0.5 * (a[0] + 1) * (limits.v_max - limits.v_min)
        return Command(v, a[1] * limits.omega_max)

    def action(self, command: Any) -> Float[Array, "*batch 2"]:
        """The action of a command with fields v and omega: the inverse of `command`."""
        limits = self.env.limits
        v = 2 * (command.v - limits.v_min) / (limits.v_max - limits.v_min) - 1
        return jnp.stack([v, command.omega / limits.omega_max], axis=-1)

    def _observe(self, world: Any) -> Float[Array, "4"]:
        return jnp.stack(self.env.observe(world))

    @property
    def observation_size(self) -> int:
        return len(Observation._fields)

    @property
    def action_size(self) -> int:
        return 2  # v and omega

    @property
    def backend(self) -> str:
        return type(self.env).__name__.lower()

    @property
    def dt(self) -> Any:
        """Control step, s."""
        return self.env.dt


METRICS = ("reward_progress", "reward_stop", "reward_clearance", "reach", "safe", "stop", "success")


def _log_distance(seen: Observation) -> Any:
    return jnp.log1p((seen.d_ball / _NEAR) ** 2)


def make(
    world: World,
    shares: tuple[tuple[str, float], ...] = (("open", 2), ("blocked", 3)),
    num_scenes: int = 16384,
    seed: int = 0,
    **options: float,
) -> Bioa:
    """`Bioa` in a world with its options, on a pool of scenes drawn from `seed`, the suites in the
    given shares.  Raises ValueError on an unknown suite, option or value."""
    # The constant keeps the pool apart from the suites that controllers are judged on.
    key = jax.random.fold_in(jax.random.key(seed), 0xB4A8)
    return Bioa(world.make(**options), world.mix(shares)(key, num_scenes))


register_environment("bioa_kinematic", partial(make, kinematic.world))
register_environment("bioa_quadruped", partial(make, quadruped.world))
