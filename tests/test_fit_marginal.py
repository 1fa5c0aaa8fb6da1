"""The marginal sampler: Gaussians in boxes, sums over samples, and posteriors on a grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arviz_versions import from_netcdf, group_names
from densities import Density
from scipy import integrate, stats

import gonio
from gonio import models
from gonio.errors import ConfigurationError
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.posterior import marginal_density, marginal_sampler, predictive, truncated_normal
from gonio.fitting.posterior import sample as posterior
from gonio.fitting.posterior.density import WholeTarget
from gonio.fitting.posterior.marginal_density import MarginalTarget
from gonio.fitting.posterior.priors import Prior
from gonio.fitting.posterior.proposal import SHARES, Proposal, pilot
from gonio.fitting.problem.penalised import PenalisedProblem
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.uncertainty.at_minimum import uncertainties
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, Cells

WARD = {"rho_d": 0.15, "rho_s": 0.19, "alpha_x": 0.088, "alpha_y": 0.13}


def directions(n, seed=1):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, 70, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def noisy(name, truth, *, n=200, sd=1e-3, relative=0.0, seed=2, **columns):
    where = directions(n, seed)
    f = models.get(name)(where, **truth)
    u = sd + relative * f
    value = f + u * np.random.default_rng(seed).standard_normal(n)
    return BRDFSamples(where, value, u_independent=u, **columns)


def sampled(samples, name, sampler="auto", seed=1, threads=1, **options):
    found = find_minimum(samples, models.get(name), threads=threads)
    errors, _ = uncertainties(found)
    chain = posterior.sample(found, errors, seed=seed, sampler=sampler, **options)
    return found, chain


# ---------------------------------------------------------------- Gaussians in boxes

BOXES = [
    ([-1.0, -0.5], [1.5, 3.0]),
    ([2.0, 3.0], [9.0, 9.0]),
    ([-9.0, 4.0], [-3.0, 6.0]),
    ([0.0, 0.0], [0.01, 8.0]),
]


@pytest.mark.parametrize("rho", [0.0, 0.6, -0.95, 0.99999])
@pytest.mark.parametrize(("lower", "upper"), BOXES)
def test_the_probability_of_a_box_is_its_integral(rho, lower, upper):
    x = np.linspace(lower[0], upper[0], 200_001)
    width = np.sqrt(1 - rho**2)
    inner = stats.norm.cdf((upper[1] - rho * x) / width) - stats.norm.cdf(
        (lower[1] - rho * x) / width
    )
    exact = integrate.simpson(stats.norm.pdf(x) * inner, x=x)
    covariance = np.array([[[1.0, rho], [rho, 1.0]]])
    found = truncated_normal.log_probability(
        np.zeros((1, 2)), covariance, np.array(lower), np.array(upper)
    )
    # The reference's differences of distributions are known to 1e-16 each.
    assert np.exp(found[0]) == pytest.approx(exact, rel=1e-6, abs=1e-15)


@pytest.mark.parametrize(
    ("mean", "rho"), [([0.1, 0.05], -0.9), ([-0.2, -0.1], 0.7), ([-0.3, -0.3], -0.9)]
)
def test_draws_in_a_box_have_its_moments(mean, rho):
    n = 2000 if rho == -0.9 and mean[0] < 0 else 20_000
    covariance = 0.01 * np.array([[1.0, rho], [rho, 1.0]])
    drawn = truncated_normal.draw(
        np.tile(mean, (n, 1)), np.tile(covariance, (n, 1, 1)), np.zeros(2), np.ones(2),
        np.random.default_rng(1),
    )  # fmt: skip
    x = np.concatenate([np.linspace(0, 0.1, 1000, endpoint=False), np.linspace(0.1, 1, 1000)])
    density = stats.multivariate_normal(mean, covariance).logpdf(
        np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    )
    density = np.exp(density - density.max())
    total = integrate.trapezoid(integrate.trapezoid(density, x), x)
    for axis in range(2):
        one = integrate.trapezoid(density, x, axis=1 - axis) / total
        first, second = (integrate.trapezoid(one * x**k, x) for k in (1, 2))
        sd = np.sqrt(second - first**2)
        assert drawn[:, axis].mean() == pytest.approx(first, abs=4 * sd / np.sqrt(n))
        assert drawn[:, axis].std() == pytest.approx(sd, rel=4 * np.sqrt(2 / n))
    assert drawn.min() >= 0


def test_one_variable_far_in_its_tail():
    drawn = truncated_normal.draw(
        np.full((5000, 1), -8.0), np.ones((5000, 1, 1)), np.zeros(1), np.ones(1),
        np.random.default_rng(1),
    )  # fmt: skip
    assert stats.kstest(drawn[:, 0], stats.truncnorm(8, 9, loc=-8).cdf).pvalue > 1e-3


# ---------------------------------------------------------------- sums over the samples


@pytest.mark.parametrize(("name", "n_linear"), [("ward", 2), ("minnaert", 1), ("oren_nayar", 0)])
def test_the_sums_are_those_of_the_jacobian(name, n_linear):
    samples = noisy(name, {}, n=700)
    problem = SingleProblem.from_samples(samples, models.get(name), threads=1)
    mode = problem.vector({})
    flat = [Prior()] * len(mode)
    target = MarginalTarget(problem, mode, 1.0, flat, 0.01 * mode)
    assert len(target.linear) == n_linear
    p = mode * np.where(np.isin(np.arange(len(mode)), target.linear), 1.0, 1.03)
    chi2, g, h = problem.normal_equations(p)
    some = target.linear
    upper = h[np.ix_(some, some)][np.triu_indices(n_linear)]
    np.testing.assert_allclose(
        target.sums(p[None])[0], np.concatenate([[chi2], g[some], upper]), rtol=1e-9
    )
    # The quadratic form is chi-squared wherever the amplitudes are.
    moved = p * 0.9
    assert -2 * target.log_likelihood(moved[None])[0] == pytest.approx(
        problem.chi2(moved), rel=1e-9
    )


def test_the_loops_read_as_plain_python():
    """What numba compiles is a template that runs as it stands, here for a constant surface."""
    from gonio.kernels import sums
    from gonio.kernels.kept import kept_around
    from gonio.kernels.moments import moments_around
    from gonio.kernels.pairs import pairs_around

    def unpack(p):
        return (p[0],)

    def store(both, above, gradient, k):
        gradient[0, k] = both[1] if above else 0.0

    def keep(kept, rows, k):
        rows[0, k] = kept[0]

    kept = kept_around(
        lambda xi, yi, zi, xr, yr, zr: (zi,), keep, lambda rows, k, q: (q[0], 1.0), store
    )
    pairs = pairs_around(unpack, lambda xi, yi, zi, xr, yr, zr, q: (q[0], 1.0), store)
    moments = moments_around(
        unpack=unpack,
        evaluate_gradient=pairs.evaluate_gradient,
        n_amplitudes=1,
        n_kept=1,
        keep_geometry=kept.keep_geometry,
        kept_gradient=kept.kept_gradient,
        add_products=sums.add_products,
    )
    rng = np.random.default_rng(1)
    components = np.abs(rng.standard_normal((6, 300)))
    value, weight = rng.random(300), rng.random(300)
    out = np.empty((1, 3))
    moments.moments(components, value, weight, np.array([[0.4]]), out)
    r = value - 0.4
    np.testing.assert_allclose(out[0], [weight @ r**2, weight @ r, weight.sum()], rtol=1e-12)


def test_cells_are_integrated_over_by_sums_and_by_factors(monkeypatch):
    rng = np.random.default_rng(1)
    n, members = 300, 3
    where = directions(n)
    w_i, w_r = where.vectors()
    many = np.repeat(w_r, members, axis=0) + 0.01 * rng.standard_normal((n * members, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    cells = Cells(many, np.full(n * members, 1 / members), np.arange(n + 1) * members)
    samples = BRDFSamples(where, 0.1 + 0 * w_i[:, 0], u_independent=np.full(n, 0.01), cells=cells)
    problem = SingleProblem.from_samples(samples, models.get("ward"), threads=1)
    mode = problem.vector(WARD)
    exact = MarginalTarget(problem, mode, 1.0, [Prior()] * 4, 0.01 * mode)
    assert exact.exact
    monkeypatch.setattr(marginal_density, "EXACT_MEMBERS", 0)
    fast = MarginalTarget(problem, mode, 1.0, [Prior()] * 4, 0.01 * mode)
    chi2, g, h = problem.normal_equations(mode)
    expected = [chi2, g[0], g[1], h[0, 0], h[0, 1], h[1, 1]]
    for target in (exact, fast):
        np.testing.assert_allclose(target.sums(mode[None])[0], expected, rtol=1e-9)
    moved = mode * [1, 1, 1.01, 0.99]
    np.testing.assert_allclose(
        fast.log_likelihood(moved[None]), exact.log_likelihood(moved[None]), rtol=1e-4
    )


def test_at_the_foot_of_a_lobe_a_cell_is_not_known_by_its_middle(monkeypatch):
    # A corner of each cell reaches into a narrow lobe of which the middle sees next to nothing.
    monkeypatch.setattr(marginal_density, "EXACT_MEMBERS", 0)
    n, members = 60, 4
    theta_r = np.linspace(0.70, 0.90, n)
    where = Directions(np.full(n, 0.5), 0.0, theta_r, np.pi)
    corners = theta_r[:, None] + 0.04 * np.array([-3.0, 1.0, 1.0, 1.0])
    many = Directions(0.5, 0.0, corners.ravel(), np.pi).vectors()[1]
    cells = Cells(np.ascontiguousarray(many), np.full(n * members, 1 / members),
                  np.arange(n + 1) * members)  # fmt: skip
    mode = np.array([0.1, 0.2, 0.03, 0.03])
    samples = BRDFSamples(where, np.full(n, 0.1), u_independent=np.full(n, 1e-3), cells=cells)
    problem = SingleProblem.from_samples(samples, models.get("ward"), threads=1)
    value = problem.values(mode)
    middle = models.get("ward")(where, **dict(zip(WARD, mode, strict=True)))
    assert ((value - 0.1 / np.pi) > 1e3 * (middle - 0.1 / np.pi)).sum() > 10
    samples = replace(samples, value=value * 1.05)
    problem = SingleProblem.from_samples(samples, models.get("ward"), threads=1)
    fast = MarginalTarget(problem, mode, 1.0, [Prior()] * 4, 0.002 * mode)
    moved = mode + 0.002 * mode * np.random.default_rng(1).standard_normal((20, 4))
    exact = np.array([-0.5 * problem.chi2(p) for p in moved])
    assert np.ptp(exact) > 5
    np.testing.assert_allclose(fast.log_likelihood(moved), exact, atol=0.02)


# ---------------------------------------------------------------- posteriors


def on_a_grid(problem, scale, axes):
    """Means and standard deviations of a posterior with flat priors, by summing over a grid."""
    mesh = np.meshgrid(*axes, indexing="ij")
    points = np.stack([m.ravel() for m in mesh], axis=1)
    chi2 = np.array([problem.chi2(p) for p in points])
    weight = np.exp(-0.5 * (chi2 - chi2.min()) / scale**2)
    weight /= weight.sum()
    mean = weight @ points
    return mean, np.sqrt(weight @ (points - mean) ** 2)


def test_the_posterior_of_three_parameters_is_that_on_a_grid():
    """rho_s near its bound, where it is far from Gaussian."""
    truth = {"rho_d": 0.3, "rho_s": 0.01, "alpha": 0.25}
    samples = noisy("ward_isotropic", truth, n=60, sd=0.01, seed=5)
    alpha = models.get("ward_isotropic").parameter("alpha")

    def middles(low, high, n):
        return low + (high - low) * (np.arange(n) + 0.5) / n

    axes = [
        middles(0.2, 0.36, 20), middles(0.0, 1.0, 100), middles(alpha.lower, alpha.upper, 40)
    ]  # fmt: skip
    found, quick = sampled(samples, "ward_isotropic", "marginal")
    mean, sd = on_a_grid(found.problem, found.noise_scale, axes)
    for name, chain in {
        "marginal": quick, "emcee": sampled(samples, "ward_isotropic", "emcee")[1]
    }.items():  # fmt: skip
        assert chain.sampler == name
        assert chain.converged
        draws = chain.draws.reshape(-1, 3)
        assert np.mean(draws[:, 0] < 0.2) < 0.01
        slack = 4 / np.sqrt(chain.measures.ess_bulk) + 0.03
        np.testing.assert_allclose((draws.mean(axis=0) - mean) / sd, 0, atol=slack)
        np.testing.assert_allclose(draws.std(axis=0) / sd, 1, atol=0.1)


def widths(seed, rho_s):
    """Standard deviations of both samplers' draws for 60 samples with 40 % noise."""
    truth = {"rho_d": 0.15, "rho_s": rho_s, "alpha": 0.1}
    samples = noisy("ward_isotropic", truth, n=60, relative=0.4, seed=seed)
    found, chain = sampled(samples, "ward_isotropic", seed=seed)
    problem, scale = found.problem, found.noise_scale
    axes = models.get("ward_isotropic").parameter("alpha")
    return chain, alpha_marginal(problem, scale, np.geomspace(axes.lower, axes.upper, 150))


def alpha_marginal(problem, scale, alpha):
    """Mean and sd of alpha, the amplitudes summed over a grid: nothing of the sampler's."""
    w_i, w_r = problem.samples.directions.vectors()
    y, w = problem.samples.value, problem.inverse_variance / scale**2
    rho_s = np.linspace(0, 1, 301) ** 2
    rho_s, step = (rho_s[1:] + rho_s[:-1]) / 2, np.diff(rho_s)
    one = np.full(len(y), 1 / np.pi)
    log_p = np.empty((len(alpha), len(rho_s)))
    for k, a in enumerate(alpha):
        lobe = problem.model.evaluate(w_i, w_r, np.array([0.0, 1.0, a]))
        rest = y[:, None] - lobe[:, None] * rho_s
        mean = (w * one) @ rest / (w @ one**2)
        chi2 = w @ rest**2 - mean**2 * (w @ one**2)
        inside = stats.norm.logcdf(mean * np.sqrt(w @ one**2))
        log_p[k] = -chi2 / 2 + inside + np.log(step)
    p = np.exp(log_p - log_p.max()).sum(axis=1)
    total = integrate.trapezoid(p, alpha)
    first, second = (integrate.trapezoid(p * alpha**k, alpha) / total for k in (1, 2))
    return first, np.sqrt(second - first**2)


def test_a_lobe_hardly_above_the_noise_is_sampled_or_refused():
    """60 samples with 40 % noise: a proposal from the curvature at the mode is far too narrow."""
    off = []
    for seed in range(20):
        chain, (mean, sd) = widths(seed, 0.01 if seed % 2 else 0.02)
        assert chain.sampler == "marginal" or chain.note
        drawn = chain.draws[:, :, 2]
        off.append(drawn.std() / sd - 1)
        assert abs(drawn.mean() - mean) < 5 * sd / np.sqrt(chain.measures.ess_bulk) + 0.02 * sd
    assert np.max(np.abs(off)) < 0.1


def rho_s_marginal(problem, scale, n=70):
    """sd of rho_s of Ward's model, alpha_x, alpha_y and rho_s summed over a grid."""
    w_i, w_r = problem.samples.directions.vectors()
    y, w = problem.samples.value, problem.inverse_variance / scale**2
    rho_s = np.linspace(0, 1, 301) ** 2
    rho_s, step = (rho_s[1:] + rho_s[:-1]) / 2, np.diff(rho_s)
    one = np.full(len(y), 1 / np.pi)
    q = problem.model.parameter("alpha_x")
    edges = np.geomspace(q.lower, q.upper, n + 1)
    alpha = np.sqrt(edges[1:] * edges[:-1])
    log_p = np.empty((n, n, len(rho_s)))
    for j, k in np.ndindex(n, n):
        lobe = problem.model.evaluate(w_i, w_r, np.array([0.0, 1.0, alpha[j], alpha[k]]))
        rest = y[:, None] - lobe[:, None] * rho_s
        mean = (w * one) @ rest / (w @ one**2)
        chi2 = w @ rest**2 - mean**2 * (w @ one**2)
        inside = stats.norm.logcdf(mean * np.sqrt(w @ one**2))
        log_p[j, k] = -chi2 / 2 + inside + np.log(alpha[j] * alpha[k])
    p = np.exp(log_p - log_p.max()).sum(axis=(0, 1)) * step
    first, second = (p @ rho_s**k / p.sum() for k in (1, 2))
    return np.sqrt(second - first**2)


def test_a_standard_deviation_that_rests_on_few_far_draws_is_not_reported():
    """A thousandth of the probability, at a tenth of the range, may be half of the variance."""
    drawn_more = 0
    for seed in (15, 31, 63):
        truth = {"rho_d": 0.15, "rho_s": [0.01, 0.02, 0.03, 0.05][seed % 4]}
        truth |= {"alpha_x": 0.1, "alpha_y": 0.2}
        samples = noisy("ward", truth, n=60, relative=0.4, seed=seed)
        found, chain = sampled(samples, "ward", seed=seed)
        assert chain.sampler == "marginal" or chain.note
        if chain.sampler == "marginal":
            drawn_more += chain.draws.shape[1] > 640
            sd = rho_s_marginal(found.problem, found.noise_scale)
            assert chain.draws[:, :, 1].std() == pytest.approx(sd, rel=0.1)
    assert drawn_more


def test_one_seed_one_posterior_at_any_number_of_threads():
    samples = noisy("ward", WARD, n=9000, relative=0.1)
    (_, one), (_, two), (_, other) = (
        sampled(samples, "ward", threads=threads, seed=seed)
        for threads, seed in ((1, 3), (2, 3), (1, 4))
    )
    assert one.sampler == "marginal"
    np.testing.assert_array_equal(one.draws, two.draws)
    assert not np.any(one.draws == other.draws)


def test_the_guard_sees_a_proposal_that_misses_a_mode():
    """Two modes far apart, and a proposal that knows one: k-hat, or the wider search, objects."""

    def log_density(p):
        return np.logaddexp(-0.5 * ((p[:, 0] - 2) / 0.05) ** 2, -0.5 * ((p[:, 0] + 2) / 0.3) ** 2)

    both = Density(log_density, [-5.0], [5.0], [2.0])
    rng = np.random.default_rng(1)
    whole = np.array([2.0]), np.array([[0.05**2]])
    narrow = Proposal.about(both, whole[0][None], whole[1][None], np.ones(1), whole, SHARES)
    seen = narrow.weighted(both, 5120, rng)
    _, evidence = pilot(both, whole[1], rng)
    doubt = marginal_sampler._doubt(
        marginal_sampler.convergence.k_hat(seen.log_weight), 0.9,
        marginal_sampler._disagreement(seen.log_weight, evidence),
    )  # fmt: skip
    assert doubt
    # The sampler itself finds both.
    run = marginal_sampler.sample(both, whole[1], rng)
    assert not run.refusal
    share = np.mean(run.draws < 0)
    assert share == pytest.approx(6 / 7, abs=4 * np.sqrt(6 / 49 / run.measures.ess_bulk))


def test_where_the_guard_refuses_emcee_takes_over(monkeypatch):
    monkeypatch.setattr(marginal_sampler, "MAX_K_HAT", -np.inf)
    samples = noisy("ward_isotropic", {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.2})
    result = gonio.fit(samples, model="ward_isotropic", posterior=True, sampler="auto")
    assert (result.posterior.sampler, result.ok) == ("emcee", True)
    assert result.posterior.note.startswith("the tail of the importance weights is too heavy")
    assert result.posterior.k_hat < 0.5
    assert not any("took over" in text for text in result.warnings)
    asked = gonio.fit(samples, model="ward_isotropic", posterior=True, sampler="marginal")
    assert asked.warnings[-1].startswith("emcee took over from the marginal sampler: the tail")


def test_other_problems_are_sampled_whole_by_emcee():
    samples = noisy("lambert", {"rho": 0.4}, n=50)
    found = find_minimum(samples, models.get("lambert"))
    other = PenalisedProblem(found.problem, found.optimum.p, np.zeros((1, 1)))
    errors, _ = uncertainties(found.at(other, found.optimum))
    chain = posterior.sample(found.at(other, found.optimum), errors, seed=1)
    assert (chain.sampler, chain.converged) == ("emcee", True)
    sd = np.sqrt(errors.covariance[0, 0])
    assert chain.draws.std() == pytest.approx(sd, rel=0.06)
    assert WholeTarget(other, found.optimum.p, 1.0, [Prior()]).sums(np.array([[0.4]])).shape == (
        1,
        1,
    )
    with pytest.raises(
        ConfigurationError, match=r"^sampler 'marginal' needs one model with independent noise"
    ):
        posterior.sample(found.at(other, found.optimum), errors, seed=1, sampler="marginal")


# ---------------------------------------------------------------- predictions


def test_predictions_cover_the_data_at_their_rate():
    samples = noisy("ward", WARD, n=2000, relative=0.05)
    found, chain = sampled(samples, "ward")
    rng = np.random.default_rng(1)
    drawn = predictive.predict(found.problem, chain.draws[:, ::64].reshape(-1, 4), 1.0, rng)
    low, high = np.quantile(drawn, [0.16, 0.84], axis=0)
    inside = np.mean((samples.value >= low) & (samples.value <= high))
    # 80 draws tell their quantiles to 4 %; 2000 samples a rate to 1 %.
    assert inside == pytest.approx(0.68, abs=0.05)


def test_the_file_holds_predictions_data_and_priors(tmp_path):
    path = tmp_path / "draws.nc"
    samples = noisy("ward", WARD, n=300, relative=0.05)
    result = gonio.fit(
        samples, model="ward", posterior=True, draws=path, priors={"alpha_x": "normal(0.1, 0.05)"}
    )
    data = from_netcdf(path)
    assert group_names(data) == {
        "posterior", "posterior_predictive", "observed_data", "sample_stats"
    }  # fmt: skip
    assert data.posterior.attrs["priors"] == (
        "rho_d flat; rho_s flat; alpha_x normal(0.1, 0.05); alpha_y flat"
    )
    assert data.posterior["alpha_x"].attrs["prior"] == "normal(0.1, 0.05)"
    assert data.posterior_predictive["brdf"].dims == ("chain", "draw", "sample")
    np.testing.assert_array_equal(data.observed_data["brdf"], samples.value)
    np.testing.assert_allclose(
        data.observed_data["theta_i"], np.degrees(samples.directions.theta_i)
    )
    assert data.sample_stats["lp"].shape == data.posterior["rho_d"].shape
    assert data.sample_stats.attrs["acceptance"] == result.posterior.acceptance
    data.close()


def test_many_samples_are_thinned_in_the_file():
    steps, samples = predictive.kept(8, 640, 5_000_000)
    assert len(steps) * 8 * len(samples) <= predictive.MAX_VALUES
    assert len(steps) * 8 >= predictive.MIN_DRAWS
    assert (samples[0], samples[-1]) == (0, 4_999_999)


def test_a_file_that_cannot_be_written_whole_is_not_there(tmp_path, monkeypatch):
    def broken(*_):
        raise RuntimeError("no")

    path = tmp_path / "draws.nc"
    monkeypatch.setattr(predictive, "_directions", broken)
    with pytest.raises(RuntimeError):
        gonio.fit(noisy("lambert", {"rho": 0.4}, n=20), model="lambert", posterior=True, draws=path)
    assert list(tmp_path.iterdir()) == []


def test_an_amplitude_with_a_sampled_prior_leaves_the_gaussian():
    samples = noisy("ward", WARD, n=100)
    problem = SingleProblem.from_samples(samples, models.get("ward"), threads=1)
    mode = problem.vector(WARD)
    mixed = [Prior(), replace(Prior(), kind="lognormal", centre=0.2, width=0.1), Prior(), Prior()]
    target = MarginalTarget(problem, mode, 1.0, mixed, 0.01 * mode)
    assert (list(target.linear), list(target.sampled)) == ([0], [1, 2, 3])
