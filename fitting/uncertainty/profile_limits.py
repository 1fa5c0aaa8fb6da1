"""Limits from profile likelihood where a bound is near, with shared errors added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from gonio.fitting.minimum.minimise import minimise, pinned_at
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_columns import thinned
from gonio.fitting.residual_tests.misfit import MisfitTest
from gonio.fitting.uncertainty.covariance import evaluate
from gonio.fitting.uncertainty.degrees_of_freedom import quantile
from gonio.fitting.uncertainty.profile_likelihood import around, profile_limit
from gonio.fitting.uncertainty.under_misfit import allowing
from gonio.geometry import FloatArray

MOST = 5_000  # samples that tell the part of the shared errors
ROUNDS = 3
SMALL = 1e-3  # part of the shared errors that changes no limit


def limit(
    minimum: Minimum,
    j: int,
    increase: float,
    *,
    side: int,
    test: MisfitTest | None = None,
) -> float | None:
    """How far parameter j can move, both kinds of errors counted; None where nothing limits it.

    Parameters
    ----------
    minimum : Minimum
    j : int
        Number of the parameter.
    increase : float
        Of chi-squared in units of its variance, for instance 3.84.
    side : {1, -1}
        +1 upwards, -1 downwards.
    test : MisfitTest, optional
        For structure in the residuals, where the uncertainties allow for what it shows.

    Notes
    -----
    Where f is linear and the estimate without bounds is x', chi-squared grows by
    ((x - x')^2 - x'^2)/u^2 from a bound at 0 to x, with u from the independent errors. Shared
    errors of variance k u^2 make the variance (1 + k) u^2, so that the limit is where chi-squared
    has grown (1 + k) times as far. k is taken at the limit itself with the parameter free: at the
    bound it may have no derivative, and a ratio of variances does not depend on how the parameter
    is written. What the uncertainties allow for beyond noise is part of k in the same way.
    """
    minimum, j, _ = around(minimum, j)
    problem = minimum.problem
    unit = minimum.noise_scale**2
    end = profile_limit(minimum, j, increase * unit, side=side)
    if not _propagated(problem) and test is None:
        return end
    before = 0.0
    for _ in range(ROUNDS):
        at = problem.parameters[j].upper if end is None and side > 0 else end
        at = problem.parameters[j].lower if at is None else at
        k = _beyond(minimum, j, at, increase, test)
        if abs(k - before) <= SMALL * (1 + k):
            break
        before = k
        end = profile_limit(minimum, j, increase * unit * (1 + k), side=side)
    return end


def excluded(minimum: Minimum, j: int, value: float, unit: float, level: float) -> bool:
    """Whether the data speak against parameter j having a value, with this confidence.

    Near a bound at which f has no derivative by the parameter (it may act by its square) the
    curvature at the minimum tells an uncertainty that is far too small. Where other parameters
    lose their effect at the value (a lobe of amplitude 0 has no width) they have helped to follow
    the noise: chi-squared has as many degrees of freedom more.

    Parameters
    ----------
    unit : float
        Growth of chi-squared for one standard uncertainty, all errors counted.
    level : float
        For instance 0.95.
    """
    minimum, j, _ = around(minimum, j)
    problem, optimum = minimum.problem, minimum.optimum
    start = np.where(np.arange(len(optimum.p)) == j, value, optimum.p)
    held = minimise(pinned_at(problem, j, value), start, search=False)
    p = np.where(np.arange(len(start)) == j, value, held.p)
    curvature = problem.normal_equations(p)[2]
    lost = int(np.count_nonzero((np.diag(curvature) <= 0) & (np.diag(optimum.curvature) > 0)))
    lost -= int(curvature[j, j] <= 0 < optimum.curvature[j, j])
    return bool(held.chi2 - optimum.chi2 > unit * stats.chi2.ppf(level, 1 + lost))


def _propagated(problem: Problem) -> bool:
    """Whether there are shared errors that the chi-squared of the problem does not hold."""
    return any(term.name not in problem.profiled for term in problem.samples.shared)


def _beyond(
    minimum: Minimum, j: int, value: float, increase: float, test: MisfitTest | None
) -> float:
    """Variance of parameter j beyond that by noise, over it, at a value of the parameter."""
    problem, optimum = minimum.problem, minimum.optimum
    start = np.where(np.arange(len(optimum.p)) == j, value, optimum.p)
    p: FloatArray = minimise(pinned_at(problem, j, value), start, search=False).p
    some = thinned(problem.independent, MOST)
    chi2, gradient, curvature = some.normal_equations(p)
    free = optimum.free | (np.arange(len(p)) == j)
    scale = minimum.noise_scale * float(np.sqrt(some.n / problem.n))
    here = replace(
        minimum.at(some, Optimum(p, chi2, gradient, curvature, free, 0, True)), noise_scale=scale
    )
    errors = evaluate(here)
    if not errors.determined[j] or errors.independent[j, j] <= 0:
        return 0.0
    by_noise = float(errors.independent[j, j])
    variance = by_noise
    if test is not None:
        errors = allowing(here, errors, test)
        own = None if errors.dof is None else float(errors.dof[j])
        probability = (1 + float(stats.chi2.cdf(increase, 1))) / 2
        fewer = quantile(probability, own) ** 2 / increase if errors.allowance else 1.0
        variance = float(errors.independent[j, j]) * fewer
    variance += sum(
        float(np.sum(moves[:, j] ** 2))
        for name, moves in errors.shared.items()
        if name not in problem.profiled
    )
    return max(variance / by_noise - 1, 0.0)
