"""What a run of a task other than bioa came to: its genes by name, as JSON values."""

from typing import Any

import jax
import numpy as np

from fntg_jax.running.provenance import version
from fntg_jax.running.runner import Result, Run


def document(run: Run, result: Result) -> dict[str, Any]:
    """The best of all seeds: genes with unit and value, fitness, judgement, provenance.

    Args:
        run: completed, of a task other than bioa.
        result: of `run.conclude()`.
    """
    config = run.config
    best = int(np.argmax(result.fitness))
    judged = {name: _number(x[best]) for name, x in (result.judgement or {}).items()}
    return {
        "format": "fntg-genes",
        "version": 1,
        "task": config.task,
        "genes": [
            {"name": gene.name, "unit": gene.unit, "value": float(x)}
            for gene, x in zip(run.problem.genes, result.theta[best])
        ],
        "fitness": _number(result.fitness[best]),
        "judgement": judged,
        "provenance": {
            "task_options": config.task_options,
            "generations": run.generation,
            "population": config.ga.population,
            "seed": config.first_seed + best,
            "best_of_seeds": config.seeds,
            "fntg_jax": version(),
            "jax": jax.__version__,
        },
    }


def _number(value: Any) -> float | None:
    """None where it is not finite."""
    return float(value) if np.isfinite(value) else None
