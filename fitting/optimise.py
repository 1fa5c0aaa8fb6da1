"""Find the minimum: starts from the data, nlopt, and a Gauss-Newton polish inside the bounds."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem import Problem
from gonio.geometry import FloatArray
from gonio.models import Parameter

GRID = 9  # starting values along each nonlinear parameter
SUBSET = 2000  # samples that choose among the starting values
STARTS = 2  # starting values that are followed to their minimum


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
        Parameters that are not held by a bound.
    evaluations : int
        Model passes over the data.
    verified : bool
        The next Gauss-Newton step is far below the uncertainties.
    """

    p: FloatArray
    chi2: float
    gradient: FloatArray
    curvature: FloatArray
    free: NDArray[np.bool_]
    evaluations: int
    verified: bool


def starts(problem: Problem, rng: np.random.Generator, n: int = STARTS) -> list[FloatArray]:
    """The best n starting values of a coarse grid over the nonlinear parameters.

    The linear parameters are solved for at each point of the grid, inside their bounds.
    """
    from scipy.optimize import lsq_linear

    parameters = problem.model.parameters
    coarse = problem.subset(SUBSET, rng)
    root = np.sqrt(coarse.inverse_variance)
    linear = [j for j, q in enumerate(parameters) if q.linear]
    axes = [_grid(q) for q in parameters if not q.linear]
    scored: list[tuple[float, FloatArray]] = []
    for point in itertools.product(*axes):
        p = np.zeros(len(parameters))
        p[[j for j, q in enumerate(parameters) if not q.linear]] = point
        p[linear] = [min(max(0.0, parameters[j].lower), parameters[j].upper) for j in linear]
        f, jac = coarse.jacobian(p)
        r = (coarse.samples.value - f + jac[:, linear] @ p[linear]) * root
        if linear:
            a = jac[:, linear] * root[:, None]
            bounds = ([parameters[j].lower for j in linear], [parameters[j].upper for j in linear])
            solution = lsq_linear(a, r, bounds)
            p[linear] = solution.x
            r = r - a @ solution.x
        scored.append((float(r @ r), p))
    scored.sort(key=lambda item: item[0])
    return [p for _, p in _distinct(scored, n)]


def minimise(problem: Problem, start: FloatArray) -> Optimum:
    """Follow one start to its minimum: nlopt's SLSQP, then Gauss-Newton steps inside the bounds.

    Parameters
    ----------
    problem : Problem
    start : ndarray
        Any point inside the bounds.
    """
    p, evaluations = _slsqp(problem, start)
    return _polish(problem, p, evaluations)


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
        return np.clip((self._internal(p) - self.low) / self.span, 0.0, 1.0)

    def back(self, x: FloatArray) -> FloatArray:
        y = self.low + x * self.span
        return np.where(self.log, np.exp(np.where(self.log, y, 0.0)), y)

    def derivative(self, p: FloatArray) -> FloatArray:
        """dp/dx."""
        return self.span * np.where(self.log, p, 1.0)


def _slsqp(problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    """nlopt LD_SLSQP on chi2 / chi2(start): unscaled, SLSQP stops after one step."""
    import nlopt

    scale = _Scale(problem.model.parameters)
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
    try:
        optimiser.optimize(scale.to(start))
    except (nlopt.RoundoffLimited, RuntimeError, ValueError):
        # The best point seen is kept; the polish and its checks decide what it is worth.
        pass
    return best[1], evaluations


def _polish(problem: Problem, p: FloatArray, evaluations: int, steps: int = 100) -> Optimum:
    """Levenberg-Marquardt with an active set of bounds, until the step is negligible."""
    parameters = problem.model.parameters
    lower = np.array([q.lower for q in parameters])
    upper = np.array([q.upper for q in parameters])
    p = np.clip(p, lower, upper)
    chi2, g, h = problem.normal_equations(p)
    evaluations += 1
    damping = 1e-3
    verified = False
    for _ in range(steps):
        free = ~(((p <= lower) & (g <= 0)) | ((p >= upper) & (g >= 0)))
        newton = _solve(h, g, free, 0.0)
        # Uncertainties in units of which the step must vanish; a noiseless fit has none.
        size = np.sqrt(np.maximum(np.diag(h), 1e-300))
        noise = np.sqrt(max(chi2, 1e-300) / max(problem.n - len(p), 1))
        if np.max(np.abs(newton) * size, initial=0.0) < 1e-5 * noise:
            verified = True
            break
        trial = np.clip(p + _solve(h, g, free, damping), lower, upper)
        new = problem.normal_equations(trial)
        evaluations += 1
        if new[0] <= chi2:
            small = np.all(np.abs(trial - p) <= 1e-14 * np.abs(p))
            p, (chi2, g, h) = trial, new
            damping = max(damping / 10, 1e-12)
            if small:
                verified = True
                break
        else:
            damping *= 10
            if damping > 1e10:
                # No step goes down: rounding limits the sum of squares.
                verified = bool(np.max(np.abs(newton) * size, initial=0.0) < 1e-2 * noise)
                break
    free = ~(((p <= lower) & (g <= 0)) | ((p >= upper) & (g >= 0)))
    return Optimum(p, chi2, g, h, free, evaluations, verified)


def _solve(h: FloatArray, g: FloatArray, free: NDArray[np.bool_], damping: float) -> FloatArray:
    """(H + damping diag H) step = g on the free parameters; 0 where the data say nothing."""
    step = np.zeros(len(g))
    active = free & (np.diag(h) > 0)
    index = np.flatnonzero(active)
    if len(index):
        scale = 1 / np.sqrt(np.diag(h)[index])
        scaled = h[np.ix_(index, index)] * np.outer(scale, scale)
        scaled = scaled + damping * np.eye(len(index))
        # rcond leaves out directions that the data do not determine.
        step[index] = scale * (np.linalg.pinv(scaled, rcond=1e-13) @ (scale * g[index]))
    return step
