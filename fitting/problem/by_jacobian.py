"""The loss and its normal equations from values and derivatives, whatever the loss.

Compiled loops that make the sums at once (`gonio.fitting.problem.single`) need neither; they are
for chi-squared over one model alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray


def loss(problem: Problem, p: FloatArray) -> float:
    """The loss at p."""
    y, w = problem.samples.value, problem.inverse_variance
    return problem.law.total(y, problem.values(p), w, problem.cos_theta_r)


def normal_equations(problem: Problem, p: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """The loss, minus half its slope, and a curvature that is not negative, at p."""
    f, jac = problem.jacobian(p)
    y, w, cos_r = problem.samples.value, problem.inverse_variance, problem.cos_theta_r
    r, v = problem.law.linearised(y, f, w, cos_r)
    weighted = jac * v[:, None]
    return problem.law.total(y, f, w, cos_r), weighted.T @ r, weighted.T @ jac


def products(problem: Problem, points: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """`Problem.products` from the normal equations at each point."""
    return np.array([_chosen(*problem.normal_equations(p), rows) for p in points])


def _chosen(chi2: float, g: FloatArray, h: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    full = np.empty((len(g) + 1, len(g) + 1))
    full[0, 0], full[0, 1:], full[1:, 0], full[1:, 1:] = chi2, g, g, h
    return full[np.ix_(rows, rows)]
