"""How the work of a learning run is spread over devices.

Seeds are spread over the devices and mapped one after the other on each, so memory does not grow
with their number.  Where there are more devices than seeds, several share the blocks of trials of
one seed's generation (`rollout.rollout_pairs`).
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from fntg_jax.learning.rollout import num_blocks

GENOME = "genome"  # axis of the devices that share a generation


def make_mesh(num_seeds: int, num_trials: int) -> Mesh:
    """Devices by axes "seed" and "genome".

    A generation's trials (genomes x scenes) are shared only among devices that the seeds leave
    idle, and only where it has a block for each of them: with less, waiting for each other costs
    what it saves (the paper's generation, 240 trials, is one block and 2 ms).
    """
    devices = np.asarray(jax.devices())
    num = min(num_seeds, len(devices))
    share = min(len(devices) // num, num_blocks(num_trials))
    chosen = devices[: num * share]
    idle = jax.process_count() - len({d.process_index for d in chosen})
    if idle:
        raise ValueError(
            f"seeds = {num_seeds}: too few for {jax.process_count()} processes, {idle} of them "
            "would have nothing to do"
        )
    return Mesh(chosen.reshape(num, share), ("seed", GENOME))


def over_seeds(fn: Callable[..., Any], mesh: Mesh) -> Callable[..., Any]:
    """(shared, rows) -> fn(shared, *row) for each row, the leading axis of the leaves of the
    tuple `rows`: spread over "seed", one after the other on each device.

    What all rows use has to be passed as `shared`: arrays that fn closes over keep a sharding that
    does not fit inside.
    """
    return jax.shard_map(
        lambda shared, rows: jax.lax.map(lambda row: fn(shared, *row), rows),
        mesh=mesh,
        in_specs=(P(), P("seed")),
        out_specs=P("seed"),
        check_vma=False,
    )
