"""The match for people of other libraries: a PettingZoo ParallelEnv (extra: pettingzoo).

    from envs.soccer.pettingzoo import parallel_env
    env = parallel_env(minutes=1)

Agents are home_0 ... and away_0 ...  An observation is 9 + 4 x players float32 numbers in the frame
of the agent's team (x to the opponents' goal): own x, y (m), cos, sin of the heading; ball x, y
(m), vx, vy (m/s); x, y (m) of all robots, own team by shirt, then the others; 1 in play, 0
else.  An action is six numbers in [-1, 1]: v, v_y, omega as shares of 0.3 m/s, 0.1 m/s, 1.5
rad/s; pan as a share of 1.5 rad; kick (none up to 0, else the first of the table); get up (where
> 0).  Reward of a step: `goal` for each goal of the own team minus those of the others, `progress`
for each metre that the ball comes nearer to the opponents' goal line, `approach` for each metre
that the robot itself comes nearer to the ball.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from envs.soccer.flat import act, observe, rewards, width
from envs.soccer.match import Match


class parallel_env(ParallelEnv):
    """One match as a ParallelEnv.  players, minutes, ...: of `Match`; goal, progress, approach:
    rewards (`envs.soccer.flat.rewards`)."""

    metadata = {"name": "fntg_soccer_v1", "render_modes": []}  # noqa: RUF012

    def __init__(
        self, goal: float = 1.0, progress: float = 0.0, approach: float = 0.0, **options: Any
    ):
        self.match = Match(**options)
        n = self.match.players
        self.possible_agents = [f"{team}_{k}" for team in ("home", "away") for k in range(n)]
        self.agents: list[str] = []
        self.render_mode = None
        high = np.full(width(self.match), np.inf, np.float32)
        self.observation_spaces = {a: spaces.Box(-high, high) for a in self.possible_agents}
        self.action_spaces = {
            a: spaces.Box(-1.0, 1.0, (6,), np.float32) for a in self.possible_agents
        }
        self._begin = jax.jit(self.match.reset)
        self._look = jax.jit(lambda state: observe(self.match, state))

        @jax.jit
        def step(state, actions):
            after = self.match.step(state, act(self.match, actions))
            reward = rewards(state, after, goal, progress, approach)
            return after, observe(self.match, after), reward

        self._step = step
        self._rng = np.random.default_rng()

    def observation_space(self, agent: str) -> spaces.Space:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Kick-off of a new match; who has it and all noise follow from the seed."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        number = int(self._rng.integers(2**31))
        self.agents = list(self.possible_agents)
        self._state = self._begin(number % 2, number)
        return self._named(self._look(self._state)), {a: {} for a in self.agents}

    def step(self, actions: dict[str, Any]):
        """One control step of 0.1 s; the match is truncated when the second half is over."""
        rows = np.stack([np.asarray(actions[a], np.float32) for a in self.agents])
        self._state, seen, reward = self._step(self._state, jnp.asarray(rows))
        over = bool(self.match.finished(self._state))
        agents = self.agents
        out: Any = (
            self._named(seen),
            {a: float(r) for a, r in zip(agents, np.asarray(reward))},
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, over),
            {a: {} for a in agents},
        )
        if over:
            self.agents = []
        return out

    def _named(self, rows):
        return dict(zip(self.agents, np.asarray(rows)))
