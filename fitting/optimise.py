"""Find the minimum: starts from the data, nlopt, and a Gauss-Newton polish inside the bounds."""

from __future__ import annotations

import contextlib
import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem import Problem
from gonio.geometry import FloatArray
from gonio.models import Parameter

GRID = 9  # starting values along each nonlinear parameter
SUBSET = 2000  # samples that choose among the starting values
STARTS = 2  # starting values that are followed to their minimum
POLISH_STEPS = 150
UNDETERMINED = 1e-10  # smallest eigenvalue of the scaled curvature that counts as information
STOP = 1e-5  # the polish ends where its next step is this part of the uncertainty
VERIFIED = 1e-3  # a minimum is verified where it is this part
ROUNDING = 1e-12  # of the norm of the data: what a step may change by rounding alone
NEAR_BOUND = 1e-6  # of the range: near enough to a bound to be put on it
DEEPER = 1e-9  # relative difference of chi-squared that is not rounding
SAME_GRADIENT = 1e-3  # of the largest derivative: agreement with a difference quotient


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
    """

    p: FloatArray
    chi2: float
    gradient: FloatArray
    curvature: FloatArray
    free: NDArray[np.bool_]
    evaluations: int
    verified: bool


def starts(problem: Problem, n: int = STARTS) -> list[FloatArray]:
    """The best n starting values of a coarse grid over the nonlinear parameters.

    The linear parameters are solved for at each point of the grid, inside their bounds.
    """
    parameters = problem.parameters
    coarse = problem.subset(SUBSET)
    nonlinear = [j for j, q in enumerate(parameters) if not q.linear]
    scored: list[tuple[float, FloatArray]] = []
    for point in itertools.product(*(_grid(parameters[j]) for j in nonlinear)):
        p = np.array([min(max(0.0, q.lower), q.upper) for q in parameters])
        p[nonlinear] = point
        scored.append(_linear_solved(coarse, p))
    scored.sort(key=lambda item: item[0])
    return [p for _, p in _distinct(scored, n)]


def minimise(problem: Problem, start: FloatArray, *, search: bool = True) -> Optimum:
    """Follow one start to its minimum: nlopt's SLSQP, then Gauss-Newton steps inside the bounds.

    Parameters
    ----------
    problem : Problem
    start : ndarray
        Any point inside the bounds; the linear parameters are solved for there.
    search : bool
        Where the minimum lies on a bound, lacks curvature, or is not verified, follow the best
        point of the coarse grid as well and keep the deeper minimum: chi-squared may be
        stationary on a bound without a minimum there (f depends on sigma^2 only).
    """
    optimum = _followed(problem, start)
    lobe_lost = np.any(np.diag(optimum.curvature) <= 0)
    if search and not (optimum.verified and optimum.free.all() and not lobe_lost):
        other = _followed(problem, starts(problem, 1)[0], optimum.evaluations)
        optimum = better(optimum, other)
    return optimum


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
    _, jac = problem.jacobian(p)
    weighted = np.abs(jac) * np.sqrt(problem.inverse_variance)[:, None]
    strongest = np.argpartition(weighted, -min(4, problem.n), axis=0)[-min(4, problem.n) :]
    spread = np.linspace(0, problem.n - 1, min(8, problem.n)).astype(np.int64)
    some = problem.at(np.union1d(strongest, spread))
    faulty = []
    for j, q in enumerate(parameters):
        width = q.upper - q.lower
        step = float(np.finfo(float).eps ** (1 / 3) * max(abs(p[j]), 1e-3 * width))
        if not 0 < 2 * step < width:
            continue
        centre = p.copy()
        centre[j] = np.clip(p[j], q.lower + step, q.upper - step)
        ends = [some.values(centre + side * step * (np.arange(len(p)) == j)) for side in (1, -1)]
        quotient = (ends[0] - ends[1]) / (2 * step)
        f, analytic = some.jacobian(centre)
        analytic = analytic[:, j]
        largest = max(np.max(np.abs(analytic)), np.max(np.abs(quotient)))
        rounding = 1e-14 * np.max(np.abs(f)) / step
        if not np.max(np.abs(analytic - quotient)) <= SAME_GRADIENT * largest + rounding:
            faulty.append(q.name)
    return faulty


def at_lower(problem: Problem, optimum: Optimum, j: int) -> Optimum:
    """The minimum with parameter j on its lower bound; verified as one of the other parameters."""
    q = problem.parameters[j]
    pinned = minimise(pinned_at(problem, j, q.lower), optimum.p, search=False)
    p = np.where(np.arange(len(optimum.p)) == j, q.lower, pinned.p)
    chi2, g, h = problem.normal_equations(p)
    free = pinned.free & (np.arange(len(p)) != j)
    return Optimum(p, chi2, g, h, free, pinned.evaluations, pinned.verified)


def pinned_at(problem: Problem, j: int, value: float) -> Problem:
    """The problem with parameter j held at a value."""
    parameters = list(problem.parameters)
    parameters[j] = replace(parameters[j], lower=value, upper=value, scale="linear", linear=False)
    return problem.with_parameters(tuple(parameters))


def _followed(problem: Problem, start: FloatArray, evaluations: int = 0) -> Optimum:
    _, p = _linear_solved(problem, start)
    p, n = _slsqp(problem, p)
    return _polish(problem, p, evaluations + n + 1)


def _linear_solved(problem: Problem, p: FloatArray) -> tuple[float, FloatArray]:
    """chi2 and the point with the linear parameters at their best inside the bounds.

    chi2 is quadratic in them, so one pass over the data tells it all.
    """
    from scipy.optimize import lsq_linear

    parameters = problem.parameters
    linear = [j for j, q in enumerate(parameters) if q.linear]
    chi2, g, h = problem.normal_equations(p)
    scale = np.sqrt(np.diag(h)[linear])
    if not linear or not np.all(np.isfinite(scale)) or not np.any(scale > 0):
        return chi2, p
    linear = [j for j, s in zip(linear, scale, strict=True) if s > 0]
    scale = scale[scale > 0]
    values, vectors = np.linalg.eigh(h[np.ix_(linear, linear)] / np.outer(scale, scale))
    known = values > UNDETERMINED
    root = np.sqrt(values[known])[:, None] * vectors.T[known]
    x = p[linear] * scale
    target = root @ x + (vectors.T[known] @ (g[linear] / scale)) / np.sqrt(values[known])
    bounds = [np.array([getattr(parameters[j], e) for j in linear]) for e in ("lower", "upper")]
    y = lsq_linear(root, target, (bounds[0] * scale, bounds[1] * scale), method="bvls").x
    solved = p.copy()
    solved[linear] = np.clip(y / scale, *bounds)
    d = solved - p
    lower = float(chi2 - 2 * g @ d + d @ h @ d)
    return (lower, solved) if lower < chi2 else (chi2, p)


def _grid(q: Parameter) -> FloatArray:
    low, high = q.start or (q.lower, q.upper)
    if q.scale == "log":
        return np.geomspace(low, high, GRID)
    return np.linspace(low, high, GRID)


def _distinct(scored: list[tuple[float, FloatArray]], n: int) -> list[tuple[float, FloatArray]]:
    """The best entries that are not neighbours of a better one on the grid."""
    chosen: list[tuple[float, FloatArray]] = []
    for chi2, p in scored:
        if all(np.max(np.abs(p - q) / (np.abs(p) + np.abs(q) + 1e-12)) > 0.4 for _, q in chosen):
            chosen.append((chi2, p))
        if len(chosen) == n:
            break
    return chosen


class _Scale:
    """Optimiser variables in [0, 1]: log parameters by their logarithm."""

    def __init__(self, parameters: tuple[Parameter, ...]) -> None:
        self.log = np.array([q.scale == "log" for q in parameters])
        self.low = self._internal(np.array([q.lower for q in parameters]))
        self.span = self._internal(np.array([q.upper for q in parameters])) - self.low

    def _internal(self, p: FloatArray) -> FloatArray:
        return np.where(self.log, np.log(np.where(self.log, p, 1.0)), p)

    def to(self, p: FloatArray) -> FloatArray:
        width = np.where(self.span > 0, self.span, 1.0)  # none where a parameter is held
        return np.clip((self._internal(p) - self.low) / width, 0.0, 1.0)

    def back(self, x: FloatArray) -> FloatArray:
        y = self.low + x * self.span
        return np.where(self.log, np.exp(np.where(self.log, y, 0.0)), y)

    def derivative(self, p: FloatArray) -> FloatArray:
        """dp/dx."""
        return self.span * np.where(self.log, p, 1.0)


def _slsqp(problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    """nlopt LD_SLSQP on chi2 / chi2(start): unscaled, SLSQP stops after one step."""
    import nlopt

    scale = _Scale(problem.parameters)
    best = (np.inf, start)
    reference = max(problem.chi2(start), 1e-300)
    evaluations = 1

    def objective(x: FloatArray, gradient: FloatArray) -> float:
        nonlocal best, evaluations
        p = scale.back(x)
        chi2, g, _ = problem.normal_equations(p)
        evaluations += 1
        if chi2 < best[0]:
            best = (chi2, p)
        if gradient.size:
            gradient[:] = -2 * g * scale.derivative(p) / reference
        return chi2 / reference

    optimiser = nlopt.opt(nlopt.LD_SLSQP, len(start))
    optimiser.set_lower_bounds(np.zeros(len(start)))
    optimiser.set_upper_bounds(np.ones(len(start)))
    optimiser.set_min_objective(objective)
    optimiser.set_ftol_rel(1e-6)
    optimiser.set_maxeval(200)
    # The best point seen is kept; the polish and its checks decide what it is worth. nlopt has
    # a runtime_error of its own, which is no RuntimeError.
    with contextlib.suppress(nlopt.RoundoffLimited, nlopt.runtime_error, RuntimeError, ValueError):
        optimiser.optimize(scale.to(start))
    return best[1], evaluations


def _polish(problem: Problem, p: FloatArray, evaluations: int) -> Optimum:
    """Levenberg-Marquardt with an active set of bounds, until the step is negligible.

    Where a point half an uncertainty away turns out deeper, it goes on from there.
    """
    for _ in range(3):
        optimum = _marquardt(problem, p, evaluations)
        deeper, n = _deeper_nearby(problem, optimum)
        evaluations = optimum.evaluations + n
        if deeper is None:
            return replace(optimum, evaluations=evaluations)
        p = deeper
    return replace(optimum, evaluations=evaluations, verified=False)


def _marquardt(problem: Problem, p: FloatArray, evaluations: int) -> Optimum:
    parameters = problem.parameters
    lower = np.array([q.lower for q in parameters])
    upper = np.array([q.upper for q in parameters])
    p = np.clip(p, lower, upper)
    size = np.sqrt(np.sum(problem.samples.value**2 * problem.inverse_variance))
    chi2, g, h = problem.normal_equations(p)
    evaluations += 1
    damping = 1e-3
    for _ in range(POLISH_STEPS):
        free = _free(p, g, lower, upper)
        stop = max(STOP, ROUNDING * size / _noise(problem, chi2))
        if _distance(problem, chi2, g, h, free) <= stop:
            break
        trial = np.clip(p + _solve(h, g, free, damping), lower, upper)
        new = problem.normal_equations(trial)
        evaluations += 1
        if new[0] <= chi2:
            same = bool(np.all(np.abs(trial - p) <= 1e-14 * np.abs(p)))
            p, (chi2, g, h) = trial, new
            damping = max(damping / 10, 1e-12)
            if same:
                break
        else:
            damping *= 10
            if damping > 1e10:
                break  # no step goes down: rounding limits the sum of squares
    p, chi2, g, h = _snapped(problem, p, chi2, g, h)
    free = _free(p, g, lower, upper)
    limit = max(VERIFIED, 1e2 * ROUNDING * size / _noise(problem, chi2))
    verified = bool(_distance(problem, chi2, g, h, free) <= limit)
    return Optimum(p, chi2, g, h, (p > lower) & (p < upper), evaluations, verified)


def _snapped(
    problem: Problem, p: FloatArray, chi2: float, g: FloatArray, h: FloatArray
) -> tuple[FloatArray, float, FloatArray, FloatArray]:
    """Parameters a hair from a bound are put on it where chi2 does not mind."""
    size = np.sum(problem.samples.value**2 * problem.inverse_variance)
    for j, q in enumerate(problem.parameters):
        hair = NEAR_BOUND * (q.upper - q.lower)
        for bound in (q.lower, q.upper):
            if 0 < abs(p[j] - bound) <= hair:
                trial = np.where(np.arange(len(p)) == j, bound, p)
                new = problem.normal_equations(trial)
                if new[0] <= chi2 * (1 + DEEPER) + ROUNDING**2 * size:
                    p, (chi2, g, h) = trial, new
    return p, chi2, g, h


def _free(p: FloatArray, g: FloatArray, lower: FloatArray, upper: FloatArray) -> NDArray[np.bool_]:
    """Parameters that no bound holds; g points downhill."""
    return np.asarray(~(((p <= lower) & (g <= 0)) | ((p >= upper) & (g >= 0))))


def _noise(problem: Problem, chi2: float) -> float:
    """Root mean square of the weighted residuals, never 0."""
    return float(np.sqrt(max(chi2 / max(problem.n - len(problem.parameters), 1), 1e-300)))


def _distance(
    problem: Problem, chi2: float, g: FloatArray, h: FloatArray, free: NDArray[np.bool_]
) -> float:
    """Length of the next Gauss-Newton step in units of the uncertainty in its direction."""
    decrease = float(g @ _solve(h, g, free, 0.0))
    return float(np.sqrt(max(decrease, 0.0))) / _noise(problem, chi2)


def _deeper_nearby(problem: Problem, optimum: Optimum) -> tuple[FloatArray | None, int]:
    """A point half an uncertainty away with a smaller chi2, or None; and how many were tried.

    The curvature J^T W J is never negative, also not on a saddle: only chi2 itself tells.
    """
    index = np.flatnonzero(optimum.free & (np.diag(optimum.curvature) > 0))
    if len(index) == 0:
        return None, 0
    parameters = problem.parameters
    bounds = [np.array([getattr(q, end) for q in parameters]) for end in ("lower", "upper")]
    scale = 1 / np.sqrt(np.diag(optimum.curvature)[index])
    values, vectors = np.linalg.eigh(
        optimum.curvature[np.ix_(index, index)] * np.outer(scale, scale)
    )
    tried = 0
    best: tuple[float, FloatArray | None] = (optimum.chi2 * (1 - DEEPER), None)
    for value, vector in zip(values, vectors.T, strict=True):
        if value < UNDETERMINED:
            continue
        step = np.zeros(len(parameters))
        step[index] = 0.5 * _noise(problem, optimum.chi2) * scale * vector / np.sqrt(value)
        for side in (1, -1):
            trial = np.clip(optimum.p + side * step, *bounds)
            chi2 = problem.chi2(trial)
            tried += 1
            if chi2 < best[0]:
                best = (chi2, trial)
    return best[1], tried


def _solve(h: FloatArray, g: FloatArray, free: NDArray[np.bool_], damping: float) -> FloatArray:
    """(H + damping diag H) step = g on the free parameters; 0 where the data say nothing."""
    step = np.zeros(len(g))
    index = np.flatnonzero(free & (np.diag(h) > 0))
    if len(index):
        scale = 1 / np.sqrt(np.diag(h)[index])
        scaled = h[np.ix_(index, index)] * np.outer(scale, scale)
        scaled = scaled + damping * np.eye(len(index))
        # rcond leaves out directions that the data do not determine.
        step[index] = scale * (np.linalg.pinv(scaled, rcond=UNDETERMINED) @ (scale * g[index]))
    return step
