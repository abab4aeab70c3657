"""One robot's whole `control` as a program for other machines: `jax.export`, batch 1.

A folder: control.bin, begin.bin (serialised, versioned StableHLO), control.mlir (the same as
text), signature.json, golden.npz (a robot's senses and actions in a match), run.py (runs them in
a process that has jax and numpy and nothing of this package).
"""

import io
import json
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fntg_jax.files import write_atomically
from fntg_jax.learning import play
from fntg_jax.running import matches
from fntg_jax.running.provenance import version

STEPS, SEED, SHIRT = 100, 5, 1  # of the golden vectors
TOLERANCE = 1e-4  # largest difference of an action's number
PLATFORMS = ("cpu", "cuda", "tpu")

_RUN = '''"""Runs the golden vectors: python run.py.  Needs jax and numpy alone.

control.bin maps (memory..., senses...) to (memory..., action...), begin.bin (shirt, pose) to
(memory...); signature.json names them in order.
"""

import json
from pathlib import Path

import jax
import numpy as np
from jax import export

here = Path(__file__).resolve().parent
begin, control = (
    jax.jit(export.deserialize(bytearray((here / f"{name}.bin").read_bytes())).call)
    for name in ("begin", "control")
)
signature = json.loads((here / "signature.json").read_text())
golden = np.load(here / "golden.npz")
num = len(signature["memory"])
memory = begin(golden["shirt"], golden["pose"])
worst = 0.0
for step in range(len(golden["sense0"])):
    senses = [golden[f"sense{n}"][step] for n in range(len(signature["senses"]))]
    out = control(*memory, *senses)
    memory = out[:num]
    for n, value in enumerate(out[num:]):
        wanted = golden[f"action{n}"][step].astype(np.float64)
        worst = max(worst, float(np.max(np.abs(np.asarray(value, np.float64) - wanted))))
print(f"{step + 1} steps, largest difference {worst:.2g}")
raise SystemExit(worst > signature["tolerance"])
'''


def write(team: str, folder: Path) -> float:
    """Write the folder; returns the largest difference of an action between the program read back
    and the match that the golden vectors are of.  Raises ValueError for an unknown team or one
    that needs the truth, OSError."""
    match = matches.get_match("soccer")
    side = matches.get_team(team, match, 0)
    if side.truth or side.both:
        raise ValueError(f"team = {team!r}: it plays from the truth, which no robot has")
    pose, senses, actions = jax.device_get(jax.jit(partial(_golden, match, side))())
    shirt = np.int32(SHIRT)
    memory = jax.eval_shape(partial(side.begin, side.team), shirt, pose)
    one = jax.tree.map(lambda x: x[0], senses)
    structure: list[Any] = [jax.tree.structure(x) for x in (memory, one)]
    num = structure[0].num_leaves

    def begin(shirt, pose):
        found = jax.tree.leaves(side.begin(side.team, shirt, pose))
        return [jnp.asarray(x, y.dtype) for x, y in zip(found, jax.tree.leaves(memory))]

    def control(*leaves):
        given = (s.unflatten(x) for s, x in zip(structure, (leaves[:num], leaves[num:])))
        return jax.tree.leaves(side.control(side.team, *given))

    arguments = [*map(_shape, jax.tree.leaves((memory, one)))]
    exported = {
        "begin": jax.export.export(jax.jit(begin), platforms=PLATFORMS)(
            _shape(shirt), _shape(pose)
        ),
        "control": jax.export.export(jax.jit(control), platforms=PLATFORMS)(*arguments),
    }
    rows = {f"sense{n}": x for n, x in enumerate(jax.tree.leaves(senses))}
    rows |= {f"action{n}": x for n, x in enumerate(jax.tree.leaves(actions))}
    golden = io.BytesIO()
    np.savez_compressed(golden, shirt=shirt, pose=pose, **rows)
    signature = {
        "format": "fntg-stablehlo",
        "version": 1,
        "team": side.name,
        "fntg_jax": version(),
        "jax": jax.__version__,
        "calling_convention": exported["control"].calling_convention_version,
        "platforms": list(PLATFORMS),
        "control_dt": match.dt,
        "tolerance": TOLERANCE,
        "memory": _names(memory),
        "senses": _names(one),
        "action": _names(jax.tree.map(lambda x: x[0], actions)),
    }
    read = {n: jax.export.deserialize(bytearray(e.serialize())) for n, e in exported.items()}
    error = _check(read, pose, senses, actions)
    folder.mkdir(parents=True, exist_ok=True)
    for name, program in exported.items():
        write_atomically(folder / f"{name}.bin", bytes(program.serialize()))
    write_atomically(folder / "control.mlir", str(exported["control"].mlir_module()).encode())
    text = json.dumps(signature, indent=1, allow_nan=False) + "\n"
    write_atomically(folder / "signature.json", text.encode())
    write_atomically(folder / "golden.npz", golden.getvalue())
    write_atomically(folder / "run.py", _RUN.encode())
    return error


def _shape(x: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(np.shape(x), x.dtype)


def _names(tree: Any) -> list[dict[str, Any]]:
    found, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [
        {
            "name": jax.tree_util.keystr(p).lstrip("."),
            "shape": list(np.shape(x)),
            "dtype": str(x.dtype),
        }
        for p, x in found
    ]


def _golden(match: Any, side: play.Side) -> tuple[Any, Any, Any]:
    """A robot's kick-off pose, and its senses and actions in a match of the team against itself."""
    seeds = jnp.full((1,), SEED, jnp.int32)
    state = match.reset(play.kickoffs(seeds), seeds)
    own = lambda tree: jax.tree.map(lambda a: a[..., SHIRT, 0], tree)  # noqa: E731

    def step(carry, _):
        senses = own(match.sense_batch(carry[0]))
        carry, action = play.control_step(match, side, side, carry)
        return carry, (senses, own(action))

    carry = (state, play.begin(match, side, side, state))
    pose = match.truth_batch(state).pose[:, SHIRT, 0]
    _, (senses, actions) = jax.lax.scan(step, carry, None, length=STEPS)
    return pose, senses, actions


def _check(read: dict[str, Any], pose: Any, senses: Any, actions: Any) -> float:
    memory = read["begin"].call(np.int32(SHIRT), pose)
    control, worst = jax.jit(read["control"].call), 0.0
    for n in range(STEPS):
        out = control(*memory, *(x[n] for x in jax.tree.leaves(senses)))
        memory = out[: len(memory)]
        for value, wanted in zip(out[len(memory) :], jax.tree.leaves(actions)):
            gap = np.abs(np.asarray(value, np.float64) - np.asarray(wanted[n], np.float64))
            worst = max(worst, float(gap.max()))
    return worst
