"""Measures of convergence: against arviz and emcee, and where the answer is known."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from arviz_versions import BEFORE_1, ess, psislw, rhat
from scipy.signal import lfilter

from gonio.fitting.posterior import convergence


def autoregressive(rho, shape, seed=1):
    """Chains (chains, steps) with autocorrelation rho^lag, from their stationary distribution."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise[:, 1:] *= np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], noise, axis=1)


CHAINS = {
    "independent": autoregressive(0.0, (8, 500)),
    "slow": autoregressive(0.9, (4, 1001)),
    "alternating": autoregressive(-0.5, (4, 400)),
    "heavy tails": np.random.default_rng(2).standard_cauchy((8, 300)),
    "one apart": autoregressive(0.3, (6, 400)) + np.array([[1.0]] + [[0.0]] * 5),
    "one wide": autoregressive(0.3, (6, 400)) * np.array([[3.0]] + [[1.0]] * 5),
}


@pytest.mark.parametrize("name", CHAINS)
def test_r_hat_and_ess_are_those_of_arviz(name):
    chains = CHAINS[name]
    stacked = np.stack([chains, np.cos(chains)], axis=2)
    for k in range(2):
        column = np.ascontiguousarray(stacked[:, :, k])
        expected = {
            "r_hat": rhat(column),
            "ess_bulk": ess(column, "bulk"),
            "ess_tail": ess(column, "tail"),
        }
        for measure, value in expected.items():
            ours = getattr(convergence, measure)(stacked)[k]
            assert ours == pytest.approx(float(value), rel=2e-3), measure


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_the_autocorrelation_time_is_emcees_and_the_known_one(rho):
    chains = autoregressive(rho, (16, 4000))[:, :, None]
    ours = convergence.autocorrelation_time(chains)[0]
    theirs = emcee.autocorr.integrated_time(np.swapaxes(chains, 0, 1), tol=0)[0]
    assert ours == pytest.approx(theirs, rel=1e-9)
    assert ours == pytest.approx((1 + rho) / (1 - rho), rel=0.08)


@pytest.mark.parametrize("shape", [-0.5, 0.2, 0.7, 1.5])
def test_k_hat_is_that_of_arviz_and_of_the_weights(shape):
    u = np.random.default_rng(3).random(5000)
    # ln of Pareto weights whose tail has this shape.
    log_weights = np.log((u**-shape - 1) / shape + 10)
    theirs = float(psislw(log_weights)[1][0])
    ours = convergence.k_hat(log_weights)
    # The tail of arviz 1 is one weight shorter.
    assert ours == pytest.approx(theirs, abs=0.01 if BEFORE_1 else 0.015)
    assert ours == pytest.approx(shape, abs=0.25)


def test_weights_that_are_hardly_there_have_no_k_hat():
    log_weights = np.full(1000, -np.inf)
    log_weights[:10] = 0.0
    assert convergence.k_hat(log_weights) == np.inf
    assert convergence.k_hat(np.full(1000, -np.inf)) == np.inf
    # Equal weights are as light as a tail can be.
    assert convergence.k_hat(np.zeros(1000)) == -np.inf


def test_a_chain_that_stands_still_has_not_converged():
    chains = np.stack([autoregressive(0.0, (8, 500)), np.ones((8, 500))], axis=2)
    found = convergence.measure(chains)
    assert (found.tau, found.r_hat, found.ess_bulk) == (np.inf, np.inf, 0.0)
    assert not found.converged


@pytest.mark.parametrize(
    ("chains", "converged"),
    [
        (CHAINS["independent"], True),
        (CHAINS["one apart"], False),
        (CHAINS["one wide"], False),
        (autoregressive(0.0, (4, 80)), False),  # 320 draws at most
        (autoregressive(0.98, (32, 2000)), False),  # tau 99
    ],
)
def test_all_rules_must_hold(chains, converged):
    assert convergence.measure(chains[:, :, None]).converged is converged
