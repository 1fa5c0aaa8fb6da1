"""Residuals larger than the stated noise: an error of the noise, or of the model."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hemisphere import GRID, ISOTROPIC

from gonio import models
from gonio.fitting.fit import fit
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

DARK = {"rho_d": 0.004, "rho_s": 0.05, "alpha": 0.15}


def few(n, seed=1):
    pick = np.sort(np.random.default_rng(seed).permutation(len(GRID.theta_r))[:n])
    return Directions(GRID.theta_i[pick], 0.0, GRID.theta_r[pick], GRID.phi_r[pick])


def verdict(f, noise, stated, where=GRID, seed=1):
    value = f + noise * np.random.default_rng(seed).standard_normal(len(f))
    return fit(BRDFSamples(where, value, stated * np.ones(len(f))), "ward_isotropic").verdict


@pytest.mark.parametrize("factor", [2.9, 3.1, 6.0])
def test_noise_that_is_stated_too_small_by_any_factor_is_no_error_of_the_model(factor):
    f = models.get("ward_isotropic")(GRID, **ISOTROPIC)
    found = verdict(f, 0.01 * factor * f, 0.01 * f)
    assert found.kind == "undecided"
    assert "times the stated noise but have no structure, and an error of the model" in found.reason
    assert found.useful


def test_where_samples_are_too_sparse_to_show_structure_the_stated_noise_decides():
    where = few(40)
    f = models.get("ward_isotropic")(where, **ISOTROPIC)
    found = verdict(f, 0.05 * f, 0.01 * f, where)
    assert found.kind == "does_not_fit"
    assert "if u_brdf is right; samples are too sparse to show structure" in found.reason


@pytest.mark.parametrize("where", [GRID, few(40)], ids=["dense", "sparse"])
@pytest.mark.parametrize("name", ["ward_duer", "ward_gmd"])
def test_the_nearest_wrong_models_do_not_escape(name, where):
    f = models.get(name)(where, rho_d=0.3, rho_s=0.1, alpha_x=0.2, alpha_y=0.2)
    assert verdict(f, 0.01 * f, 0.01 * f, where).kind == "does_not_fit"


def test_a_few_wrong_readings_are_counted():
    f = models.get("ward_isotropic")(GRID, **ISOTROPIC)
    f[[20, 110, 200]] *= 3
    found = verdict(f, 0.01 * f, 0.01 * f)
    assert found.kind == "does_not_fit"
    assert f"of {len(f)} samples make half of chi2" in found.reason


def test_a_floor_that_u_brdf_lacks_is_named_with_its_size():
    f = models.get("ward_isotropic")(GRID, **DARK)
    found = verdict(f, np.hypot(0.02 * f, 4e-4), 0.02 * f)
    assert found.kind == "undecided"
    assert "is all in dark readings" in found.reason
    assert "u_brdf lacks a floor of about 0.0004 sr^-1" in found.reason


def test_unstated_noise_that_would_be_unusual_is_said_with_its_size():
    f = models.get("ward_isotropic")(GRID, **ISOTROPIC)
    for noise, unusual in ((0.05, False), (0.5, True)):
        value = f * (1 + noise * np.random.default_rng(3).standard_normal(len(f)))
        found = fit(BRDFSamples(GRID, value), "ward_isotropic").verdict
        assert found.kind == "undecided"
        assert f"residuals of {100 * found.interval[1]:.2g} % of f" in found.reason
        assert ("and noise of that size would be unusual" in found.reason) is unusual
        assert found.useful


def narrow_lobe_on_a_coarse_grid():
    theta = np.radians(np.arange(0.0, 80.0, 5.0))
    theta_i, theta_r = (a.ravel() for a in np.meshgrid(np.radians([20, 40, 60]), theta))
    d = Directions(theta_i, 0.0, theta_r, np.pi)
    return d, models.get("ward_isotropic")(d, rho_d=0.3, rho_s=0.05, alpha=0.01)


@pytest.mark.parametrize("model", ["lambert", "oren_nayar"])
def test_residuals_of_many_times_f_above_zero_are_no_noise(model):
    d, f = narrow_lobe_on_a_coarse_grid()
    noise = 0.01 * np.random.default_rng(1).standard_normal(len(f))
    result = fit(BRDFSamples(d, f * (1 + noise)), model)
    assert result.verdict.kind == "does_not_fit"
    assert "noise of that size would make about " in result.verdict.reason
    assert re.search(r"of 48 readings negative, and none is; it explains ", result.verdict.reason)
    assert not result.ok


def test_noise_of_many_times_f_stays_undecided():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        f = models.get("lambert")(GRID, rho=0.3)
        result = fit(BRDFSamples(GRID, f * (1 + 5 * rng.standard_normal(len(f)))), "lambert")
        assert result.verdict.kind == "undecided"
        assert result.ok


def test_speckle_stays_undecided():
    for seed in range(5):
        speckle = np.random.default_rng(seed).exponential(size=len(GRID.theta_r))
        f = models.get("lambert")(GRID, rho=0.3)
        result = fit(BRDFSamples(GRID, f * speckle), "lambert")
        assert result.verdict.kind == "undecided"
        assert result.ok


def test_a_place_is_named_only_where_the_error_is_larger_than_it_typically_is():
    phong = models.get("phong")(GRID, rho_d=0.3, rho_s=0.1, n=20.0)
    found = verdict(phong, 0.01 * phong, 0.01 * phong)
    assert abs(found.most) > found.typical_misfit
    waves = 1 + 0.1 * np.sin(9 * GRID.theta_r)
    f = models.get("ward_isotropic")(GRID, **ISOTROPIC)
    found = verdict(f * waves, 0.002 * f, 0.002 * f)
    assert found.kind == "does_not_fit"
    assert found.most is None or abs(found.most) > found.typical_misfit


def test_a_tail_that_the_model_lacks_is_no_missing_floor():
    ward = models.get("ward_isotropic")
    f = ward(GRID, **DARK) + ward(GRID, rho_d=0.0, rho_s=0.02, alpha=0.6)
    assert verdict(f, 0.02 * f, 0.02 * f).kind == "does_not_fit"


def test_structure_below_noise_that_is_stated_too_large_names_the_noise():
    f = models.get("ward_isotropic")(GRID, **ISOTROPIC)
    found = verdict(f * (1 + 0.01 * np.sin(4 * GRID.theta_r)), 0.01 * f, 0.04 * f)
    assert found.kind == "undecided"
    assert re.search(
        r"residuals are only 0\.\d+ times the stated noise and yet have structure: u_brdf is too "
        r"large, and may hide an error of the model of up to",
        found.reason,
    )
    assert "of 0 %" not in found.reason
