"""From starts to minima: one start followed, several compared, a parameter held."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from gonio.fitting.minimum import starting_values
from gonio.fitting.minimum.gauss_newton import (
    _marquardt,
    _polish,
    _State,
)
from gonio.fitting.minimum.optimum import Optimum, better
from gonio.fitting.minimum.variable_projection import amplitudes_solved
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

# Starting values that are followed to their minimum: chi-squared has more minima with more than two
# nonlinear parameters, and with two and few samples, and most with both.
STARTS = (2, 12, 32)
FEW_SAMPLES = 500
SEARCHES = 1  # starting values, the best ones, from which an engine searches
FAR = 2.0  # times the least chi2 of some samples: a minimum there is none of all samples
FIRST = 4000  # samples on which a start is followed before all are used
SAME_PLACE = 0.1  # of the uncertainty: two ends that are nearer are one minimum
SAME_VALLEY = 1.0  # of the uncertainty: steps that come so near end in this minimum
# A way from a start to the neighbourhood of a minimum: the point and the passes over the data.
Engine = Callable[[Problem, FloatArray], tuple[FloatArray, int]]


def starts(problem: Problem, n: int | None = None) -> list[FloatArray]:
    """The best n starting values, searched for in the data (`starting_values.candidates`)."""
    if n is None:
        nonlinear = sum(not q.linear and q.lower < q.upper for q in problem.parameters)
        hardness = (nonlinear > 2) + (nonlinear > 1 and problem.n <= FEW_SAMPLES)
        n = STARTS[hardness]
    return starting_values.candidates(problem, n)


def minimise(
    problem: Problem,
    start: FloatArray,
    *,
    search: bool = True,
    near: bool = False,
    engine: Engine | None = None,
) -> Optimum:
    """Follow one start to its minimum: an engine, then Gauss-Newton steps inside the bounds.

    Parameters
    ----------
    problem : Problem
    start : ndarray
        Any point inside the bounds; the linear parameters are solved for there.
    search : bool
        Where the minimum lies on a bound, lacks curvature, or is not verified, follow the best
        starting value of the data as well and keep the deeper minimum: chi-squared may be
        stationary on a bound without a minimum there (f depends on sigma^2 only).
    near : bool
        The start is nearer to the minimum than that of a part of the samples is.
    engine : callable, optional
        What searches before the Gauss-Newton steps; nothing by default.
    """
    optimum = _followed(problem, start, engine, near=near or not search)
    lobe_lost = np.any(np.diag(optimum.curvature) <= 0)
    if search and not (optimum.verified and optimum.free.all() and not lobe_lost):
        other = _followed(problem, starts(problem, 1)[0], engine)
        optimum = better(optimum, other)
    return optimum


def minima(problem: Problem, engine: Engine | None = None) -> list[Optimum]:
    """The minima to which the best starting values of the data lead, deepest first."""
    return _minima_from(problem, starts(problem), engine)


def _minima_from(
    problem: Problem, begun: Sequence[FloatArray], engine: Engine | None
) -> list[Optimum]:
    """The minima to which these starts lead, deepest first.

    Gauss-Newton steps go on from where the engine ends. From each start itself they go as well,
    until they come near a minimum that is known: where both ways end in different minima, both are
    kept. Of many samples a start is followed on some first, and on all only where it leads to
    another place than a better one.
    """
    first = problem.subset(FIRST) if problem.n > 2 * FIRST and not problem.profiled else problem
    searched, evaluations = _searched(problem, begun, engine)
    ends: list[_State] = []
    for point in [*searched, *begun]:
        end = _marquardt(first, point, partial(_leads_to, first, ends))
        evaluations += end.evaluations
        if not _leads_to(first, ends, end):
            ends.append(end)
    ends.sort(key=lambda end: end.chi2)
    optima: list[Optimum] = []
    kept: list[_State] = []
    for end in ends:
        if any(_apart(first, other, end) <= SAME_PLACE for other in kept):
            continue
        if first is not problem and kept and end.chi2 > FAR * kept[0].chi2:
            continue
        kept.append(end)
        optima.append(_polish(problem, end.p if end.problem is not problem else end, evaluations))
        evaluations = 0
    best = optima[0]
    for other in optima[1:]:
        best = better(best, other)
    return [best, *(other for other in optima if other is not best)]


def _searched(
    problem: Problem, begun: Sequence[FloatArray], engine: Engine | None
) -> tuple[list[FloatArray], int]:
    """Where the engine ends from each start, on some of the samples, and the passes over these."""
    if engine is None:
        return [], 0
    some = starting_values.few(problem)
    ends, passes = [], 0
    for start in begun[:SEARCHES]:
        point, n = engine(some, start)
        ends.append(point)
        passes += n
    return ends, passes


def at_lower(problem: Problem, optimum: Optimum, j: int) -> Optimum:
    """The minimum with parameter j on its lower bound; verified as one of the other parameters."""
    q = problem.parameters[j]
    pinned = minimise(pinned_at(problem, j, q.lower), optimum.p, search=False)
    p = np.where(np.arange(len(optimum.p)) == j, q.lower, pinned.p)
    chi2, g, h = problem.normal_equations(p)
    free = pinned.free & (np.arange(len(p)) != j)
    return Optimum(p, chi2, g, h, free, pinned.evaluations, pinned.verified, pinned.limited)


def pinned_at(problem: Problem, j: int, value: float) -> Problem:
    """The problem with parameter j held at a value."""
    parameters = list(problem.parameters)
    parameters[j] = replace(parameters[j], lower=value, upper=value, scale="linear", linear=False)
    return problem.with_parameters(tuple(parameters))


def _followed(
    problem: Problem, start: FloatArray, engine: Engine | None, *, near: bool = False
) -> Optimum:
    p = amplitudes_solved(problem, start)
    if near:
        return _polish(problem, p, 1)
    return _minima_from(problem, [p], engine)[0]


def _leads_to(problem: Problem, known: Sequence[_State], state: _State) -> bool:
    """Whether a state is hardly above a minimum that is known, and hardly away from it."""
    return any(
        0 <= state.chi2 - other.chi2 <= (2 * SAME_VALLEY * other.noise) ** 2
        and _apart(problem, other, state) <= SAME_VALLEY
        for other in known
    )


def _apart(problem: Problem, first: _State, second: _State) -> float:
    """Distance of two states in units of the uncertainty at the first."""
    step = starting_values.ordered(problem, second.p) - starting_values.ordered(problem, first.p)
    lost = np.diag(first.h) <= 0
    if np.any(step[lost] != 0):
        return math.inf
    return math.sqrt(max(float(step @ first.h @ step), 0.0)) / first.noise
