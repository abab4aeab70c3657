"""Spreading work over devices: the same bits on one as on several."""

import json

import pytest

# In a process of its own: the number of CPU devices is fixed when jax starts.
PROGRAM = """
import dataclasses, hashlib, json
from fntg_jax.running import problem, xla
xla.configure(num_cpu_devices=4)
import jax
from fntg_jax.running import settings, final_choice as choice, runner

def spread(seeds, counts, conclude):
    config = settings.PRESETS["robust"]
    config = dataclasses.replace(
        config, seeds=seeds, generations=2, num_scenes=32, scene_pool=64,
        refine_steps=3, refine_scenes=32,
        ga=dataclasses.replace(config.ga, population=48),
    )
    problem.VALIDATION, choice._SCREENING = 96, 64
    devices = jax.devices()
    found = []
    for num in counts:
        jax.devices = lambda: devices[:num]
        run = runner.train(config)
        result = run.conclude() if conclude else None
        refined = (result.theta, result.fitness, result.refined) if conclude else ()
        arrays = (*run.history(), *refined)
        digest = hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()
        found.append((tuple(run.rows.mesh.shape.values()), digest))
    print(json.dumps(found))
"""


def spread(python, *arguments):
    """Meshes (seed, genome) by number of devices, and whether all found the same."""
    found = json.loads(python(f"{PROGRAM}\nspread{arguments}"))
    return [tuple(mesh) for mesh, _ in found], len({digest for _, digest in found}) == 1


@pytest.mark.slow
def test_genomes_of_one_seed_are_shared(python):
    # Three blocks of genomes, so that one of two devices has less to do.
    assert spread(python, 1, (1, 2), False) == ([(1, 1), (1, 2)], True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "counts", "meshes"),
    [
        (1, (1, 2, 4), [(1, 1), (1, 2), (1, 3)]),
        (2, (1, 2, 4), [(1, 1), (2, 1), (2, 2)]),
        (3, (1, 2, 4), [(1, 1), (2, 1), (3, 1)]),
    ],
)
def test_seeds_come_first_and_genomes_share_what_is_left(python, seeds, counts, meshes):
    assert spread(python, seeds, counts, True) == (meshes, True)
