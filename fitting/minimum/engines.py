"""Engines: ways from a start to the neighbourhood of a minimum, selected by name.

All end in the same Gauss-Newton steps and the same checks (`optimise.minimise`): they differ in
time and in which minimum they reach, not in how exactly. The gradient-free ones search the
nonlinear parameters alone; at each point the linear ones are solved for.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gonio.errors import unknown_name
from gonio.fitting.minimum import starting_values
from gonio.fitting.minimum.box import Box
from gonio.fitting.minimum.minimise import Engine
from gonio.fitting.minimum.variable_projection import scored
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.models import Parameter

DEFAULT = "gauss_newton"
ENGINES = {
    "gauss_newton": "Gauss-Newton steps alone",
    "slsqp": "nlopt LD_SLSQP, sequential quadratic programming",
    "lbfgs": "nlopt LD_LBFGS, quasi-Newton",
    "mma": "nlopt LD_MMA, moving asymptotes",
    "bobyqa": "nlopt LN_BOBYQA, quadratic models without gradient",
    "sbplx": "nlopt LN_SBPLX, simplices without gradient",
    "mlsl": "nlopt G_MLSL_LDS, many starts, L-BFGS from each",
}
_WITH_GRADIENT = {"slsqp": "LD_SLSQP", "lbfgs": "LD_LBFGS", "mma": "LD_MMA"}
_WITHOUT = {"bobyqa": "LN_BOBYQA", "sbplx": "LN_SBPLX"}
TOLERANCE = 1e-7  # of the objective; the Gauss-Newton steps do the rest
EVALUATIONS = 400
GLOBAL_EVALUATIONS = 300  # a nonlinear parameter
LOCAL_EVALUATIONS = 40


def get(name: str, seed: int = 0) -> Engine | None:
    """The engine with this name; None for Gauss-Newton steps alone.

    Parameters
    ----------
    name : str
        One of `ENGINES`.
    seed : int
        Of the starts of "mlsl".

    Raises
    ------
    ConfigurationError
        If there is none, with the nearest name.
    """
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    if name == DEFAULT:
        return None
    if name in _WITH_GRADIENT:
        return partial(_gradient, _WITH_GRADIENT[name])
    if name in _WITHOUT:
        return partial(_gradient_free, _WITHOUT[name])
    return partial(_multistart, seed)


class _Scale:
    """Optimiser variables in [0, 1]: log parameters by their logarithm."""

    def __init__(self, parameters: tuple[Parameter, ...]) -> None:
        self.log = np.array([q.scale == "log" for q in parameters], bool)
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


class _Objective:
    """chi2 / chi2(start) over some parameters, and the best point that it saw.

    Unscaled, SLSQP stops after one step.
    """

    def __init__(self, problem: Problem, start: FloatArray, *, projected: bool) -> None:
        self.problem = problem
        self.box = Box.of(problem)
        self.projected = projected and problem.quadratic
        searched = [not (self.projected and q.linear) for q in problem.parameters]
        self.index = np.flatnonzero(np.array(searched) & (self.box.lower < self.box.upper))
        self.scale = _Scale(tuple(problem.parameters[j] for j in self.index))
        self.best = (np.inf, self.box.inside(start))
        self.evaluations = 0
        self.reference = max(self._value(self.best[1]), 1e-300)
        self.start = self.scale.to(start[self.index])

    def _value(self, p: FloatArray) -> float:
        if self.projected:
            chi2, solved = scored(self.problem, self.box, p[None])
            return self._seen(float(chi2[0]), solved[0])
        return self._seen(float(self.problem.batch_chi2(p[None])[0]), p)

    def _seen(self, chi2: float, p: FloatArray) -> float:
        self.evaluations += 1
        if chi2 < self.best[0]:
            self.best = (chi2, p)
        self.last = p
        return chi2

    def __call__(self, x: FloatArray, gradient: FloatArray) -> float:
        p = self.best[1].copy()
        p[self.index] = self.scale.back(x)
        p = self.box.inside(p)
        if not gradient.size:
            return self._value(p) / self.reference
        if self.projected:
            # The best amplitudes move as well, but chi2 is stationary in them.
            self._value(p)
            p = self.last
        chi2, g, _ = self.problem.normal_equations(p)
        self._seen(chi2, p)
        gradient[:] = -2 * g[self.index] * self.scale.derivative(p[self.index]) / self.reference
        return chi2 / self.reference


def _optimiser(name: str, objective: _Objective, evaluations: int) -> Any:
    import nlopt

    n = len(objective.index)
    optimiser = nlopt.opt(getattr(nlopt, name), n)
    optimiser.set_lower_bounds(np.zeros(n))
    optimiser.set_upper_bounds(np.ones(n))
    optimiser.set_min_objective(objective)
    optimiser.set_ftol_rel(TOLERANCE)
    optimiser.set_xtol_rel(TOLERANCE)
    optimiser.set_maxeval(evaluations)
    return optimiser


def _run(make: Callable[[], Any], objective: _Objective) -> tuple[FloatArray, int]:
    """The best point seen; the polish and its checks decide what it is worth."""
    import nlopt

    # nlopt has a runtime_error of its own, which is no RuntimeError.
    with contextlib.suppress(nlopt.RoundoffLimited, nlopt.runtime_error, RuntimeError, ValueError):
        if len(objective.index):
            make().optimize(objective.start)
    return objective.best[1], objective.evaluations


def _gradient(name: str, problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    objective = _Objective(problem, start, projected=False)
    return _run(lambda: _optimiser(name, objective, EVALUATIONS), objective)


def _gradient_free(name: str, problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    objective = _Objective(problem, start, projected=True)
    return _run(lambda: _optimiser(name, objective, EVALUATIONS), objective)


def _multistart(seed: int, problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    """Many starts on some of the samples; the best minimum is the start for all of them."""
    import nlopt

    objective = _Objective(problem.subset(starting_values.SUBSET), start, projected=True)

    def make() -> Any:
        nlopt.srand(seed)
        n = len(objective.index)
        optimiser = _optimiser("G_MLSL_LDS", objective, GLOBAL_EVALUATIONS * n)
        local = nlopt.opt(nlopt.LD_LBFGS, n)
        local.set_ftol_rel(1e-5)
        local.set_maxeval(LOCAL_EVALUATIONS)
        optimiser.set_local_optimizer(local)
        return optimiser

    return _run(make, objective)
