"""The match as an environment in JaxMARL's form: dictionaries by agent, inside jit.

    env = Soccer(players=1, minutes=1)
    seen, state = env.reset(key)
    seen, state, reward, done, info = env.step(key, state, {agent: action, ...})

The methods are those of JaxMARL's `MultiAgentEnv` (reset, step, step_env, get_obs, spaces, agents,
num_agents, agent_classes), so that its learners and wrappers take it; JaxMARL need not be
installed.  As there, `step` begins a new match by itself where one is over.  Observations,
actions and rewards with their units: `envs.soccer.pettingzoo`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from envs.soccer.flat import act, observe, rewards, width
from envs.soccer.match import Match
from envs.soccer.state import State

Named = dict[str, Float[Array, "..."]]


class Box(NamedTuple):
    """A space of vectors: bounds, shape, and `sample`, as JaxMARL's spaces have them."""

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: Any = jnp.float32

    def sample(self, key: Array) -> Float[Array, "..."]:
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, x: Array) -> Array:
        return jnp.all((x >= self.low) & (x <= self.high))


class Soccer:
    """goal, progress, approach: rewards, see `envs.soccer.flat.rewards`; options of `Match`."""

    name = "fntg_soccer"

    def __init__(
        self, goal: float = 1.0, progress: float = 0.0, approach: float = 0.0, **options: Any
    ):
        self.match = Match(**options)
        self.rewards = goal, progress, approach
        n = self.match.players
        self.agents = [f"{team}_{k}" for team in ("home", "away") for k in range(n)]
        self.num_agents = len(self.agents)
        self.agent_classes = {"home": self.agents[:n], "away": self.agents[n:]}
        seen = Box(-1e3, 1e3, (width(self.match),))
        self.observation_spaces = dict.fromkeys(self.agents, seen)
        self.action_spaces = dict.fromkeys(self.agents, Box(-1.0, 1.0, (6,)))

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        return self.action_spaces[agent]

    def reset(self, key: Array) -> tuple[Named, State]:
        """Kick-off of a new match; who has it and all noise follow from the key."""
        seed = jax.random.randint(key, (), 0, 2**31 - 1)
        state = self.match.reset(seed % 2, seed)
        return self.get_obs(state), state

    def step(self, key: Array, state: State, actions: Named, reset_state: State | None = None):
        """`step_env`, then a new match (or `reset_state`) where this one is over."""
        seen, after, reward, done, info = self.step_env(key, state, actions)
        fresh = self.reset(key)[1] if reset_state is None else reset_state
        fresh_seen = self.get_obs(fresh)
        choose = lambda new, old: jnp.where(done["__all__"], new, old)  # noqa: E731
        seen, after = jax.tree.map(choose, (fresh_seen, fresh), (seen, after))
        return seen, after, reward, done, info

    def step_env(self, key: Array, state: State, actions: Named):
        """One control step of 0.1 s, without a new match at the end."""
        rows = jnp.stack([actions[a] for a in self.agents])
        after = self.match.step(state, act(self.match, rows))
        reward = rewards(state, after, *self.rewards)
        over = self.match.finished(after)
        done = {**dict.fromkeys(self.agents, over), "__all__": over}
        return self.get_obs(after), after, self._named(reward), done, {}

    def get_obs(self, state: State) -> Named:
        return self._named(observe(self.match, state))

    def _named(self, rows: Array) -> Named:
        return {agent: rows[k] for k, agent in enumerate(self.agents)}
