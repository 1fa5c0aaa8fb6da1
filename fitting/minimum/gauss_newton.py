"""Find the minimum: starts from the data, Gauss-Newton steps inside the bounds, and the checks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum import starting_values
from gonio.fitting.minimum.curvature import TAKES_PART, axes
from gonio.fitting.problem.problem import Problem
from gonio.geometry import FloatArray
from gonio.kernels import boxed
from gonio.kernels.boxed import next_point

UNDETERMINED: float = boxed.UNDETERMINED  # smallest part of the curvature that is information
STARTS = 2  # starting values that are followed to their minimum,
MANY_STARTS = 8  # and where more than two parameters are nonlinear: chi2 then has more than one
FAR = 2.0  # times the least chi2 of some samples: a minimum there is none of all samples
FIRST = 4000  # samples on which a start is followed before all are used
POLISH_STEPS = 300
STOP = 1e-5  # the polish ends where its next step is this part of the uncertainty
VERIFIED = 1e-3  # a minimum is verified where it is this part
SAME_PLACE = 0.1  # of the uncertainty: two ends that are nearer are one minimum
ROUNDING = 1e-12  # of the norm of the data: what a step may change by rounding alone
NEAR_BOUND = 1e-6  # of the range: near enough to a bound to be put on it
DEEPER = 1e-9  # relative difference of chi-squared that is not rounding
SAME_GRADIENT = 1e-3  # of the largest derivative: agreement with a difference quotient
CHECKED = 12  # samples at which derivatives are compared

# A way from a start to the neighbourhood of a minimum: the point and the passes over the data.
Engine = Callable[[Problem, FloatArray], tuple[FloatArray, int]]


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


def starts(problem: Problem, n: int | None = None) -> list[FloatArray]:
    """The best n starting values, searched for in the data (`starting_values.candidates`)."""
    if n is None:
        nonlinear = sum(not q.linear and q.lower < q.upper for q in problem.parameters)
        n = STARTS if nonlinear <= 2 else MANY_STARTS
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
        What goes before the Gauss-Newton steps; nothing by default.
    """
    optimum = _followed(problem, start, engine, near=near or not search)
    lobe_lost = np.any(np.diag(optimum.curvature) <= 0)
    if search and not (optimum.verified and optimum.free.all() and not lobe_lost):
        other = _followed(problem, starts(problem, 1)[0], engine)
        optimum = better(optimum, other)
    return optimum


def minima(problem: Problem, engine: Engine | None = None) -> list[Optimum]:
    """The minima to which the best starting values of the data lead, deepest first.

    Of many samples a start is followed on some first, and on all only where it leads to another
    place than a better one.
    """
    first = problem.subset(FIRST) if problem.n > 2 * FIRST else problem
    ends: list[_State] = []
    evaluations = 0
    for start in starts(problem):
        point = start
        if engine is not None:
            point, n = engine(problem, start)
            evaluations += n
        ends.append(_marquardt(first if engine is None else problem, point))
    ends.sort(key=lambda end: end.chi2)
    found: list[Optimum] = []
    kept: list[_State] = []
    for end in ends:
        evaluations += end.evaluations
        if any(_same_place(first, other, end) for other in kept):
            continue
        if first is not problem and kept and end.chi2 > FAR * kept[0].chi2:
            continue
        kept.append(end)
        found.append(_polish(problem, end.p if end.problem is not problem else end, evaluations))
        evaluations = 0
    best = found[0]
    for other in found[1:]:
        best = better(best, other)
    return [best, *(other for other in found if other is not best)]


def better(first: Optimum, second: Optimum) -> Optimum:
    """The deeper of two minima; the verified one, else the first, where they are the same."""
    slack = DEEPER * min(first.chi2, second.chi2)
    if second.chi2 < first.chi2 - slack:
        return second
    if second.chi2 <= first.chi2 + slack and second.verified and not first.verified:
        return second
    return first


def gradient_faults(problem: Problem, p: FloatArray) -> list[str]:
    """Parameters whose derivative, as the kernel gives it, is no derivative of the model.

    The derivatives of a few samples are compared with central differences; a wrong one moves the
    point at which the fit stops and believes itself at the minimum.
    """
    parameters = problem.parameters
    some = _telling(problem, p)
    faulty = []
    for j, q in enumerate(parameters):
        width = q.upper - q.lower
        step = float(np.finfo(float).eps ** (1 / 3) * max(abs(p[j]), 1e-3 * width))
        if not 0 < 2 * step < width:
            continue
        centre = p.copy()
        centre[j] = min(max(p[j], q.lower + step), q.upper - step)
        ends = [centre.copy(), centre.copy()]
        ends[0][j] += step
        ends[1][j] -= step
        quotient = (some.values(ends[0]) - some.values(ends[1])) / (2 * step)
        f, jac = some.jacobian(centre)
        analytic = jac[:, j]
        largest = max(abs(analytic).max(), abs(quotient).max())
        rounding = 1e-14 * abs(f).max() / step
        if not abs(analytic - quotient).max() <= SAME_GRADIENT * largest + rounding:
            faulty.append(q.name)
    return faulty


def _telling(problem: Problem, p: FloatArray) -> Problem:
    """A few samples: those on which each derivative is strongest, and some over all."""
    coarse = (
        problem.subset(starting_values.SUBSET)
        if problem.n > 2 * starting_values.SUBSET
        else problem
    )
    _, jac = coarse.jacobian(p)
    n, strong = coarse.n, min(4, coarse.n)
    weighted = abs(jac) * np.sqrt(coarse.inverse_variance)[:, None]
    strongest = np.argpartition(weighted, -strong, axis=0)[-strong:]
    taken = np.zeros(n, bool)
    taken[strongest] = True
    taken[np.linspace(0, n - 1, min(CHECKED, n)).astype(np.int64)] = True
    return coarse.at(np.flatnonzero(taken))


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


@dataclass
class _State:
    """Where Gauss-Newton steps stand: a point, chi-squared there, its slope and its curvature."""

    problem: Problem
    box: starting_values.Box
    size: float
    p: FloatArray
    chi2: float
    g: FloatArray
    h: FloatArray
    evaluations: int = 1

    @classmethod
    def at(cls, problem: Problem, p: FloatArray) -> _State:
        """The state at the point inside the bounds that is nearest to p."""
        box = starting_values.Box.of(problem)
        p = box.inside(p)
        value = problem.samples.value
        size = math.sqrt(float(np.vdot(value * value, problem.inverse_variance)))
        return cls(problem, box, size, p, *problem.normal_equations(p))

    def step(self, damping: float = 0.0) -> tuple[FloatArray, float, bool]:
        """Where the next step leads, length of the undamped one, and whether the sum ends it.

        The length is in units of the uncertainty in its direction.
        """
        box = self.box
        point, decrease, limited = next_point(
            self.h, self.g, self.p, box.lower, box.upper, box.c, damping
        )
        return point, math.sqrt(max(decrease, 0.0)) / self.noise, limited

    @property
    def noise(self) -> float:
        """Root mean square of the weighted residuals, never 0."""
        dof = max(self.problem.n - len(self.p), 1)
        return math.sqrt(max(self.chi2 / dof, 1e-300))

    @property
    def rounding(self) -> float:
        """What a step may change by rounding alone, in units of the uncertainty."""
        return ROUNDING * self.size / self.noise

    def moved(self, p: FloatArray, chi2: float, g: FloatArray, h: FloatArray) -> None:
        """Stand at another point."""
        self.p, self.chi2, self.g, self.h = p, chi2, g, h


def _followed(
    problem: Problem, start: FloatArray, engine: Engine | None, *, near: bool = False
) -> Optimum:
    p = starting_values.amplitudes_solved(problem, start)
    evaluations = 1
    if engine is not None:
        p, n = engine(problem, p)
        evaluations += n
    elif problem.n > 2 * FIRST and not near:
        end = _marquardt(problem.subset(FIRST), p)
        p, evaluations = end.p, end.evaluations
    return _polish(problem, p, evaluations)


def _same_place(problem: Problem, first: _State, second: _State) -> bool:
    step = starting_values.ordered(problem, second.p) - starting_values.ordered(problem, first.p)
    apart = float(step @ first.h @ step)
    lost = np.diag(first.h) <= 0
    moved = np.any(step[lost] != 0)
    return not moved and apart <= (SAME_PLACE * first.noise) ** 2


def _polish(problem: Problem, start: FloatArray | _State, evaluations: int) -> Optimum:
    """Levenberg-Marquardt with an active set of bounds, until the step is negligible.

    Where a point half an uncertainty away turns out deeper, it goes on from there.
    """
    for _ in range(3):
        state = start if isinstance(start, _State) else _marquardt(problem, start)
        if state is not start:
            evaluations += state.evaluations
        optimum = _settled(state, evaluations)
        deeper, n = _deeper_nearby(state, optimum)
        evaluations += n
        if deeper is None:
            return replace(optimum, evaluations=evaluations)
        start = deeper
    return replace(optimum, evaluations=evaluations, verified=False)


def _marquardt(problem: Problem, p: FloatArray) -> _State:
    """Damped Gauss-Newton steps; a step between the bounds is the best one between them."""
    state = _State.at(problem, p)
    damping = 1e-3
    for _ in range(POLISH_STEPS):
        trial, distance, _ = state.step(damping)
        if distance <= max(STOP, state.rounding):
            break
        new = problem.normal_equations(trial)
        state.evaluations += 1
        if new[0] <= state.chi2:
            same = bool((abs(trial - state.p) <= 1e-14 * abs(state.p)).all())
            state.moved(trial, *new)
            damping = max(damping / 10, 1e-12)
            if same:
                break
        else:
            damping *= 10
            if damping > 1e10:
                break  # no step goes down: rounding limits the sum of squares
    return state


def _settled(state: _State, evaluations: int) -> Optimum:
    """The state with what is a hair from a bound put on it, and whether its step is negligible."""
    _snap(state)
    _leave_chance_bounds(state)
    _, distance, limited = state.step()
    held = tuple(map(int, np.flatnonzero(state.box.c))) if limited else ()
    verified = distance <= max(VERIFIED, 1e2 * state.rounding)
    p, box = state.p, state.box
    free = (p > box.lower) & (p < box.upper)
    return Optimum(p, state.chi2, state.g, state.h, free, evaluations, verified, held)


def _snap(state: _State) -> None:
    """Parameters a hair from a bound are put on it where chi2 does not mind."""
    box = state.box
    hair = NEAR_BOUND * (box.upper - box.lower)
    for bound in (box.lower, box.upper):
        gap = abs(state.p - bound)
        for j in np.flatnonzero((gap > 0) & (gap <= hair)):
            trial = state.p.copy()
            trial[j] = bound[j]
            new = state.problem.normal_equations(trial)
            state.evaluations += 1
            if new[0] <= state.chi2 * (1 + DEEPER) + (ROUNDING * state.size) ** 2:
                state.moved(trial, *new)


def _leave_chance_bounds(state: _State) -> None:
    """Amplitudes that only share out a sum are put between their bounds.

    Where f does not change along a line of amplitudes, the search may end where a bound cuts the
    line. That bound is chance: what remains would look as if the data determined it.
    """
    box = state.box
    flagged = np.array([q.linear for q in state.problem.parameters])
    linear = np.flatnonzero(flagged & (np.diag(state.h) > 0) & (box.upper > box.lower))
    at_bound = (state.p <= box.lower) | (state.p >= box.upper)
    if len(linear) < 2 or not at_bound[linear].any():
        return
    values, vectors, scale = axes(state.h, linear)
    for vector in vectors.T[values < UNDETERMINED]:
        line = np.zeros(len(state.p))
        line[linear] = np.where(np.abs(vector) > TAKES_PART, vector / scale, 0.0)
        some = line != 0
        ends = [(b - state.p)[some] / line[some] for b in (box.lower, box.upper)]
        first, last = np.minimum(*ends).max(), np.maximum(*ends).min()
        trial = np.clip(state.p + (first + last) / 2 * line, box.lower, box.upper)
        if not last > first or float(trial @ box.c) > 1:
            continue
        new = state.problem.normal_equations(trial)
        state.evaluations += 1
        if new[0] <= state.chi2 * (1 + DEEPER) + (ROUNDING * state.size) ** 2:
            state.moved(trial, *new)


def _deeper_nearby(state: _State, optimum: Optimum) -> tuple[FloatArray | None, int]:
    """A point half an uncertainty away with a smaller chi2, or None; and how many were tried.

    The curvature J^T W J is never negative, also not on a saddle: only chi2 itself tells.
    """
    h, box = optimum.curvature, state.box
    index = np.flatnonzero(optimum.free & (np.diag(h) > 0))
    if len(index) == 0:
        return None, 0
    scale = 1 / np.sqrt(np.diag(h)[index])
    scaled = h[np.ix_(index, index)] * np.outer(scale, scale)
    along = within_sum(scale * box.c[index]) if optimum.limited else np.eye(len(index))
    values, vectors = np.linalg.eigh(along.T @ scaled @ along)
    known = values >= UNDETERMINED
    steps = (0.5 * state.noise * scale)[:, None] * (along @ vectors[:, known])
    steps = steps / np.sqrt(values[known])
    trials = np.repeat(optimum.p[None], 2 * steps.shape[1], axis=0)
    trials[:, index] += np.concatenate([steps.T, -steps.T])
    trials = np.array([box.inside(trial) for trial in trials])
    if len(trials) == 0:
        return None, 0
    chi2 = state.problem.batch_chi2(trials)
    k = int(np.argmin(chi2))
    # Where the model leaves nothing over, rounding makes one point or the other deeper.
    floor = (ROUNDING * state.size) ** 2
    deeper = trials[k] if chi2[k] < optimum.chi2 * (1 - DEEPER) - floor else None
    return deeper, len(trials)


def within_sum(c: FloatArray) -> FloatArray:
    """Orthonormal directions (P, P - 1) along which a sum with coefficients c stays."""
    if not np.any(c):
        return np.eye(len(c))
    _, _, rows = np.linalg.svd(c[None])
    return np.asarray(rows[1:].T)
