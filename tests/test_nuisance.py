"""Shared errors as unknowns of the fit: against explicit least squares, limits, and coverage."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares
from virtual import images, small

import gonio
from gonio import cli, models
from gonio.calibration.effects import azimuth
from gonio.errors import ConfigurationError
from gonio.fitting.minimum.derivative_check import gradient_faults
from gonio.fitting.problem.nuisance import NuisanceProblem
from gonio.fitting.problem.nuisance_names import parse_names, profiled_terms
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.result import FitResult, NuisanceEstimate
from gonio.fitting.uncertainty.nuisance import PULL, pull_warnings
from gonio.geometry import Directions, angles, rotated, unit_vectors
from gonio.instrument.images import Fixed, Images
from gonio.instrument.realisation import Realisation
from gonio.metadata import Limits, Plan
from gonio.samples import BRDFSamples, Cells, SharedTerm

BRUSHED = {"rho_d": 0.1, "rho_s": 0.05, "alpha_x": 0.04, "alpha_y": 0.11}
TRUE = np.array(list(BRUSHED.values()))
ISOTROPIC = {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.3}
U_STANDARD, U_LAMP, U_AZIMUTH = 0.02, 0.01, np.radians(0.5)
TERMS = ("standard", "lamp", "azimuth")


def lobe(n=900, seed=1, incidences=(10, 25, 40, 55), rotations=(0, 45, 90)):
    """Directions about the lobe and over the hemisphere, frame of the sample, with incidences."""
    rng = np.random.default_rng(seed)
    each = n // (len(incidences) * len(rotations))
    w_i, w_r, incidence = [], [], []
    for k, theta in enumerate(np.radians(incidences)):
        for psi in np.radians(rotations):
            light = unit_vectors(theta, 0.0)
            spread = np.where(rng.random((4 * each, 1)) < 0.7, 0.1, 0.6)
            slope = spread * rng.standard_normal((4 * each, 2))
            h = np.concatenate([slope, np.ones((4 * each, 1))], axis=1)
            h /= np.linalg.norm(h, axis=1, keepdims=True)
            out = 2 * (h @ light)[:, None] * h - light
            out = out[out[:, 2] > 0.2][:each]
            w_i.append(rotated(np.tile(light, (len(out), 1)), psi))
            w_r.append(rotated(out, psi))
            incidence.append(np.full(len(out), k))
    return map(np.concatenate, (w_i, w_r, incidence))


def budget(incidence):
    """A standard of 2 %, a lamp that drifts by 1 % between incidences, an azimuth to 0.5 deg."""
    return (
        SharedTerm("standard", "", U_STANDARD),
        SharedTerm("lamp", "", U_LAMP, group=incidence),
        SharedTerm("azimuth", "", turn=U_AZIMUTH),
    )


def measured(seed=1, n=900, noise=0.01, draws=None, **kept):
    """Samples of a brushed surface with a draw of every error, and these draws."""
    w_i, w_r, incidence = lobe(n, seed=1, **kept)
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(2 + incidence.max() + 1) if draws is None else np.asarray(draws)
    ward = models.get("ward")
    turned = [np.ascontiguousarray(rotated(w, z[-1] * U_AZIMUTH)) for w in (w_i, w_r)]
    factor = 1 + U_STANDARD * z[0] + U_LAMP * z[1:-1][incidence]
    # The noise is stated as it is: 1 % of the surface's own f.
    sd = 0.01 * ward.evaluate(w_i, w_r, TRUE) + 1e-6
    value = ward.evaluate(*turned, TRUE) * factor + noise / 0.01 * sd * rng.standard_normal(len(sd))
    where = Directions(*angles(w_i), *angles(w_r))
    return BRDFSamples(where, value, u_independent=sd, shared=budget(incidence)), z


def joint_reference(samples, expectation, n_z, start):
    """Parameters and draws by scipy, every draw a parameter with a prior of its own."""

    def residual(x):
        p, z = x[: len(start)], x[len(start) :]
        return np.concatenate([(samples.value - expectation(p, z)) / samples.u_independent, z])

    found = least_squares(
        residual, np.concatenate([start, np.zeros(n_z)]), jac="3-point",
        x_scale=np.concatenate([start, np.ones(n_z)]), xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac))), 2 * found.cost


def learnt(samples, model="ward", names="all", **options):
    return gonio.fit(samples, model=model, nuisance=names, threads=1, **options)


def by_name(result, name):
    return [e for e in result.nuisance if e.name == name]


# -------------------------------------------------- the same as all unknowns written out


def test_marginalised_draws_are_those_of_one_large_least_squares():
    samples, _ = measured()
    w_i, w_r = samples.directions.vectors()
    group = samples.shared[1].group
    ward = models.get("ward")

    def expectation(p, z):
        turned = [np.ascontiguousarray(rotated(w, z[5] * U_AZIMUTH)) for w in (w_i, w_r)]
        return ward.evaluate(*turned, p) * (1 + U_STANDARD * z[0] + U_LAMP * z[1:5][group])

    x, sd, chi2 = joint_reference(samples, expectation, 6, TRUE)
    result = learnt(samples)
    values = [e.value for e in result.parameters.values()]
    np.testing.assert_allclose(values, x[:4], rtol=1e-6)
    np.testing.assert_allclose([e.estimate for e in result.nuisance], x[4:], atol=1e-4)
    assert result.chi2 == pytest.approx(chi2, rel=1e-6)
    np.testing.assert_allclose([e.stderr for e in result.nuisance], sd[4:], rtol=1e-4)
    stderr = [e.stderr for e in result.parameters.values()]
    np.testing.assert_allclose(np.array(stderr) / result.noise_scale, sd[:4], rtol=1e-2)
    assert [e.group for e in result.nuisance] == [None, 0, 1, 2, 3, None]


def test_shifts_and_offsets_and_profiles_as_well():
    w_i, w_r, incidence = lobe(600)
    tangent = np.cross(w_r, [0.0, 1.0, 0.0])
    # A fifth of the lobe's width: far from linear.
    shift = 0.016 * tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    profile = w_r[:, 2] ** 2
    terms = (
        SharedTerm("mapping", "", shift=shift),
        SharedTerm(
            "lamp", "", 0.02, group=incidence, profile=profile, offset=np.full(len(w_r), 2e-4)
        ),
    )
    z_true = np.array([1.3, 0.5, -1.0, 1.5, 0.2])
    ward = models.get("ward")

    def expectation(p, z):
        moved = w_r + z[0] * shift
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        f = ward.evaluate(w_i, moved, p)
        return f * (1 + 0.02 * profile * z[1:][incidence]) + 2e-4 * z[1:][incidence]

    sd = 0.01 * expectation(TRUE, 0 * z_true) + 1e-5
    value = expectation(TRUE, z_true) + sd * np.random.default_rng(2).standard_normal(len(sd))
    samples = BRDFSamples(
        Directions(*angles(w_i), *angles(w_r)), value, u_independent=sd, shared=terms
    )
    x, sd, _ = joint_reference(samples, expectation, 5, TRUE)
    result = learnt(samples)
    off = np.array([e.value for e in result.parameters.values()]) - x[:4]
    assert np.max(np.abs(off) / sd[:4]) < 0.01
    np.testing.assert_allclose([e.estimate for e in result.nuisance], x[4:], atol=1e-3)


def test_the_parts_of_a_joint_fit_share_a_lamp():
    rng = np.random.default_rng(3)
    n, true = 200, np.array([0.3, 0.6])
    channel = np.repeat(["red", "blue"], n)
    where = Directions(*np.full((4, 2 * n), 0.3))
    rho = np.repeat(true, n)
    sd = np.full(2 * n, 1e-3)
    group = np.tile(np.repeat([0, 1], n // 2), 2)
    terms = (SharedTerm("lamp", "", 0.05, group=group),)
    value = rho / np.pi * (1 + 0.05 * np.array([1.0, -0.4])[group]) + sd * rng.standard_normal(
        2 * n
    )
    samples = BRDFSamples(where, value, u_independent=sd, channel=channel, shared=terms)

    def expectation(p, z):
        return np.repeat(p, n) / np.pi * (1 + 0.05 * z[group])

    x, errors, _ = joint_reference(samples, expectation, 2, true)
    result = gonio.fit(samples, model="lambert", share=[], nuisance="all", threads=1)
    # Every part has a noise scale of its own, a few per cent from 1.
    for name, value, u in zip(("red", "blue"), x, errors, strict=False):
        estimate = result.parameters[f"rho[{name}]"]
        assert abs(estimate.value - value) < 0.02 * u
        assert estimate.stderr == pytest.approx(u, rel=0.05)
    np.testing.assert_allclose([e.estimate for e in result.nuisance], x[2:], atol=0.03)


def test_the_inverse_covariance_is_the_dense_one():
    samples, _ = measured(n=120)
    problem = NuisanceProblem.of(SingleProblem.from_samples(samples, models.get("ward")), TERMS)
    problem = problem.reweighted(TRUE).reweighted(TRUE)
    u = problem.basis.toarray()
    dense = np.diag(1 / problem.inverse_variance) + u @ u.T / problem.noise**2
    columns = np.random.default_rng(1).standard_normal((problem.n, 3))
    np.testing.assert_allclose(
        problem.weighted(columns), np.linalg.solve(dense, columns), rtol=1e-8
    )
    r = samples.value - problem.values(TRUE) + u @ problem.z0
    chi2, g, h = problem.normal_equations(TRUE)
    _, jac = problem.jacobian(TRUE)
    assert chi2 == pytest.approx(r @ np.linalg.solve(dense, r), rel=1e-9)
    assert problem.chi2(TRUE) == pytest.approx(chi2, rel=1e-12)
    some = TRUE * np.array([[1.0], [1.02]])
    np.testing.assert_allclose(
        problem.batch_chi2(some), [problem.chi2(p) for p in some], rtol=1e-12
    )
    np.testing.assert_allclose(g, jac.T @ np.linalg.solve(dense, r), rtol=1e-6, atol=1e-6 * chi2)
    np.testing.assert_allclose(h, jac.T @ np.linalg.solve(dense, jac), rtol=1e-7)
    # Some samples alone know the same draws.
    some = problem.at(np.arange(0, problem.n, 2))
    np.testing.assert_array_equal(some.values(TRUE), problem.values(TRUE)[::2])
    dense = dense[::2, ::2]
    assert some.chi2(TRUE) == pytest.approx(r[::2] @ np.linalg.solve(dense, r[::2]), rel=1e-9)
    assert not gradient_faults(problem, TRUE)


# ----------------------------------------------------------------------------- limits


def test_without_a_prior_spread_it_is_the_ordinary_fit():
    samples, _ = measured(draws=np.zeros(6))
    none = tuple(replace(t, relative=t.relative * 1e-9, turn=t.turn * 1e-9) for t in samples.shared)
    samples = replace(samples, shared=none)
    ordinary, held = gonio.fit(samples, model="ward"), learnt(samples)
    for name, estimate in ordinary.parameters.items():
        assert held.parameters[name].value == pytest.approx(estimate.value, rel=1e-8)
        assert held.parameters[name].stderr == pytest.approx(estimate.stderr, rel=1e-5)
    for e in held.nuisance:
        assert abs(e.estimate) < 1e-5
        assert e.stderr == pytest.approx(1, abs=1e-6)


def test_a_scale_that_nobody_knows_leaves_rho_undetermined():
    where = Directions(*np.full((4, 100), 0.4))
    rng = np.random.default_rng(4)
    value = 0.1 + 1e-3 * rng.standard_normal(100)
    terms = (SharedTerm("standard", "", 50.0),)
    samples = BRDFSamples(where, value, u_independent=np.full(100, 1e-3), shared=terms)
    result = learnt(samples, "lambert")
    rho = result.parameters["rho"]
    assert (rho.stderr, rho.interval_95) == (None, None)
    assert (
        "rho is not determined by these data: its value is arbitrary and it has no uncertainty; "
        "measure other directions or use a simpler model." in result.warnings
    )


def test_two_readings_with_a_common_factor_meet_between_them():
    # Peelle's puzzle: 1.5 and 1.0 to 10 % each and 20 % together. With the common covariance
    # from the readings least squares gives 0.88, below both.
    y = np.array([0.15, 0.10])
    own, common = 0.1 * y, 0.2
    from_data = np.diag(own**2) + common**2 * np.outer(y, y)
    ones = np.linalg.solve(from_data, np.ones(2))
    assert ones @ y / ones.sum() == pytest.approx(0.0882, abs=1e-4)
    where = Directions(*np.full((4, 2), 0.4))
    terms = (SharedTerm("standard", "", common),)
    result = learnt(BRDFSamples(where, y, u_independent=own, shared=terms), "lambert")
    mean = np.sum(y / own**2) / np.sum(1 / own**2)
    assert result.parameters["rho"].value == pytest.approx(np.pi * mean, rel=1e-6)


def test_a_drift_by_groups_is_the_model_of_random_effects():
    counts, sd, drift = np.array([5, 20, 80, 320]), 2e-3, 0.03
    group = np.repeat(np.arange(4), counts)
    rng = np.random.default_rng(5)
    f = 0.1 * (1 + drift * rng.standard_normal(4)[group])
    value = f + sd * rng.standard_normal(len(group))
    where = Directions(*np.full((4, len(group)), 0.3))
    terms = (SharedTerm("lamp", "", drift, group=group),)
    samples = BRDFSamples(where, value, u_independent=np.full(len(group), sd), shared=terms)
    rho = learnt(samples, "lambert").parameters["rho"]
    means = np.bincount(group, value) / counts
    level = 0.1
    for _ in range(50):  # the drift is a part of the model's value
        weight = 1 / (sd**2 / counts + (drift * level) ** 2)
        level = np.sum(weight * means) / np.sum(weight)
    # The value is linear in the factor, whose draws then scale the weights a little: second order.
    assert rho.value == pytest.approx(np.pi * level, rel=2e-3)
    assert rho.stderr == pytest.approx(np.pi / np.sqrt(np.sum(weight)), rel=0.05)
    ordinary = gonio.fit(samples, model="lambert").parameters["rho"]
    # Without, the largest group decides, and its drift is the uncertainty.
    assert rho.stderr < 0.75 * ordinary.stderr


def test_a_large_turn_is_taken_as_a_turn_and_not_as_a_slope():
    # Three standard uncertainties, 1.5 deg, without noise.
    samples, z = measured(noise=0.0, draws=[0, 0, 0, 0, 0, 3.0])
    result = learnt(samples, names=["azimuth"])
    for name, true in BRUSHED.items():
        # A prior of mean 0 holds the draw back by its sd squared.
        assert result.parameters[name].value == pytest.approx(true, rel=2e-4)
    (azimuth,) = result.nuisance
    assert azimuth.estimate == pytest.approx(z[-1], rel=2e-3)
    assert azimuth.stderr < 0.05


# -------------------------------------------------------------- what data can tell


def test_the_turn_of_an_isotropic_surface_stays_as_the_prior_says():
    w_i, w_r, incidence = lobe(300)
    where = Directions(*angles(w_i), *angles(w_r))
    f = models.get("ward_isotropic")(where, **ISOTROPIC)
    sd = 0.01 * f
    value = f + sd * np.random.default_rng(6).standard_normal(len(f))
    samples = BRDFSamples(where, value, u_independent=sd, shared=budget(incidence))
    result = learnt(samples, "ward_isotropic")
    (azimuth,) = by_name(result, "azimuth")
    assert abs(azimuth.estimate) < 1e-6
    assert azimuth.stderr == pytest.approx(1, abs=1e-6)
    assert not result.warnings


def test_nor_can_a_lone_plane_of_incidence_tell_it():
    theta_r = np.radians(np.linspace(-75, 75, 120))
    where = Directions(np.full(120, 0.5), 0.0, np.abs(theta_r), np.where(theta_r < 0, 0, np.pi))
    f = models.get("ward")(where, **BRUSHED)
    samples = BRDFSamples(
        where, f, u_independent=0.01 * f, shared=(SharedTerm("azimuth", "", turn=U_AZIMUTH),)
    )
    result = learnt(samples)
    (azimuth,) = result.nuisance
    assert abs(azimuth.estimate) < 1e-3
    assert azimuth.stderr == pytest.approx(1, abs=1e-2)
    assert result.parameters["alpha_y"].interval_95 is None


def test_sources_add_up_whether_learnt_or_propagated():
    samples, _ = measured()
    for names in ("all", ["azimuth"], ["lamp", "azimuth"]):
        result = learnt(samples, names=names)
        for j, estimate in enumerate(result.parameters.values()):
            assert set(estimate.components) == {"independent", *TERMS}
            squares = sum(u**2 for u in estimate.components.values())
            assert estimate.stderr == pytest.approx(np.sqrt(squares), rel=1e-9)
            assert estimate.stderr**2 == pytest.approx(result.covariance[j][j], rel=1e-9)


def test_what_is_not_learnt_moves_the_parameters_as_a_refit_does():
    samples, _ = measured(noise=0.0, draws=np.zeros(6))
    result = learnt(samples, names=["lamp"])
    # A true error of one standard uncertainty of the standard, and of the lamp's first draw.
    moved = learnt(replace(samples, value=samples.value * (1 + U_STANDARD)), names=["lamp"])
    for name in BRUSHED:
        change = moved.parameters[name].value - result.parameters[name].value
        expected = result.parameters[name].components["standard"]
        # The weights stay: the stated noise is the same.
        assert abs(change) == pytest.approx(expected, rel=0.02, abs=1e-7)


def test_learning_narrows_what_propagation_states():
    samples, _ = measured()
    ordinary, held = gonio.fit(samples, model="ward"), learnt(samples)
    for name in ("alpha_x", "alpha_y"):
        assert held.parameters[name].stderr < 0.8 * ordinary.parameters[name].stderr
    for name in ("rho_d", "rho_s"):
        # Nothing but the certificate knows the scale.
        assert held.parameters[name].components["standard"] == pytest.approx(
            U_STANDARD * held.parameters[name].value, rel=0.05
        )
    (standard,) = by_name(held, "standard")
    assert standard.stderr > 0.99


def test_residuals_larger_than_stated_widen_the_priors_share():
    honest, _ = measured()
    boast = replace(honest, u_independent=honest.u_independent / 5)
    a, b = learnt(honest), learnt(boast)
    assert b.noise_scale == pytest.approx(5 * np.sqrt(a.chi2 / a.dof), rel=0.02)
    for name in BRUSHED:
        assert b.parameters[name].stderr == pytest.approx(
            a.parameters[name].stderr * b.noise_scale / 5, rel=0.05
        )
    for one, other in zip(a.nuisance, b.nuisance, strict=True):
        assert other.estimate == pytest.approx(one.estimate, abs=0.05)


def test_noise_of_unknown_size_is_found_beside_the_draws():
    samples, _ = measured()
    ward = models.get("ward")
    f = ward(samples.directions, **BRUSHED)
    rng = np.random.default_rng(7)
    factor = 1 + U_LAMP * np.array([1.5, -1.0, 0.5, -2.0])[samples.shared[1].group]
    value = f * factor + 0.02 * rng.standard_normal(len(f))
    stated = replace(samples, value=value, u_independent=np.full(len(f), 0.02))
    unstated = replace(stated, u_independent=None)
    a, b = learnt(stated), learnt(unstated)
    assert b.weights == "none"
    assert b.noise_scale == pytest.approx(0.02 * np.sqrt(a.chi2 / a.dof), rel=2e-2)
    for one, other in zip(a.nuisance, b.nuisance, strict=True):
        assert other.estimate == pytest.approx(one.estimate, abs=0.05)


# ----------------------------------------------------------------------- pulls and names


def test_a_budget_that_is_too_small_is_reported():
    samples, _ = measured(draws=[0.5, 1.0, -8.0, 6.0, 0.5, -9.0])
    warnings = learnt(samples).warnings
    (azimuth,) = (w for w in warnings if "'azimuth'" in w)
    assert azimuth.startswith("the data pull the shared error 'azimuth' to -9.0 of its standard ")
    assert azimuth.endswith(
        "uncertainties: the budget is too small for it, or the model is wrong and this error makes "
        "up for it."
    )
    (lamp,) = (w for w in warnings if "'lamp'" in w)
    assert "'lamp' (draw 1) to -" in lamp


def test_many_honest_draws_are_no_reason_to_warn():
    rng = np.random.default_rng(8)
    found = [
        NuisanceEstimate("lamp", k, float(z), 0.1) for k, z in enumerate(rng.standard_normal(2000))
    ]
    assert max(abs(e.estimate) for e in found) > PULL
    assert pull_warnings(found) == []
    assert pull_warnings([NuisanceEstimate("lamp", 1, 3.2, 0.1)])
    # What the data do not know cannot pull.
    assert pull_warnings([NuisanceEstimate("standard", None, 0.5, 0.999)]) == []


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["standart"], r"nuisance 'standart' is not a shared error of these samples; give "
         r"all, none, or some of: standard; lamp; azimuth\."),
        ("lamps", "nuisance 'lamps' is not a shared error"),
    ],
)  # fmt: skip
def test_unknown_names(names, message):
    samples, _ = measured(n=120)
    with pytest.raises(ConfigurationError, match=message):
        gonio.fit(samples, model="ward", nuisance=names)


def test_samples_without_shared_errors():
    samples = replace(measured(n=120)[0], shared=())
    with pytest.raises(ConfigurationError, match="state no shared errors that a fit could profile"):
        gonio.fit(samples, model="ward", nuisance="all")
    assert gonio.fit(samples, model="ward", nuisance="none").nuisance == ()


def test_a_family_of_names():
    terms = tuple(SharedTerm(n, "", 0.01) for n in ("geometry, mode 1", "lamp", "geometry, mode 2"))
    where = Directions(*np.full((4, 3), 0.1))
    samples = BRDFSamples(where, np.ones(3), shared=terms)
    assert profiled_terms(samples, parse_names("geometry")) == (
        "geometry, mode 1",
        "geometry, mode 2",
    )
    assert profiled_terms(samples, parse_names("lamp,geometry, mode 2")) == (
        "lamp",
        "geometry, mode 2",
    )


def test_a_typical_shape_is_not_learnt():
    samples, _ = measured(n=240)
    standard, lamp, azimuth = samples.shared
    slope = replace(lamp, name="dome slope, shift", typical=True)
    samples = replace(samples, shared=(standard, slope, azimuth))
    assert {e.name for e in learnt(samples).nuisance} == {"standard", "azimuth"}
    for name in ("dome slope, shift", "dome slope"):
        with pytest.raises(
            ConfigurationError,
            match=f"the shared error '{name}' is only a typical shape of an error of many shapes: "
            "it is propagated and cannot be profiled; others can: standard; azimuth",
        ):
            profiled_terms(samples, [name])
    # It is propagated through the fit with the others learnt.
    held = learnt(samples, names=["azimuth"]).parameters["rho_d"]
    assert held.components["dome slope, shift"] > 0.003 * held.value


def test_the_result_keeps_the_draws(tmp_path):
    result = learnt(measured(n=240)[0])
    result.save(tmp_path / "fit.json")
    assert FitResult.load(tmp_path / "fit.json").nuisance == result.nuisance


# ------------------------------------------------------------------------------ posterior


def test_the_posterior_of_a_linear_model_has_the_marginal_covariance():
    rng = np.random.default_rng(9)
    group = np.repeat([0, 1, 2], [20, 60, 120])
    where = Directions(*np.full((4, 200), 0.3))
    terms = (
        SharedTerm("lamp", "", 0.02, group=group),
        SharedTerm("room", "", offset=np.full(200, 5e-4)),
    )
    value = 0.1 * (1 + 0.02 * rng.standard_normal(3)[group]) + 1e-3 * rng.standard_normal(200)
    samples = BRDFSamples(where, value, u_independent=np.full(200, 1e-3), shared=terms)
    for names, propagated in (("all", False), (["lamp"], True)):
        result = learnt(samples, "lambert", names, posterior=True, seed=1)
        rho = result.parameters["rho"]
        # By hand: the dense covariance, with U at the fitted value.
        f = np.full(200, rho.value / np.pi)
        u = 0.02 * f[:, None] * (group[:, None] == np.arange(3))
        dense = np.eye(200) * (1e-3 * result.noise_scale) ** 2 + u @ u.T
        room = np.full(200, 5e-4)
        if not propagated:
            dense += np.outer(room, room)
        gain = np.linalg.solve(dense, np.ones(200)) * np.pi
        gain /= np.sum(np.linalg.solve(dense, np.ones(200)))
        variance = gain @ dense @ gain + propagated * (gain @ room) ** 2
        sd = np.sqrt(variance)
        assert rho.stderr == pytest.approx(sd, rel=0.02)
        assert rho.value == pytest.approx(gain @ value, abs=0.05 * sd)
        low, high = rho.interval_95
        assert (high - low) / (2 * 1.96) == pytest.approx(sd, rel=0.08)
        assert (high + low) / 2 == pytest.approx(rho.value, abs=0.1 * sd)


# ------------------------------------------------------------------------------- coverage


def test_intervals_hold_the_truth_with_shared_errors_learnt():
    repeats = 60
    hits, pulls = dict.fromkeys(BRUSHED, 0), []
    for k in range(repeats):
        samples, z = measured(seed=100 + k, n=360)
        result = learnt(samples)
        pulls += [(e.estimate - t) / e.stderr for e, t in zip(result.nuisance, z, strict=True)]
        for q in models.get("ward").parameters:
            low, high = result.parameters[q.name].interval_95
            hits[q.name] += low <= BRUSHED[q.name] <= high
    for name, count in hits.items():
        # 3 standard deviations of a binomial count.
        assert count / repeats >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / repeats), name
    # The draws are where they are said to be; 360 of them, correlated six by six.
    assert np.std(pulls) == pytest.approx(1, abs=0.15)


# ------------------------------------------------------- the azimuth, from frames to terms


def test_a_turn_takes_both_directions_along():
    w_i, w_r, _ = lobe(60)
    where = Directions(*angles(w_i), *angles(w_r))
    term = SharedTerm("azimuth", "", turn=0.01)
    assert term.moves_directions
    samples = BRDFSamples(where, np.ones(len(w_i)), shared=(term,))
    problem = SingleProblem.from_samples(samples, models.get("ward"))
    from gonio.fitting.problem.shared_change import shared_change

    change = shared_change(problem, term, TRUE, problem.values(TRUE))
    seen = [
        models.get("ward")(
            Directions(where.theta_i, where.phi_i - s, where.theta_r, where.phi_r - s), **BRUSHED
        )
        for s in (0.01, -0.01)
    ]
    np.testing.assert_allclose(change, (seen[0] - seen[1]) / 2, rtol=1e-9, atol=1e-14)


def test_a_turn_survives_the_file(tmp_path):
    where = Directions(*np.full((4, 3), 0.1))
    cells = Cells(np.tile(unit_vectors(0.1, 0.1), (3, 1)), np.ones(3), np.arange(4))
    terms = (SharedTerm("azimuth", "", turn=0.02), SharedTerm("slope", "", 0.1, typical=True))
    BRDFSamples(where, np.ones(3), shared=terms, cells=cells).save(tmp_path / "samples.nc")
    assert BRDFSamples.load(tmp_path / "samples.nc").shared == terms


def test_the_stated_azimuth_becomes_a_term_and_the_unstated_one_is_named():
    def terms(limits):
        return list(azimuth.terms(SimpleNamespace(metadata=SimpleNamespace(limits=limits))))

    assert terms(Limits()) == terms(Limits(u_azimuth_deg=0.0)) == []
    (term,) = terms(Limits(u_azimuth_deg=0.5))
    assert (term.name, term.group) == ("azimuth", None)
    assert term.turn == pytest.approx(np.radians(0.5))


def test_the_simulated_sample_lies_turned():
    rig = small(n=24)
    plan = Plan(theta_i_deg=(40.0,), rotations_deg=(10.0,), exposures_s=(0.01,))
    scene = images(rig, plan, "ward", **BRUSHED)
    off = Fixed(scene.fixed.dome_seed, scene.fixed.pattern_seed, azimuth=np.radians(5.0))
    turned = Images(rig, scene.surface, plan, off)
    further = images(rig, plan.model_copy(update={"rotations_deg": (15.0,)}), "ward", **BRUSHED)
    at = ("sample", 0, 0, [1.0])
    np.testing.assert_allclose(turned.rates(*at)[0], further.rates(*at)[0], rtol=1e-12)
    assert not np.allclose(turned.rates(*at)[0], scene.rates(*at)[0], rtol=1e-3)
    standard = ("standard", 0, 0, [1.0])
    np.testing.assert_array_equal(turned.rates(*standard)[0], scene.rates(*standard)[0])


def test_the_azimuths_error_is_drawn_and_disturbs_no_other_draw():
    plan = Plan(theta_i_deg=(40.0,), rotations_deg=(10.0,), exposures_s=(0.01,))
    known, unsure = small("modern12"), small("modern12", holder={"u_azimuth_deg": 0.5})
    drawn = [Realisation.from_seed(k, unsure, plan) for k in range(300)]
    offsets = np.degrees([d.azimuth for d in drawn])
    assert np.std(offsets) == pytest.approx(0.5, rel=0.15)
    assert abs(np.mean(offsets)) < 0.1
    before = Realisation.from_seed(7, known, plan)
    assert before.azimuth == 0
    np.testing.assert_array_equal(before.lamp, drawn[7].lamp)
    assert replace(drawn[7], azimuth=0.0, lamp=None) == replace(before, lamp=None)
    given = small("modern12", holder={"azimuth_deg": 2.0})
    assert Realisation.from_seed(7, given, plan).azimuth == pytest.approx(np.radians(2.0))


# --------------------------------------------------------------------------- command line


def test_the_command_line_tells_what_was_learnt(tmp_path, capsys):
    path = tmp_path / "samples.nc"
    measured(n=240)[0].save(path)
    with pytest.raises(SystemExit) as left:
        cli.main(["fit", str(path), "--model", "ward", "--nuisance", "standard,azimuth"])
    out = capsys.readouterr().out
    assert left.value.code == 0
    assert "profiled shared errors, in units of their stated standard uncertainty" in out
    assert "  standard " in out
    assert "  azimuth " in out
    assert "  lamp " not in out
    with pytest.raises(SystemExit) as left:
        cli.main(["fit", str(path), "--model", "ward", "--nuisance", "dome"])
    assert left.value.code == 2
    assert "Error: nuisance 'dome' is not a shared error" in capsys.readouterr().err
