"""The posterior about a minimum, and the deeper minimum that its draws may lead to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gonio.errors import DataError
from gonio.fitting.minimum.derivative_check import gradient_faults
from gonio.fitting.minimum.find import reweighted_minimum
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.minimum.rivals import parameter_text
from gonio.fitting.posterior import sample as posteriors
from gonio.fitting.posterior.chain import Chain, Progress, Sampler
from gonio.fitting.posterior.priors import Prior, resolve
from gonio.fitting.residual_tests.verdict import misfit_beyond_shared
from gonio.fitting.result import Estimate
from gonio.fitting.uncertainty.at_minimum import honest_uncertainties
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.models import Parameter

RESTARTS = 2  # times that a posterior may lead to a deeper minimum
NO_DEEPER = 1e-3  # of the noise squared: as deep, but for rounding


def sampled(
    minimum: Minimum,
    priors: Mapping[str, str | Prior] | None,
    *,
    seed: int,
    sampler: Sampler,
    progress: Progress | None,
) -> tuple[Minimum, Chain]:
    """The posterior, and the minimum where its draws led to a deeper one.

    Raises
    ------
    DataError
        Where there is no noise.
    """
    if minimum.noise_scale == 0:
        raise DataError(
            "the model leaves no residuals and the samples state no uncertainty: there is no "
            "noise to sample a posterior with; give u_brdf or fit without a posterior."
        )
    believed = resolve(minimum.problem.parameters, priors)
    for _ in range(RESTARTS + 1):
        test = misfit_beyond_shared(minimum) if minimum.problem.quadratic else None
        errors, _ = honest_uncertainties(minimum, test)
        chain = posteriors.sample(
            minimum, errors, seed=seed, sampler=sampler, priors=believed, progress=progress
        )
        deeper = _deeper_by_draws(minimum, chain)
        if deeper is None:
            break
        minimum = deeper
        if not deeper.optimum.verified:
            break
    return _along_exchanges(minimum, errors, chain), chain


def _along_exchanges(minimum: Minimum, errors: Uncertainty, chain: Chain) -> Minimum:
    """The minimum moved along what the data do not see to the middle of the posterior.

    Every point there fits as well. The one where the search ended may lie outside the posterior's
    intervals, which the bounds and priors make.
    """
    problem, optimum = minimum.problem, minimum.optimum
    informed = np.diag(optimum.curvature) > 0
    free = optimum.free & ~errors.determined & informed
    free[list(optimum.limited)] = False
    index = np.flatnonzero(free)
    if len(index) < 2 or problem.profiled or not optimum.verified:
        return minimum
    draws = chain.draws.reshape(-1, chain.draws.shape[-1])
    low, middle, high = np.quantile(draws[:, index], [0.16, 0.5, 0.84], axis=0)
    away = np.sum(((draws[:, index] - middle) / np.maximum(high - low, 1e-300)) ** 2, axis=1)
    start = optimum.p.copy()
    start[index] = draws[int(np.argmin(away))][index]
    other = minimise(problem, start, search=False)
    slack = NO_DEEPER * minimum.noise_scale**2
    same = np.array_equal(other.free, optimum.free) and other.limited == optimum.limited
    if not (other.verified and same and other.chi2 <= optimum.chi2 + slack):
        return minimum
    names = " and ".join(problem.parameters[j].name for j in index)
    warning = (
        f"{names}: of the values that fit as well, some near the middle of the posterior are "
        "stated; their intervals are those of the bounds and priors."
    )
    return replace(minimum, optimum=other, warnings=[*minimum.warnings, warning])


def outside_posterior(
    parameters: Sequence[Parameter], estimates: Mapping[str, Estimate]
) -> list[str]:
    """A sentence for each least-squares value outside the interval of its posterior."""
    warnings = []
    for q in parameters:
        e = estimates[q.name]
        if e.interval_95 is not None and not e.interval_95[0] <= e.value <= e.interval_95[1]:
            warnings.append(
                f"{q.name}: the value, of least squares, lies outside the 95 % interval, of the "
                "posterior, which its prior or a curved likelihood moves; take the posterior's "
                "median where you use its interval."
            )
    return warnings


def _deeper_by_draws(minimum: Minimum, chain: Chain) -> Minimum | None:
    """The minimum below the best draw where it is deeper; unverified where it cannot be taken."""
    best = chain.draws.reshape(-1, chain.draws.shape[-1])[int(np.argmax(chain.log_density))]
    problem, optimum = minimum.problem, minimum.optimum
    other = minimise(problem, best, search=False)
    if not other.verified or optimum.chi2 - other.chi2 <= NO_DEEPER * minimum.noise_scale**2:
        return None
    if minimum.parts or problem.profiled:
        warning = "the posterior holds a deeper minimum, which the search did not find."
        return replace(
            minimum, optimum=replace(optimum, verified=False), warnings=[*minimum.warnings, warning]
        )
    problem, other = reweighted_minimum(problem, other)
    warning = (
        f"the search found a minimum at {parameter_text(problem, optimum)}; the posterior "
        "led to a deeper one, which was taken."
    )
    faults = gradient_faults(problem, other.p)
    return Minimum.of(problem, other, warnings=[warning], faults=faults)
