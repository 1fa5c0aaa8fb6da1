"""Independence Metropolis-Hastings on the marginal posterior, behind a guard.

Proposals do not depend on where a chain stands, so the density of thousands of them is computed at
once; which are accepted is then a matter of their importance weights. The guard asks that the tail
of the weights is light enough (k-hat), that enough are accepted, and that a first look, which drew
far more widely, saw the same evidence. Where it is not content the proposal is fitted anew to what
was seen, a few times; then the sampler gives up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.posterior import convergence
from gonio.fitting.posterior.convergence import Convergence
from gonio.fitting.posterior.density import Target
from gonio.fitting.posterior.proposal import Proposal, Weighted, fitted, pilot
from gonio.geometry import FloatArray

CHAINS = 8
STEPS = 640  # of each chain before convergence is looked at
EXPLORED = 128  # steps of each chain that judge a proposal for emcee
MAX_PROPOSALS = 163_840
REFITS = 4
GOOD_ACCEPTANCE = 0.78  # in two dimensions; below this the proposal is fitted anew,
PER_DIMENSION = 0.05  # less for each further one: what a Student-t loses on a Gaussian
GOOD_K_HAT = 0.0  # and above this
MIN_ACCEPTANCE = 0.2  # below this the draws are not used
MAX_K_HAT = 0.5
MAX_DISAGREEMENT = 4.0  # standard errors between the evidence of the pilot and of the run
SPREAD_ERROR = 0.03  # of a standard deviation: its standard error, by the importance weights


@dataclass(frozen=True)
class MarginalRun:
    """What the sampler did.

    Parameters
    ----------
    draws : ndarray, shape (chains, steps, P)
    log_density : ndarray, shape (chains, steps)
        Of the marginal posterior.
    measures : Convergence
    acceptance : float
    k_hat : float or None
        None where there was nothing to weigh: the amplitudes are all there is.
    refusal : str
        Why the draws are not to be used; empty where the guard passes.
    proposal : Proposal or None
        The last one.
    """

    draws: FloatArray
    log_density: FloatArray
    measures: Convergence
    acceptance: float
    k_hat: float | None
    refusal: str
    proposal: Proposal | None = None


def sample(target: Target, covariance: FloatArray, rng: np.random.Generator) -> MarginalRun:
    """Run the chains until they have converged, or the guard refuses them.

    Parameters
    ----------
    target : Target
    covariance : ndarray, shape (S, S)
        Of the sampled coordinates, about the mode: a first guess.
    rng : numpy.random.Generator
    """
    if len(target.sampled) == 0:
        return _amplitudes_alone(target, rng)
    proposal, evidence = pilot(target, covariance, rng)
    proposal, proposed, state = _adapted(target, proposal, STEPS, rng)
    while True:
        k = convergence.k_hat(proposed.log_weight)
        acceptance = _acceptance(state)
        refusal = _doubt(k, acceptance, _disagreement(proposed.log_weight, evidence))
        if refusal:
            nothing = Convergence(np.inf, np.inf, 0.0, 0.0, 0)
            none = np.empty((0, 0))
            return MarginalRun(none[None], none, nothing, acceptance, k, refusal, proposal)
        drawn = target.draw(proposed.x[state.ravel()], proposed.sums[state.ravel()], rng)
        drawn = drawn.reshape(*state.shape, -1)
        measures = convergence.measure(drawn)
        error = _spread_error(target, proposed, rng)
        done = measures.converged and error <= SPREAD_ERROR
        if done or 2 * len(proposed.x) > MAX_PROPOSALS:
            if not measures.converged:
                refusal = "its chains did not converge"
            elif not done:
                refusal = f"a standard deviation rests on few far draws ({100 * error:.0f} %)"
            return MarginalRun(
                drawn, proposed.density[state], measures, acceptance, k, refusal, proposal
            )
        proposed = proposed.joined(proposal.weighted(target, len(proposed.x), rng))
        state = _chains(proposed.log_weight, rng)


def explored(target: Target, covariance: FloatArray, rng: np.random.Generator) -> Proposal:
    """The proposal that the sampler ends with."""
    proposal, _ = pilot(target, covariance, rng)
    return _adapted(target, proposal, EXPLORED, rng)[0]


def _adapted(
    target: Target, proposal: Proposal, steps: int, rng: np.random.Generator
) -> tuple[Proposal, Weighted, NDArray[np.int64]]:
    """A proposal of which enough draws are accepted, with its draws and chains of them."""
    for refit in range(REFITS + 1):
        proposed = proposal.weighted(target, CHAINS * steps, rng)
        state = _chains(proposed.log_weight, rng)
        light = convergence.k_hat(proposed.log_weight) <= GOOD_K_HAT
        enough = GOOD_ACCEPTANCE - PER_DIMENSION * max(len(target.sampled) - 2, 0)
        good = light and _acceptance(state) >= enough
        better = None if good or refit == REFITS else fitted(target, proposed, rng)
        if better is None:
            break
        proposal = better
    return proposal, proposed, state


def _amplitudes_alone(target: Target, rng: np.random.Generator) -> MarginalRun:
    """Independent draws of a posterior that is one Gaussian between bounds."""
    x = np.empty((CHAINS * STEPS, 0))
    density, sums = target.evaluate(x[:1])
    drawn = target.draw(x, np.repeat(sums, len(x), axis=0), rng).reshape(CHAINS, STEPS, -1)
    log_density = np.full((CHAINS, STEPS), density[0])
    return MarginalRun(drawn, log_density, convergence.measure(drawn), 1.0, None, "")


def _doubt(k: float, acceptance: float, gap: float) -> str:
    """Why the draws are not to be used."""
    if not k <= MAX_K_HAT:
        return f"the tail of the importance weights is too heavy (k-hat {k:.2f})"
    if acceptance < MIN_ACCEPTANCE:
        return f"only {100 * acceptance:.0f} % of the proposals were accepted"
    if not gap <= MAX_DISAGREEMENT:
        return f"a wider search found another evidence ({gap:.1f} standard errors away)"
    return ""


def _chains(log_weight: FloatArray, rng: np.random.Generator) -> NDArray[np.int64]:
    """Which proposal each chain holds at each step, (chains, steps).

    A chain starts at one of its proposals chosen by weight, and so at the posterior.
    """
    rows = log_weight.reshape(CHAINS, -1)
    n = rows.shape[1]
    limits = np.log(1 - rng.random(rows.shape))
    starts = rng.random(CHAINS)
    state = np.empty((CHAINS, n), np.int64)
    for c in range(CHAINS):
        share = np.exp(rows[c] - max(float(rows[c].max()), -1e300))
        at = min(int(np.searchsorted(np.cumsum(share), starts[c] * share.sum())), n - 1)
        row, limit, states = rows[c].tolist(), limits[c].tolist(), []
        for k in range(n):
            if row[k] - row[at] >= limit[k]:
                at = k
            states.append(at)
        state[c] = states
        state[c] += c * n
    return state


def _acceptance(state: NDArray[np.int64]) -> float:
    """Share of the proposals that a chain moved to."""
    n = state.shape[1]
    return float(np.mean(state == np.arange(state.size).reshape(-1, n)))


def _spread_error(target: Target, proposed: Weighted, rng: np.random.Generator) -> float:
    """Largest standard error of a standard deviation, relative to it.

    A thousandth of the mass far away may be most of the variance; it then hangs on few draws,
    whose weights need not be large.
    """
    weight = proposed.weight
    kept = weight > 0
    weight = weight[kept]
    p = target.draw(proposed.x[kept], proposed.sums[kept], rng)
    square = (p - weight @ p) ** 2
    variance = weight @ square
    error = np.sqrt(np.sum((weight[:, None] * (square - variance)) ** 2, axis=0))
    return float(np.max(error / (2 * variance), initial=0.0, where=variance > 0))


def _disagreement(log_weight: FloatArray, other: FloatArray) -> float:
    """Difference of two estimates of the evidence, in standard errors."""
    top = max(log_weight.max(), other.max())
    if not np.isfinite(top):
        return np.inf
    both = [np.exp(w - top) for w in (log_weight, other)]
    variance = sum(float(w.var() / len(w)) for w in both)
    return float(abs(both[0].mean() - both[1].mean()) / np.sqrt(variance + 1e-300))
