"""The posterior: against what is known in closed form, reproducible, honest about failure."""

from __future__ import annotations

import dataclasses

import emcee
import numpy as np
import pytest
import xarray as xr
from arviz_versions import from_netcdf
from densities import Density
from scipy import stats

import gonio
from gonio import models
from gonio.errors import DataError
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.posterior import density as targets
from gonio.fitting.posterior import ensemble_sampler, marginal_density, marginal_sampler
from gonio.fitting.posterior import sample as posterior
from gonio.fitting.posterior.emcee_moves import IndependenceMove, SnookerMove
from gonio.fitting.posterior.marginal_density import MarginalTarget
from gonio.fitting.posterior.priors import Prior
from gonio.fitting.posterior.proposal import SHARES, Proposal
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, Cells, SharedTerm

ISOTROPIC = {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.2}


def directions(n, seed=1, theta_max=70):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, theta_max, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def noisy(name, truth, *, n=200, sd=1e-3, seed=2, where=None, **columns):
    rng = np.random.default_rng(seed)
    where = where or directions(n)
    f = models.get(name)(where, **truth)
    value = f + sd * rng.standard_normal(len(f))
    return BRDFSamples(where, value, u_independent=np.full(len(f), sd), **columns)


def run(density, covariance, steps, seed=1):
    """The moves of emcee on a known density: draws (draws, P), and the effective number."""
    rng = np.random.default_rng(seed)
    chain = ensemble_sampler.run(density, np.array(covariance), rng, steps, None)
    return chain.draws.reshape(-1, len(covariance)), chain.measures.ess_bulk


def test_the_moves_sample_a_truncated_gaussian():
    """x > 0.5 sd above the mode of its own, y correlated with it: one-sided, as at a bound."""
    rho = 0.8
    inverse = np.linalg.inv([[1, rho], [rho, 1]])
    density = Density(
        lambda b: -0.5 * np.einsum("ni,ij,nj->n", b, inverse, b), [0.5, -20], [20, 20], [0.5, 0.4]
    )
    draws, ess = run(density, [[1, rho], [rho, 1]], 1000)
    x = stats.truncnorm(0.5, 20)
    # Means to 4 standard errors, variances to 4 sqrt(3/ESS) of themselves.
    assert ess > 1000
    assert draws[:, 0].mean() == pytest.approx(x.mean(), abs=4 * x.std() / np.sqrt(ess))
    assert draws[:, 0].var() == pytest.approx(x.var(), rel=4 * np.sqrt(3 / ess))
    y_var = 1 - rho**2 + rho**2 * x.var()
    assert draws[:, 1].mean() == pytest.approx(rho * x.mean(), abs=4 * np.sqrt(y_var / ess))
    assert draws[:, 1].var() == pytest.approx(y_var, rel=4 * np.sqrt(3 / ess))


@pytest.mark.parametrize("move", ["SnookerMove", "IndependenceMove"])
def test_each_move_alone_leaves_a_gaussian_as_it_is(move):
    if move == "SnookerMove":
        moves = SnookerMove()
    else:
        box = Density(None, [-20, -20], [20, 20], [0.0, 0.0])
        whole = np.array([0.3, 0.0]), np.diag([1.5, 0.8]) ** 2
        each = (whole[0][None], whole[1][None], np.ones(1))
        moves = IndependenceMove(Proposal.about(box, *each, whole, SHARES))
    sampler = emcee.EnsembleSampler(
        32, 2, lambda b: -0.5 * np.sum(b**2, axis=1), moves=moves, vectorize=True
    )
    legacy = np.random.RandomState(np.random.MT19937(1))
    start = np.random.default_rng(1).standard_normal((32, 2))
    sampler.run_mcmc(emcee.State(start, random_state=legacy.get_state()), 3000)
    draws = sampler.get_chain(discard=100)
    ess = draws[:, :, 0].size / np.max(emcee.autocorr.integrated_time(draws, tol=0, quiet=True))
    assert ess > 2500
    # emcee's own snooker gives 0.89 here; four standard errors of a variance are 0.1 at most.
    np.testing.assert_allclose(draws.var(axis=(0, 1)), 1, atol=4 * np.sqrt(2 / ess))
    np.testing.assert_allclose(draws.mean(axis=(0, 1)), 0, atol=4 / np.sqrt(ess))


def test_a_linear_model_has_its_analytic_posterior(tmp_path):
    samples = noisy("lambert", {"rho": 0.4}, n=50)
    problem = SingleProblem.from_samples(samples, models.get("lambert"))
    result = gonio.fit(samples, model="lambert", posterior=True, draws=tmp_path / "draws.nc")
    assert result.ok
    mean = np.pi * samples.value.mean()
    sd = np.pi * 1e-3 / np.sqrt(50) * result.noise_scale
    rho = result.parameters["rho"]
    ess = result.posterior.ess
    low, high = rho.interval_68
    # A quantile one sd from the middle has a standard error of 1.5 sd/sqrt(ESS).
    assert low == pytest.approx(mean - sd, abs=6 * sd / np.sqrt(ess))
    assert high == pytest.approx(mean + sd, abs=6 * sd / np.sqrt(ess))
    assert rho.stderr == pytest.approx(sd, rel=1e-6)
    assert problem.n == 50


def test_draws_have_the_covariance_of_the_fit_where_the_noise_is_small():
    samples = noisy("ward_isotropic", ISOTROPIC, n=400, sd=2e-4)
    problem = SingleProblem.from_samples(samples, models.get("ward_isotropic"))
    optimum = minimise(problem, np.array(list(ISOTROPIC.values())))
    errors = uncertainty.evaluate(Minimum.of(problem, optimum, 1.0))
    chain = posterior.sample(Minimum.of(problem, optimum, 1.0), errors, seed=1)
    assert chain.converged
    draws = chain.draws.reshape(-1, 3)
    sd = np.sqrt(np.diag(errors.covariance))
    np.testing.assert_allclose(
        draws.mean(axis=0), optimum.p, atol=5 * sd.max() / np.sqrt(chain.measures.ess_bulk)
    )
    z = np.cov((draws / sd).T)
    # 4 standard errors of a variance, and 1 % for the curvature of the model.
    np.testing.assert_allclose(
        z,
        errors.covariance / np.outer(sd, sd),
        atol=4 * np.sqrt(2 / chain.measures.ess_bulk) + 0.01,
    )


def test_shared_terms_move_the_draws():
    term = SharedTerm("standard", "reflectance of the standard", relative=0.03)
    samples = noisy("lambert", {"rho": 0.4}, n=50, shared=(term,))
    result = gonio.fit(samples, model="lambert", posterior=True)
    low, high = result.parameters["rho"].interval_68
    stderr = result.parameters["rho"].stderr
    assert stderr > 0.03 * 0.39
    assert (high - low) / 2 == pytest.approx(stderr, rel=0.05)


def test_one_seed_one_chain_at_any_number_of_threads(monkeypatch):
    monkeypatch.setattr(marginal_density, "EXACT_MEMBERS", 0)  # the batched likelihood
    # More samples than one block of the likelihood, so that two threads have work.
    samples = noisy("lambert", {"rho": 0.4}, n=16_500, sd=5e-3)

    def chain(seed, threads):
        problem = SingleProblem.from_samples(samples, models.get("lambert"), threads=threads)
        optimum = minimise(problem, np.array([0.4]))
        errors = uncertainty.evaluate(Minimum.of(problem, optimum, 1.0))
        return posterior.sample(Minimum.of(problem, optimum, 1.0), errors, seed=seed, max_steps=100)

    one, two, other = chain(7, 1), chain(7, 2), chain(8, 1)
    np.testing.assert_array_equal(one.draws, two.draws)
    assert one.measures == two.measures
    assert not np.any(one.draws == other.draws)


def test_the_global_generator_is_neither_used_nor_moved():
    samples = noisy("lambert", {"rho": 0.4}, n=50)
    a = gonio.fit(samples, model="lambert", posterior=True, seed=3)
    before = np.random.mtrand._rand.get_state()[1].copy()
    b = gonio.fit(samples, model="lambert", posterior=True, seed=3)
    assert a.parameters == b.parameters
    np.testing.assert_array_equal(np.random.mtrand._rand.get_state()[1], before)


def test_at_a_bound_the_posterior_is_one_sided():
    truth = {"rho_d": 0.3, "rho_s": 0.0005, "alpha": 0.2}
    samples = noisy("ward_isotropic", truth, n=60, sd=0.01, seed=3)
    rho_s = gonio.fit(samples, model="ward_isotropic", posterior=True).parameters["rho_s"]
    for interval in (rho_s.interval_68, rho_s.interval_95):
        assert interval[0] == 0 < interval[1]
    assert rho_s.interval_95[1] > 0.0005


def test_the_posterior_at_a_bound_of_one_parameter_is_the_truncated_gaussian():
    where = directions(100)
    noise = np.random.default_rng(3).standard_normal(100)
    value = 0.01 * (noise - noise.mean()) / noise.std(ddof=1) - 0.0005
    samples = BRDFSamples(where, value, u_independent=np.full(100, 0.01))
    result = gonio.fit(samples, model="lambert", posterior=True)
    rho, scale = result.parameters["rho"], result.noise_scale
    sd = np.pi * 1e-3 * scale
    mean = -0.0005 * np.pi
    exact = stats.truncnorm(-mean / sd, np.inf, loc=mean, scale=sd)
    assert (rho.at_bound, rho.stderr, rho.interval_95[0]) == ("lower", None, 0.0)
    # The 95 % quantile of n draws: sqrt(.05 .95/n)/density = about 4 sd/sqrt(n) at the tail.
    slack = 4 * 4 * sd / np.sqrt(result.posterior.ess)
    assert rho.interval_95[1] == pytest.approx(exact.ppf(0.95), abs=slack)


@pytest.mark.parametrize("sampler", ["marginal", "emcee"])
def test_a_limited_sum_cuts_the_posterior(sampler, tmp_path):
    # Where rho_d + rho_s may be at most 1 the posterior is that without the limit, cut at it.
    true = {"rho_d": 0.7, "rho_s": 0.3, "n": 20.0}
    samples = noisy("phong", true, n=300, sd=0.02)
    claims = dataclasses.replace(models.get("phong").claims, albedo_at_most=None)
    free = dataclasses.replace(models.get("phong"), claims=claims)
    draws = []
    for model, own in ((models.get("phong"), sampler), (free, "auto")):
        path = tmp_path / "draws.nc"
        result = gonio.fit(samples, model=model, posterior=True, sampler=own, draws=path, seed=4)
        assert result.posterior.converged
        with xr.open_dataset(path, group="posterior", engine="h5netcdf") as drawn:
            draws.append(np.stack([drawn[name].values.ravel() for name in true]))
    cut, whole = draws
    assert cut[:2].sum(axis=0).max() <= 1 + 1e-12
    assert 0.2 < (whole[:2].sum(axis=0) > 1).mean() < 0.99
    whole = whole[:, whole[:2].sum(axis=0) <= 1]
    sd = whole.std(axis=1)
    for k in range(3):
        assert cut[k].mean() == pytest.approx(whole[k].mean(), abs=0.15 * sd[k])
        assert cut[k].std() == pytest.approx(sd[k], rel=0.15)


def test_a_chain_too_short_says_so(monkeypatch):
    monkeypatch.setattr(ensemble_sampler, "BLOCK_STEPS", 10)
    original = posterior.sample
    monkeypatch.setattr(posterior, "sample", lambda *a, **k: original(*a, max_steps=10, **k))
    result = gonio.fit(
        noisy("ward_isotropic", ISOTROPIC), model="ward_isotropic", posterior=True, sampler="emcee"
    )
    assert result.status == "converged"
    assert not result.posterior.converged
    assert not result.ok
    assert any(
        text.startswith("the posterior has not converged (R-hat ")
        and text.endswith("): its intervals are provisional.")
        for text in result.warnings
    )
    result.to_json()


def test_progress_is_reported():
    told = []
    gonio.fit(
        noisy("lambert", {"rho": 0.4}, n=50), model="lambert", posterior=True,
        sampler="emcee", progress=lambda *steps: told.append(steps),
    )  # fmt: skip
    assert told[0] == (ensemble_sampler.BLOCK_STEPS, posterior.MAX_STEPS)


def test_without_noise_there_is_no_posterior():
    samples = BRDFSamples(directions(20), np.zeros(20))
    with pytest.raises(
        DataError,
        match=r"^the model leaves no residuals and the samples state no uncertainty: there is no "
        r"noise to sample a posterior with; give u_brdf or fit without a posterior\.$",
    ):
        gonio.fit(samples, model="lambert", posterior=True)


def test_arviz_opens_the_draws_in_degrees(tmp_path):
    path = tmp_path / "draws.nc"
    samples = noisy("oren_nayar", {"rho": 0.8, "sigma": 0.4}, n=200, sd=2e-3)
    result = gonio.fit(samples, model="oren_nayar", posterior=True, draws=path, sampler="marginal")
    assert result.posterior.draws == str(path)
    data = from_netcdf(path)
    sigma = data.posterior["sigma"]
    assert sigma.dims == ("chain", "draw")
    assert sigma.attrs["units"] == "deg"
    low, high = result.parameters["sigma"].interval_95
    expected = np.degrees([low, high])
    np.testing.assert_allclose(np.quantile(sigma, [0.025, 0.975]), expected, rtol=1e-12)
    assert np.degrees(0.4) == pytest.approx(float(sigma.mean()), rel=0.1)
    assert sigma.shape[0] == marginal_sampler.CHAINS
    data.close()


# ----------------------------------------------------------------- cells of the samples


def celled(sd, spread=0.02, n=400, members=4):
    rng = np.random.default_rng(2)
    where = directions(n)
    w_i, w_r = where.vectors()
    many = np.repeat(w_r, members, axis=0) + spread * rng.standard_normal((n * members, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    cells = Cells(many, np.full(n * members, 1 / members), np.arange(n + 1) * members)
    p = np.array(list(ISOTROPIC.values()))
    f = models.get("ward_isotropic").evaluate(np.repeat(w_i, members, axis=0), many, p)
    value = f.reshape(n, members).mean(axis=1) + sd * rng.standard_normal(n)
    samples = BRDFSamples(where, value, u_independent=np.full(n, sd), cells=cells)
    problem = SingleProblem.from_samples(samples, models.get("ward_isotropic"))
    optimum = minimise(problem, p)
    return problem, optimum, uncertainty.evaluate(Minimum.of(problem, optimum, 1.0))


def test_cell_factors_keep_the_likelihood(monkeypatch):
    problem, optimum, errors = celled(1e-3)
    monkeypatch.setattr(marginal_density, "EXACT_MEMBERS", 0)
    spread = np.sqrt(np.diag(errors.covariance))
    fast = MarginalTarget(problem, optimum.p, 1.0, [Prior()] * 3, spread)
    assert not fast.exact
    root = np.linalg.cholesky(errors.covariance)
    batch = optimum.p + np.random.default_rng(3).standard_normal((50, 3)) @ root.T
    exact = np.array([-0.5 * problem.chi2(p) for p in batch])
    assert np.ptp(fast.log_likelihood(batch) - exact) < targets.TOLERANCE
    # Without the factors the cells would be missed by far more.
    for factor in fast.factors:
        factor[:, 0], factor[:, 1:] = 1, 0
    assert np.ptp(fast.log_likelihood(batch) - exact) > 2 * targets.TOLERANCE
    # Nothing is expanded where the cells are integrated over.
    fast.exact = True
    assert np.ptp(fast.log_likelihood(batch) - exact) < 1e-6
    chain = posterior.sample(Minimum.of(problem, optimum, 1.0), errors, seed=1)
    assert chain.warnings == []


def test_a_broad_posterior_falls_back_to_the_cells(monkeypatch):
    problem, optimum, errors = celled(0.1, spread=0.2, n=100)
    monkeypatch.setattr(marginal_density, "EXACT_MEMBERS", 0)
    slow = posterior.sample(Minimum.of(problem, optimum, 1.0), errors, seed=1, max_steps=300)
    assert slow.warnings == [
        "the lobe changes over the cells within the posterior: the likelihood was integrated over "
        "every cell, which is slower."
    ]
    monkeypatch.setattr(marginal_density, "EXACT_MEMBERS", 10**9)
    assert (
        posterior.sample(Minimum.of(problem, optimum, 1.0), errors, seed=1, max_steps=300).warnings
        == []
    )
