"""Starting values of a joint fit: what separate fits agree on, and a grid."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.joint import JointProblem, base_name
from gonio.geometry import FloatArray
from gonio.kernels.boxed import UNDETERMINED
from gonio.models import Parameter

POINTS = (9, 9, 5, 3)  # of the grid along each shared nonlinear parameter, by how many there are
SUBSET = 4000  # samples that choose among the points of the grid
FOLLOWED = 2  # points of the grid that are followed to their minimum


def joint_starts(problem: JointProblem, alone: Sequence[Minimum]) -> list[FloatArray]:
    """What the separate fits agree on, and the best points of a grid over what is shared."""
    agreed = _agreed(problem, alone)
    shared = [
        j for j, q in enumerate(problem.parameters) if q.name == base_name(q.name) and not q.linear
    ]
    if not shared:
        return [agreed]
    coarse = problem.subset(SUBSET)
    n = POINTS[min(len(shared), len(POINTS)) - 1]
    varied = [problem.parameters[j] for j in shared]
    axes = [_grid(q, n) for q in varied]
    nearest = [
        int(np.argmin(np.abs(_even(q, axis) - _even(q, agreed[j]))))
        for q, axis, j in zip(varied, axes, shared, strict=True)
    ]
    inside = all(q.lower < agreed[j] < q.upper for q, j in zip(varied, shared, strict=True))
    scored: list[tuple[float, FloatArray]] = []
    for index in itertools.product(range(n), repeat=len(shared)):
        p = agreed.copy()
        p[shared] = [a[i] for a, i in zip(axes, index, strict=True)]
        near = inside and all(abs(i - k) <= 1 for i, k in zip(index, nearest, strict=True))
        chi2, solved = _amplitudes_solved(coarse, p)
        # A neighbour of what the parts agree on leads to the same minimum.
        scored.append((chi2, agreed if near else solved))
    scored.sort(key=lambda item: item[0])
    return [agreed, *(p for _, p in scored[:FOLLOWED] if p is not agreed)]


def _even(q: Parameter, value: Any) -> Any:
    """Values on the scale on which the points of the grid lie evenly."""
    return np.log(value) if q.scale == "log" else value


def _agreed(problem: JointProblem, alone: Sequence[Minimum]) -> FloatArray:
    """Mean of the separate minima, weighted by their curvature."""
    n_p = len(problem.parameters)
    h, g = np.zeros((n_p, n_p)), np.zeros(n_p)
    fallback = np.zeros(n_p)
    for minimum, columns, scale in zip(alone, problem.indices, problem.scales, strict=True):
        own = minimum.optimum.curvature / scale**2
        h[np.ix_(columns, columns)] += own
        g[columns] += own @ minimum.optimum.p
        fallback[columns] = minimum.optimum.p
    informed = np.diag(h) > 0
    unit = np.where(informed, 1 / np.sqrt(np.where(informed, np.diag(h), 1.0)), 0.0)
    mean = unit * (np.linalg.pinv(h * np.outer(unit, unit), rcond=UNDETERMINED) @ (unit * g))
    lower = np.array([q.lower for q in problem.parameters])
    upper = np.array([q.upper for q in problem.parameters])
    return np.clip(np.where(informed, mean, fallback), lower, upper)


def _grid(q: Parameter, n: int) -> FloatArray:
    low, high = q.start or (q.lower, q.upper)
    return np.geomspace(low, high, n) if q.scale == "log" else np.linspace(low, high, n)


def _amplitudes_solved(problem: JointProblem, p: FloatArray) -> tuple[float, FloatArray]:
    """chi2 and the point with each part's own linear parameters at their best: parts separate."""
    total, solved = 0.0, p.copy()
    names = [q.name for q in problem.parameters]
    for part, _, columns in problem.pieces():
        own = [
            k
            for k, j in enumerate(columns)
            if problem.parameters[j].linear and names[j] != base_name(names[j])
        ]
        chi2, g, h = part.normal_equations(p[columns])
        step = np.linalg.pinv(h[np.ix_(own, own)], rcond=UNDETERMINED) @ g[own]
        ends = [problem.parameters[j] for j in columns[own]]
        new = np.clip(p[columns[own]] + step, [q.lower for q in ends], [q.upper for q in ends])
        d = new - p[columns[own]]
        total += float(chi2 - 2 * g[own] @ d + d @ h[np.ix_(own, own)] @ d)
        solved[columns[own]] = new
    return total, solved
