"""The dome's exact trace against independent solutions, and eq. (3) against the trace."""

from types import MappingProxyType

import numpy as np
import pytest
from eq3_theory import mapping_error
from scipy.optimize import brentq, root

from gonio.calibration.reflector import (
    camera_angles,
    reflected_angles,
)
from gonio.geometry import angles, hemisphere_quadrature, unit_vectors
from gonio.instrument import Dome

R = 150.0


def dome(shape, ratio, **slopes):
    return Dome(shape=shape, R=R, D=ratio * R, **slopes)


def angle_between(a, b):
    """Angle between unit vectors, radians, exact for small ones."""
    return 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1))


def solid_angle_at_sample(shape, ratio, theta_c, phi_c):
    """dOmega_r / dOmega_c of the exact trace, by central differences."""
    w_c = unit_vectors(theta_c, phi_c)
    e1 = unit_vectors(theta_c + np.pi / 2, phi_c)
    e2 = np.cross(w_c, e1)
    h = 1e-5

    def change(e):
        ends = [
            unit_vectors(*dome(shape, ratio).reflected_angles(*angles(w_c + step * e)))
            for step in (-h, h)
        ]
        return (ends[1] - ends[0]) / (2 * h)

    return np.linalg.norm(np.cross(change(e1), change(e2)), axis=-1)


def ellipsoid_direction_at_camera(w_r, D):
    """Closed form: the polar equation of the ellipsoid about its focus T."""
    r_t = R**2 / (np.hypot(R, D) + D * w_r[..., 1])
    from_camera = r_t[..., None] * w_r + [0.0, 2 * D, 0.0]
    return from_camera / np.linalg.norm(from_camera, axis=-1, keepdims=True)


def fermat_on_sphere(w_c, D):
    """Direction from the sample by Fermat's principle, solved numerically for one camera ray.

    The light path from a point L of the plane z = 0 over the dome point P to the camera is
    stationary against every shift of P along the sphere.
    """
    camera = np.array([0.0, -D, 0.0])
    far = brentq(lambda t: np.linalg.norm(camera + t * w_c) - R, 1e-6, 3 * R, xtol=1e-13)
    point = camera + far * w_c
    e1 = np.cross(point, [0.3, -0.5, 0.8])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(point / R, e1)

    def change_of_path(landing):
        legs = [camera - point, np.array([*landing, 0.0]) - point]
        pull = sum(leg / np.linalg.norm(leg) for leg in legs)
        return [pull @ e1, pull @ e2]

    found = root(change_of_path, [0.0, D], tol=1e-13)
    assert np.linalg.norm(change_of_path(found.x)) < 1e-11
    w_r = point - np.array([*found.x, 0.0])
    return w_r / np.linalg.norm(w_r)


class TestTrace:
    @pytest.mark.parametrize("ratio", [0.02, 0.10, 0.15])
    def test_ellipsoid_equals_its_closed_form(self, ratio):
        theta, phi, _ = hemisphere_quadrature(20, 24)
        w_r = unit_vectors(theta, phi)
        w_c = ellipsoid_direction_at_camera(w_r, ratio * R)
        traced = unit_vectors(*dome("ellipsoid", ratio).reflected_angles(*angles(w_c)))
        assert angle_between(traced, w_r).max() < 1e-8

    @pytest.mark.parametrize("ratio", [0.02, 0.10, 0.15])
    def test_sphere_obeys_fermat(self, ratio):
        theta, phi, _ = hemisphere_quadrature(5, 6, theta_max=np.radians(80))
        w_c = unit_vectors(theta, phi)
        expected = np.array([fermat_on_sphere(w, ratio * R) for w in w_c])
        traced = unit_vectors(*dome("sphere", ratio).reflected_angles(theta, phi))
        assert angle_between(traced, expected).max() < 1e-8

    @pytest.mark.parametrize("ratio", [0.02, 0.10, 0.15])
    def test_a_ray_from_one_focus_of_the_ellipsoid_lands_on_the_other(self, ratio):
        theta, phi, _ = hemisphere_quadrature(20, 24, theta_max=np.radians(85))
        camera = np.broadcast_to([0.0, -ratio * R, 0.0], (len(theta), 3))
        _, landing = dome("ellipsoid", ratio).trace(camera, unit_vectors(theta, phi))
        assert np.abs(landing).max() < 1e-9  # mm

    def test_points_lie_on_the_dome(self):
        theta, phi, _ = hemisphere_quadrature(10, 12)
        camera = np.broadcast_to([0.0, -15.0, 0.0], (len(theta), 3))
        shapes = {"sphere": R, "ellipsoid": np.sqrt(R**2 + 15.0**2)}
        for shape, semi_axis in shapes.items():
            x, y, z = dome(shape, 0.1).hit(camera, unit_vectors(theta, phi)).T
            np.testing.assert_allclose((x**2 + z**2) / R**2 + (y / semi_axis) ** 2, 1, atol=1e-13)

    # Largest distance from the target, in R, where the chief ray lands: three limits of theta_r.
    @pytest.mark.parametrize(
        ("ratio", "expected"),
        [
            (0.02, (0.0007, 0.0008, 0.0008)),
            (0.05, (0.0047, 0.0053, 0.0055)),
            (0.10, (0.020, 0.024, 0.025)),
            (0.15, (0.048, 0.060, 0.064)),
        ],
    )
    def test_landing_offsets_of_the_sphere(self, ratio, expected):
        theta, phi, _ = hemisphere_quadrature(160, 160)
        camera = np.broadcast_to([0.0, -ratio * R, 0.0], (len(theta), 3))
        w_r, landing = dome("sphere", ratio).trace(camera, unit_vectors(theta, phi))
        offset = np.linalg.norm(landing, axis=-1) / R
        theta_r, _ = angles(w_r)
        for limit, value in zip((60, 75, 85), expected, strict=True):
            # Half the last printed digit, and 1 % for a maximum that falls between sampled rays.
            half_digit = 0.5 * (1e-4 if ratio < 0.1 else 1e-3)
            found = offset[theta_r <= np.radians(limit)].max()
            assert found == pytest.approx(value, abs=half_digit + 0.01 * value)


class TestEquation3:
    """Ward's eq. (3) leaves out the law of reflection; this is what that costs."""

    @staticmethod
    def errors(shape, ratio, limit_deg):
        """Errors of eq. (3) and the rays' solid angles at the sample."""
        theta_c, phi_c, weight = hemisphere_quadrature(160, 160)
        D = ratio * R
        exact = unit_vectors(*dome(shape, ratio).reflected_angles(theta_c, phi_c))
        ward = unit_vectors(*reflected_angles(theta_c, phi_c, R=R, D=D))
        weight = weight * solid_angle_at_sample(shape, ratio, theta_c, phi_c)
        inside = exact[:, 2] >= np.cos(np.radians(limit_deg))
        return np.degrees(angle_between(exact, ward))[inside], weight[inside]

    # Median and maximum, deg, over theta_r <= 60, 75, 85.
    @pytest.mark.parametrize(
        ("shape", "ratio", "expected", "digit"),
        [
            ("sphere", 0.02, [(0.016, 0.023), (0.017, 0.023), (0.017, 0.023)], 1e-3),
            ("sphere", 0.05, [(0.101, 0.143), (0.109, 0.143), (0.108, 0.143)], 1e-3),
            ("sphere", 0.10, [(0.400, 0.573), (0.433, 0.573), (0.430, 0.573)], 1e-3),
            ("sphere", 0.15, [(0.891, 1.289), (0.967, 1.289), (0.963, 1.289)], 1e-3),
            ("ellipsoid", 0.02, [(0.0001, 0.0002)] * 3, 1e-4),
            ("ellipsoid", 0.05, [(0.001, 0.003)] * 3, 1e-3),
            ("ellipsoid", 0.10, [(0.008, 0.024), (0.010, 0.024), (0.011, 0.024)], 1e-3),
            ("ellipsoid", 0.15, [(0.027, 0.084), (0.036, 0.084), (0.039, 0.084)], 1e-3),
        ],
    )
    def test_size(self, shape, ratio, expected, digit):
        for limit, (median, largest) in zip((60, 75, 85), expected, strict=True):
            error, weight = self.errors(shape, ratio, limit)
            order = np.argsort(error)
            share = np.cumsum(weight[order]) / weight.sum()
            found = error[order][np.searchsorted(share, 0.5)]
            # Half the last printed digit, and 0.5 % for the finite set of rays.
            assert found == pytest.approx(median, abs=0.5 * digit + 0.005 * median)
            assert error.max() == pytest.approx(largest, abs=0.5 * digit + 0.005 * largest)

    @pytest.mark.parametrize(("shape", "order"), [("sphere", 2), ("ellipsoid", 3)])
    def test_leading_order_has_the_right_size_and_direction(self, shape, order):
        theta_c, phi_c, _ = hemisphere_quadrature(30, 32, theta_max=np.radians(80))
        left = []
        for ratio in (0.02, 0.04):
            exact = unit_vectors(*dome(shape, ratio).reflected_angles(theta_c, phi_c))
            ward = unit_vectors(*reflected_angles(theta_c, phi_c, R=R, D=ratio * R))
            shift = mapping_error(ward, R=R, D=ratio * R, shape=shape)
            np.testing.assert_allclose(np.sum(shift * ward, axis=-1), 0, atol=1e-15)
            left.append(np.linalg.norm(exact - ward - shift, axis=-1).max())
            size = np.linalg.norm(exact - ward, axis=-1).max()
            assert np.linalg.norm(shift, axis=-1).max() == pytest.approx(size, rel=5 * ratio)
            # What is left is of the next order in D/R, with a coefficient of order one.
            assert left[-1] < 5 * ratio ** (order + 1)
        assert left[1] / left[0] > 2 ** (order + 0.8)

    def test_wrong_sign_of_d_turns_directions_by_20_degrees(self):
        theta_c, phi_c, weight = hemisphere_quadrature(60, 64, theta_max=np.radians(75))
        exact = unit_vectors(*dome("ellipsoid", 0.1).reflected_angles(theta_c, phi_c))
        # The inverse of eq. (3) is eq. (3) with the other sign of D.
        mirrored = unit_vectors(*camera_angles(theta_c, phi_c, R=R, D=15.0))
        error = np.degrees(angle_between(exact, mirrored))
        order = np.argsort(error)
        median = error[order][np.searchsorted(np.cumsum(weight[order]) / weight.sum(), 0.5)]
        # Two points 2 D = 30 mm apart, seen from 150 mm: 20 to 23 deg, whatever the set of rays.
        assert median == pytest.approx(20.4, abs=0.5)
        assert error.max() == pytest.approx(22.7, abs=0.3)

    def test_camera_frame_has_y_towards_the_target(self):
        # C = (0, -D, 0), T = (0, D, 0): light that leaves T straight up meets the dome on the
        # camera's +y side, which is downwards in a picture whose rows count from the top.
        theta_c, phi_c = angles(ellipsoid_direction_at_camera(np.array([0.0, 0.0, 1.0]), 15.0))
        assert np.degrees(phi_c) == pytest.approx(90)
        assert np.degrees(theta_c) == pytest.approx(11.365, abs=5e-4)
        theta_r, _ = dome("ellipsoid", 0.1).reflected_angles(theta_c, phi_c)
        assert theta_r == pytest.approx(0, abs=1e-12)


class TestSlopeErrors:
    PARTS = MappingProxyType(
        {"slope_error_deg": 0.03, "rim_slope_error_deg": 0.2, "slope_correlation_deg": 10.0}
    )
    SEEDS = 500

    def fields(self, theta_deg, phi_deg=0.0):
        """Slope errors at points of the dome in many independent domes: (seeds, points, 2)."""
        one = dome("sphere", 0.1, **self.PARTS)
        point = R * unit_vectors(np.radians(theta_deg), np.radians(phi_deg))
        return np.array(
            [one.slope_errors(point, np.random.default_rng(seed)) for seed in range(self.SEEDS)]
        )

    def test_standard_deviation_is_the_stated_one(self):
        theta = np.array([0.0, 30.0, 60.0, 75.0, 90.0])
        found = self.fields(theta).std(axis=0)
        stated = np.radians(0.03 + 0.2 * (theta / 90) ** 6)
        # The relative standard error of a standard deviation is 1/sqrt(2 n).
        np.testing.assert_allclose(
            found, np.stack([stated] * 2, -1), rtol=4 / np.sqrt(2 * self.SEEDS)
        )

    def test_neighbours_are_alike_and_distant_points_are_not(self):
        apart = np.array([0.0, 5.0, 10.0, 20.0, 60.0])
        field = self.fields(apart)
        chord = 2 * np.sin(np.radians(apart) / 2)
        expected = np.exp(-(chord**2) / 2 / np.radians(10.0) ** 2)
        for axis in range(2):
            found = np.corrcoef(field[..., axis].T)[0]
            # Standard error of a correlation coefficient.
            error = 4 * (1 - expected**2) / np.sqrt(self.SEEDS)
            assert np.all(np.abs(found - expected) <= error + 1e-12)
        between = np.corrcoef(field[:, 0, 0], field[:, 0, 1])[0, 1]
        assert abs(between) < 4 / np.sqrt(self.SEEDS)

    def test_one_seed_one_field(self):
        one = dome("sphere", 0.1, **self.PARTS)
        point = R * unit_vectors(np.linspace(0, 1.5, 700), 0.3)
        first = one.slope_errors(point, np.random.default_rng(7))
        np.testing.assert_array_equal(first, one.slope_errors(point, np.random.default_rng(7)))
        assert not np.allclose(first, one.slope_errors(point, np.random.default_rng(8)))
        # A point's slope does not depend on which other points are asked for with it.
        part = one.slope_errors(point[600:], np.random.default_rng(7))
        np.testing.assert_allclose(part, first[600:], rtol=1e-12)

    def test_a_tilted_mirror_turns_the_ray_by_twice_the_tilt(self):
        one = dome("sphere", 0.1)
        origin, up = np.array([[0.0, -15.0, 0.0]]), np.array([[0.0, 0.1, 1.0]]) / np.sqrt(1.01)
        straight, _ = one.trace(origin, up)
        for slope in ([1e-4, 0.0], [0.0, 1e-4]):
            turned, _ = one.trace(origin, up, np.array([slope]))
            # cos of the angle of incidence (11.5 deg) enters for the tilt across the plane only.
            assert angle_between(straight, turned)[0] == pytest.approx(2e-4, rel=0.03)
