"""Residuals, weights and cells: what chi-squared is made of."""

from __future__ import annotations

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, Cells

WARD = {"rho_d": 0.15, "rho_s": 0.19, "alpha_x": 0.088, "alpha_y": 0.13}


def directions(n, seed=1, theta_max=70):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, theta_max, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def problem_of(value, where, model="ward", weights=None, **columns):
    return SingleProblem.from_samples(
        BRDFSamples(where, value, **columns), models.get(model), weights
    )


def test_weights_are_what_their_names_say():
    where = directions(50)
    value, u = np.full(50, 0.1), np.linspace(0.001, 0.01, 50)
    cos_i, cos_r = np.cos(where.theta_i), np.cos(where.theta_r)
    for weights, factor in (
        ("none", np.ones(50)), ("cos", cos_r), ("coscos", cos_i * cos_r), ("sd", 1 / u),
    ):  # fmt: skip
        problem = problem_of(value, where, weights=weights, u_independent=u)
        np.testing.assert_allclose(problem.inverse_variance, factor**2, rtol=1e-14)
        r = factor * (value - models.get("ward")(where, **WARD))
        p = np.array(list(WARD.values()))
        assert problem.chi2(p) == pytest.approx(np.sum(r**2), rel=1e-12)


def test_weights_default_to_the_uncertainties_where_there_are_any():
    where = directions(10)
    assert problem_of(np.ones(10), where).weights == "none"
    assert problem_of(np.ones(10), where, u_independent=np.ones(10)).weights == "sd"


def test_unknown_weights_are_named():
    with pytest.raises(
        ConfigurationError,
        match=r"^weights 'cosine' are unknown; allowed are none, cos, coscos, relative, sd\.$",
    ):
        problem_of(np.ones(10), directions(10), weights="cosine")


def test_sd_weights_need_uncertainties():
    with pytest.raises(
        ConfigurationError,
        match=r"^weights 'sd' need uncertainties and the samples have none \(no u_brdf column\); "
        r"use none, relative, cos or coscos\.$",
    ):
        problem_of(np.ones(10), directions(10), weights="sd")


@pytest.mark.parametrize(("model", "n", "least"), [("ward", 4, 5), ("lambert", 1, 2)])
def test_fewer_samples_than_parameters_are_refused(model, n, least):
    text = (
        f"{n} samples? cannot determine the {least - 1} parameters? of {model}; "
        f"give at least {least}"
    )
    with pytest.raises(DataError, match=f"^{text}"):
        problem_of(np.ones(n), directions(n), model)
    assert problem_of(np.ones(least), directions(least), model).n == least


def test_normal_equations_are_the_derivatives_of_chi2():
    where = directions(100)
    problem = problem_of(np.full(100, 0.1), where, weights="coscos")
    p = np.array(list(WARD.values()))
    chi2, g, h = problem.normal_equations(p)
    assert chi2 == pytest.approx(problem.chi2(p), rel=1e-13)
    for j in range(4):
        step = 1e-5 * p[j] * (np.arange(4) == j)
        slope = (problem.chi2(p + step) - problem.chi2(p - step)) / (2 * step[j])
        # Central differences: 1e-10 of truncation, 1e-16/1e-5 of rounding, by the sum's size.
        assert slope == pytest.approx(-2 * g[j], rel=1e-5, abs=1e-8 * chi2 / p[j])
    assert np.all(np.linalg.eigvalsh(h) > 0)


def test_results_do_not_depend_on_threads():
    where = directions(20_000)
    value = models.get("ward")(where, **WARD)
    p = np.array([0.2, 0.1, 0.1, 0.2])
    samples = BRDFSamples(where, value)
    one, two = (
        SingleProblem.from_samples(samples, models.get("ward"), threads=n).normal_equations(p)
        for n in (1, 2)
    )
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def celled(n=60, seed=2, members=5, spread=0.05):
    """Samples whose values are a narrow lobe averaged over cells of several members."""
    rng = np.random.default_rng(seed)
    where = directions(n, seed)
    w_i, w_r = where.vectors()
    many = np.repeat(w_r, members, axis=0) + spread * rng.standard_normal((n * members, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    cells = Cells(many, np.full(n * members, 1 / members), np.arange(n + 1) * members)
    p = np.array([0.15, 0.19, 0.08, 0.1])
    f = models.get("ward").evaluate(np.repeat(w_i, members, axis=0), many, p)
    return BRDFSamples(where, f.reshape(n, members).mean(axis=1), cells=cells), p


def test_the_model_is_integrated_over_cells():
    samples, p = celled()
    problem = SingleProblem.from_samples(samples, models.get("ward"))
    np.testing.assert_allclose(problem.values(p), samples.value, rtol=1e-12)
    result = gonio.fit(samples, model="ward")
    assert result.status == "converged"
    # The data hold no noise and the same integral.
    np.testing.assert_allclose(list(result.values().values()), p, rtol=1e-8)


def test_some_samples_keep_their_cells_and_weights():
    samples, p = celled()
    problem = SingleProblem.from_samples(samples, models.get("ward"), "coscos")
    index = np.array([3, 17, 40])
    part = problem.at(index)
    np.testing.assert_array_equal(part.values(p), problem.values(p)[index])
    np.testing.assert_array_equal(part.inverse_variance, problem.inverse_variance[index])


def test_variance_follows_the_model_and_stays_positive():
    value, u2, slope = np.array([0.1, 0.2, -0.01] * 2), 1e-4, 5e-4
    problem = problem_of(
        value, directions(6), "lambert", u_independent=np.full(6, np.sqrt(u2)),
        noise_slope=np.full(6, slope),
    )  # fmt: skip
    np.testing.assert_allclose(problem.variance(), u2)
    f = np.full(6, 0.15)
    expected = u2 + slope * (f - np.maximum(value, 0))
    np.testing.assert_allclose(problem.variance(f), np.maximum(expected, 0.1 * u2), rtol=1e-12)
    np.testing.assert_allclose(problem.variance(np.full(6, -1.0)), 0.1 * u2)


def test_the_noise_of_a_shared_standard_counts_for_every_image():
    reference = np.full(6, 2e-3)
    problem = problem_of(
        np.full(6, 0.1), directions(6), "lambert", u_independent=np.full(6, 3e-3),
        u_reference=reference, reference_sharing=4,
    )  # fmt: skip
    np.testing.assert_allclose(problem.variance(), 9e-6)
    np.testing.assert_allclose(problem.variance(sharing=True), 9e-6 + 3 * 4e-6)
    np.testing.assert_allclose(problem.inverse_variance, 1 / (9e-6 + 3 * 4e-6))


def test_weights_from_the_model_do_not_pull_the_fit_down():
    """Shot noise whose variance is taken from each reading makes low readings look certain."""
    rng = np.random.default_rng(6)
    n, repeats, electrons, rho = 400, 60, 500.0, 0.3
    where = directions(n)
    true = rho / np.pi
    per = electrons / true  # electrons per sr^-1
    harmonic: list[float] = []
    plain: list[float] = []
    reweighted: list[float] = []
    for _ in range(repeats):
        counts = rng.poisson(electrons, n)
        value = counts / per
        u = np.sqrt(counts) / per
        slope = np.full(n, 1 / per)
        harmonic.append(np.pi * np.average(value, weights=1 / u**2))
        for found, extra in ((plain, {}), (reweighted, {"noise_slope": slope})):
            samples = BRDFSamples(where, value, u_independent=u, **extra)
            found.append(gonio.fit(samples, model="lambert").values()["rho"])
    error = rho / np.sqrt(electrons * n * repeats)
    # Weights 1/count make the mean the harmonic one: low by 1/electrons = 0.2 %.
    assert np.mean(harmonic) / rho - 1 == pytest.approx(-1 / electrons, abs=4 * error / rho)
    assert abs(np.mean(reweighted) - rho) < 3 * error
    # A stated u that follows the readings is recognised where no slope is stated.
    assert abs(np.mean(plain) - rho) < 3 * error
