"""Other minima that fit almost as well."""

from __future__ import annotations

import numpy as np

from gonio.fitting.minimum import starting_values
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import CHI2_95, goodness
from gonio.fitting.problem.protocol import Problem


def rival(problem: Problem, optimum: Optimum, other: Optimum) -> list[str]:
    """A warning where another minimum, far from the deepest, fits almost as well."""
    noise = goodness(problem, optimum)[2]
    step = starting_values.ordered(problem, other.p) - starting_values.ordered(problem, optimum.p)
    apart = float(step @ optimum.curvature @ step) > 25 * noise**2
    apart = apart and bool(np.all(np.diag(optimum.curvature) > 0))
    if not (apart and other.verified and other.chi2 - optimum.chi2 < CHI2_95 * noise**2):
        return []
    return [
        f"the data hardly prefer this minimum to another one at {parameter_text(problem, other)}."
    ]


def parameter_text(problem: Problem, optimum: Optimum) -> str:
    """Parameters at a minimum, in file units, as text."""
    return ", ".join(
        f"{q.name} = {q.to_file(float(v)):.4g}"
        for q, v in zip(problem.parameters, optimum.p, strict=True)
    )
