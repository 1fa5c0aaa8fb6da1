"""Tests of the residuals for errors of the model: level, power, shared errors, kinds of problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hemisphere import INCIDENCE, ISOTROPIC, grid, noisy
from scipy import stats

from gonio import models
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.joint import find_joint_minimum
from gonio.fitting.minimum.nuisance import profiled
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.shared_columns import shared_columns
from gonio.fitting.residual_tests.misfit import misfit_test
from gonio.fitting.residual_tests.model_errors import FACTOR, SMOOTH, smooth_columns
from gonio.fitting.residual_tests.quadratic_forms import combined, upper_tail
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm


def chances(name, samples_of, runs):
    return np.array([
        misfit_test(find_minimum(samples_of(np.random.default_rng(k)), models.get(name))).p
        for k in range(runs)
    ])  # fmt: skip


def in_range(count, runs, chance):
    """Whether a count lies within the 99.9 % range of its binomial law."""
    low, high = stats.binom.interval(0.999, runs, chance)
    return low <= count <= high


# ---------------------------------------------------------------- quadratic forms


def test_the_saddlepoint_agrees_with_draws():
    rng = np.random.default_rng(1)
    counts = np.array([1.0, 1.0, 1.0, 9.0])
    for last in (-0.4, -1.5):
        weights = np.array([3.0, 1.0, 0.2, last])
        draws = rng.chisquare(counts, (400_000, 4)) @ weights
        assert upper_tail(weights, counts) == pytest.approx(np.mean(draws > 0), rel=0.04)


def test_the_saddlepoint_is_that_of_fisher_far_in_the_tail():
    for p in (0.5, 0.01, 1e-6, 1e-12):
        f = stats.f.isf(p, 4, 60)
        found = upper_tail(np.array([1 / 4, -f / 60]), np.array([4.0, 60.0]))
        assert found == pytest.approx(p, rel=0.02)


def test_one_clear_component_is_not_outweighed_by_p_values_near_one():
    assert combined([1e-4, 1.0, 1.0, 1.0]) < 0.01
    assert combined([1e-300, 0.5]) < 1e-200


def test_smooth_columns_have_the_covariance_they_stand_for():
    x = np.linspace(0, 1, 25)
    columns = smooth_columns([x], {SMOOTH: ((40,), 0.15)}).full(SMOOTH)
    distance = np.sqrt(3) * np.abs(x[:, None] - x) / 0.15
    matern = (1 + distance) * np.exp(-distance)
    assert np.max(np.abs(columns @ columns.T - matern)) < 0.06


# ---------------------------------------------------------------- level


@pytest.mark.parametrize("stated", [True, False])
def test_true_models_are_rejected_at_the_stated_level(stated):
    """p is uniform under a true model, with stated noise and with noise that follows f unstated."""
    p = chances("lambert", lambda rng: noisy(rng, stated=stated), 120)
    for level in (0.01, 0.05, 0.5):
        assert in_range(np.sum(p < level), 120, level)


def test_the_level_holds_for_a_lobe_with_unknown_noise():
    p = chances(
        "ward_isotropic", lambda rng: noisy(rng, "ward_isotropic", ISOTROPIC, stated=False), 60
    )
    for level in (0.05, 0.5):
        assert in_range(np.sum(p < level), 60, level)


def test_the_level_holds_where_few_samples_are_left():
    where = grid((30,), 12, (0,))
    p = chances("lambert", lambda rng: noisy(rng, where=where), 120)
    for level in (0.05, 0.5):
        assert in_range(np.sum(p < level), 120, level)


def test_fewer_than_eight_degrees_of_freedom_decide_nothing():
    samples = noisy(np.random.default_rng(1), where=grid((30,), 8, (0,)))
    assert misfit_test(find_minimum(samples, models.get("lambert"))) is None


def test_a_million_samples_are_thinned():
    where = grid((5, 25, 45, 65), 250, np.arange(0, 360, 1.44))
    samples = noisy(np.random.default_rng(1), where=where)
    found = misfit_test(find_minimum(samples, models.get("lambert")))
    assert found.n_all == len(samples) == 250_000
    assert 4_000 < found.n <= 5_000
    assert not found.structured


# ---------------------------------------------------------------- power


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("wrong", ["ward_duer", "phong"])
def test_a_wrong_lobe_is_found(wrong, stated):
    samples = noisy(np.random.default_rng(1), "ward_isotropic", ISOTROPIC, stated=stated)
    assert misfit_test(find_minimum(samples, models.get(wrong))).p < 1e-10


def test_a_factor_of_each_incidence_is_found_and_named():
    factors = np.array([0.02, -0.01, 0.015, -0.02])[INCIDENCE]
    samples = noisy(np.random.default_rng(1), error=factors)
    found = misfit_test(find_minimum(samples, models.get("lambert")))
    assert found.p < 1e-6
    assert min(found.components, key=found.components.get) in (FACTOR, SMOOTH)
    assert found.components[FACTOR] < 1e-6


# ---------------------------------------------------------------- shared errors


def with_lamp(rng, *, u=0.03):
    """A lamp that drifts by 3 % between incidences, as its term says or as `u` says."""
    lamp = SharedTerm("lamp", "", u, group=INCIDENCE)
    return replace(noisy(rng, error=0.03 * rng.standard_normal(4)[INCIDENCE]), shared=(lamp,))


def test_shared_errors_as_large_as_stated_are_no_misfit():
    p = chances("lambert", with_lamp, 80)
    for level in (0.05, 0.5):
        assert in_range(np.sum(p < level), 80, level)


def test_without_their_statement_shared_errors_are_misfit():
    minimum = find_minimum(with_lamp(np.random.default_rng(1)), models.get("lambert"))
    assert misfit_test(minimum, shared=False).p < 1e-6


def test_shared_errors_much_larger_than_stated_are_misfit():
    samples = with_lamp(np.random.default_rng(1), u=0.002)
    assert misfit_test(find_minimum(samples, models.get("lambert"))).p < 1e-4


# ---------------------------------------------------------------- kinds of problem


def test_profiled_shared_errors_are_no_misfit():
    lambert = models.get("lambert")
    p = []
    for k in range(60):
        minimum = find_minimum(with_lamp(np.random.default_rng(k)), lambert)
        p.append(misfit_test(profiled(minimum, ("lamp",))).p)
    for level in (0.05, 0.5):
        assert in_range(np.sum(np.array(p) < level), 60, level)


BRUSHED = {"rho_d": 0.1, "rho_s": 0.05, "alpha_x": 0.08, "alpha_y": 0.2}


def turned():
    """Samples of a brushed surface that lay turned by 2 deg, of which their term tells."""
    turn, where = np.radians(2), grid((15, 35, 55), 20, np.arange(0, 360, 30))
    ward = models.get("ward")
    rng = np.random.default_rng(3)
    moved = Directions(where.theta_i, where.phi_i - turn, where.theta_r, where.phi_r - turn)
    sd = 0.01 * ward(where, **BRUSHED)
    value = ward(moved, **BRUSHED) + sd * rng.standard_normal(len(sd))
    return BRDFSamples(where, value, sd, shared=(SharedTerm("azimuth", "", turn=np.radians(1)),))


def test_a_fit_with_profiled_errors_has_turns_in_its_residuals():
    """A turn that the fit does not profile changes the samples as it does without profiling."""
    lamp = SharedTerm("standard", "", 0.01)
    samples = turned()
    samples = replace(samples, shared=(*samples.shared, lamp))
    minimum = find_minimum(samples, models.get("ward"))
    fit = profiled(minimum, ("standard",))
    p = minimum.optimum.p
    plain = shared_columns(minimum.problem, p, minimum.problem.values(p)).toarray()[:, 0]
    found = shared_columns(fit.problem, p, fit.problem.values(p)).toarray()[:, 0]
    scale = fit.problem.factor
    np.testing.assert_allclose(found, plain * scale, atol=1e-6 * np.max(plain))
    assert np.max(np.abs(plain)) > 0


def test_a_turn_that_is_stated_is_no_misfit():
    minimum = find_minimum(turned(), models.get("ward"))
    assert misfit_test(minimum, shared=False).structured
    assert not misfit_test(minimum).structured
    assert not misfit_test(profiled(minimum, ("azimuth",))).structured


def test_fixed_parameters_are_not_projected_out():
    samples = noisy(np.random.default_rng(2), "ward_isotropic", ISOTROPIC)
    ward = models.get("ward_isotropic")
    right = find_minimum(samples, ward, constraints=Constraints.of(ward, {"alpha": 0.2}, {}))
    wrong = find_minimum(samples, ward, constraints=Constraints.of(ward, {"alpha": 0.19}, {}))
    assert misfit_test(right).p > 0.01
    assert misfit_test(wrong).p < 1e-6


def materials(rng, seconds):
    return {
        "a": noisy(rng, "ward_isotropic", ISOTROPIC),
        "b": noisy(rng, "ward_isotropic", seconds, sd=0.02),
    }


def test_a_joint_fit_of_true_parts_has_no_structure_and_a_wrong_sharing_has():
    ward = models.get("ward_isotropic")
    same = {"rho_d": 0.1, "rho_s": 0.05, "alpha": 0.2}
    rng = np.random.default_rng(4)
    right = find_joint_minimum(materials(rng, same), ward, ["alpha"]).whole
    found = misfit_test(right)
    assert found.p > 0.01
    assert len(found.parts) == 2
    other = find_joint_minimum(materials(rng, {**same, "alpha": 0.25}), ward, ["alpha"]).whole
    assert misfit_test(other).p < 1e-6
