"""Profile likelihood: chi-squared with one parameter held, the others free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.minimise import minimise, pinned_at
from gonio.fitting.minimum.record import Minimum
from gonio.geometry import FloatArray


def around(minimum: Minimum, j: int) -> tuple[Minimum, int, NDArray[np.int64]]:
    """The smallest problem in which parameter j can be followed, at its minimum.

    With the number of the parameter there, and the indices of its parameters in the whole.
    """
    problem, optimum = minimum.problem, minimum.optimum
    small, index = problem.around(optimum.p, optimum.curvature, j)
    at = int(np.flatnonzero(index == j)[0])
    if small is problem:
        return minimum, at, index
    p = optimum.p[index]
    chi2, g, h = small.normal_equations(p)
    own = replace(optimum, p=p, chi2=chi2, gradient=g, curvature=h, free=optimum.free[index])
    return minimum.at(small, own), at, index


def profile_limit(
    minimum: Minimum,
    j: int,
    increase: float,
    *,
    side: int,
    steps: int = 40,
) -> float | None:
    """How far parameter j can move before the minimum of chi-squared grows by `increase`.

    The other parameters follow to their minimum at each value. None where chi-squared never
    grows so much inside the bounds: the data do not limit the parameter.

    Parameters
    ----------
    side : {1, -1}
        +1 upwards, -1 downwards.
    """
    minimum, j, _ = around(minimum, j)
    problem, optimum = minimum.problem, minimum.optimum
    parameter = problem.parameters[j]
    near, far = float(optimum.p[j]), parameter.upper if side > 0 else parameter.lower

    def excess(value: float) -> float:
        start = np.where(np.arange(len(optimum.p)) == j, value, optimum.p)
        held = minimise(pinned_at(problem, j, value), start, search=False)
        return held.chi2 - optimum.chi2 - increase

    if excess(far) <= 0:
        return None
    low, high = near, far
    for _ in range(steps):
        middle = (low + high) / 2
        if excess(middle) > 0:
            high = middle
        else:
            low = middle
        if abs(high - low) <= 1e-3 * abs(high - near):
            break
    return (low + high) / 2


def profile(minimum: Minimum, j: int, points: FloatArray) -> FloatArray:
    """Smallest chi-squared with parameter j held at each of the points, the others free.

    Parameters
    ----------
    minimum : Minimum
    j : int
        Number of the parameter.
    points : ndarray, shape (K,)
        Values inside the bounds, in the unit of Python.

    Returns
    -------
    ndarray, shape (K,)
        Each point starts from the minimum of its neighbour towards the optimum.
    """
    problem, optimum = minimum.problem, minimum.optimum
    chi2 = np.empty(len(points))
    order = np.argsort(points)
    at = int(np.searchsorted(points[order], optimum.p[j]))
    for run in (order[at:], order[:at][::-1]):
        start = optimum.p
        for k in run:
            start = np.where(np.arange(len(start)) == j, points[k], start)
            held = minimise(pinned_at(problem, j, float(points[k])), start, search=False)
            chi2[k], start = held.chi2, held.p
    return chi2
