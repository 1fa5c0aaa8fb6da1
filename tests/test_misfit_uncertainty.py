"""Uncertainties under misfit: textbook formulas, coverage, and where nothing may change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import gonio
from gonio import models
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.residual_tests.misfit import misfit_test
from gonio.fitting.result import FitResult
from gonio.fitting.uncertainty.at_minimum import honest_uncertainties, uncertainties
from gonio.fitting.uncertainty.clustered import by_groups
from gonio.fitting.uncertainty.degrees_of_freedom import Spread
from gonio.fitting.uncertainty.incidence_groups import incidence_groups
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.larger_of import larger_of
from gonio.fitting.uncertainty.sample_jackknife import by_samples
from gonio.fitting.uncertainty.second_derivatives import SecondDerivatives
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

ISOTROPIC = {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.3}


def over_incidences(n_incidences=6, n=40, seed=1):
    """Directions at some incidences over the hemisphere."""
    rng = np.random.default_rng(seed)
    theta_i = np.radians(np.repeat(np.linspace(5, 60, n_incidences), n))
    theta_r = np.arccos(rng.uniform(0.3, 1, len(theta_i)))
    return Directions(theta_i, 0.0, theta_r, rng.uniform(0, 2 * np.pi, len(theta_i)))


def noisy(where, seed=2, *, noise=0.01, factor=None, stated=True, proportional=False, **truth):
    """Ward's isotropic lobe with noise and a factor of each sample."""
    f = models.get("ward_isotropic")(where, **(truth or ISOTROPIC))
    sd = noise * (f if proportional else np.full(len(f), f.mean()))
    value = f * (1.0 if factor is None else factor)
    value = value + sd * np.random.default_rng(seed).standard_normal(len(f))
    return BRDFSamples(where, value, u_independent=sd if stated else None)


def wrong_scale(where, seed, sd=0.05):
    """A factor of each incidence."""
    group = np.unique(where.theta_i, return_inverse=True)[1]
    return 1 + sd * np.random.default_rng(seed).standard_normal(group.max() + 1)[group]


def bent(where, seed=3, stated=True):
    """A surface that Ward's isotropic model does not fit."""
    f = models.get("ggx")(where, rho_d=0.2, k_s=0.5, alpha_x=0.3, alpha_y=0.3, eta=1.5, kappa=0.5)
    sd = np.full(len(f), 0.01 * f.mean())
    value = f + sd * np.random.default_rng(seed).standard_normal(len(f))
    return BRDFSamples(where, value, u_independent=sd if stated else None)


@pytest.fixture(scope="module")
def misfit():
    """A minimum where the model does not hold."""
    return find_minimum(bent(over_incidences(), stated=False), models.get("ward_isotropic"))


@pytest.fixture(scope="module")
def linear():
    """A minimum in two amplitudes, with its whitened derivatives and residuals."""
    where = over_incidences()
    data = noisy(where, factor=wrong_scale(where, 5))
    minimum = find_minimum(data, models.get("ward_isotropic"))
    free = minimum.optimum.free.copy()
    free[2] = False  # alpha is held: the model is linear in the others
    minimum = minimum.at(minimum.problem, replace(minimum.optimum, free=free))
    p = minimum.optimum.p
    root = np.sqrt(minimum.problem.inverse_variance)
    f, jacobian = minimum.problem.jacobian(p)
    return minimum, root[:, None] * jacobian[:, :2], root * (data.value - f)


# ------------------------------------------------------------------ formulas


def test_of_a_linear_model_samples_give_the_textbooks_hc3(linear):
    minimum, x, z = linear
    bread = np.linalg.inv(x.T @ x)
    h = np.einsum("ij,jk,ik->i", x, bread, x)
    meat = (x * (z / (1 - h))[:, None] ** 2).T @ x
    informed = Informed.of(minimum)
    for second in (None, SecondDerivatives(minimum)):
        spread = by_samples(informed, second)
        np.testing.assert_allclose(spread.covariance[:2, :2], bread @ meat @ bread, rtol=1e-6)


def test_of_a_linear_model_groups_give_the_textbooks_cr3(linear):
    minimum, x, z = linear
    bread = np.linalg.inv(x.T @ x)
    group = incidence_groups(minimum.problem)
    total = np.zeros((2, 2))
    for g in np.unique(group):
        own = x[group == g]
        rest = np.eye(len(own)) - own @ bread @ own.T
        change = bread @ own.T @ np.linalg.solve(rest, z[group == g])
        total += np.outer(change, change)
    spread, lone = by_groups(Informed.of(minimum), group)
    np.testing.assert_allclose(spread.covariance[:2, :2], total, rtol=1e-6)
    assert np.all(lone < 0.5)


def test_degrees_of_freedom_are_those_of_the_dense_form(linear):
    minimum, x, _ = linear
    bread = np.linalg.inv(x.T @ x)
    hat = x @ bread @ x.T
    number = Informed.of(minimum).effective_samples
    for j in range(2):
        a = (x @ bread)[:, j] / (1 - np.diag(hat))
        form = a[:, None] * (np.eye(len(a)) - hat) * a
        assert number[j] == pytest.approx(np.trace(form) ** 2 / np.sum(form**2), rel=1e-6)


def test_leaving_a_sample_out_is_a_refit_without_it():
    samples = bent(over_incidences(n=250), stated=False)
    misfit = find_minimum(samples, models.get("ward_isotropic"))
    rows = []
    for k in range(0, len(samples), 50):
        rest = samples.select(np.delete(np.arange(len(samples)), k), "one less")
        rows.append(find_minimum(rest, misfit.problem.model).optimum.p - misfit.optimum.p)
    refits = np.array(rows)
    every = np.zeros(len(samples), bool)
    every[::50] = True
    spread = by_samples(Informed.of(misfit), SecondDerivatives(misfit), every)
    np.testing.assert_allclose(
        np.sqrt(np.diag(spread.covariance)), np.sqrt(np.diag(refits.T @ refits)), rtol=0.05
    )


def test_the_larger_of_two_covariances_does_not_depend_on_how_parameters_are_written():
    rng = np.random.default_rng(1)
    a, b, turn = (rng.standard_normal((3, 3)) for _ in range(3))
    first, second = (Spread(m @ m.T, np.full(3, 5.0)) for m in (a, b))
    both = larger_of(first, second).covariance
    turned = larger_of(
        *(Spread(turn @ s.covariance @ turn.T, s.dof) for s in (first, second))
    ).covariance
    np.testing.assert_allclose(turned, turn @ both @ turn.T, rtol=1e-8)
    for spread in (first, second):
        assert np.all(np.linalg.eigvalsh(both - spread.covariance) > -1e-10)


def test_angles_in_other_units_and_another_order_change_nothing(misfit):
    samples = misfit.problem.samples
    order = np.random.default_rng(1).permutation(len(samples))
    other = find_minimum(samples.select(order, "shuffled"), misfit.problem.model)
    errors = [honest_uncertainties(m, misfit_test(m))[0] for m in (misfit, other)]
    assert errors[0].allowance is not None
    np.testing.assert_allclose(errors[1].covariance, errors[0].covariance, rtol=1e-4)
    np.testing.assert_allclose(errors[1].dof, errors[0].dof, rtol=1e-4)


def test_a_file_that_holds_its_samples_twice_is_no_better():
    data = bent(over_incidences(), stated=False)
    once = gonio.fit(data, model="ward_isotropic")
    twice = gonio.fit(
        data.select(np.tile(np.arange(len(data)), 2), "twice"), model="ward_isotropic"
    )
    for name, e in once.parameters.items():
        assert twice.parameters[name].stderr == pytest.approx(e.stderr, rel=1e-6)


# ------------------------------------------------------------------ when it is on


@pytest.mark.parametrize("stated", [True, False])
def test_where_the_model_fits_nothing_changes(stated):
    for seed in range(8):
        minimum = find_minimum(
            noisy(over_incidences(), seed, stated=stated), models.get("ward_isotropic")
        )
        test = misfit_test(minimum)
        if test is not None and test.p < 0.01:
            continue  # once in a hundred
        before, after = uncertainties(minimum)[0], honest_uncertainties(minimum, test)[0]
        if after.allowance is None:
            np.testing.assert_array_equal(after.covariance, before.covariance)
        else:  # of noise that follows f, once in a hundred
            assert not stated


def test_a_scale_error_of_each_incidence_is_covered():
    hits = dict.fromkeys(ISOTROPIC, 0)
    runs = 60
    for seed in range(runs):
        where = over_incidences(seed=seed)
        data = noisy(where, 100 + seed, factor=wrong_scale(where, seed))
        result = gonio.fit(data, model="ward_isotropic", threads=1)
        for name, true in ISOTROPIC.items():
            low, high = result.parameters[name].interval_95
            hits[name] += low <= true <= high
    for count in hits.values():
        assert stats.binom.cdf(count, runs, 0.95) > 0.005


def test_noise_that_follows_the_value_and_that_nobody_stated_is_covered():
    hits = dict.fromkeys(ISOTROPIC, 0)
    runs = 80
    for seed in range(runs):
        data = noisy(over_incidences(seed=seed), seed, noise=0.03, stated=False, proportional=True)
        result = gonio.fit(data, model="ward_isotropic", threads=1)
        for name, true in ISOTROPIC.items():
            low, high = result.parameters[name].interval_95
            hits[name] += low <= true <= high
    for count in hits.values():
        assert stats.binom.cdf(count, runs, 0.95) > 0.005


def test_stated_shared_errors_that_explain_the_residuals_leave_them_alone():
    where = over_incidences()
    group = np.unique(where.theta_i, return_inverse=True)[1]
    lamp = SharedTerm("lamp", "output at each incidence", relative=0.05, group=group)
    data = noisy(where, factor=wrong_scale(where, 7))
    alone = gonio.fit(data, model="ward_isotropic")
    explained = gonio.fit(replace(data, shared=(lamp,)), model="ward_isotropic")
    assert alone.diagnostics["allowance"] is not None
    assert explained.diagnostics["allowance"] is None
    assert explained.parameters["rho_d"].dof is None


def test_never_below_the_stated_noise(misfit):
    data = bent(over_incidences())
    minimum = find_minimum(data, models.get("ward_isotropic"))
    errors, _ = honest_uncertainties(minimum, misfit_test(minimum))
    noise = Informed.of(minimum).of_noise()
    assert np.all(np.linalg.eigvalsh(errors.covariance - noise) > -1e-12)


# ------------------------------------------------------------------ what is said


def test_the_result_says_that_and_how_misfit_is_allowed_for(tmp_path):
    result = gonio.fit(bent(over_incidences(), stated=False), model="ward_isotropic")
    assert "intervals allow for misfit (p < 1e-06): each sample and each of 6 incidences" in str(
        result
    )
    for e in result.parameters.values():
        low, high = e.interval_95
        assert e.dof is not None
        assert (high - low) / 2 == pytest.approx(stats.t.ppf(0.975, e.dof) * e.stderr, rel=1e-6)
    result.save(tmp_path / "fit.json")
    assert FitResult.load(tmp_path / "fit.json").parameters == result.parameters
    there = Directions(0.3, 0.0, 0.3, np.pi)
    by_noise = gonio.fit(noisy(over_incidences(), stated=False), model="ward_isotropic")
    assert result.predict(there).u > by_noise.predict(there).u


@pytest.mark.parametrize(("n", "words"), [(1, "one incidence cannot"), (2, "2 incidences cannot")])
def test_one_or_two_incidences_cannot_speak_for_others(n, words):
    data = bent(over_incidences(n, 150), stated=False)
    result = gonio.fit(data, model="ward_isotropic")
    assert result.diagnostics["allowance"]["basis"] == "samples"
    assert any(words in text for text in result.warnings)


def test_the_posterior_agrees_with_the_interval_and_says_so(tmp_path):
    import arviz

    data = bent(over_incidences(), stated=False)
    path = tmp_path / "draws.nc"
    plain = gonio.fit(data, model="ward_isotropic")
    result = gonio.fit(data, model="ward_isotropic", posterior=True, seed=1, draws=path)
    assert result.posterior.allowance.startswith("draws are spread so that their intervals allow")
    assert arviz.from_netcdf(path).posterior.attrs["allowance"] == result.posterior.allowance
    for name, e in plain.parameters.items():
        widths = [np.diff(each.parameters[name].interval_95)[0] for each in (plain, result)]
        assert widths[1] == pytest.approx(widths[0], rel=0.25)
        low, high = result.parameters[name].interval_95
        assert low <= e.value <= high


def test_joint_fits_count_one_misfit_of_all_parts_once():
    where = over_incidences()
    parts = {str(k): bent(where, seed=k, stated=False) for k in range(4)}
    alone = gonio.fit(parts["0"], model="ward_isotropic")
    joint = gonio.fit(parts, model="ward_isotropic", share="alpha")
    assert joint.diagnostics["allowance"]["basis"] == "samples and incidences"
    # Four parts with the same misfit tell no more of alpha than one.
    assert joint.parameters["alpha"].stderr > 0.8 * alone.parameters["alpha"].stderr


def test_nuisance_fits_allow_for_misfit_beside_their_shared_errors():
    term = SharedTerm("standard", "reflectance of the standard", relative=0.02)
    data = replace(bent(over_incidences()), shared=(term,))
    propagated = gonio.fit(data, model="ward_isotropic")
    profiled = gonio.fit(data, model="ward_isotropic", nuisance="all")
    assert profiled.diagnostics["allowance"]["basis"] == "samples and incidences"
    for name, e in propagated.parameters.items():
        assert profiled.parameters[name].stderr == pytest.approx(e.stderr, rel=0.1)


# ------------------------------------------------------------------ what carries a parameter


def test_a_lobe_that_three_samples_saw_is_not_established():
    theta_i = np.radians(np.repeat([10.0, 30.0, 50.0], 9))
    theta_r = np.radians(np.tile(np.arange(0.0, 81.0, 10.0), 3))
    where = Directions(theta_i, 0.0, theta_r, np.pi)
    truth = {"rho_d": 0.06, "rho_s": 0.006, "alpha": 0.03}
    data = noisy(where, noise=0.003, proportional=True, **truth)
    result = gonio.fit(data, model="ward_isotropic")
    assert not result.parameters["alpha"].established
    assert "not established" in str(result)
    (text,) = [w for w in result.warnings if w.startswith("alpha is not established")]
    assert "effective samples carry it, where 10 establish it" in text
    support = result.diagnostics["support"]["alpha"]
    first = support["samples"][0]
    assert (
        f"theta_i {np.degrees(theta_i[first]):.3g}, theta_r {np.degrees(theta_r[first]):.3g}"
        in text
    )
    assert support["effective_samples"] < 10
    assert len(support["samples"]) == 3


def test_a_lobe_that_many_samples_saw_is_established():
    result = gonio.fit(noisy(over_incidences()), model="ward_isotropic")
    assert all(e.established for e in result.parameters.values())
    assert result.diagnostics["support"]["alpha"]["effective_samples"] > 10


def test_the_sensitivity_to_angles_is_that_of_refits():
    where = over_incidences()
    data = noisy(where, noise=1e-4, alpha=0.1, rho_d=0.3, rho_s=0.1)
    result = gonio.fit(data, model="ward_isotropic")
    rng = np.random.default_rng(1)
    u = np.radians(0.1)
    moved = []
    for _ in range(60):
        _, w = where.vectors()
        w = np.broadcast_to(w, (len(data), 3)) + u * rng.standard_normal((len(data), 3))
        w /= np.linalg.norm(w, axis=1, keepdims=True)
        there = replace(where, theta_r=np.arccos(w[:, 2]), phi_r=np.arctan2(w[:, 1], w[:, 0]))
        other = BRDFSamples(there, data.value, u_independent=data.u_independent)
        moved.append(gonio.fit(other, model="ward_isotropic", threads=1).parameters["alpha"].value)
    stated = result.diagnostics["support"]["alpha"]["moved_by_angles"]
    assert np.std(moved) == pytest.approx(stated, rel=0.35)
