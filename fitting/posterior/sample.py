"""The posterior of a fit: emcee's walkers, or the marginal sampler where its guard lets it.

The likelihood holds the independent errors. Errors that the samples share are not estimated from
the data: each draw is moved by a random draw of every shared term, as GUM supplement 1 propagates
them. Where the uncertainties allow for misfit the draws are spread to them first. Priors are those
of `gonio.fitting.posterior.priors`, flat between the bounds where none is declared. Both samplers
integrate over the amplitudes in closed form (`gonio.fitting.posterior.density`); emcee's walkers
propose by a Student-t at the mode, by differential evolution and by a snooker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gonio.errors import ConfigurationError
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.posterior import marginal_sampler
from gonio.fitting.posterior.chain import Chain, Progress, Sampler
from gonio.fitting.posterior.density import TOLERANCE, Target, WholeTarget
from gonio.fitting.posterior.marginal_density import MarginalTarget
from gonio.fitting.posterior.priors import Prior, resolve
from gonio.fitting.posterior.widened import widened
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.geometry import FloatArray

MAX_STEPS = 20_000
NEAR_SUM = 6.0  # standard deviations from 1 at which a limited sum no longer matters


def sample(
    minimum: Minimum,
    errors: Uncertainty,
    *,
    seed: int,
    sampler: Sampler = "emcee",
    priors: Sequence[Prior] | None = None,
    max_steps: int = MAX_STEPS,
    progress: Progress | None = None,
) -> Chain:
    """Sample the posterior until it has converged or `max_steps` are done.

    Parameters
    ----------
    minimum : Minimum
    errors : Uncertainty
        Its noise scale widens the likelihood, its shared terms move the draws.
    seed : int
        One seed, one chain, whatever the number of threads.
    sampler : {"emcee", "marginal", "auto"}
        "marginal" and "auto" try the marginal sampler first, and emcee takes over where its guard
        refuses it; "marginal" warns of it.
    priors : sequence of Prior, optional
        One a parameter; as the parameters declare them where not given.
    progress : callable, optional
        Called with (steps done, most steps) while emcee runs.

    Raises
    ------
    ConfigurationError
        Where the marginal sampler is asked for and the problem is not one model with independent
        noise and squared residuals.
    """
    problem, optimum = minimum.problem, minimum.optimum
    rng = np.random.default_rng(seed)
    priors = resolve(problem.parameters) if priors is None else tuple(priors)
    root = _proposal_root(problem, optimum, errors)
    marginal = problem.kernel_parameters is not None
    if sampler == "marginal" and not marginal:
        raise ConfigurationError(
            "sampler 'marginal' needs one model with independent noise and the loss chi2, and "
            f"{problem.name} is more than that; use auto or emcee.",
            value=sampler,
        )

    def target(*, whole: bool) -> Target:
        if not marginal:
            return WholeTarget(problem, optimum.p, errors.noise_scale, priors)
        spread = np.sqrt(np.sum(root**2, axis=1))
        built = MarginalTarget(problem, optimum.p, errors.noise_scale, priors, spread)
        # emcee needs something to walk in, and a limit on a sum is not integrated over.
        if (whole and len(built.sampled) == 0) or _sum_is_near(problem, optimum.p, root):
            return MarginalTarget(
                problem, optimum.p, errors.noise_scale, priors, spread, amplitudes=0
            )
        return built

    k_hat, note, notes = None, "", []
    if sampler != "emcee" and not marginal:
        note = "the problem is not one model with independent noise and squared residuals"
    elif sampler != "emcee":
        chain = _checked(_by_marginal, target(whole=False), root, rng)
        if not chain.note:
            return _moved(minimum, chain, errors, rng)
        k_hat, note = chain.k_hat, chain.note
        if sampler == "marginal":
            notes = [f"emcee took over from the marginal sampler: {note}."]

    def by_emcee(target: Target, covariance: FloatArray, rng: np.random.Generator) -> Chain:
        from gonio.fitting.posterior import ensemble_sampler  # emcee is slow to import

        return ensemble_sampler.run(target, covariance, rng, max_steps, progress)

    chain = _checked(by_emcee, target(whole=True), root, rng)
    chain = replace(chain, k_hat=k_hat, note=note, warnings=notes + chain.warnings)
    return _moved(minimum, chain, errors, rng)


def _sum_is_near(problem: Problem, mode: FloatArray, root: FloatArray) -> bool:
    """Whether the limit on the sum of the reflectances cuts the posterior."""
    c = problem.sum_limit
    limited = np.flatnonzero(c)
    sd = float(np.linalg.norm((root[limited] * c[limited, None]).sum(axis=0)))
    return len(limited) > 0 and float((mode[limited] * c[limited]).sum()) + NEAR_SUM * sd > 1


def _checked(
    run: Callable[[Target, FloatArray, np.random.Generator], Chain],
    target: Target,
    root: FloatArray,
    rng: np.random.Generator,
) -> Chain:
    """A run, and another one with every cell where the draws show that the factors do not do."""
    covariance = _sampled_covariance(target, root)
    chain = run(target, covariance, rng)
    if target.exact or chain.note:
        return chain
    if target.worst_error(chain.draws.reshape(-1, chain.draws.shape[-1]), rng) <= TOLERANCE:
        return chain
    target.exact = True
    chain = run(target, covariance, rng)
    return replace(
        chain,
        warnings=[
            *chain.warnings,
            "the lobe changes over the cells within the posterior: the likelihood was "
            "integrated over every cell, which is slower.",
        ],
    )


def _by_marginal(target: Target, covariance: FloatArray, rng: np.random.Generator) -> Chain:
    run = marginal_sampler.sample(target, covariance, rng)
    return Chain(
        run.draws, run.measures, run.acceptance, "marginal", run.k_hat, run.refusal,
        run.log_density, target.priors,
    )  # fmt: skip


def _proposal_root(problem: Problem, optimum: Optimum, errors: Uncertainty) -> FloatArray:
    """Matrix whose square is the proposal's covariance.

    From the curvature where the data determine a parameter; one at a bound or undetermined is
    given the width that its own curvature allows, at most a third of its range.
    """
    n_p = len(optimum.p)
    covariance = errors.of_likelihood
    for j, q in enumerate(problem.parameters):
        if not errors.determined[j]:
            widest = (q.upper - q.lower) / 3
            information = optimum.curvature[j, j] / errors.noise_scale**2
            width = widest if information <= 0 else min(1 / np.sqrt(information), widest)
            covariance[j, :] = covariance[:, j] = 0.0
            covariance[j, j] = width**2
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale) + 1e-12 * np.eye(n_p)
    return np.asarray(scale[:, None] * np.linalg.cholesky(correlation))


def _sampled_covariance(target: Target, root: FloatArray) -> FloatArray:
    """Covariance of the sampled coordinates, from that of the parameters."""
    some = target.sampled
    covariance = (root @ root.T)[np.ix_(some, some)]
    slope = np.where(target.log, 1 / np.where(target.log, target.mode[some], 1.0), 1.0)
    return np.asarray(covariance * np.outer(slope, slope))


def _moved(minimum: Minimum, chain: Chain, errors: Uncertainty, rng: np.random.Generator) -> Chain:
    """Draws spread to what the uncertainties allow for, and moved by the shared terms.

    Each is moved by a random draw of every shared term, and held inside the bounds.
    """
    problem, draws, allowance = minimum.problem, chain.draws.copy(), ""
    if errors.allowance is not None:
        draws = widened(problem, minimum.optimum.p, draws, errors, rng)
        allowance = f"draws are spread so that their {errors.allowance.text}"
    for moves in errors.propagated.values():
        draws += rng.standard_normal((*draws.shape[:2], len(moves))) @ moves
    lower = [q.lower for q in problem.parameters]
    upper = [q.upper for q in problem.parameters]
    draws = np.clip(draws, lower, upper)
    c = problem.sum_limit
    limited = np.flatnonzero(c)
    if len(limited):
        total = (draws[..., limited] * c[limited]).sum(axis=-1, keepdims=True)
        draws[..., limited] /= np.maximum(total, 1.0)
    return replace(chain, draws=draws, unmoved=chain.draws, allowance=allowance)
