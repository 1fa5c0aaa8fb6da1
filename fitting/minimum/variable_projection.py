"""The linear parameters solved for at given values of the others."""

from __future__ import annotations

import numpy as np

from gonio.fitting.minimum.box import Box
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.kernels.boxed import solve_amplitudes


def amplitudes_solved(problem: Problem, p: FloatArray) -> FloatArray:
    """The point with the linear parameters at their best inside the bounds."""
    if not problem.quadratic:
        return p
    return np.asarray(scored(problem, Box.of(problem), p[None])[1][0])


def scored(problem: Problem, box: Box, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """chi-squared and the points, with the linear parameters at their best at each."""
    points = np.array(points, float)
    linear = np.array([j for j, q in enumerate(problem.parameters) if q.linear], np.int64)
    linear = linear[box.lower[linear] < box.upper[linear]]
    if len(linear) == 0:
        return problem.batch_chi2(points), points
    rows = np.concatenate([[0], linear + 1])
    products = problem.products(points, rows)
    chi2 = solve_amplitudes(products, points, linear, box.lower, box.upper, box.c, 1.0)
    return np.where(np.isfinite(chi2), chi2, np.inf), points
