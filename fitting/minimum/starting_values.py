"""Starting values: the nonlinear parameters searched, the linear ones solved for.

The linear parameters are those in which f is linear, so that chi-squared is quadratic in them: one
pass over a few samples gives their best values between the bounds at each point of the search
(variable projection), and only widths, roughness and refractive indices need a search.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.losses import CHI2
from gonio.fitting.problem.problem import Problem
from gonio.geometry import FloatArray
from gonio.kernels.boxed import solve_amplitudes
from gonio.models import Parameter

SUBSET = 2000  # samples that choose among the starting values
FEW = 400  # samples that choose which points these are asked about
GRID = 9  # values along each nonlinear parameter, where there are few
MOST = 800  # points of a grid
RESCORED = 10
TURN = 410  # points when a lobe is added
BEAM = 5  # combinations of lobes that are kept while lobes are added
APART = 0.4  # of the sum of two values: starts that are nearer in all parameters are one


@dataclass(frozen=True)
class Box:
    """Where a parameter vector may lie: bounds, and a limit on a sum.

    Parameters
    ----------
    lower, upper : ndarray, shape (P,)
    c : ndarray, shape (P,)
        1 for the parameters whose sum is at most 1; all 0 where there is no limit.
    """

    lower: FloatArray
    upper: FloatArray
    c: FloatArray

    @classmethod
    def of(cls, problem: Problem) -> Box:
        """The box of a problem's parameters."""
        parameters = problem.parameters
        c = np.zeros(len(parameters))
        c[list(problem.sum_at_most_one)] = 1.0
        lower = np.array([q.lower for q in parameters])
        return cls(lower, np.array([q.upper for q in parameters]), c)

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


def amplitudes_solved(problem: Problem, p: FloatArray) -> FloatArray:
    """The point with the linear parameters at their best inside the bounds."""
    if not problem.quadratic:
        return p
    return np.asarray(scored(problem, Box.of(problem), p[None])[1][0])


def candidates(problem: Problem, n: int) -> list[FloatArray]:
    """The best n starting values that are not neighbours of a better one.

    All points of a grid where these are few. Else lobe by lobe: those of a sum are added one
    after the other, each on a grid beside the best combinations of those before, and then each is
    searched again beside the others.
    """
    coarse = problem.subset(SUBSET)
    if not coarse.quadratic:
        # Amplitudes are solved for in chi-squared, whatever is fitted then.
        coarse = replace(coarse, loss=CHI2.name)
    few = _few(coarse)
    box = Box.of(problem)
    groups = _groups(problem)
    base = np.minimum(np.maximum(0.0, box.lower), box.upper)
    nonlinear = [j for j, q in enumerate(problem.parameters) if not q.linear]
    base[nonlinear] = [problem.parameters[j].default for j in nonlinear]
    base = np.clip(base, box.lower, box.upper)
    if len(groups) < 2 or _size(problem, nonlinear) <= MOST:
        points = _grid(problem, nonlinear, base)
    else:
        points = _lobe_by_lobe(problem, few, box, groups, base)
    points = np.array([ordered(problem, p) for p in points]) if len(groups) > 1 else points
    chi2, solved = scored(few, box, points)
    if few is not coarse:
        best = np.argsort(chi2, kind="stable")[: max(RESCORED, 4 * n)]
        chi2, solved = scored(coarse, box, solved[best])
    return _distinct(chi2, solved, n)


def ordered(problem: Problem, p: FloatArray) -> FloatArray:
    """The same f with lobes of one kind in the order of their parameters."""
    result = p
    for same in _alike(problem):
        parts = sorted((tuple(p[group]) for group in same), key=lambda part: part[::-1])
        if result is p:
            result = p.copy()
        for group, part in zip(same, parts, strict=True):
            result[group] = part
    return result


def _few(coarse: Problem) -> Problem:
    return coarse.subset(FEW) if coarse.n > 2 * FEW else coarse


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


def _axis(q: Parameter, n: int) -> FloatArray:
    if q.lower == q.upper:
        return np.array([q.lower])
    low, high = q.start or (q.lower, q.upper)
    low, high = max(low, q.lower), min(high, q.upper)
    return np.geomspace(low, high, n) if q.scale == "log" else np.linspace(low, high, n)


def _counts(problem: Problem, index: Sequence[int], most: int) -> int:
    """Values along each parameter so that a grid has at most `most` points."""
    free = sum(problem.parameters[j].lower < problem.parameters[j].upper for j in index)
    n = GRID
    while n > 2 and n**free > most:
        n -= 1
    return n


def _size(problem: Problem, index: Sequence[int]) -> int:
    free = sum(problem.parameters[j].lower < problem.parameters[j].upper for j in index)
    return int(GRID**free)


def _grid(problem: Problem, index: Sequence[int], base: FloatArray, most: int = MOST) -> FloatArray:
    """All points of a grid over these parameters, the others as in `base`."""
    n = _counts(problem, index, most)
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


def _groups(problem: Problem) -> list[NDArray[np.int64]]:
    """The parameters of each term of a sum."""
    return [group for _, group in problem.terms_of_sum]


def _alike(problem: Problem) -> list[list[NDArray[np.int64]]]:
    """Terms of a sum that are one model, with bounds that are the same."""
    kinds: dict[object, list[NDArray[np.int64]]] = {}
    parameters = problem.parameters
    for name, group in problem.terms_of_sum:
        bounds = tuple((parameters[j].lower, parameters[j].upper) for j in group)
        kinds.setdefault((name, bounds), []).append(group)
    return [same for same in kinds.values() if len(same) > 1]


def _lobe_by_lobe(
    problem: Problem,
    few: Problem,
    box: Box,
    groups: list[NDArray[np.int64]],
    base: FloatArray,
) -> FloatArray:
    """Combinations of lobes, found by adding one after the other."""
    parameters = problem.parameters
    own = [[int(j) for j in group if not parameters[j].linear] for group in groups]
    linear = [[int(j) for j in group if parameters[j].linear] for group in groups]
    order = sorted(range(len(groups)), key=lambda k: len(own[k]))
    off = Box(box.lower, box.upper.copy(), box.c)
    for k in order:
        off.upper[linear[k]] = box.lower[linear[k]]
    beam = base[None].copy()
    seen = [beam]
    for turn, k in enumerate([*order, *order]):
        off.upper[linear[k]] = box.upper[linear[k]]
        most = TURN // (BEAM if turn < len(order) else 2)
        tried = np.concatenate(
            [_grid(problem, own[k], p, most) for p in beam[: min(TURN // most, BEAM)]]
        )
        chi2, solved = scored(few, off, tried)
        best = _distinct(chi2, solved, BEAM)
        beam = np.array(best)
        seen.append(beam)
    return np.concatenate(seen[-2:])


def _distinct(chi2: FloatArray, points: FloatArray, n: int) -> list[FloatArray]:
    """The best points that are not neighbours of a better one."""
    chosen: list[FloatArray] = []
    for k in np.argsort(chi2, kind="stable"):
        p = points[k]
        if all(np.max(abs(p - q) / (abs(p) + abs(q) + 1e-12)) > APART for q in chosen):
            chosen.append(p)
        if len(chosen) == n:
            break
    return chosen
