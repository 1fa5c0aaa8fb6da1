"""Criteria of optimal design: one number of a plan, which the search makes small.

References
----------
A. Atkinson, A. Donev, R. Tobias, "Optimum Experimental Designs, with SAS", Oxford 2007, chapter 10.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.planning.information import Expected

_MISSING = 100.0  # what a parameter without information adds to a criterion

Criterion = Callable[[Expected], float]


def c_optimality(targets: FloatArray) -> Criterion:
    """C-optimality: ln sum (u/target)^2 over the parameters that have a target.

    Parameters
    ----------
    targets : ndarray, shape (P,)
        Standard uncertainties to reach; NaN for a parameter without a target.
    """
    index = np.flatnonzero(np.isfinite(targets))

    def criterion(expected: Expected) -> float:
        estimated = index[expected.determined[index]]
        total = float(np.sum((expected.u[estimated] / targets[estimated]) ** 2))
        missing = len(index) - len(estimated)
        return (np.log(total) if total > 0 else 0.0) + _MISSING * missing

    return criterion


def d_optimality(determined: NDArray[np.bool_]) -> Criterion:
    """D-optimality: ln of the product of the standard uncertainties, whatever their units.

    Parameters
    ----------
    determined : ndarray of bool, shape (P,)
        Parameters that some candidate image determines.
    """
    index = np.flatnonzero(determined)

    def criterion(expected: Expected) -> float:
        estimated = index[expected.determined[index]]
        u = np.maximum(expected.u[estimated], 1e-300)
        return float(np.sum(np.log(u))) + _MISSING * (len(index) - len(estimated))

    return criterion
