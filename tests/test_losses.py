"""Losses: what each measures, how sure it is, and what it cannot do."""

from __future__ import annotations

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.problem import losses
from gonio.fitting.problem.single import SingleProblem
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

TRUE = np.array([0.2, 0.1, 0.15])
MODEL = "ward_isotropic"


def where(n, seed=1):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, 60, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def truth(directions):
    return models.get(MODEL).evaluate(*directions.vectors(), TRUE)


@pytest.mark.parametrize("name", losses.LOSSES)
def test_the_slope_is_that_of_the_loss(name):
    directions = where(200)
    f = truth(directions)
    noise = 0.02 * np.random.default_rng(2).standard_normal(200)
    problem = SingleProblem.from_samples(
        BRDFSamples(directions, f * (1 + noise)), models.get(MODEL), loss=name
    )
    p = TRUE * 1.1
    _, g, h = problem.normal_equations(p)
    for j in range(3):
        step = 1e-6 * (np.arange(3) == j)
        slope = (problem.chi2(p + step) - problem.chi2(p - step)) / 2e-6
        assert slope == pytest.approx(-2 * g[j], rel=1e-6)
    assert np.all(np.linalg.eigvalsh(h) > 0)


@pytest.mark.parametrize(
    ("name", "distance"),
    [
        ("log", lambda x: np.log(1 + x)),
        ("cube_root", lambda x: np.sign(x) * np.abs(x) ** (1 / 3)),
    ],
)
def test_what_is_made_small_is_what_its_name_says(name, distance):
    from scipy.optimize import least_squares

    directions = where(300)
    cos_r = np.cos(directions.theta_r)
    # Another model than the one that is fitted: the loss decides where they meet.
    y = models.get("phong")(directions, rho_d=0.2, rho_s=0.1, n=40.0)
    result = gonio.fit(BRDFSamples(directions, y), model=MODEL, loss=name)
    assert result.loss == name
    model = models.get(MODEL)
    w_i, w_r = directions.vectors()
    found = least_squares(
        lambda p: distance(y * cos_r) - distance(model.evaluate(w_i, w_r, p) * cos_r),
        TRUE, xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(list(result.values().values()), found.x, rtol=1e-5)
    assert result.chi2 == pytest.approx(2 * found.cost, rel=1e-9)
    squares = gonio.fit(BRDFSamples(directions, y), model=MODEL)
    assert abs(squares.values()["rho_s"] / result.values()["rho_s"] - 1) > 0.01


def test_noise_around_zero_keeps_its_sign_under_the_cube_root():
    directions = where(4000)
    y = truth(directions)
    y[::10] = 1e-3 * np.random.default_rng(3).standard_normal(400)
    problem = SingleProblem.from_samples(
        BRDFSamples(directions, y), models.get(MODEL), loss="cube_root"
    )
    assert np.all(np.isfinite(problem.normal_equations(TRUE)[1]))


CASES = {"chi2": 0.0, "log": 0.0, "cube_root": 0.0, "student_t": 0.05}


@pytest.mark.parametrize("name", CASES)
def test_intervals_cover_the_truth(name):
    """Two standard uncertainties hold 95 % of the errors, with outliers under Student's t."""
    directions = where(300)
    f = truth(directions)
    rng = np.random.default_rng(4)
    repeats, inside = 120, np.zeros(3)
    for _ in range(repeats):
        y = f * (1 + 0.02 * rng.standard_normal(300))
        outlier = rng.random(300) < CASES[name]
        y = np.where(outlier, y * rng.uniform(1.2, 2.0, 300), y)
        options = {"weights": "none"} if name == "chi2" else {}
        u = None if name in ("log", "cube_root") else 0.02 * f
        if name == "chi2":
            options = {"weights": "sd"}
        samples = BRDFSamples(directions, y, u_independent=u)
        result = gonio.fit(samples, model=MODEL, loss=name, **options)
        assert result.status == "converged"
        for j, (estimate, true) in enumerate(zip(result.parameters.values(), TRUE, strict=True)):
            inside[j] += abs(estimate.value - true) < 1.96 * estimate.stderr
    # The binomial's sd is 2 %; one-sided outliers leave a bias of a part of the uncertainty.
    assert np.all(inside / repeats > 0.88)
    assert np.all(inside / repeats < 0.999)


@pytest.mark.parametrize("stated", [True, False])
def test_outliers_hardly_move_students_t(stated):
    directions = where(2000)
    f = truth(directions)
    rng = np.random.default_rng(5)
    y = f * (1 + 0.01 * rng.standard_normal(2000))
    bad = rng.random(2000) < 0.05
    y[bad] *= rng.uniform(1.5, 3.0, bad.sum())
    samples = BRDFSamples(directions, y, u_independent=0.01 * f if stated else None)
    errors = {}
    for name in ("chi2", "student_t"):
        result = gonio.fit(samples, model=MODEL, loss=name)
        assert result.status == "converged"
        errors[name] = abs(result.values()["rho_d"] / TRUE[0] - 1)
    assert errors["chi2"] > 0.02
    assert errors["student_t"] < 0.1 * errors["chi2"]


def test_the_likelihood_of_students_t_is_that_of_scipy():
    from scipy import stats

    directions = where(50)
    f = truth(directions)
    u = 0.03 * f
    problem = SingleProblem.from_samples(
        BRDFSamples(directions, 1.05 * f, u_independent=u), models.get(MODEL), loss="student_t"
    )
    points = np.array([TRUE, 0.9 * TRUE, 1.2 * TRUE])
    logs = [np.sum(stats.t.logpdf((1.05 * f - problem.values(p)) / u, losses.NU)) for p in points]
    found = problem.batch_chi2(points)
    np.testing.assert_allclose(np.diff(found), -2 * np.diff(logs), rtol=1e-9)


def test_losses_that_are_no_likelihoods_have_no_posterior():
    samples = BRDFSamples(where(50), truth(where(50)), u_independent=np.full(50, 0.01))
    for name in ("log", "cube_root"):
        with pytest.raises(
            ConfigurationError,
            match=f"^loss '{name}' is not a likelihood and has no posterior; fit without one, "
            r"or use loss chi2 or student_t\.$",
        ):
            gonio.fit(samples, model=MODEL, loss=name, posterior=True)


def test_transformed_losses_take_no_weights():
    samples = BRDFSamples(where(50), truth(where(50)))
    with pytest.raises(
        ConfigurationError,
        match=r"^loss 'log' compares ln\(1 \+ f cos theta_r\) with equal weights; leave the "
        r"weights 'cos' out, or use loss chi2 with them\.$",
    ):
        gonio.fit(samples, model=MODEL, loss="log", weights="cos")


def test_the_logarithm_of_a_value_below_minus_one_is_refused():
    y = truth(where(50))
    y[3] = -4.0
    with pytest.raises(DataError, match=r"loss 'log' takes ln\(1 \+ f cos theta_r\) and needs"):
        gonio.fit(BRDFSamples(where(50), y), model=MODEL, loss="log")


def test_unknown_losses_and_combinations_are_refused():
    samples = BRDFSamples(where(50), truth(where(50)))
    with pytest.raises(ConfigurationError, match=r"^unknown loss 'lg': did you mean 'log'\?"):
        gonio.fit(samples, model=MODEL, loss="lg")
    with pytest.raises(
        ConfigurationError,
        match=r"^share and nuisance need loss 'chi2', not 'log'; change it, or leave share and "
        r"nuisance out\.$",
    ):
        gonio.fit([samples], model=MODEL, loss="log", share="rho_d")
