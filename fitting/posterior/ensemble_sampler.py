"""emcee's walkers in the sampled coordinates until they have converged."""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np

from gonio.fitting.posterior import convergence, marginal_sampler
from gonio.fitting.posterior.chain import Chain, Progress
from gonio.fitting.posterior.density import Target
from gonio.fitting.posterior.emcee_moves import IndependenceMove, SnookerMove
from gonio.fitting.posterior.proposal import cholesky
from gonio.geometry import FloatArray

WALKERS = 32
BURN_IN = 50
BLOCK_STEPS = 100
GROWTH = 1.25  # of the chain between two looks at its convergence


def run(
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
        (IndependenceMove(proposal), 0.8),
        (emcee.moves.DEMove(), 0.15),
        (SnookerMove(), 0.05),
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


def _start(
    target: Target, mode: FloatArray, root: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Walkers scattered about the mode, mirrored at the bounds."""
    walkers = mode + rng.standard_normal((_walkers(len(mode)), len(mode))) @ root.T
    lower, upper = target.x_lower, target.x_upper
    walkers = np.where(walkers < lower, 2 * lower - walkers, walkers)
    walkers = np.where(walkers > upper, 2 * upper - walkers, walkers)
    # A place mirrored beyond the other bound is drawn anywhere between them.
    anywhere = lower + (upper - lower) * rng.random(walkers.shape)
    walkers = np.where((walkers < lower) | (walkers > upper), anywhere, walkers)
    limited = np.isin(target.sampled, target.limited)
    if limited.any():
        # A walker that starts where nothing is allowed has no density to go on from.
        total = (walkers[:, limited] * target.limit).sum(axis=1, keepdims=True)
        walkers[:, limited] /= np.where(total > 1, total * (1 + 0.01 * rng.random(total.shape)), 1)
    return walkers
