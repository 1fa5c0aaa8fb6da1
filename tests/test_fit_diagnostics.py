"""What data tell: exchanges, what mends them, structure of residuals, limits at bounds."""

from __future__ import annotations

import json

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.fitting.diagnostics import identifiability as identify
from gonio.fitting.diagnostics import next_measurement
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.residual_tests import report as residuals
from gonio.fitting.residual_tests.groups import RINGS
from gonio.fitting.uncertainty.information import information
from gonio.fitting.uncertainty.profile_likelihood import profile
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

WARD = {"rho_d": 0.2, "rho_s": 0.05, "alpha_x": 0.1, "alpha_y": 0.2}


def directions(n, seed=1, theta_max=70):
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, theta_max, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    return Directions(theta[0], phi[0], theta[1], phi[1])


def plane(n=120, theta_i=0.5):
    theta_r = np.radians(np.linspace(-75, 75, n))
    return Directions(np.full(n, theta_i), 0.0, np.abs(theta_r), np.where(theta_r < 0, 0, np.pi))


def noisy(name, truth, where, *, noise=0.01, seed=2, **columns):
    rng = np.random.default_rng(seed)
    f = models.get(name)(where, **truth)
    sd = np.full(len(f), noise * f.mean())
    return BRDFSamples(where, f + sd * rng.standard_normal(len(f)), u_independent=sd, **columns)


def fitted(samples, name, truth):
    """Problem and minimum, from the truth."""
    model = models.get(name)
    problem = SingleProblem.from_samples(samples, model)
    start = np.array([truth.get(q.name, q.default) for q in model.parameters])
    return problem, minimise(problem, start, search=False)


def identified(samples, name):
    found = find_minimum(samples, models.get(name))
    return identify.identify(found)


# ---------------------------------------------------------------- identifiability


def test_one_plane_exchanges_the_amplitude_and_the_width_across():
    found = identified(noisy("ward", WARD, plane()), "ward")
    # In one plane only rho_s/alpha_y enters: equal relative changes of both cancel.
    assert found.not_identified == ("rho_s", "alpha_y")
    assert found.axes[0].information < 1e-10
    assert found.causes == (
        "rho_s and alpha_y can be exchanged: +10 % in rho_s and +10 % in alpha_y leave every "
        "sample unchanged (a single angle of incidence, 28.6 deg; only one plane was measured, "
        "phi = 0 deg).",
    )
    assert found.bound["rho_s"] is None
    assert found.bound["alpha_x"] > 0
    json.dumps(found.to_dict(), allow_nan=False)


def test_the_measurement_that_is_named_mends_it():
    one = noisy("ward", WARD, plane())
    found = identified(one, "ward")
    suggested = found.suggested_measurement
    assert suggested is not None
    assert suggested.text in found.warnings[-1]
    kind = next(k for k, words in next_measurement.PATTERNS.items() if words == suggested.pattern)
    theta_i, phi_i = np.radians([suggested.theta_i_deg, suggested.rotation_deg])
    theta_r, phi_r = next_measurement.unit_directions(theta_i, phi_i, kind)
    both = Directions(
        np.r_[np.full(120, 0.5), np.full(len(theta_r), theta_i)],
        np.r_[np.zeros(120), np.full(len(theta_r), phi_i)],
        np.r_[one.directions.theta_r, theta_r],
        np.r_[one.directions.phi_r, phi_r],
    )
    result = gonio.fit(noisy("ward", WARD, both), model="ward")
    for name, true in WARD.items():
        estimate = result.parameters[name]
        assert estimate.stderr is not None
        assert abs(estimate.value - true) < 4.5 * estimate.stderr


def test_normal_incidence_exchanges_rho_and_sigma():
    where = directions(100)
    where = Directions(np.zeros(100), 0.0, where.theta_r, where.phi_r)
    found = identified(noisy("oren_nayar", {"rho": 0.3, "sigma": 0.4}, where), "oren_nayar")
    # At theta_i = 0 the model is rho A(sigma)/pi, one number for all viewing directions.
    assert found.not_identified == ("rho", "sigma")
    assert found.suggested_measurement is not None
    assert found.suggested_measurement.theta_i_deg > 0


def test_a_width_without_a_lobe_waits_for_the_lobe():
    rng = np.random.default_rng(5)
    value = 0.1 - 2e-3 * models.get("ward")(directions(200), **{**WARD, "rho_d": 0.0})
    samples = BRDFSamples(
        directions(200), value + 1e-4 * rng.standard_normal(200), u_independent=np.full(200, 1e-4)
    )
    problem = SingleProblem.from_samples(samples, models.get("ward"))
    # A lobe as wide as the hemisphere would fit better; this is the minimum beside it.
    start = problem.vector({**WARD, "rho_s": 0.0})
    found = Minimum.of(problem, minimise(problem, start, search=False))
    report = identify.identify(found)
    assert found.optimum.p[1] == 0
    assert report.not_identified == ("alpha_x", "alpha_y")
    assert report.causes[0].startswith("alpha_x has no effect while rho_s is at its bound 0: ")
    assert report.suggested_measurement is None


def test_two_terms_of_one_shape_are_named():
    where = directions(100)
    model = models.get("lambert+lambert")
    problem = SingleProblem.from_samples(noisy("lambert", {"rho": 0.4}, where), model)
    found = identify.identify(Minimum.of(problem, minimise(problem, np.array([0.2, 0.2])), 1.0))
    first, second = (q.name for q in model.parameters)
    assert found.causes == (
        f"{first} and {second} scale the same shape in these data: only their sum is determined.",
    )
    assert found.suggested_measurement is None  # nothing can


def test_everything_is_identified_where_the_hemisphere_was_seen():
    found = identified(noisy("ward", WARD, directions(300)), "ward")
    assert (found.not_identified, found.hardly_identified, found.causes) == ((), (), ())
    assert found.warnings == []
    assert np.all(np.diag(np.array(found.correlation)) == 1)


def test_the_bound_is_reached_by_least_squares_and_learns_shared_errors():
    half = np.repeat([1.0, -1.0], 150)
    lamp = SharedTerm("lamp", "a number that both halves share", relative=0.2, profile=half)
    samples = noisy("ward", WARD, directions(300), shared=(lamp,))
    problem, optimum = fitted(samples, "ward", WARD)
    alone = np.linalg.inv(information(problem, optimum.p, 1.0, shared=False))
    np.testing.assert_allclose(alone, np.linalg.inv(optimum.curvature), rtol=1e-9)
    marginal = np.linalg.inv(information(problem, optimum.p, 1.0))
    # The same with one more parameter of prior variance 1, by hand.
    f, jac = problem.jacobian(optimum.p)
    columns = np.column_stack([jac, 0.2 * half * f])
    joint = columns.T @ problem.weighted(columns) + np.diag([0, 0, 0, 0, 1.0])
    np.testing.assert_allclose(marginal, np.linalg.inv(joint)[:4, :4], rtol=1e-7)
    stated = gonio.fit(samples, model="ward").parameters["rho_d"].stderr
    assert np.sqrt(marginal[0, 0]) < stated


def test_a_profile_of_a_linear_model_is_its_parabola():
    problem, optimum = fitted(noisy("lambert", {"rho": 0.4}, directions(50)), "lambert", {})
    sd = 1 / np.sqrt(optimum.curvature[0, 0])
    points = optimum.p[0] + sd * np.array([-2.0, 0.0, 1.0, 3.0])
    growth = profile(Minimum.of(problem, optimum), 0, points) - optimum.chi2
    np.testing.assert_allclose(growth, [4, 0, 1, 9], atol=1e-6)


# ---------------------------------------------------------------- residuals


@pytest.mark.parametrize("kind", ["stated", "unstated", "shared", "understated"])
def test_right_models_raise_no_alarm(kind):
    repeats, alarms, sizes = 150, 0, 0
    where, n = directions(300, seed=8), 300
    f = models.get("lambert")(where, rho=0.5)
    group = np.repeat(np.arange(10), 30)
    shared = (SharedTerm("standard", "", relative=0.02),
              SharedTerm("lamp", "", relative=0.03, group=group))  # fmt: skip
    for k in range(repeats):
        rng = np.random.default_rng([k, len(kind)])
        sd = 0.02 * f
        value = f + sd * rng.standard_normal(n)
        if kind == "shared":
            drift = 0.03 * rng.standard_normal(10)[group]
            value = value + f * (0.02 * rng.standard_normal() + drift)
        stated = {"unstated": None, "understated": sd / 3}.get(kind, sd)
        columns = {"shared": shared} if kind == "shared" else {}
        samples = BRDFSamples(where, value, u_independent=stated, **columns)
        report = residuals.examine(Minimum.of(*fitted(samples, "lambert", {"rho": 0.5})))
        alarms += report.structured
        sizes += report.noise == "larger"
    # 1 % of the sets at most: 3 standard deviations of a count of 1.5.
    assert alarms <= 1.5 + 3 * np.sqrt(1.5)
    if kind == "understated":
        assert sizes == repeats
    else:
        assert sizes <= 1.5 + 3 * np.sqrt(1.5)


@pytest.mark.parametrize(
    ("true", "wrong"), [("ggx", "ward"), ("oren_nayar", "lambert"), ("ward", "ward_isotropic")]
)
def test_wrong_models_are_caught(true, wrong):
    truth = {q.name: q.default for q in models.get(true).parameters}
    if true == "ward":
        truth = WARD
    if true == "oren_nayar":
        truth = {"rho": 0.8, "sigma": 0.5}
    samples = noisy(true, truth, directions(500, seed=4), noise=0.02)
    report = residuals.examine(Minimum.of(*fitted(samples, wrong, truth)))
    assert report.structured
    assert report.model_share > 0.5
    assert report.warnings[0].startswith("the model, not the noise, dominates: its error makes up ")
    assert report.warnings[0].endswith(
        "The stated uncertainties hold only for the best-fitting surface of this family of models."
    )
    json.dumps(report.to_dict(), allow_nan=False)


def test_a_ring_that_is_too_bright_is_found_where_it_is():
    where = plane(400, np.radians(60.0))
    _, w_r = where.vectors()
    mirror = np.array([-np.sin(np.pi / 3), 0, 0.5])
    near = np.degrees(np.arccos(np.clip(w_r @ mirror, -1, 1))) < 6
    f = models.get("lambert")(where, rho=0.5) * np.where(near, 1.08, 1.0)
    rng = np.random.default_rng(3)
    samples = BRDFSamples(where, f * (1 + 0.01 * rng.standard_normal(400)), u_independent=0.01 * f)
    report = residuals.examine(Minimum.of(*fitted(samples, "lambert", {"rho": 0.5})))
    rings = [p for p in report.maps[RINGS] if p.z > 3]
    assert rings
    for place in rings:
        assert place.theta_i_deg == pytest.approx(60)
        assert float(place.where.split(" deg")[0].split()[-1]) <= 6
        # The fit itself rises a little with the bright ring.
        assert place.relative == pytest.approx(0.08, abs=0.015)


def test_chi_squared_that_is_too_small_is_reported():
    samples = noisy("lambert", {"rho": 0.5}, directions(200))
    boast = BRDFSamples(samples.directions, samples.value, u_independent=2 * samples.u_independent)
    report = residuals.examine(Minimum.of(*fitted(boast, "lambert", {"rho": 0.5})))
    assert report.noise == "smaller"
    assert report.noise_factor == pytest.approx(0.5, abs=0.1)
    assert "u_brdf is too large" in report.warnings[0]


@pytest.mark.parametrize("explains", [True, False])
def test_structure_is_no_alarm_where_a_stated_shared_error_makes_it(explains):
    """Of a shape that no shared error has it is one, however large the shared errors are."""
    where = directions(500, seed=4)
    shape = np.cos(3 * where.theta_r)
    f = models.get("lambert")(where, rho=0.5) * (1 + 0.02 * shape)
    rng = np.random.default_rng(3)
    value = f * (1 + 0.003 * rng.standard_normal(500))
    standard = SharedTerm("standard", "", relative=0.05, profile=shape if explains else None)
    samples = BRDFSamples(where, value, u_independent=0.003 * f, shared=(standard,))
    report = residuals.examine(Minimum.of(*fitted(samples, "lambert", {"rho": 0.5})))
    assert report.structured is not explains
    assert report.covered is explains
    assert (report.warnings == []) is explains
    assert report.line.endswith("which the stated shared errors explain") is explains


# ---------------------------------------------------------------- limits at bounds


@pytest.mark.parametrize("true", [0.0, 0.006])
def test_upper_limits_at_a_bound_hold_shared_errors(true):
    where = directions(60, seed=5)
    f = models.get("lambert")(where, rho=true)
    background = SharedTerm("background", "", offset=np.full(60, 0.004))
    held = {"alone": 0, "shared": 0}
    repeats = 60
    for k in range(repeats):
        rng = np.random.default_rng(k)
        value = f + 0.003 * rng.standard_normal(60) + 0.004 * rng.standard_normal()
        for name, shared in (("alone", ()), ("shared", (background,))):
            samples = BRDFSamples(where, value, u_independent=np.full(60, 0.003), shared=shared)
            result = gonio.fit(samples, model="lambert", threads=1)
            held[name] += true <= result.parameters["rho"].interval_95[1]
    assert held["shared"] >= 0.95 * repeats
    if true:
        assert held["alone"] < held["shared"]  # what leaving them out would claim


def test_a_limit_with_shared_errors_is_that_of_the_whole_variance():
    where = directions(100)
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(100)
    value = 0.01 * (noise - noise.mean()) / noise.std() - 0.0005
    background = SharedTerm("background", "", offset=np.full(100, 0.002))
    samples = BRDFSamples(where, value, u_independent=np.full(100, 0.01), shared=(background,))
    result = gonio.fit(samples, model="lambert")
    # By hand: mean m with variance s^2 = 0.01^2/100 + 0.002^2, grown by 3.841459 from rho = 0.
    m, s = value.mean(), np.hypot(0.001 * result.noise_scale, 0.002)
    limit = np.pi * (m + np.sqrt(m**2 + 3.841459 * s**2))
    assert result.parameters["rho"].interval_95[1] == pytest.approx(limit, rel=3e-3)


def test_sigma_of_zero_is_held_as_often_as_is_said():
    # f depends on sigma^2: the curvature at a small sigma would exclude 0 in 15 % of all sets.
    where = directions(60, seed=5)
    f = models.get("oren_nayar")(where, rho=0.6, sigma=0.0)
    repeats, held = 60, 0
    for k in range(repeats):
        value = f + 0.003 * np.random.default_rng(k).standard_normal(60)
        samples = BRDFSamples(where, value, u_independent=np.full(60, 0.003))
        low, _ = gonio.fit(samples, model="oren_nayar", threads=1).parameters["sigma"].interval_95
        held += low <= 0
    assert held >= 0.95 * repeats - 1


@pytest.mark.parametrize("name", ["ashikhmin_shirley", "ward"])
def test_few_samples_anywhere_make_a_document_without_nan(name):
    """What the curvature of few samples informs changes with its rounding."""
    truth = {
        q.name: 0.3 if q.linear else float(np.mean(q.start)) for q in models.get(name).parameters
    }
    for seed in range(6):
        rng = np.random.default_rng(seed)
        n = len(truth) + int(rng.integers(2, 12))
        theta = np.radians(rng.uniform(0, 80, (2, n)))
        phi = rng.uniform(0, 2 * np.pi, (2, n))
        where = Directions(theta[0], phi[0], theta[1], phi[1])
        f = models.get(name)(where, **truth)
        u = 0.05 * f + 0.005 * f.mean() + 1e-9
        result = gonio.fit(BRDFSamples(where, f + u * rng.standard_normal(n)), name)
        assert json.loads(result.to_json())["parameters"].keys() == truth.keys()
