"""BIOA's world as a Gymnasium environment, alone or many at once (extra `gym`).

    import fntg_jax

    env = fntg_jax.gym.make("kinematic", suite="blocked")
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

Observation, float32 [4]: d_B, d_O (m), theta_B, theta_O (rad), the inputs of the FNTG.  Action,
float32 [2] in [-1, 1]: v from v_min to v_max and omega from -omega_max to omega_max
(`command_of`, `action_of`); beyond, it is clipped.  An episode is truncated after 220 control
steps and terminates when the robot falls.

The reward of a step is that of `envs.brax`: progress 1.3 (L(d_B before) - L(d_B after)) with
L(d) = log(1 + (d / 0.05 m)^2); less 0.014 log(1 + (v / 0.01 m/s)^2) / (1 + (d_B / 0.4 m)^2) for not
standing still near the ball; less max(0.16 m - d_O, 0) / 0.1 m for too little clearance; less 30
for a fall.  The last step's info has `reach`, `safe`, `stop` and `success`, as `fntg evaluate`
judges them.
"""

from typing import Any, NamedTuple, overload

import jax
import jax.numpy as jnp
import numpy as np

from envs.base import Command, Environment, Scene
from fntg_jax.learning.fitness import success
from fntg_jax.learning.rollout import EPISODE_STEPS, SAMPLE_STEPS, Outcome
from fntg_jax.running import registry

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    if (error.name or "").split(".")[0] != "gymnasium":
        raise
    raise ModuleNotFoundError(
        "fntg_jax.gym needs Gymnasium: pip install 'fntg-jax[gym]'", name="gymnasium"
    ) from None

_PROGRESS, _STOP, _CLEARANCE, _FALL = 1.3, 0.7 / 50, 1.0, 30.0
_NEAR, _STILL, _GATE, _MARGIN = 0.05, 0.01, 0.4, 0.16  # m, m/s, m, m
_FAR = 1000.0  # m: further than any episode goes
_PARTS = ("reach", "safe", "stop", "success")


class _Episode(NamedTuple):
    """A world's state, control steps so far, and what the trial will be judged by."""

    world: Any
    time: Any
    outcome: Outcome


class _Step(NamedTuple):
    observation: Any
    reward: Any
    terminated: Any
    truncated: Any
    parts: dict[str, Any]


def command_of(action: Any, limits: Any) -> Command:
    """The command of an action.

    Args:
        action: [..., 2] in [-1, 1] (clipped).
        limits: of the world: v_min, v_max (m/s), omega_max (rad/s).

    Returns:
        v, m/s, and omega, rad/s, each [...].
    """
    a = jnp.clip(action, -1, 1)
    v = limits.v_min + 0.5 * (a[..., 0] + 1) * (limits.v_max - limits.v_min)
    return Command(v, a[..., 1] * limits.omega_max)


def action_of(v: Any, omega: Any, limits: Any) -> np.ndarray:
    """The action of a command: the inverse of `command_of`.

    Args:
        v: m/s.
        omega: rad/s.
        limits: of the world: v_min, v_max (m/s), omega_max (rad/s).

    Returns:
        float32 [..., 2].
    """
    forward = 2 * (np.asarray(v) - limits.v_min) / (limits.v_max - limits.v_min) - 1
    return np.stack([forward, np.asarray(omega) / limits.omega_max], axis=-1).astype(np.float32)


def _reset(env: Environment, scene: Scene) -> tuple[_Episode, Any]:
    world = env.reset(scene)
    zeros, near = jnp.zeros(len(SAMPLE_STEPS)), jnp.asarray(env.measure(world).d_obstacle)
    nothing = Outcome(zeros, zeros, zeros, near, jnp.zeros(()), jnp.zeros((), bool))
    return _Episode(world, jnp.zeros((), jnp.int32), nothing), jnp.stack(env.observe(world))


def _step(env: Environment, episode: _Episode, action: Any) -> tuple[_Episode, _Step]:
    command = command_of(action, env.limits)
    before = env.measure(episode.world)
    world = env.step(episode.world, command)
    after, failed = env.measure(world), env.failed(world)
    time, last = episode.time + 1, episode.outcome
    now = time == jnp.asarray(SAMPLE_STEPS)
    outcome = Outcome(
        distance=jnp.where(now, after.d_ball, last.distance),
        v=jnp.where(now, command.v, last.v),
        omega=jnp.where(now, command.omega, last.omega),
        clearance=jnp.minimum(last.clearance, after.d_obstacle),
        v_peak=jnp.maximum(last.v_peak, command.v),
        failed=failed,
    )
    reward = (
        _PROGRESS * (_log_distance(before) - _log_distance(after))
        - _STOP * jnp.log1p((command.v / _STILL) ** 2) / (1 + (after.d_ball / _GATE) ** 2)
        - _CLEARANCE * jnp.maximum(_MARGIN - after.d_obstacle, 0) / 0.1
        - _FALL * failed
    )
    truncated = time >= EPISODE_STEPS
    judged = success(outcome)
    parts = {name: getattr(judged, name) & truncated for name in _PARTS}
    seen = jnp.stack(env.observe(world))
    return _Episode(world, time, outcome), _Step(seen, reward, failed, truncated & ~failed, parts)


def _log_distance(seen: Any) -> Any:
    return jnp.log1p((seen.d_ball / _NEAR) ** 2)


def _spaces() -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    high = np.asarray([_FAR, _FAR, np.pi, np.pi], np.float32)
    action = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    return gymnasium.spaces.Box(-high, high, dtype=np.float32), action


class Bioa(gymnasium.Env):
    """One robot on its way to the ball; see `make`.

    Attributes:
        env: the environment (contract: `envs.base.Environment`).
        scenes: batch of scenes, of which every reset draws one.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's spelling)
    render_mode = None

    def __init__(self, env: Environment, scenes: Scene):
        self.env, self.scenes = env, scenes
        self.observation_space, self.action_space = _spaces()
        self._num_scenes = len(scenes.start)
        self._start = jax.jit(lambda n: _reset(env, jax.tree.map(lambda x: x[n], scenes)))
        self._advance = jax.jit(lambda episode, action: _step(env, episode, action))
        self._episode: _Episode | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """A start in a random scene, or in number options["scene"] of `scenes`.

        Raises ValueError on a scene that there is not.
        """
        super().reset(seed=seed)
        number = (options or {}).get("scene")
        if number is None:
            number = int(self.np_random.integers(self._num_scenes))
        elif not 0 <= number < self._num_scenes:
            raise ValueError(f"scene = {number}: allowed are 0 to {self._num_scenes - 1}")
        self._episode, observation = self._start(np.int32(number))
        return np.array(observation), {"scene": number}

    def step(self, action: Any):
        """One control step.  Raises ValueError before the first reset."""
        if self._episode is None:
            raise ValueError("step before reset: call reset first")
        self._episode, step = self._advance(self._episode, np.asarray(action, np.float32))
        observation, reward, terminated, truncated, parts = jax.device_get(step)
        over = bool(terminated or truncated)
        info = {name: bool(value) for name, value in parts.items()} if over else {}
        return observation, float(reward), bool(terminated), bool(truncated), info


class BioaVector(VectorEnv):
    """As many robots as you like, each on a field of its own, in one compiled step; see `make`.

    A robot whose episode is over starts anew at the next step, whose reward is 0 (Gymnasium's
    mode "next step").  `infos` of a step in which episodes end has `reach`, `safe`, `stop`,
    `success` as arrays, and for each the mask `_reach` ... of the robots that it is about.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012
    render_mode = None

    def __init__(self, env: Environment, scenes: Scene, num_envs: int):
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}: allowed are whole numbers from 1")
        self.env, self.scenes, self.num_envs = env, scenes, num_envs
        self.single_observation_space, self.single_action_space = _spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._num_scenes = len(scenes.start)

        def start(numbers):
            return jax.vmap(lambda n: _reset(env, jax.tree.map(lambda x: x[n], scenes)))(numbers)

        def advance(episodes, actions, over, numbers):
            moved, step = jax.vmap(lambda e, a: _step(env, e, a))(episodes, actions)
            fresh, seen = start(numbers)

            def choose(new, old):
                return jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), new, old)

            # All other fields of a fresh start are 0 or False.
            blank = jax.tree.map(jnp.zeros_like, step)._replace(observation=seen)
            return jax.tree.map(choose, fresh, moved), jax.tree.map(choose, blank, step)

        self._start, self._advance = jax.jit(start), jax.jit(advance)
        self._episodes: Any = None

    def _draw(self) -> np.ndarray:
        return self.np_random.integers(self._num_scenes, size=self.num_envs).astype(np.int32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """A start in a random scene for each robot."""
        super().reset(seed=seed)
        numbers = self._draw()
        self._episodes, observations = self._start(numbers)
        self._over = np.zeros(self.num_envs, bool)
        return np.array(observations), {"scene": numbers}

    def step(self, actions: Any):
        """One control step of all.  Raises ValueError before the first reset."""
        if self._episodes is None:
            raise ValueError("step before reset: call reset first")
        numbers = self._draw() if self._over.any() else np.zeros(self.num_envs, np.int32)
        actions = np.asarray(actions, np.float32)
        self._episodes, step = self._advance(self._episodes, actions, self._over, numbers)
        observations, rewards, terminated, truncated, parts = jax.device_get(step)
        self._over = terminated | truncated
        infos = {}
        if self._over.any():
            for name, value in parts.items():
                infos[name], infos[f"_{name}"] = value, self._over.copy()
        return observations, rewards, terminated, truncated, infos


@overload
def make(
    env: str = ...,
    suite: str = ...,
    *,
    num_envs: None = None,
    env_options: dict[str, float] | None = ...,
    num_scenes: int = ...,
    seed: int = ...,
) -> Bioa: ...
@overload
def make(
    env: str = ...,
    suite: str = ...,
    *,
    num_envs: int,
    env_options: dict[str, float] | None = ...,
    num_scenes: int = ...,
    seed: int = ...,
) -> BioaVector: ...
def make(
    env: str = "kinematic",
    suite: str = "open:2,blocked:3",
    *,
    num_envs: int | None = None,
    env_options: dict[str, float] | None = None,
    num_scenes: int = 4096,
    seed: int = 0,
) -> Bioa | BioaVector:
    """A Gymnasium environment in one of our worlds, or a vector environment.

    Args:
        env: world, by its entry point name: "kinematic", "quadruped".
        suite: kind of scenes, or several with their shares.
        num_envs: None for an environment (`gymnasium.Env`); a number for a vector environment
            (`gymnasium.vector.VectorEnv`) of as many robots.
        env_options: options of that world by name: {"latency": 2}.
        num_scenes: how many scenes there are to start in.
        seed: of those scenes.  (`reset(seed=...)` seeds which of them is drawn.)

    Raises ValueError on an unknown world, suite or option.
    """
    if not 1 <= num_scenes <= 1_000_000:
        raise ValueError(f"num_scenes = {num_scenes}: allowed are 1 to 1000000")
    world = registry.get_world(env)
    # The constant keeps the pool apart from the suites that controllers are judged on.
    key = jax.random.fold_in(jax.random.key(seed), 0x61A)
    environment = world.make(**(env_options or {}))
    scenes = jax.tree.map(jnp.asarray, registry.get_suite(world, suite)(key, num_scenes))
    if num_envs is None:
        return Bioa(environment, scenes)
    return BioaVector(environment, scenes, num_envs)
