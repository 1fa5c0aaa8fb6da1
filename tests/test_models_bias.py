"""What one Oren-Nayar variant makes of another: fitted biases and relative differences.

Parameters of one variant are not those of another; here it stands by how much. The truth is the
integral, `oren_nayar_numeric`, without noise.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from gonio import models
from gonio.geometry import Directions

DEG = np.pi / 180

# --- parameters -----------------------------------------------------------------------------------

# sigma and rho of the truth, then as each approximation finds them, with the rms of the relative
# residuals in per cent.
FITTED = [
    ((20, 0.80), "oren_nayar", (18.1, 0.802, 3.3)),
    ((30, 0.90), "oren_nayar", (25.7, 0.890, 2.2)),
    ((42, 0.75), "oren_nayar", (32.8, 0.715, 2.4)),
    ((20, 0.80), "oren_nayar_qualitative", (24.9, 0.831, 9.7)),
    ((30, 0.90), "oren_nayar_qualitative", (44.4, 1.008, 11.6)),
]


def plane(limit: int) -> Directions:
    """theta_i 30, 45 and 60 deg, theta_r to both sides in the plane of incidence in steps of 5."""
    theta_i, theta_r = np.meshgrid([30, 45, 60], np.arange(-limit, limit + 1, 5))
    theta_i, theta_r = theta_i.ravel() * DEG, theta_r.ravel() * DEG
    return Directions(theta_i, 0.0, np.abs(theta_r), np.where(theta_r < 0, np.pi, 0.0))


def fitted(name: str, where: Directions, f: np.ndarray, start=(25.0, 0.8)) -> tuple[float, ...]:
    """sigma in degrees, rho, and the rms of the relative residuals in per cent; no bounds."""
    model, pairs = models.get(name), where.vectors()

    def residual(x):
        return model.evaluate(*pairs, np.array([x[1], x[0] * DEG])) / f - 1

    found = least_squares(residual, start, x_scale=(10, 0.1), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    # f depends on sigma^2 only.
    return abs(found.x[0]), found.x[1], 100 * np.sqrt(np.mean(found.fun**2))


@cache
def truth(sigma: float, rho: float, limit: int = 80) -> np.ndarray:
    return models.get("oren_nayar_numeric")(plane(limit), rho=rho, sigma=sigma * DEG)


@pytest.mark.parametrize(("true", "name", "expected"), FITTED)
def test_parameters_of_one_variant_are_not_those_of_another(true, name, expected):
    found = fitted(name, plane(80), truth(*true))
    assert found[0] == pytest.approx(expected[0], abs=0.051)
    assert found[1] == pytest.approx(expected[1], abs=5.1e-4)
    assert found[2] == pytest.approx(expected[2], abs=0.051)


@pytest.mark.parametrize("start", [(5.0, 0.8), (60.0, 1.0), (100.0, 1.0)])
def test_the_sketch_of_a_very_rough_surface_runs_out_of_its_range(start):
    """B has nearly reached its limit of 0.45: beyond 60 deg sigma tells nothing."""
    sigma, rho, rms = fitted("oren_nayar_qualitative", plane(80), truth(42, 0.75), start)
    assert sigma == pytest.approx(131.5, abs=0.1)
    assert rho == pytest.approx(0.906, abs=5.1e-4)
    assert rms == pytest.approx(12.7, abs=0.051)
    sigma_max = models.get("oren_nayar_qualitative").parameter("sigma").upper / DEG
    assert sigma > 2 * sigma_max


@pytest.mark.parametrize(
    ("true", "sigma"), [((20, 0.80), 15.5), ((30, 0.90), 23.1), ((42, 0.75), 31.7)]
)
def test_the_bias_moves_with_the_range_of_the_data(true, sigma):
    found = fitted("oren_nayar", plane(60), truth(*true, 60))
    assert found[0] == pytest.approx(sigma, abs=0.051)


@pytest.mark.parametrize("true", [(20, 0.80), (42, 0.75)])
def test_a_variant_finds_its_own_parameters_again(true):
    for name in ("oren_nayar", "oren_nayar_qualitative"):
        f = models.get(name)(plane(80), rho=true[1], sigma=true[0] * DEG)
        found = fitted(name, plane(80), f)
        np.testing.assert_allclose(found[:2], true, rtol=1e-6)


# --- values ---------------------------------------------------------------------------------------

# sigma, largest theta, rho or part, and the largest and mean difference from the integral in per
# cent; `test_oren_nayar_numeric.py` holds further ones.
FUNCTIONAL = [
    (10, 75, "total", 24, 1.4),
    (10, 85, "total", 180, 3.3),
    (10, 75, "direct", 23, 1.8),
    (10, 75, "twice", 39, 17),
    (60, 60, "total", 24, 3.4),
    (60, 85, "total", 55, 6.0),
    (60, 75, "direct", 88, 4.9),
    (60, 75, "twice", 204, 25),
]
QUALITATIVE = [
    (10, 60, 0.9, 5.4, 3.0),
    (10, 75, 0.9, 41, 3.4),
    (10, 75, 0.3, 46, 2.5),
    (30, 60, 0.9, 23, 11),
    (30, 75, 0.9, 79, 11),
    (30, 75, 0.3, 162, 8.6),
    (60, 60, 0.9, 24, 13),
    (60, 75, 0.9, 47, 13),
    (60, 75, 0.3, 179, 11),
]


def parts(name: str, sigma: float, theta_max: float) -> tuple[np.ndarray, np.ndarray]:
    """f for rho = 1 of light that bounced once and twice, over polar angles and azimuths."""
    theta = np.array([t for t in (0, 15, 30, 45, 60, 75, 85) if t <= theta_max]) * DEG
    theta_i, theta_r, dphi = np.meshgrid(theta, theta, np.arange(0, 181, 30) * DEG, indexing="ij")
    where = Directions(theta_i, 0.0, theta_r, dphi)
    # f = rho a + rho^2 b: two values of rho part them.
    full, half = (models.get(name)(where, rho=rho, sigma=sigma * DEG) for rho in (1.0, 0.5))
    return 4 * half - full, 2 * full - 4 * half


def assert_off(f: np.ndarray, exact: np.ndarray, largest: float, average: float) -> None:
    """Figures are told in whole per cents, or in tenths below 10."""
    off = 100 * np.abs(f / exact - 1)
    assert off.max() == pytest.approx(largest, abs=0.51 if largest >= 10 else 0.051)
    assert off.mean() == pytest.approx(average, abs=0.51 if average >= 10 else 0.051)


@pytest.mark.parametrize(("sigma", "theta_max", "part", "largest", "average"), FUNCTIONAL)
def test_how_far_the_functional_model_is_off(sigma, theta_max, part, largest, average):
    once, twice = parts("oren_nayar", sigma, theta_max)
    exact_once, exact_twice = parts("oren_nayar_numeric", sigma, theta_max)
    f, exact = {
        "direct": (once, exact_once),
        "twice": (twice, exact_twice),
        "total": (0.9 * once + 0.81 * twice, 0.9 * exact_once + 0.81 * exact_twice),
    }[part]
    assert_off(f, exact, largest, average)


@pytest.mark.parametrize(("sigma", "theta_max", "rho", "largest", "average"), QUALITATIVE)
def test_how_far_the_qualitative_model_is_off(sigma, theta_max, rho, largest, average):
    f = rho * parts("oren_nayar_qualitative", sigma, theta_max)[0]
    once, twice = parts("oren_nayar_numeric", sigma, theta_max)
    assert_off(f, rho * once + rho**2 * twice, largest, average)


@pytest.mark.parametrize(
    ("sigma", "largest", "rms"), [(10, 0.162, 0.022), (30, 0.174, 0.026), (60, 0.172, 0.044)]
)
def test_the_error_of_the_functional_model_in_units_of_lambert(sigma, largest, rms):
    f, exact = (
        0.9 * once + 0.81 * twice
        for once, twice in (parts(n, sigma, 75) for n in ("oren_nayar", "oren_nayar_numeric"))
    )
    error = np.abs(f - exact) * np.pi / 0.9
    assert error.max() == pytest.approx(largest, abs=6e-4)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(rms, abs=6e-4)
