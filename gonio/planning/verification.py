"""Check of a plan by simulation: the scatter of fits against the expected uncertainties."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.calibration.reduction.reduce import reduce
from gonio.fitting.fit import fit
from gonio.metadata import Channel
from gonio.planning.result import DesignResult
from gonio.progress import StagedProgress, begin


def verify(
    result: DesignResult, n_seeds: int, *, progress: StagedProgress | None = None
) -> dict[str, Any]:
    """Scatter of fits to simulated sessions against what was expected of it.

    Parameters
    ----------
    result : DesignResult
    n_seeds : int
        Sessions to simulate, at least 2.
    progress : callable, optional
        Called with (stage, seeds done, seeds in all).

    Returns
    -------
    dict
        ``seeds``, ``relative_sd_of_scatter``, and under ``parameters`` for each its predicted
        standard deviation, the scatter, their ratio and the bias, in the unit of files.
    """
    setup = result.setup
    plan = result.plan.model_copy(update={"channels": (Channel(),)})
    callback = begin(progress, f"verifying with {n_seeds} seeds", "seeds")
    fitted = []
    for seed in range(n_seeds):
        samples = reduce(setup.drawn(plan, seed), threads=setup.threads)
        estimate = fit(
            samples,
            model=setup.model,
            fixed=setup.constraints.fixed,
            tied=setup.constraints.tied,
            threads=setup.threads,
        )
        fitted.append([q.to_file(estimate.parameters[q.name].value) for q in setup.unknowns])
        if callback is not None:
            callback(seed + 1, n_seeds)
    values = np.array(fitted)
    rows = []
    for j, q in enumerate(setup.unknowns):
        determined = bool(result.expected.determined[j])
        components = result.expected.components
        parts = {k: u[j] for k, u in components.items() if k not in result.constant}
        predicted = (
            q.to_file(float(np.sqrt(sum(u**2 for u in parts.values())))) if determined else None
        )
        scatter = float(values[:, j].std(ddof=1))
        rows.append(
            {
                "name": q.name,
                "predicted": predicted,
                "scatter": scatter,
                "ratio": scatter / predicted if predicted else None,
                "bias": float(values[:, j].mean() - q.to_file(result.parameters[q.name])),
            }
        )
    return {
        "seeds": n_seeds,
        "relative_sd_of_scatter": 1 / math.sqrt(2 * (n_seeds - 1)),
        "parameters": rows,
    }
