"""Uncertainties of losses, their scale and units, and data that no loss may break at."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from scipy.optimize import minimize

import gonio
from gonio import formats, models
from gonio.errors import DataError
from gonio.fitting.diagnostics.diagnose import diagnose
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.problem import losses
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.residual_tests.misfit import misfit_test
from gonio.fitting.uncertainty.at_minimum import honest_uncertainties
from gonio.fitting.uncertainty.covariance import evaluate
from gonio.fitting.uncertainty.intervals import estimated
from gonio.fitting.warnings import warnings_of
from gonio.geometry import Directions
from gonio.models.base import Model
from gonio.samples import BRDFSamples

MODEL = "ward_isotropic"
TRUE = {"rho_d": 0.2, "rho_s": 0.1, "alpha": 0.15}
ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
OTHERS = [name for name in losses.LOSSES if name != "chi2"]


def where(n, seed=1):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, 60, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def about_the_mirror(n=120, seed=3):
    """Viewing directions at logarithmic distances from the mirror directions of four incidences."""
    rng = np.random.default_rng(seed)
    theta_i = np.radians(np.repeat([10, 25, 40, 55], n // 4))
    off = 10 ** rng.uniform(-3, -0.3, n) * rng.choice([-1, 1], n)
    beta = np.clip(np.sin(theta_i) + off, -0.99, 0.99)
    return Directions(theta_i, 0.0, np.abs(np.arcsin(beta)), np.where(beta > 0, np.pi, 0.0))


# --- uncertainties --------------------------------------------------------------------------------


def plane(directions, a, b):
    return a + b * np.cos(directions.theta_r)


PLANE = Model.from_function(plane, {"a": (0.2, 0.0, 10.0), "b": (0.1, 0.0, 10.0)})


def t_regression(x, y, start):
    """a, b and the scale that maximise the likelihood of Student's t with 4 degrees of freedom."""

    def loss(q):
        z2 = ((y - q[0] - q[1] * x) / math.exp(q[2])) ** 2
        return 2.5 * np.sum(np.log1p(z2 / 4)) + len(x) * q[2]

    return minimize(loss, start, method="BFGS", options={"gtol": 1e-4}).x


def test_students_t_of_a_straight_line_is_as_uncertain_as_its_bootstrap():
    rng = np.random.default_rng(11)
    directions = where(150)
    x = np.cos(directions.theta_r)
    y = 1.0 + 2.0 * x + 0.05 * rng.standard_t(2.5, 150)
    result = gonio.fit(BRDFSamples(directions, y), model=PLANE, loss="student_t")
    here = t_regression(x, y, [1.0, 2.0, math.log(0.05)])
    np.testing.assert_allclose(list(result.values().values()), here[:2], rtol=2e-3)
    points = []
    for _ in range(150):
        drawn = rng.integers(0, 150, 150)
        points.append(t_regression(x[drawn], y[drawn], here)[:2])
    stated = [e.stderr for e in result.parameters.values()]
    np.testing.assert_allclose(stated, np.std(points, axis=0), rtol=0.3)


@pytest.mark.parametrize("loss", OTHERS)
def test_under_a_wrong_model_every_loss_is_as_uncertain_as_its_bootstrap(loss):
    """J^T B J alone would be far off: the residuals are part of the curvature."""
    rng = np.random.default_rng(5)
    directions = where(200)
    f = models.get("phong")(directions, rho_d=0.2, rho_s=0.1, n=12.0)
    y = f * (1 + 0.05 * rng.standard_normal(200))
    samples = BRDFSamples(directions, y)
    angles = np.array([getattr(directions, name) for name in ANGLES])
    model = models.get(MODEL)
    minimum = find_minimum(samples, model, loss=loss)
    points = []
    for _ in range(40):
        rows = rng.integers(0, 200, 200)
        theta_i, phi_i, theta_r, phi_r = angles[:, rows]
        theta_r = theta_r + 1e-9 * np.arange(200)  # a reading that is there twice counts once
        drawn = BRDFSamples(Directions(theta_i, phi_i, theta_r, phi_r), y[rows])
        points.append(find_minimum(drawn, model, loss=loss).optimum.p)
    scatter = np.std(points, axis=0)
    # They agree within 30 %, and 40 draws know a standard deviation to 11 %.
    of_samples = np.sqrt(np.diag(evaluate(minimum).independent))
    np.testing.assert_allclose(of_samples, scatter, rtol=0.4)
    # What is stated allows for errors that an incidence has in common as well: no draw of single
    # samples shows them.
    stated = np.array(
        [e.stderr for e in gonio.fit(samples, model=model, loss=loss).parameters.values()]
    )
    assert np.all(stated > 0.7 * scatter)


@pytest.mark.parametrize("loss", OTHERS)
def test_intervals_take_students_t(loss):
    y = models.get(MODEL)(where(300), **TRUE)
    y = y * (1 + 0.05 * np.random.default_rng(2).standard_normal(300))
    result = gonio.fit(BRDFSamples(where(300), y), model=MODEL, loss=loss)
    for estimate in result.parameters.values():
        assert 5 < estimate.dof < 300
        low, high = estimate.interval_95
        assert (high - low) / 2 / estimate.stderr > 1.96


# --- the scale of Student's t ---------------------------------------------------------------------


def test_the_scale_of_students_t_is_found():
    directions = where(20_000)
    f = models.get(MODEL)(directions, **TRUE)
    rng = np.random.default_rng(7)
    y = f + 0.003 * rng.standard_t(losses.NU, len(f))
    problem = SingleProblem.from_samples(
        BRDFSamples(directions, y), models.get(MODEL), loss="student_t"
    )
    p = models.get(MODEL).vector(TRUE)
    scale = problem.reweighted(p).inverse_variance[0] ** -0.5
    assert scale == pytest.approx(0.003, rel=0.02)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.75, 0.79])
def test_residuals_that_are_zero_do_not_take_the_scale_away(share):
    """The median of their sizes would be 0 from one half on."""
    r = np.random.default_rng(1).standard_normal(10_000)
    r[: int(share * len(r))] = 0.0
    scale = losses.get("student_t").scale(r)
    x2 = (r / scale) ** 2
    assert np.mean(5 * x2 / (4 + x2)) == pytest.approx(1, rel=1e-9)
    assert scale > 1e-3


def test_more_zeros_than_the_scale_bears_are_said():
    directions = where(200)
    y = models.get("lambert")(directions, rho=0.0)
    y[:30] = -0.01 + 0.001 * np.random.default_rng(1).standard_normal(30)
    minimum = find_minimum(BRDFSamples(directions, y), models.get("lambert"), loss="student_t")
    assert any(
        text.startswith("170 of 200 residuals are exactly 0: loss 'student_t' finds the size")
        for text in warnings_of(minimum, evaluate(minimum))
    )


@pytest.mark.parametrize("factor", [1e3, 1e-3])
@pytest.mark.parametrize(
    "options",
    [{"loss": "student_t"}, {"loss": "relative"}, {"loss": "cube_root"}, {"weights": "relative"},
     {"loss": "student_t", "weights": "relative"}, {"loss": "student_t", "weights": "sd"}],
    ids=str,
)  # fmt: skip
def test_the_unit_of_f_changes_amplitudes_alone(options, factor):
    directions = about_the_mirror()
    rng = np.random.default_rng(9)
    f = models.get("abg")(directions, A=1e-3, B=1e-3, g=2.0)
    y = f * (1 + 0.1 * rng.standard_normal(len(f)))
    one, other = (
        gonio.fit(BRDFSamples(directions, k * y, u_independent=k * 0.1 * f), model="abg",
                  **{"weights": None if options.get("loss") == "relative" else "none", **options})
        for k in (1.0, factor)
    )  # fmt: skip
    for name, unit in (("A", factor), ("B", 1.0), ("g", 1.0)):
        a, b = one.parameters[name], other.parameters[name]
        assert b.value == pytest.approx(unit * a.value, rel=1e-4)
        assert b.stderr == pytest.approx(unit * a.stderr, rel=1e-2)


# --- data that no loss may break at ---------------------------------------------------------------


def test_the_cube_root_does_not_rest_where_the_model_is_black():
    directions = where(100)
    y = models.get("lambert")(directions, rho=0.3)
    problem = SingleProblem.from_samples(
        BRDFSamples(directions, y), models.get("lambert"), loss="cube_root"
    )
    chi2, g, h = problem.normal_equations(np.array([0.0]))
    assert g[0] > 0
    assert 0 < h[0, 0] < np.inf
    assert problem.chi2(np.array([1e-9])) < chi2


@pytest.mark.parametrize("loss", losses.LOSSES)
@pytest.mark.parametrize("kind", ["zeros", "negative", "constant", "one value", "huge", "tiny"])
def test_no_loss_breaks_at_odd_data(loss, kind):
    directions = where(60)
    y = models.get(MODEL)(directions, **TRUE)
    rng = np.random.default_rng(4)
    y = y * (1 + 0.02 * rng.standard_normal(60))
    if kind == "zeros":
        y[:40] = 0.0
    elif kind == "negative":
        y[::3] *= -1
    elif kind == "constant":
        y[:] = 0.1
    elif kind == "one value":
        y[1:] = 1e-4
    else:
        y *= 1e30 if kind == "huge" else 1e-30
    if loss == "relative" and y.min() <= 0:
        pytest.skip("refused, see below")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        minimum = find_minimum(BRDFSamples(directions, y), models.get(MODEL), loss=loss)
        squares = minimum.as_least_squares()
        test = misfit_test(squares)
        errors, _ = honest_uncertainties(minimum, test)
        estimates, _ = estimated(minimum, errors, test)
        diagnose(squares)
    assert np.isfinite(minimum.chi2)
    for estimate in estimates.values():
        assert np.isfinite(estimate.value)
        if estimate.stderr is not None:
            assert np.isfinite(estimate.stderr)
        if estimate.interval_95 is not None:
            assert estimate.interval_95[0] <= estimate.value <= estimate.interval_95[1]


def test_logarithms_of_readings_that_are_not_positive_are_refused():
    y = models.get(MODEL)(where(50), **TRUE)
    y[[3, 7]] = -0.01, -0.02
    with pytest.raises(
        DataError,
        match=r"^2 of 50 values are not above 0 \(the first is sample 4, -0\.01\): loss 'relative' "
        r"compares logarithms\. Use weights relative, which follow the fitted value and take any "
        r"reading; or remove these samples, which makes dark places seem brighter\.$",
    ):
        gonio.fit(BRDFSamples(where(50), y), model=MODEL, loss="relative")


# --- weights from the fitted value ----------------------------------------------------------------


def test_relative_weights_are_those_of_the_fitted_values():
    directions = where(300)
    y = models.get(MODEL)(directions, **TRUE)
    y = y * (1 + 0.1 * np.random.default_rng(3).standard_normal(300))
    y[5] = -0.01  # noise
    result = gonio.fit(BRDFSamples(directions, y), model=MODEL, weights="relative")
    assert result.status == "converged"
    problem = SingleProblem.from_samples(BRDFSamples(directions, y), models.get(MODEL))
    p = models.get(MODEL).vector(result.values())
    f, jacobian = problem.jacobian(p)
    # The quasi-score of noise that is a fixed part of f.
    terms = ((y - f) / f**2)[:, None] * jacobian
    assert np.all(np.abs(terms.sum(axis=0)) < 1e-4 * np.sqrt(np.sum(terms**2, axis=0)))
    assert result.noise_scale == pytest.approx(np.sqrt(np.mean((y / f - 1) ** 2)), rel=0.02)


def test_relative_weights_do_not_follow_noise():
    """Weights from the readings would make f 2 % too small where the noise is 10 %."""
    directions = where(200)
    f = models.get("lambert")(directions, rho=0.3)
    rng = np.random.default_rng(8)
    found = []
    for _ in range(30):
        y = f * (1 + 0.1 * rng.standard_normal(200))
        fitted = gonio.fit(BRDFSamples(directions, y), model="lambert", weights="relative")
        found.append(fitted.values()["rho"])
    assert np.mean(found) == pytest.approx(0.3, rel=4 * 0.1 / np.sqrt(30 * 200))


# --- six decades ----------------------------------------------------------------------------------


def test_abg_is_recovered_from_six_decades():
    directions = about_the_mirror(400)
    truth = {"A": 2e-3, "B": 5e-7, "g": 2.2}
    f = models.get("abg")(directions, **truth)
    assert f.max() / f.min() > 1e5
    inside = np.zeros(3)
    rng = np.random.default_rng(6)
    for _ in range(20):
        y = f * np.exp(0.3 * rng.standard_normal(400))
        result = gonio.fit(BRDFSamples(directions, y), model="abg", loss="relative")
        assert result.status == "converged"
        for j, name in enumerate(truth):
            low, high = result.parameters[name].interval_95
            inside[j] += low <= truth[name] <= high
    assert np.all(inside >= 16)  # 95 % of 20; 15 or fewer once in 4,000


def test_abg_is_recovered_from_the_steep_metal():
    path = Path(ROOT).parent / "shared" / "cases" / "steep_metal_six_decades.csv"
    if not path.is_file():
        pytest.skip(f"no {path}")
    result = gonio.fit(formats.read(path), model="abg", loss="relative")
    for name, value in {"A": 3.4e-3, "B": 4.3e-6, "g": 2.07}.items():
        low, high = result.parameters[name].interval_95
        assert low <= value <= high
        assert (high - low) / value < 2.0


# --- diagnosis in the loss's own residuals --------------------------------------------------------


@pytest.mark.parametrize("loss", OTHERS)
def test_residuals_of_every_loss_are_looked_at(loss):
    """Structure is seen under a wrong model, and not under the true one, outliers included."""
    rng = np.random.default_rng(12)
    directions = Directions(
        np.repeat(np.radians([10, 25, 40, 55]), 60), 0.0,
        np.tile(np.radians(np.linspace(0, 65, 30)), 8), np.repeat([0.0, np.pi] * 4, 30),
    )  # fmt: skip
    outlier = rng.random(240) < (0.05 if loss == "student_t" else 0.0)
    noise = np.where(outlier, 1.6, 1 + 0.03 * rng.standard_normal(240))
    right = models.get(MODEL)(directions, **TRUE)
    wrong = models.get("oren_nayar")(directions, rho=0.3, sigma=0.5) + 0.3 * right
    for f, structured in ((right, False), (wrong, True)):
        result = gonio.fit(BRDFSamples(directions, f * noise), model=MODEL, loss=loss)
        assert result.diagnostics["residuals"]["structured"] == structured
        allowance = result.diagnostics["allowance"]
        assert (allowance is not None) == structured
        if structured:
            assert allowance["basis"] == "samples and incidences"


@pytest.mark.parametrize("loss", losses.LOSSES)
def test_least_squares_of_what_a_loss_sees_have_its_minimum(loss):
    directions = where(200)
    y = models.get(MODEL)(directions, **TRUE)
    y = y * (1 + 0.05 * np.random.default_rng(3).standard_normal(200))
    minimum = find_minimum(BRDFSamples(directions, y), models.get(MODEL), loss=loss)
    squares = minimum.as_least_squares()
    assert squares.problem.quadratic
    _, g, h = squares.problem.normal_equations(minimum.optimum.p)
    sd = np.sqrt(squares.chi2 / squares.dof / np.diag(h))
    assert np.all(np.abs(np.linalg.solve(h, g)) < 1e-2 * sd)


@pytest.mark.parametrize("options", [{"loss": "relative"}, {"weights": "relative"}], ids=str)
def test_noise_that_is_a_part_of_f_is_no_structure_over_six_decades(options):
    """The scatter by groups of f would let the few samples at the peak decide."""
    directions = about_the_mirror()
    f = models.get("abg")(directions, A=2e-3, B=5e-7, g=2.0)
    structured = 0
    rng = np.random.default_rng(1)
    for _ in range(10):
        y = f * (1 + 0.05 * rng.standard_normal(len(f)))
        minimum = find_minimum(BRDFSamples(directions, y), models.get("abg"), **options)
        test = misfit_test(minimum.as_least_squares())
        structured += test.structured
    assert structured <= 1


def test_the_verdict_on_six_decades_is_on_logarithms():
    """Plain residuals of 30 % noise would be those of the few brightest samples."""
    directions = about_the_mirror()
    f = models.get("abg")(directions, A=2e-3, B=5e-7, g=2.0)
    y = f * np.exp(0.3 * np.random.default_rng(2).standard_normal(len(f)))
    samples = BRDFSamples(directions, y)
    right = gonio.fit(samples, model="abg", loss="relative").verdict
    assert right.kind == "undecided"
    assert "without structure" in right.reason
    wrong = gonio.fit(samples, model=MODEL, loss="relative").verdict
    assert wrong.kind == "does_not_fit"
