"""XLA's flags must be set before anything computes: without them the quadruped's step takes
minutes to compile."""

from fntg_jax import xla

xla.configure()
