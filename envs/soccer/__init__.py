"""Three a side under a referee: pure functions of one match, or of thousands."""

from envs.soccer.match import Match, Picture
from envs.soccer.state import CALLS, State

__all__ = ["CALLS", "Match", "Picture", "State"]
