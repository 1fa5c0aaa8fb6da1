"""Whether a kernel's derivatives are those of its model."""

from __future__ import annotations

import numpy as np

from gonio.fitting.minimum import starting_values
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

SAME_GRADIENT = 1e-3  # of the largest derivative: agreement with a difference quotient
CHECKED = 12  # samples at which derivatives are compared


def gradient_faults(problem: Problem, p: FloatArray) -> list[str]:
    """Parameters whose derivative, as the kernel gives it, is no derivative of the model.

    The derivatives of a few samples are compared with central differences; a wrong one moves the
    point at which the fit stops and believes itself at the minimum.
    """
    parameters = problem.parameters
    some = _telling(problem, p)
    faulty = []
    for j, q in enumerate(parameters):
        width = q.upper - q.lower
        size = abs(p[j]) if q.scale == "log" else max(abs(p[j]), 1e-3 * width)
        step = float(np.finfo(float).eps ** (1 / 3) * size)
        if not 0 < 2 * step < width:
            continue
        centre = p.copy()
        centre[j] = min(max(p[j], q.lower + step), q.upper - step)
        ends = [centre.copy(), centre.copy()]
        ends[0][j] += step
        ends[1][j] -= step
        quotient = (some.values(ends[0]) - some.values(ends[1])) / (2 * step)
        f, jac = some.jacobian(centre)
        analytic = jac[:, j]
        largest = max(abs(analytic).max(), abs(quotient).max())
        rounding = 1e-14 * abs(f).max() / step
        if not abs(analytic - quotient).max() <= SAME_GRADIENT * largest + rounding:
            faulty.append(q.name)
    return faulty


def _telling(problem: Problem, p: FloatArray) -> Problem:
    """A few samples: those on which each derivative is strongest, and some over all."""
    coarse = starting_values.few(problem) if problem.n > 2 * starting_values.FEW else problem
    _, jac = coarse.jacobian(p)
    n, strong = coarse.n, min(4, coarse.n)
    weighted = abs(jac) * np.sqrt(coarse.inverse_variance)[:, None]
    strongest = np.argpartition(weighted, -strong, axis=0)[-strong:]
    taken = np.zeros(n, bool)
    taken[strongest] = True
    taken[np.linspace(0, n - 1, min(CHECKED, n)).astype(np.int64)] = True
    return coarse.at(np.flatnonzero(taken))
