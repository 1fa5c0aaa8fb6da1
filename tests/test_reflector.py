"""Ward's eq. (3): the mapping itself, its inverse, its Jacobian, and what it leaves out."""

import math

import numpy as np
import pytest
from eq3_theory import mapping_error

from gonio.calibration.reflector import (
    camera_angles,
    reflected_angles,
    solid_angle_ratio,
)
from gonio.errors import ConfigurationError
from gonio.geometry import angles, hemisphere_quadrature, unit_vectors
from gonio.instrument import Dome

SIZES = [(150.0, 3.0), (150.0, 15.0), (300.0, 45.0)]


def directions(seed: int, n: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """The whole hemisphere, the zenith and the horizon included."""
    rng = np.random.default_rng(seed)
    theta = np.concatenate([[0.0, 0.0, np.pi / 2, np.pi / 2], np.arccos(rng.uniform(0, 1, n))])
    phi = np.concatenate([[0.0, 2.0, 1.0, -1.5], rng.uniform(-np.pi, np.pi, n)])
    return theta, phi


def printed_equation_3(theta_c: float, phi_c: float, R: float, D: float) -> tuple[float, float]:
    """Eq. (3) letter by letter (Ward 1992, p. 267), atan2 for the quadrant."""
    sin, cos = math.sin, math.cos
    r_c = D * sin(phi_c) * sin(theta_c) + math.sqrt(
        D**2 * sin(phi_c) ** 2 * sin(theta_c) ** 2 + R**2 - D**2
    )
    theta_r = math.acos(
        r_c
        * cos(theta_c)
        / math.sqrt(
            r_c**2 * cos(phi_c) ** 2 * sin(theta_c) ** 2
            + (r_c * sin(phi_c) * sin(theta_c) - 2 * D) ** 2
            + r_c**2 * cos(theta_c) ** 2
        )
    )
    phi_r = math.atan2(r_c * sin(phi_c) * sin(theta_c) - 2 * D, r_c * cos(phi_c) * sin(theta_c))
    return theta_r, phi_r


@pytest.mark.parametrize(("R", "D"), SIZES)
def test_reflected_angles_are_the_printed_equation(R, D):
    theta_c, phi_c = directions(1)
    theta_r, phi_r = reflected_angles(theta_c, phi_c, R=R, D=D)
    expected = [printed_equation_3(t, p, R, D) for t, p in zip(theta_c, phi_c, strict=True)]
    # acos keeps 8 digits near 0, where the formula is ill-conditioned; directions, not angles,
    # are compared because phi means nothing at the zenith.
    got, want = unit_vectors(theta_r, phi_r), unit_vectors(*np.array(expected).T)
    np.testing.assert_allclose(got, want, atol=3e-8)
    far = theta_r > 0.1
    np.testing.assert_allclose(got[far], want[far], atol=1e-13)


def test_a_camera_at_the_target_sees_its_own_angles():
    theta_c, phi_c = directions(2)
    theta_r, phi_r = reflected_angles(theta_c, phi_c, R=150.0, D=0.0)
    # hypot and atan2 of an exact unit vector: a few units in the last place.
    np.testing.assert_allclose(theta_r, theta_c, atol=1e-15)
    np.testing.assert_allclose(
        unit_vectors(theta_r, phi_r), unit_vectors(theta_c, phi_c), atol=1e-15
    )
    np.testing.assert_allclose(solid_angle_ratio(theta_c, phi_c, R=150.0, D=0.0), 1, rtol=1e-15)


@pytest.mark.parametrize(("R", "D"), SIZES)
def test_the_inverse_leads_back(R, D):
    theta, phi = directions(3)
    start = unit_vectors(theta, phi)
    there = reflected_angles(theta, phi, R=R, D=D)
    np.testing.assert_allclose(unit_vectors(*camera_angles(*there, R=R, D=D)), start, atol=1e-14)
    back = camera_angles(theta, phi, R=R, D=D)
    np.testing.assert_allclose(unit_vectors(*reflected_angles(*back, R=R, D=D)), start, atol=1e-14)


def test_the_horizon_stays_the_horizon():
    phi = np.linspace(-np.pi, np.pi, 37)
    theta_r, _ = reflected_angles(np.pi / 2, phi, R=150.0, D=15.0)
    # Camera and target lie in the plane of the horizon.
    np.testing.assert_allclose(theta_r, np.pi / 2, atol=1e-15)


@pytest.mark.parametrize(("R", "D"), SIZES)
def test_the_jacobian_is_the_ratio_of_small_areas(R, D):
    theta, phi = directions(4, 100)
    theta = np.minimum(theta, 1.5)  # central differences need room before the horizon
    w = unit_vectors(theta, phi)
    e1 = np.cross(w, np.where(np.abs(w[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(w, e1)
    h = 1e-3

    def mapped(offset: np.ndarray) -> np.ndarray:
        return unit_vectors(*reflected_angles(*angles(w + offset), R=R, D=D))

    def derivative(e: np.ndarray) -> np.ndarray:
        # Five-point rule: error h^4 f'''''/30 ~ 1e-12, rounding 1e-16/h ~ 1e-13.
        return (8 * (mapped(h * e) - mapped(-h * e)) - mapped(2 * h * e) + mapped(-2 * h * e)) / (
            12 * h
        )

    area = np.linalg.norm(np.cross(derivative(e1), derivative(e2)), axis=1)
    np.testing.assert_allclose(solid_angle_ratio(theta, phi, R=R, D=D), area, rtol=1e-10)


@pytest.mark.parametrize(("R", "D"), SIZES)
def test_the_camera_hemisphere_covers_the_sample_hemisphere(R, D):
    theta, phi, weight = hemisphere_quadrature(64, 128)
    ratio = solid_angle_ratio(theta, phi, R=R, D=D)
    # Gauss rules converge geometrically for a smooth integrand.
    assert np.sum(ratio * weight) == pytest.approx(2 * np.pi, rel=1e-12)


def test_a_narrower_lens_covers_what_its_edge_encloses():
    R, D, edge = 150.0, 15.0, np.radians(85)
    theta, phi, weight = hemisphere_quadrature(64, 128, theta_max=edge)
    covered = np.sum(solid_angle_ratio(theta, phi, R=R, D=D) * weight)
    # Solid angle inside the mapped edge: the line integral of (1 - cos theta_r) dphi_r. The
    # trapezoid rule's error is (2 pi / n)^2 times a factor of order 1.
    n = 40_000
    theta_r, phi_r = reflected_angles(edge, np.linspace(0, 2 * np.pi, n + 1), R=R, D=D)
    height = 1 - np.cos(theta_r)
    enclosed = np.sum((height[1:] + height[:-1]) / 2 * np.diff(np.unwrap(phi_r)))
    assert covered == pytest.approx(enclosed, abs=(2 * np.pi / n) ** 2)
    assert covered < 2 * np.pi * (1 - np.cos(np.radians(86)))  # at most 86.0 deg are reached


@pytest.mark.parametrize("function", [reflected_angles, camera_angles, solid_angle_ratio])
@pytest.mark.parametrize("D", [150.0, 200.0, -15.0, math.nan])
def test_a_camera_outside_the_dome_is_refused(function, D):
    message = r"D = .* mm with R = 150 mm: the camera must sit inside the dome, 0 <= D < R\."
    with pytest.raises(ConfigurationError, match=message):
        function(0.3, 0.2, R=150.0, D=D)


def test_the_sign_of_D_matters():
    """A picture drawn with y up is like D -> -D: directions off by about 4 D/R."""
    theta_c, phi_c = directions(5)
    right = unit_vectors(*reflected_angles(theta_c, phi_c, R=150.0, D=15.0))
    wrong = unit_vectors(*camera_angles(theta_c, phi_c, R=150.0, D=15.0))
    off = np.degrees(np.arccos(np.clip(np.sum(right * wrong, axis=1), -1, 1)))
    assert 15 < np.median(off) < 4 * np.degrees(0.1)


@pytest.mark.parametrize("shape", ["sphere", "ellipsoid"])
def test_what_eq_3_leaves_out_is_known_to_leading_order(shape):
    R, D = 150.0, 3.0
    theta_c, phi_c, _ = hemisphere_quadrature(24, 48, theta_max=np.radians(80))
    by_eq_3 = unit_vectors(*reflected_angles(theta_c, phi_c, R=R, D=D))
    exact = unit_vectors(*Dome(shape=shape, R=R, D=D).reflected_angles(theta_c, phi_c))
    stated = mapping_error(by_eq_3, R=R, D=D, shape=shape)
    largest = np.max(np.linalg.norm(stated, axis=1))
    # The next order is smaller by D/R = 0.02, with a factor of a few.
    difference = np.linalg.norm(exact - by_eq_3 - stated, axis=1)
    assert np.max(difference) < 5 * (D / R) * largest
    if shape == "sphere":
        assert largest == pytest.approx((D / R) ** 2, rel=0.01)  # at gamma = 45 deg
