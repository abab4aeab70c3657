"""FNTG-JAX: train small, readable robot controllers with a genetic algorithm in JAX."""

__version__ = "0.1.0"
