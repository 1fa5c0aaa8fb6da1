"""emcee and the compiled marginal sampler draw from one posterior, and from one seed one chain."""

from __future__ import annotations

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.posterior import convergence
from gonio.fitting.posterior import sample as posterior
from gonio.fitting.posterior.priors import resolve
from gonio.fitting.uncertainty.at_minimum import uncertainties
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

# Model, truth, relative noise, priors: plain ones, a lobe that is hardly there (its amplitude is
# cut at 0), a roughness that is cut at 0, an amplitude at its upper bound, priors that cut or pull.
CASES = {
    "ward": ("ward", (0.15, 0.19, 0.088, 0.13), 0.02, {}),
    "oren_nayar": ("oren_nayar", (0.7, 0.4), 0.05, {}),
    "hardly a lobe": ("ward_isotropic", (0.3, 0.001, 0.2), 0.10, {"alpha": "normal(0.2, 0.02)"}),
    "smooth": ("oren_nayar", (0.5, 0.02), 0.05, {}),
    "white": ("oren_nayar", (0.999, 0.3), 0.05, {}),
    "half normal": ("ward_isotropic", (0.3, 0.02, 0.2), 0.10, {"rho_s": "half_normal(0.005)"}),
    "pulled": ("ward_isotropic", (0.3, 0.1, 0.2), 0.05, {"alpha": "lognormal(0.15, 1.05)"}),
    "minnaert": ("minnaert", (0.4, 0.8), 0.05, {}),
}
QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)


def samples_of(name, truth, noise, n=150):
    rng = np.random.default_rng(5)
    theta = np.radians(rng.uniform(0, 70, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    where = Directions(theta[0], phi[0], theta[1], phi[1])
    f = models.get(name).evaluate(*where.vectors(), np.array(truth))
    u = noise * f + 1e-4
    return BRDFSamples(where, f + u * rng.standard_normal(n), u_independent=u)


@pytest.mark.parametrize("case", CASES)
def test_both_samplers_have_the_same_quantiles(case):
    name, truth, noise, priors = CASES[case]
    minimum = find_minimum(samples_of(name, truth, noise), models.get(name), threads=1)
    errors, _ = uncertainties(minimum)
    believed = resolve(minimum.problem.parameters, priors)
    chains = {
        kind: posterior.sample(minimum, errors, seed=3, sampler=kind, priors=believed)
        for kind in ("emcee", "marginal")
    }
    assert {kind: chain.sampler for kind, chain in chains.items()} == {k: k for k in chains}
    for j in range(len(truth)):
        own = {kind: chain.draws[..., j : j + 1] for kind, chain in chains.items()}
        pooled = np.concatenate([draws.ravel() for draws in own.values()])
        for q in QUANTILES:
            # The share of each below the pooled quantile: its variance is q (1 - q)/ESS.
            place = np.quantile(pooled, q)
            share, variance = {}, 0.0
            for kind, draws in own.items():
                below = (draws <= place).astype(float)
                share[kind] = below.mean()
                effective = min(float(convergence.ess_tail(draws)[0]), draws.size)
                variance += q * (1 - q) / effective
            assert abs(share["emcee"] - share["marginal"]) < 4.5 * np.sqrt(variance)


def test_the_default_is_emcee_and_says_so():
    result = gonio.fit(
        samples_of("ward_isotropic", (0.3, 0.1, 0.2), 0.05), model="ward_isotropic", posterior=True
    )
    assert (result.posterior.sampler, result.posterior.note) == ("emcee", "")
    assert "  emcee sampler, " in str(result)


@pytest.mark.parametrize("sampler", ["emcee", "marginal", "auto"])
def test_one_seed_is_one_chain_whatever_the_threads(sampler):
    samples = samples_of("ward_isotropic", (0.3, 0.1, 0.2), 0.05, n=9000)
    drawn = []
    for threads in (1, 2):
        minimum = find_minimum(samples, models.get("ward_isotropic"), threads=threads)
        errors, _ = uncertainties(minimum)
        drawn.append(posterior.sample(minimum, errors, seed=4, sampler=sampler).draws)
    np.testing.assert_array_equal(*drawn)
