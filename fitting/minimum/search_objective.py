"""What a search makes small: chi-squared of the nonlinear parameters, the linear ones solved for.

At each point the amplitudes take their best values inside their bounds (variable projection), so
that only widths, roughness and refractive indices are searched. chi-squared is stationary in the
amplitudes there: its slope is that with the amplitudes held.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.box import Box
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.kernels.boxed import solve_amplitudes
from gonio.models import Parameter

TINY = 1e-300


class Objective:
    """chi2 / chi2(start) over variables in [0, 1], and the best point that it saw.

    Unscaled, SLSQP stops after one step. Parameters that are declared logarithmic are searched by
    their logarithm. Where the loss is not chi-squared, amplitudes are searched with the rest.

    Parameters
    ----------
    problem : Problem
    start : ndarray, shape (P,)

    Attributes
    ----------
    start : ndarray, shape (V,)
        Variables of the start.
    best : ndarray, shape (P,)
        The point with the least chi-squared so far.
    passes : int
        Passes over the data.
    """

    def __init__(self, problem: Problem, start: FloatArray) -> None:
        self.problem = problem
        self.box = Box.of(problem)
        moves = self.box.lower < self.box.upper
        solved = np.array([problem.quadratic and q.linear for q in problem.parameters], bool)
        self.amplitudes = np.flatnonzero(solved & moves)
        self.searched = np.flatnonzero(~solved & moves)
        self.axes = [_Axis(problem.parameters[j]) for j in self.searched]
        # A sum of which only amplitudes are part is kept where these are solved for.
        self.sum_moves = bool(np.any(self.box.c[self.searched]))
        self.rows: NDArray[np.int64] = np.concatenate([[0], self.amplitudes + 1])
        self.passes = 0
        self.least = math.inf
        self.best = self.box.inside(np.array(start, float))
        self.start = np.array(
            [axis.variable(self.best[j]) for axis, j in zip(self.axes, self.searched, strict=True)]
        )
        self.reference = 1.0
        self.reference = max(self(self.start, np.empty(0)), TINY)

    def __call__(self, x: FloatArray, gradient: FloatArray) -> float:
        """The objective, and its slope in `gradient` unless that is empty, as nlopt asks for it."""
        p = self.best.copy()
        for j, axis, variable in zip(self.searched, self.axes, x.tolist(), strict=True):
            p[j] = axis.value(variable)
        if self.sum_moves:
            p = self.box.inside(p)
        chi2 = math.inf
        if len(self.amplitudes):
            chi2 = self._solved(p)
        if gradient.size:
            chi2, g, _ = self.problem.normal_equations(p)
            self.passes += 1
            for k, (j, axis) in enumerate(zip(self.searched, self.axes, strict=True)):
                gradient[k] = -2 * g[j] * axis.slope(p[j]) / self.reference
        elif not len(self.amplitudes):
            chi2 = float(self.problem.batch_chi2(p[None])[0])
            self.passes += 1
        if chi2 < self.least:
            self.least, self.best = chi2, p
        return chi2 / self.reference

    def _solved(self, p: FloatArray) -> float:
        """chi-squared with the amplitudes of p at their best, which are put into p."""
        products = self.problem.products(p[None], self.rows)
        self.passes += 1
        box = self.box
        chi2 = solve_amplitudes(
            products, p[None], self.amplitudes, box.lower, box.upper, box.c, 1.0
        )
        return float(chi2[0]) if math.isfinite(chi2[0]) else math.inf


class _Axis:
    """One searched parameter between its bounds, by a variable between 0 and 1."""

    def __init__(self, q: Parameter) -> None:
        self.log = q.scale == "log"
        self.lower, self.upper = q.lower, q.upper
        self.first = math.log(q.lower) if self.log else q.lower
        self.span = (math.log(q.upper) if self.log else q.upper) - self.first

    def variable(self, value: float) -> float:
        inner = (math.log(value) if self.log else value) - self.first
        return min(max(inner / self.span, 0.0), 1.0)

    def value(self, variable: float) -> float:
        inner = self.first + variable * self.span
        return min(max(math.exp(inner) if self.log else inner, self.lower), self.upper)

    def slope(self, value: float) -> float:
        """Change of the parameter by that of the variable."""
        return self.span * (value if self.log else 1.0)
