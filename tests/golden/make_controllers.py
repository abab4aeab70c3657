"""Random controllers, one a layout, for make_golden.py: python -m tests.golden.make_controllers"""

from pathlib import Path

import numpy as np

from envs.base import Limits
from fntg_jax import export
from fntg_jax.controller.layout import LAYOUTS

NUM_BITS = 15


def main():
    rng = np.random.default_rng(31)
    for n, layout in enumerate(LAYOUTS.values()):
        # Limits wide enough that most outputs lie between them.
        clip = n % 2 == 1
        limits = Limits(-2.0, 4.0, 4.0) if clip else Limits(-0.2, 0.3, 1.5)
        controller = export.from_bits(
            layout,
            rng.integers(0, 2, layout.num_genes * NUM_BITS) == 1,
            output="clip" if clip else "scale",
            limits=limits,
        )
        export.save(controller, Path(__file__).parent / f"controller-{layout.name}.json")


if __name__ == "__main__":
    main()
