"""Worlds for soccer-playing robots: the field, scenes, and models that move in it."""

from envs.base import Command, Environment, Limits, Observation, Scene, Snapshot, World

__all__ = ["Command", "Environment", "Limits", "Observation", "Scene", "Snapshot", "World"]
