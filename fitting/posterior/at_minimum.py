"""The posterior about a minimum, and the deeper minimum that its draws may lead to."""

from __future__ import annotations

from collections.abc import Mapping
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
from gonio.fitting.uncertainty.at_minimum import uncertainties

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
        errors, _ = uncertainties(minimum)
        chain = posteriors.sample(
            minimum, errors, seed=seed, sampler=sampler, priors=believed, progress=progress
        )
        deeper = _deeper_by_draws(minimum, chain)
        if deeper is None:
            break
        minimum = deeper
        if not deeper.optimum.verified:
            break
    return minimum, chain


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
