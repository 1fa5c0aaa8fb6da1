"""Grids of points over the nonlinear parameters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.models import Parameter

GRID = 9  # values along each nonlinear parameter, where there are few
MOST = 800  # points of a grid
NEAR = 4.0  # bounds by at most this factor beyond the range of starting values are tried as well


@lru_cache(maxsize=256)
def _axis(q: Parameter, n: int, *, between: bool = False) -> FloatArray:
    """Values along one parameter; with a value between the range of starts and a near bound."""
    if q.lower == q.upper:
        return np.array([q.lower])
    low, high = q.start or (q.lower, q.upper)
    low, high = max(low, q.lower), min(high, q.upper)
    if q.scale != "log":
        return np.linspace(low, high, n)
    # A lobe as wide or as narrow as it may be is a minimum of its own where none is seen.
    ends = [
        end for end in (q.lower, q.upper) if high < end <= NEAR * high or low / NEAR <= end < low
    ]
    values = [*np.geomspace(low, high, max(n - len(ends) + 1, 2)), *ends]
    if between:
        values += [float(np.sqrt(end * (low if end < low else high))) for end in ends]
    return np.sort(values)


def _counts(problem: Problem, index: Sequence[int], most: int) -> int:
    """Values along each parameter so that a grid has at most `most` points."""
    free = sum(problem.parameters[j].lower < problem.parameters[j].upper for j in index)
    n = GRID
    while n > 2 and n**free > most:
        n -= 1
    return n


def grid_size(problem: Problem, index: Sequence[int]) -> int:
    free = sum(problem.parameters[j].lower < problem.parameters[j].upper for j in index)
    return int(GRID**free)


def grid(problem: Problem, index: Sequence[int], base: FloatArray, most: int = MOST) -> FloatArray:
    """All points of a grid over these parameters, the others as in `base`."""
    n = _counts(problem, index, most)
    axes = [_axis(problem.parameters[j], n, between=True) for j in index]
    if math.prod(map(len, axes)) > most:
        axes = [_axis(problem.parameters[j], n) for j in index]
    if n ** len(index) > 4 * most:
        mixed = _low_discrepancy(len(index), most)
        axes = [_axis(problem.parameters[j], most) for j in index]
        values = np.array(
            [a[np.minimum((m * len(a)).astype(int), len(a) - 1)]
             for a, m in zip(axes, mixed.T, strict=True)]
        ).T  # fmt: skip
    else:
        values = np.array(list(itertools.product(*axes)), float)
    points = np.repeat(base[None], len(values), axis=0)
    points[:, list(index)] = values
    return points


def _low_discrepancy(dimensions: int, n: int) -> FloatArray:
    """Roberts' sequence: multiples of powers of the generalised golden ratio, modulo 1."""
    phi = 2.0
    for _ in range(60):
        phi = (1 + phi) ** (1 / (dimensions + 1))
    steps = phi ** -np.arange(1.0, dimensions + 1)
    return np.asarray((0.5 + np.arange(1, n + 1)[:, None] * steps) % 1.0)
