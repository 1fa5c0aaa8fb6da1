"""A minimum of chi-squared as the search leaves it, and which of two is deeper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray

DEEPER = 1e-9  # relative difference of chi-squared that is not rounding


@dataclass(frozen=True)
class Optimum:
    """A minimum of chi-squared.

    Parameters
    ----------
    p : ndarray
        Parameters.
    chi2 : float
    gradient, curvature : ndarray
        J^T W r and J^T W J at p.
    free : ndarray of bool
        Parameters that do not lie on a bound.
    evaluations : int
        Model passes over the data.
    verified : bool
        The next Gauss-Newton step is far below the uncertainties, and half a standard uncertainty
        away along every axis of the uncertainty ellipsoid chi-squared is larger.
    limited : tuple of int
        Reflectances whose sum would exceed 1 were it not held there; empty where it is not.
    """

    p: FloatArray
    chi2: float
    gradient: FloatArray
    curvature: FloatArray
    free: NDArray[np.bool_]
    evaluations: int
    verified: bool
    limited: tuple[int, ...] = ()


def better(first: Optimum, second: Optimum) -> Optimum:
    """The deeper of two minima; the verified one, else the first, where they are the same."""
    slack = DEEPER * min(first.chi2, second.chi2)
    if second.chi2 < first.chi2 - slack:
        return second
    if second.chi2 <= first.chi2 + slack and second.verified and not first.verified:
        return second
    return first
