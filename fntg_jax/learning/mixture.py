"""Several teams as one program: which of them plays is data, so that every pairing of a league or
of a generation runs in the same batch."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from fntg_jax.learning.play import Side


def mixture(sides: Sequence[Side]) -> tuple[Side, Any]:
    """A side that can be any of these, and their parameters stacked, leaves [len(sides), ...]: what
    row n of them makes of it plays as sides[n].

    Teams of the same functions share them and differ in numbers; the others are all computed and
    one is taken.  A team is (index of its functions, parameters for each of the functions).
    """
    kinds: list[Side] = []
    kind_of = []
    for side in sides:
        same = [n for n, kind in enumerate(kinds) if _same(kind, side)]
        kind_of.append(same[0] if same else len(kinds))
        if not same:
            kinds.append(side)
    # A team without parameters for some functions has those of the first that has them: unused.
    rows = [
        (jnp.int32(own), tuple(side.team if n == own else k.team for n, k in enumerate(kinds)))
        for side, own in zip(sides, kind_of)
    ]
    stacked = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(leaf) for leaf in x]), *rows)

    def begin(team, shirt, pose):
        return tuple(k.begin(own, shirt, pose) for k, own in zip(kinds, team[1]))

    def control(team, memory, given):
        which, parameters = team
        senses, truth = given
        after, action = [], None
        for n, (kind, own, mine) in enumerate(zip(kinds, parameters, memory)):
            seen = given if kind.both else truth if kind.truth else senses
            new, wanted = kind.control(own, mine, seen)
            after.append(new)
            action = (
                wanted
                if action is None
                else jax.tree.map(lambda a, b, n=n: jnp.where(which == n, a, b), wanted, action)
            )
        return tuple(after), action

    return Side("mixture", None, begin, control, both=True), stacked


def _same(a: Side, b: Side) -> bool:
    structures: list[Any] = [jax.tree.structure(x.team) for x in (a, b)]
    return (a.begin, a.control, a.truth) == (b.begin, b.control, b.truth) and (
        structures[0] == structures[1]
        and [jnp.shape(x) for x in jax.tree.leaves(a.team)]
        == [jnp.shape(x) for x in jax.tree.leaves(b.team)]
    )
