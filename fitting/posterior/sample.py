"""The posterior of a fit: the marginal sampler where its guard lets it, emcee otherwise.

The likelihood holds the independent errors. Errors that the samples share are not learnt from the
data: each draw is moved by a random draw of every shared term, as GUM supplement 1 propagates
them. Priors are those of `gonio.fitting.posterior.priors`, flat between the bounds where none is
declared. Both samplers integrate over the amplitudes in closed form
(`gonio.fitting.posterior.density`); emcee's walkers propose by
a Student-t at the mode, by differential evolution and by a snooker.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import emcee
import numpy as np

from gonio.errors import ConfigurationError
from gonio.fitting.minimum.gauss_newton import Optimum
from gonio.fitting.posterior import convergence, marginal_sampler
from gonio.fitting.posterior.convergence import Convergence
from gonio.fitting.posterior.density import TOLERANCE, MarginalTarget, Target, WholeTarget
from gonio.fitting.posterior.priors import Prior, resolve
from gonio.fitting.posterior.proposal import Proposal, cholesky
from gonio.fitting.problem.problem import Problem
from gonio.fitting.result import PosteriorSummary
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.geometry import FloatArray
from gonio.models import Parameter

WALKERS = 32
BURN_IN = 50
BLOCK_STEPS = 100
GROWTH = 1.25  # of the chain between two looks at its convergence
MAX_STEPS = 20_000
NEAR_SUM = 6.0  # standard deviations from 1 at which a limited sum no longer matters

Sampler = Literal["auto", "marginal", "emcee"]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Chain:
    """Draws of the posterior.

    Parameters
    ----------
    draws : ndarray, shape (chains, steps, parameters)
        Python units, burn-in removed, shared terms added.
    measures : Convergence
        Of the sampled chains, before the shared terms.
    acceptance : float
    sampler : {"marginal", "emcee"}
    k_hat : float or None
        Of the importance weights of the marginal sampler, also where its guard refused it; None
        where it had nothing to weigh or did not run.
    note : str
        Why the marginal sampler was not used; empty where it was.
    log_density : ndarray, shape (chains, steps)
        Log of the density that was sampled, amplitudes integrated out, up to a constant.
    priors : tuple of Prior
    warnings : list of str
    """

    draws: FloatArray
    measures: Convergence
    acceptance: float
    sampler: Literal["marginal", "emcee"]
    k_hat: float | None
    note: str
    log_density: FloatArray
    priors: tuple[Prior, ...]
    warnings: list[str] = field(default_factory=list)

    @property
    def n_steps(self) -> int:
        """Steps a chain after the burn-in."""
        return int(self.draws.shape[1])

    @property
    def converged(self) -> bool:
        """Long against tau, R-hat near 1, enough effective draws in the middle and the tails."""
        return self.measures.converged

    def summary(self, parameters: Sequence[Parameter], path: str | None) -> PosteriorSummary:
        """The part of the chain that stands in a fit's JSON document."""
        m = self.measures
        return PosteriorSummary(
            ess=m.ess_bulk,
            r_hat=m.r_hat if np.isfinite(m.r_hat) else float(len(self.draws)),
            tau=m.tau if np.isfinite(m.tau) else float(self.n_steps),
            acceptance=self.acceptance,
            converged=self.converged,
            draws=path,
            ess_bulk=m.ess_bulk,
            ess_tail=m.ess_tail,
            sampler=self.sampler,
            k_hat=self.k_hat if self.k_hat is not None and np.isfinite(self.k_hat) else None,
            note=self.note,
            priors={q.name: p.text(q) for q, p in zip(parameters, self.priors, strict=True)},
        )


def sample(
    problem: Problem,
    optimum: Optimum,
    errors: Uncertainty,
    *,
    seed: int,
    sampler: Sampler = "auto",
    priors: Sequence[Prior] | None = None,
    max_steps: int = MAX_STEPS,
    progress: Progress | None = None,
) -> Chain:
    """Sample the posterior until it has converged or `max_steps` are done.

    Parameters
    ----------
    problem : Problem
        With the weights of the least-squares minimum.
    optimum : Optimum
    errors : Uncertainty
        Its noise scale widens the likelihood, its shared terms move the draws.
    seed : int
        One seed, one chain, whatever the number of threads.
    sampler : {"auto", "marginal", "emcee"}
        The marginal sampler is tried first unless emcee is asked for; emcee takes over where its
        guard refuses it.
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
    rng = np.random.default_rng(seed)
    priors = resolve(problem.parameters) if priors is None else tuple(priors)
    root = _proposal_root(problem, optimum, errors)
    plain = _is_plain(problem)
    if sampler == "marginal" and not plain:
        raise ConfigurationError(
            "sampler 'marginal' needs one model with independent noise and the loss chi2, and "
            f"{problem.name} is more than that; use auto or emcee.",
            value=sampler,
        )

    def target(*, whole: bool) -> Target:
        if not plain:
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
    if not plain:
        note = "the problem is not one model with independent noise and squared residuals"
    elif sampler == "emcee":
        note = "emcee was asked for"
    else:
        chain = _checked(_by_marginal, target(whole=False), root, rng)
        if not chain.note:
            return _moved(problem, chain, errors, rng)
        k_hat, note = chain.k_hat, chain.note
        if sampler == "marginal":
            notes = [f"emcee took over from the marginal sampler: {note}."]

    def by_emcee(target: Target, covariance: FloatArray, rng: np.random.Generator) -> Chain:
        return _by_emcee(target, covariance, rng, max_steps, progress)

    chain = _checked(by_emcee, target(whole=True), root, rng)
    chain = replace(chain, k_hat=k_hat, note=note, warnings=notes + chain.warnings)
    return _moved(problem, chain, errors, rng)


def _is_plain(problem: Problem) -> bool:
    """Whether this is one model with independent noise whose squared residuals are summed."""
    return type(problem) is Problem and problem.quadratic


def _sum_is_near(problem: Problem, mode: FloatArray, root: FloatArray) -> bool:
    """Whether the limit on the sum of the reflectances cuts the posterior."""
    limited = list(problem.sum_at_most_one)
    sd = float(np.linalg.norm(root[limited].sum(axis=0)))
    return bool(limited) and float(mode[limited].sum()) + NEAR_SUM * sd > 1


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


def _by_emcee(
    target: Target,
    covariance: FloatArray,
    rng: np.random.Generator,
    max_steps: int,
    progress: Progress | None,
) -> Chain:
    """Walkers in the sampled coordinates until they have converged, then the amplitudes."""
    mode = target.coordinates(target.mode)
    proposal = marginal_sampler.explored(target, covariance, rng)
    moves = [
        (_IndependenceMove(proposal), 0.6),
        (emcee.moves.DEMove(), 0.3),
        (_SnookerMove(), 0.1),
    ]

    def with_sums(x: FloatArray) -> FloatArray:
        density, sums = target.evaluate(x)
        return np.column_stack([density, sums])

    n = _walkers(len(mode))
    sampler = emcee.EnsembleSampler(n, len(mode), with_sums, moves=moves, vectorize=True)
    # emcee keeps a legacy generator; its `random_state` setter ignores a Generator silently, so
    # the state of a seeded RandomState is handed over with the start.
    legacy = np.random.RandomState(np.random.MT19937(int(rng.integers(0, 2**63))))
    start = _start(target, mode, cholesky(covariance, target.x_upper - target.x_lower), rng)
    state = emcee.State(start, random_state=legacy.get_state())
    state = sampler.run_mcmc(state, BURN_IN)
    sampler.reset()
    done = look = 0
    while True:
        state = sampler.run_mcmc(state, min(BLOCK_STEPS, max_steps - done))
        done = min(done + BLOCK_STEPS, max_steps)
        if progress is not None:
            progress(done, max_steps)
        if done < min(look, max_steps):
            continue
        look = int(GROWTH * done)
        x = np.swapaxes(sampler.get_chain(), 0, 1)
        if done < max_steps and not convergence.measure(x).converged:
            continue
        draws = _drawn(target, sampler, x, rng)
        measures = convergence.measure(draws)
        if measures.converged or done == max_steps:
            break
    return Chain(
        draws, measures, float(np.mean(sampler.acceptance_fraction)), "emcee", None, "",
        sampler.get_log_prob().T, target.priors,
    )  # fmt: skip


def _walkers(n: int) -> int:
    """How many walk in n dimensions, so that each half of them spans all."""
    return max(WALKERS, 4 * n)


def _drawn(target: Target, sampler: Any, x: FloatArray, rng: np.random.Generator) -> FloatArray:
    """All parameters of every walker at every step."""
    blobs = np.asarray(sampler.get_blobs(), float)
    sums = np.swapaxes(blobs.reshape(x.shape[1], x.shape[0], -1), 0, 1)
    flat = target.draw(x.reshape(-1, x.shape[2]), sums.reshape(-1, target.n_sums), rng)
    return flat.reshape(*x.shape[:2], -1)


class _IndependenceMove(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Propose from a mixture that was fitted to the posterior, whatever the walkers' places."""

    def __init__(self, proposal: Proposal) -> None:
        self.proposal = proposal
        super().__init__()

    def get_proposal(
        self, sample: FloatArray, complement: Any, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """New places and the log of the ratio of proposal densities, old over new."""
        proposed = self.proposal.draw(len(sample), random)
        both = self.proposal.log_density(np.concatenate([sample, proposed]))
        return proposed, both[: len(sample)] - both[len(sample) :]


class _SnookerMove(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Differential evolution along the line through another walker (ter Braak & Vrugt 2008).

    emcee's own move neither normalises the direction of the line nor takes the whole ratio of
    the distances, and so does not leave the posterior as it is.
    """

    def __init__(self) -> None:
        super().__init__(nsplits=4)

    def get_proposal(
        self, sample: FloatArray, complement: Any, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """New places q and (d - 1) log(|q - z| / |x - z|)."""
        n, d = sample.shape
        z, z1, z2 = (c[random.randint(len(c), size=n)] for c in complement)
        line = sample - z
        length = np.linalg.norm(line, axis=1)
        unit = line / length[:, None]
        proposed = sample + 1.7 * np.sum(unit * (z1 - z2), axis=1)[:, None] * unit
        return proposed, (d - 1) * np.log(np.linalg.norm(proposed - z, axis=1) / length)


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


def _start(
    target: Target, mode: FloatArray, root: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Walkers scattered about the mode, mirrored at the bounds."""
    places = mode + rng.standard_normal((_walkers(len(mode)), len(mode))) @ root.T
    lower, upper = target.x_lower, target.x_upper
    places = np.where(places < lower, 2 * lower - places, places)
    places = np.where(places > upper, 2 * upper - places, places)
    # A place mirrored beyond the other bound is drawn anywhere between them.
    anywhere = lower + (upper - lower) * rng.random(places.shape)
    places = np.where((places < lower) | (places > upper), anywhere, places)
    limited = np.isin(target.sampled, target.limited)
    if limited.any():
        # A walker that starts where nothing is allowed has no density to go on from.
        total = places[:, limited].sum(axis=1, keepdims=True)
        places[:, limited] /= np.where(total > 1, total * (1 + 0.01 * rng.random(total.shape)), 1)
    return places


def _moved(problem: Problem, chain: Chain, errors: Uncertainty, rng: np.random.Generator) -> Chain:
    """Each draw moved by a random draw of every shared term, held inside the bounds."""
    draws = chain.draws.copy()
    for moves in errors.propagated.values():
        draws += rng.standard_normal((*draws.shape[:2], len(moves))) @ moves
    lower = [q.lower for q in problem.parameters]
    upper = [q.upper for q in problem.parameters]
    draws = np.clip(draws, lower, upper)
    limited = list(problem.sum_at_most_one)
    if limited:
        draws[..., limited] /= np.maximum(draws[..., limited].sum(axis=-1, keepdims=True), 1.0)
    return replace(chain, draws=draws)
