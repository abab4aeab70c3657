"""How the work of a learning run is spread over devices.

Seeds are spread over the devices and mapped one after the other on each, so memory does not grow
with their number.  Where there are more devices than seeds, several share the blocks of trials of
one seed's generation (`rollout.rollout_pairs`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from fntg_jax.learning.objective import AXIS
from fntg_jax.running import hosts, memory

GENOME = AXIS


def make_mesh(num_seeds: int, blocks: int) -> Mesh:
    """Devices by axes "seed" and "genome".

    A generation's trials (genomes x scenes) are shared only among devices that the seeds leave
    idle, and only where it has a block for each of them: with less, waiting for each other costs
    what it saves (the paper's generation, 240 trials, is one block and 2 ms).

    Args:
        num_seeds: rows that advance together.
        blocks: of one row's generation (`Problem.blocks`).

    Raises ValueError where a process would have nothing to do.
    """
    devices = np.asarray(jax.devices())
    num = min(num_seeds, len(devices))
    share = min(len(devices) // num, blocks)
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

    Args:
        fn: what all rows use has to be passed as its first argument: arrays that it closes over
            keep a sharding that does not fit inside.
        mesh: of `make_mesh`.
    """
    return jax.shard_map(
        lambda shared, rows: jax.lax.map(lambda row: fn(shared, *row), rows),
        mesh=mesh,
        in_specs=(P(), P("seed")),
        out_specs=P("seed"),
        check_vma=False,
    )


class Rows(NamedTuple):
    """Where the rows of a run lie: its seeds (and variants), spread over the devices of a mesh."""

    mesh: Mesh
    num: int

    def place(self, values: Any, fn: Callable[[Any], Any] = lambda x: x) -> Any:
        """Something computed from values, on the devices of the rows.

        Every device gets as many rows: the last ones are repeated, computed and dropped.

        Args:
            values: leaves [num, ...].
            fn: of all of them, compiled.
        """
        size = self.mesh.shape["seed"]
        row = np.arange(-(-self.num // size) * size) % self.num
        return self._place(jax.tree.map(lambda x: np.asarray(x)[row], values), P("seed"), fn)

    def share(self, values: Any) -> Any:
        """Values that all rows use, on all devices.

        Args:
            values: a pytree of arrays.
        """
        return self._place(values, P(), lambda x: x)

    def gather(self, values: Any) -> Any:
        """As NumPy [num, ...].

        Args:
            values: what was placed, or computed from it.
        """
        return jax.tree.map(lambda x: hosts.gather(x)[: self.num], values)

    def compile(self, program: Any, arguments: tuple) -> Any:
        """A jitted function compiled for its arguments.

        Args:
            program: of `jax.jit`.
            arguments: of a call.

        Raises ValueError (one line) where memory will not do.
        """
        compiled = program.lower(*arguments).compile()
        memory.check(compiled, len(self.mesh.local_devices))
        return compiled

    def _place(self, values, spec, fn):
        # By the compiler, because `jax.device_put` does not reach the devices of other processes.
        values = jax.tree.map(np.asarray, values)
        return self.compile(jax.jit(fn, out_shardings=NamedSharding(self.mesh, spec)), (values,))(
            values
        )
