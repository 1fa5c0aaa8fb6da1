"""Uncertainties: against scipy, by repetition, by source, at bounds, and where there are none."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

import gonio
from gonio import models
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.shared_change import _blurred
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.uncertainty.profile_likelihood import profile_limit
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

ISOTROPIC = {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.3}
ROUGH = {"sigma": 0.5, "rho": 0.8, "ks_over_kb": 0.1}


def directions(n, seed=1, theta_max=70):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, theta_max, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def noisy(name, truth, *, n=200, noise=0.01, seed=2, stated=True, where=None, **columns):
    """Samples with noise of a share of the mean."""
    rng = np.random.default_rng(seed)
    where = where or directions(n)
    f = models.get(name)(where, **truth)
    sd = noise * f.mean()
    u = np.full(len(f), sd) if stated else None
    return BRDFSamples(where, f + sd * rng.standard_normal(len(f)), u_independent=u, **columns)


def matrix(result):
    return np.array(result.covariance)


def test_covariance_is_that_of_scipy():
    samples = noisy("ward_isotropic", ISOTROPIC)
    model = models.get("ward_isotropic")
    result = gonio.fit(samples, model=model)
    w_i, w_r = samples.directions.vectors()
    sd = samples.u_independent
    found = least_squares(
        lambda p: (samples.value - model.evaluate(w_i, w_r, p)) / sd, list(ISOTROPIC.values()),
        jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    expected = np.linalg.inv(found.jac.T @ found.jac) * max(1, 2 * found.cost / result.dof)
    # Three-point differences are good to about 1e-7.
    np.testing.assert_allclose(matrix(result), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "truth"), [("ward_isotropic", ISOTROPIC), ("oren_nayar_torrance_sparrow", ROUGH)]
)
@pytest.mark.parametrize("stated", [True, False])
def test_intervals_hold_the_truth_as_often_as_they_say(name, truth, stated):
    model = models.get(name)
    repeats = 100
    hits = dict.fromkeys(itertools.product(truth, (68, 95)), 0)
    for k in range(repeats):
        samples = noisy(name, truth, n=80, noise=0.02, seed=100 + k, stated=stated)
        result = gonio.fit(samples, model=model, threads=1)
        assert result.status == "converged"
        for q in model.parameters:
            true = truth[q.name]
            for level in (68, 95):
                low, high = getattr(result.parameters[q.name], f"interval_{level}")
                hits[q.name, level] += low <= true <= high
    for (_, level), count in hits.items():
        share = {68: 0.6827, 95: 0.95}[level]
        # 3 standard deviations of a binomial count, and 2 % for the curvature of the model;
        # Birge's ratio widens but never narrows.
        slack = 3 * np.sqrt(share * (1 - share) / repeats) + 0.02
        assert share - slack < count / repeats < share + slack + (0.05 if stated else 0)


def test_larger_residuals_than_stated_widen_the_uncertainty():
    honest = noisy("ward_isotropic", ISOTROPIC)
    boast = BRDFSamples(honest.directions, honest.value, u_independent=honest.u_independent / 10)
    a, b = (gonio.fit(s, model="ward_isotropic") for s in (honest, boast))
    for name in ISOTROPIC:
        assert b.parameters[name].stderr == pytest.approx(
            a.parameters[name].stderr * b.noise_scale / 10 / a.noise_scale, rel=1e-6
        )
    larger = f"the residuals are {b.noise_scale:.3g} times as large as the stated"
    assert any(text.startswith(larger) for text in b.warnings)
    assert not a.warnings


# ------------------------------------------------------------- terms that samples share


def test_a_standard_of_two_percent_limits_rho_and_not_alpha():
    term = SharedTerm("standard", "reflectance of the standard", relative=0.02)
    name = "ward_isotropic"
    with_term = gonio.fit(noisy(name, ISOTROPIC, shared=(term,)), model=name)
    without = gonio.fit(noisy(name, ISOTROPIC), model=name)
    assert with_term.values() == without.values()
    for name in ("rho_d", "rho_s"):
        estimate = with_term.parameters[name]
        # The model is linear in both together: they scale with the standard, exactly 2 % here
        # but for the weights' pull, quadratic in the residuals.
        assert estimate.components["standard"] == pytest.approx(0.02 * estimate.value, rel=0.02)
        assert estimate.stderr >= 0.02 * estimate.value * 0.98
        assert estimate.stderr == pytest.approx(
            np.hypot(estimate.components["independent"], estimate.components["standard"])
        )
    alpha, bare = with_term.parameters["alpha"], without.parameters["alpha"]
    assert alpha.stderr == pytest.approx(bare.stderr, rel=0.01)


def test_a_lamp_that_drifts_between_images_averages_out():
    group = np.repeat(np.arange(10), 20)
    each = SharedTerm("lamp", "drift", relative=0.03, group=group)
    result = gonio.fit(noisy("lambert", {"rho": 0.5}, shared=(each,)), model="lambert")
    # Ten equal groups with one draw each.
    rho = result.parameters["rho"]
    assert rho.components["lamp"] == pytest.approx(0.03 * rho.value / np.sqrt(10), rel=0.01)


def test_a_profile_weighs_the_samples():
    half = np.repeat([0.0, 1.0], 100)
    term = SharedTerm("standard, shape", "shape of the standard", relative=0.04, profile=half)
    result = gonio.fit(noisy("lambert", {"rho": 0.5}, shared=(term,)), model="lambert")
    rho = result.parameters["rho"]
    # Half of the samples move by 4 %, each as good as the others.
    assert rho.components["standard, shape"] == pytest.approx(0.02 * rho.value, rel=0.01)


def test_a_shift_moves_the_parameters_as_a_refit_does():
    where = directions(400)
    _, w_r = where.vectors()
    tangent = np.cross(w_r, [0.0, 1.0, 0.0])
    shift = 1e-3 * tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    term = SharedTerm("mapping", "direction of the viewer", shift=shift)
    f = models.get("ward_isotropic")(where, **ISOTROPIC)
    samples = BRDFSamples(where, f, u_independent=np.full(400, 1e-3), shared=(term,))
    result = gonio.fit(samples, model="ward_isotropic")
    w_i, _ = where.vectors()
    moved = w_r + shift
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    seen = models.get("ward_isotropic").evaluate(w_i, moved, np.array(list(ISOTROPIC.values())))
    refit = gonio.fit(
        BRDFSamples(where, seen, u_independent=np.full(400, 1e-3)), model="ward_isotropic"
    )
    for name, true in ISOTROPIC.items():
        # Linear to first order in a shift of 1e-3 against a lobe of 0.3.
        change = abs(refit.values()[name] - true)
        expected = result.parameters[name].components["mapping"]
        assert expected == pytest.approx(change, rel=0.03, abs=2e-6)


def test_a_blur_is_the_gaussian_blur_to_leading_order():
    sd = 0.01
    where = directions(60, theta_max=60)
    problem = SingleProblem.from_samples(
        BRDFSamples(where, np.ones(60)), models.get("ward_isotropic")
    )
    p = np.array([0.3, 0.1, 0.15])
    quick = _blurred(problem, sd, p) - problem.values(p)
    # Gauss-Hermite quadrature over two tangents of the viewing direction.
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    w_i, w_r = where.vectors()
    a = np.cross(w_r, [1.0, 0.0, 0.0])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(w_r, a)
    exact = -problem.values(p)
    for (s, ws), (t, wt) in itertools.product(zip(nodes, weights, strict=True), repeat=2):
        moved = w_r + sd * (s * a + t * b)
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        exact += ws * wt / (2 * np.pi) * models.get("ward_isotropic").evaluate(w_i, moved, p)
    # The next order is (sd/alpha)^2, 0.4 % of the change, times some ten.
    np.testing.assert_allclose(quick, exact, atol=0.05 * np.abs(exact).max())


# ---------------------------------------------------------------- bounds and ignorance


def test_at_a_bound_the_interval_is_one_sided_from_the_profile():
    # rho = 0.001 with noise far above it, drawn so that the mean is negative.
    where = directions(100)
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(100)
    value = 0.01 * (noise - noise.mean() - 0.05)
    samples = BRDFSamples(where, value, u_independent=np.full(100, 0.01))
    result = gonio.fit(samples, model="lambert")
    rho = result.parameters["rho"]
    assert (rho.value, rho.stderr, rho.at_bound) == (0.0, None, "lower")
    assert result.covariance is None
    # chi2(rho) = n ((rho/pi - mean)/sd)^2 + const, by hand.
    scale = result.noise_scale
    for interval, increase in ((rho.interval_68, 1.0), (rho.interval_95, 3.841459)):
        m, s = value.mean(), 0.01 * scale / 10
        limit = np.pi * (m + np.sqrt(m**2 + increase * s**2))
        assert interval[0] == 0
        assert interval[1] == pytest.approx(limit, rel=2e-3)
    assert (
        f"rho is at its lower bound (0): the data do not support a value above "
        f"{rho.interval_95[1]:.3g} (95 %) and do not determine it otherwise." in result.warnings
    )


def test_an_interval_that_meets_a_bound_comes_from_the_profile():
    where = directions(100)
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(100)
    value = 0.01 * (noise - noise.mean()) / noise.std() + 0.0015
    samples = BRDFSamples(where, value, u_independent=np.full(100, 0.01))
    rho = gonio.fit(samples, model="lambert").parameters["rho"]
    assert rho.value == pytest.approx(0.0015 * np.pi)
    assert rho.interval_95[0] == 0
    assert rho.interval_68[0] == pytest.approx(rho.value - rho.stderr, abs=1e-6)
    assert rho.interval_95[1] == pytest.approx(rho.value + 1.96 * rho.stderr, rel=1e-4)


def test_in_one_plane_an_anisotropic_lobe_is_not_determined():
    theta_r = np.radians(np.linspace(-75, 75, 120))
    where = Directions(np.full(120, 0.5), 0.0, np.abs(theta_r), np.where(theta_r < 0, 0, np.pi))
    truth = {"rho_d": 0.2, "rho_s": 0.05, "alpha_x": 0.1, "alpha_y": 0.2}
    result = gonio.fit(noisy("ward", truth, where=where), model="ward")
    for name in ("rho_s", "alpha_y"):  # only rho_s/alpha_y enters
        assert result.parameters[name].stderr is None
        assert result.parameters[name].interval_95 is None
        assert (
            f"{name} is not determined by these data: its value is arbitrary and it has no "
            "uncertainty; measure other directions or use a simpler model." in result.warnings
        )
    for name in ("rho_d", "alpha_x"):
        estimate = result.parameters[name]
        assert abs(estimate.value - truth[name]) < 4 * estimate.stderr
    assert result.covariance is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["ward", "ward_isotropic"])
def test_without_a_lobe_alpha_is_not_determined(name, seed):
    result = gonio.fit(noisy("lambert", {"rho": 0.3}, n=300, seed=seed), model=name)
    assert result.parameters["rho_d"].value == pytest.approx(0.3, rel=0.02)
    result.to_json()
    if result.status == "converged":
        # Nothing but noise makes the lobe: its amplitude is 0 or far below rho_d.
        rho_s = result.parameters["rho_s"]
        assert rho_s.at_bound == "lower" or rho_s.interval_95[0] < 0.01
    alphas = [v for k, v in result.parameters.items() if k.startswith("alpha")]
    if result.parameters["rho_s"].at_bound == "lower":
        assert all(a.stderr is None for a in alphas)
        assert any("is not determined by these data" in text for text in result.warnings)


def test_a_lobe_that_only_follows_single_samples_is_dropped():
    # A draw of the noise in which the lobe would shrink to one sample, found by trying some.
    value = 0.1 * (1 + 0.01 * np.random.default_rng(55).standard_normal(300))
    result = gonio.fit(BRDFSamples(directions(300, seed=55), value), model="ward_isotropic")
    assert result.status == "converged"
    assert result.parameters["rho_s"].at_bound == "lower"
    assert result.parameters["alpha"].stderr is None
    assert any(
        text.startswith("rho_s was set to its bound: with it the fit only followed the noise of ")
        for text in result.warnings
    )


# ------------------------------------------------------------------------------ fuzzing


def cases():
    where = directions(200)
    rng = np.random.default_rng(9)
    one_plus = 1 + 0.01 * rng.standard_normal(200)
    single = Directions(np.full(200, 0.5), 0.0, where.theta_r, where.phi_r)
    twins = Directions(*(np.full(200, a) for a in (0.5, 0.0, 0.5, np.pi)))
    few = directions(60, seed=4)
    plywood = {"rho_d": 0.33, "rho_s": 0.025, "alpha_x": 0.04, "alpha_y": 0.11}
    f = models.get("ward")(few, **plywood)
    yield "constant", BRDFSamples(where, np.full(200, 0.1))
    yield "constant with u", BRDFSamples(where, np.full(200, 0.1), u_independent=np.full(200, 1e-3))
    yield "zero", BRDFSamples(where, np.zeros(200))
    yield "zero with u", BRDFSamples(where, np.zeros(200), u_independent=np.full(200, 1e-3))
    yield "negative", BRDFSamples(where, -0.1 * one_plus)
    yield "duplicates", BRDFSamples(twins, 0.1 * one_plus)
    yield "one incidence", BRDFSamples(single, models.get("ward")(single, **plywood) * one_plus)
    yield "minute", BRDFSamples(where, 1e-12 * one_plus)
    yield "huge", BRDFSamples(where, 1e6 * one_plus)
    yield "noisy", BRDFSamples(few, f * (1 + 0.4 * rng.standard_normal(60)))
    yield "huge u", BRDFSamples(where, 0.1 * one_plus, u_independent=np.full(200, 1e9))
    yield "six samples", BRDFSamples(directions(6), 0.1 * one_plus[:6])


@pytest.mark.parametrize("name", ["ward", "oren_nayar", "oren_nayar_torrance_sparrow", "lambert"])
@pytest.mark.parametrize(
    ("what", "samples"), list(cases()), ids=lambda v: v if isinstance(v, str) else ""
)
def test_odd_data_never_give_nan(what, samples, name):
    result = gonio.fit(samples, model=name)
    text = result.to_json()
    assert "NaN" not in text
    assert "Infinity" not in text
    for q in models.get(name).parameters:
        estimate = result.parameters[q.name]
        assert q.lower <= estimate.value <= q.upper
        assert (estimate.at_bound is not None) == (estimate.value in (q.lower, q.upper))
        if estimate.at_bound:
            assert estimate.stderr is None
        for interval in (estimate.interval_68, estimate.interval_95):
            if interval is not None:
                assert q.lower <= interval[0] <= interval[1] <= q.upper
    if what == "huge" and name == "lambert":
        assert result.parameters["rho"].at_bound == "upper"
    if what == "minute" and name == "lambert":
        rho = result.parameters["rho"]
        assert abs(rho.value - 1e-12 * np.pi) < 4 * rho.stderr
    if what == "negative":
        assert "200 of 200 values are negative; they were kept as noise around zero." in (
            result.warnings
        )


def test_profile_of_an_unlimited_parameter_is_none():
    samples = BRDFSamples(directions(50), np.full(50, 1e-3), u_independent=np.full(50, 10.0))
    problem = SingleProblem.from_samples(samples, models.get("lambert"))
    end = minimise(problem, np.array([0.5]))
    assert profile_limit(Minimum.of(problem, end), 0, 1.0, side=1) is None
