"""How the work of a learning run is spread over devices, and cut into blocks.

Seeds are spread over the devices and mapped one after the other on each, so memory does not grow
with their number.  Where there are more devices than seeds, several share the genomes of one
seed's generation.  Blocks are cut by the configuration alone, so that the number of devices
changes no bit of a result.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P

from fntg_jax.objective import Static, Traced, score

# Trials (genomes x scenes) that are simulated side by side.  On a CPU the state of so many stays
# in the cache: a generation of 512 genomes x 32 scenes took 0.16 s of one core in one piece, 0.09 s
# in pieces of 8192 and 0.06 s in pieces of 256 to 512.  A GPU wants many, within its memory.
_BLOCK_TRIALS = {"cpu": 512}
_BLOCK_TRIALS_ELSEWHERE = 1 << 20


def make_mesh(num_seeds: int, population: int, num_scenes: int) -> Mesh:
    """Devices by axes "seed" and "genome".

    Genomes are shared only among devices that the seeds leave idle, and only where a generation
    has a block for each of them: with less, waiting for each other costs what it saves (the
    paper's generation, 240 trials, is one block and 2 ms).
    """
    devices = np.asarray(jax.devices())
    num = min(num_seeds, len(devices))
    share = min(len(devices) // num, num_blocks(population, num_scenes))
    chosen = devices[: num * share]
    idle = jax.process_count() - len({d.process_index for d in chosen})
    if idle:
        raise ValueError(
            f"seeds = {num_seeds}: too few for {jax.process_count()} processes, {idle} of them "
            "would have nothing to do"
        )
    return Mesh(chosen.reshape(num, share), ("seed", "genome"))


def num_blocks(num_genomes: int, num_scenes: int) -> int:
    """Into how many blocks a batch of trials is cut."""
    size = _BLOCK_TRIALS.get(jax.default_backend(), _BLOCK_TRIALS_ELSEWHERE)
    return min(num_genomes, -(-num_genomes * num_scenes // size))


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


def shared_score(
    static: Static, mesh: Mesh, traced: Traced, theta: Any, scenes: Any, progress: Any = 1.0
) -> Any:
    """`objective.score` inside `over_seeds`, block by block, shared by the devices of "genome".

    theta: [P, genes], the same on all of them; all get all of the fitness [P].
    """
    num = theta.shape[0]
    blocks = num_blocks(num, jax.tree.leaves(scenes)[0].shape[0])
    if blocks == 1:
        return score(static, traced, theta, scenes, progress)
    share = mesh.shape["genome"]
    shape = (share, -(-blocks // share), -(-num // blocks), theta.shape[1])
    # Every device gets as many blocks; the surplus is computed and dropped.
    padded = jnp.resize(theta, (shape[0] * shape[1] * shape[2], shape[3])).reshape(shape)
    mine = padded[jax.lax.axis_index("genome")]
    value = jax.lax.map(lambda t: score(static, traced, t, scenes, progress), mine)
    return jax.lax.all_gather(value, "genome").reshape(-1)[:num]
