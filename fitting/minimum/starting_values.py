"""Starting values: the nonlinear parameters searched, the linear ones solved for.

The linear parameters are those in which f is linear, so that chi-squared is quadratic in them: one
pass over a few samples gives their best values between the bounds at each point of the search
(variable projection), and only widths, roughness and refractive indices need a search.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.box import Box
from gonio.fitting.minimum.grids import (
    MOST,
    grid,
    grid_size,
)
from gonio.fitting.minimum.variable_projection import scored
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

SUBSET = 2000  # samples that choose among the starting values
FEW = 400  # samples that choose which points these are asked about
RESCORED = 10
TURN = 410  # points when a lobe is added
BEAM = 5  # combinations of lobes that are kept while lobes are added
LARGEST = 100.0  # times the median: no weight of a loss at a measured value counts for more
SAME = 1e-6  # of chi-squared: points that differ by less give the same f
APART = 0.4  # of the sum of two values: starts that are nearer in all parameters are one


def candidates(problem: Problem, n: int) -> list[FloatArray]:
    """The best n starting values that are not neighbours of a better one, nor give the same f.

    All points of a grid where these are few. Else lobe by lobe: those of a sum are added one
    after the other, each on a grid beside the best combinations of those before, and then each is
    searched again beside the others.
    """
    coarse = problem.subset(SUBSET)
    if not coarse.quadratic:
        coarse = _like_loss(coarse)
    some = _few(coarse)
    box = Box.of(problem)
    groups = _groups(problem)
    base = np.minimum(np.maximum(0.0, box.lower), box.upper)
    nonlinear = [j for j, q in enumerate(problem.parameters) if not q.linear]
    base[nonlinear] = [problem.parameters[j].default for j in nonlinear]
    base = np.clip(base, box.lower, box.upper)
    if len(groups) < 2 or grid_size(problem, nonlinear) <= MOST:
        points = grid(problem, nonlinear, base)
    else:
        points = _lobe_by_lobe(problem, some, box, groups, base)
    points = np.array([ordered(problem, p) for p in points]) if len(groups) > 1 else points
    chi2, solved = scored(some, box, points)
    if some is not coarse:
        best = np.argsort(chi2, kind="stable")[: max(RESCORED, 4 * n)]
        chi2, solved = scored(coarse, box, solved[best])
    return _distinct(chi2, solved, n, apart=SAME)


def _like_loss(problem: Problem) -> Problem:
    """Least squares in place of another loss: amplitudes are solved for in chi-squared.

    Its weights are those that the loss has at the measured values, so that it looks where the loss
    does; a value that noise brings near 0 does not decide alone.
    """
    y = problem.samples.value
    _, v = problem.law.linearised(y, y, problem.inverse_variance, problem.cos_theta_r)
    v = np.minimum(v, LARGEST * float(np.median(v)))
    return problem.with_weights(v).as_least_squares()


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


def few(problem: Problem) -> Problem:
    """Some of the samples, taken as points: enough to search for a minimum's neighbourhood."""
    return _few(problem.subset(SUBSET))


def _few(coarse: Problem) -> Problem:
    return coarse.subset(FEW) if coarse.n > 2 * FEW else coarse


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
    beams = [beam]
    for turn, k in enumerate([*order, *order]):
        off.upper[linear[k]] = box.upper[linear[k]]
        most = TURN // (BEAM if turn < len(order) else 2)
        tried = np.concatenate(
            [grid(problem, own[k], p, most) for p in beam[: min(TURN // most, BEAM)]]
        )
        chi2, solved = scored(few, off, tried)
        best = _distinct(chi2, solved, BEAM)
        beam = np.array(best)
        beams.append(beam)
    return np.concatenate(beams[-2:])


def _distinct(
    chi2: FloatArray, points: FloatArray, n: int, apart: float | None = None
) -> list[FloatArray]:
    """The best points that are not neighbours of a better one.

    Nor those whose chi-squared is within `apart`, as a fraction, of the one before: lobes that no
    sample meets, or one alone, are the same f.
    """
    chosen: list[FloatArray] = []
    last = 0.0
    for k in np.argsort(chi2, kind="stable"):
        p = points[k]
        if chosen and apart is not None and chi2[k] - last <= apart * abs(last):
            continue
        if all(np.max(abs(p - q) / (abs(p) + abs(q) + 1e-12)) > APART for q in chosen):
            chosen.append(p)
            last = float(chi2[k])
        if len(chosen) == n:
            break
    return chosen
