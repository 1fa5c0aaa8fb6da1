"""Where a parameter vector may lie: bounds, and a limit on a sum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray


@dataclass(frozen=True)
class Box:
    """Where a parameter vector may lie: bounds, and a limit on a sum.

    Parameters
    ----------
    lower, upper : ndarray, shape (P,)
    c : ndarray, shape (P,)
        Coefficients of the limit c . p <= 1; all 0 where there is none.
    """

    lower: FloatArray
    upper: FloatArray
    c: FloatArray

    @classmethod
    def of(cls, problem: Problem) -> Box:
        """The box of a problem's parameters."""
        parameters = problem.parameters
        lower = np.array([q.lower for q in parameters])
        return cls(lower, np.array([q.upper for q in parameters]), problem.sum_limit)

    def inside(self, p: FloatArray) -> FloatArray:
        """The point moved into the bounds, then towards the lower ones until the sum fits.

        A point within rounding of a bound is put on it.
        """
        hair = 1e-15 * (self.upper - self.lower)
        p = np.where(p <= self.lower + hair, self.lower, p)
        p = np.where(p >= self.upper - hair, self.upper, p)
        total = float(self.c @ p)
        if total > 1.0:
            low = float(self.c @ self.lower)
            share = max(1.0 - low, 0.0) / (total - low) if total > low else 0.0
            p = np.where(self.c > 0, self.lower + share * (p - self.lower), p)
        return p
