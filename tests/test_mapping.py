"""From pixels to directions: eq. (3) and the exact mirror, for a camera that stands askew."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root

from gonio.calibration.dome.pixel_map import PixelMap, error_modes, left_out
from gonio.calibration.reflector import (
    landing_points,
    reflected_angles,
    reflected_directions,
    solid_angle_ratio,
)
from gonio.errors import ConfigurationError
from gonio.geometry import angles, hemisphere_quadrature, unit_vectors
from gonio.instrument import Dome, preset
from gonio.metadata import Camera, Geometry, LensCalibration, Uncertain

R, D = 150.0, 15.0
K = (-0.012, 0.004, -0.0015, 0.0002)
SHAPES = ["sphere", "ellipsoid"]
MAPPINGS = ["eq3", "exact"]

CAMERA = Camera(
    rows=416, columns=420, pitch_mm=(0.0138, 0.0137), gain_dn_per_e=1, black_dn=0,
    saturation_dn=4095, full_well_e=1e4, noise_dn=1, dark_e_per_s=0,
)  # fmt: skip
ASKEW = {
    "pupil_mm": (0.4, -0.3, 0.8),
    "pupil_walk_mm": 1.5,
    "camera_azimuth_deg": 3.0,
}


def pixel_map(shape="ellipsoid", mapping="exact", *, centre_px=None, **geometry) -> PixelMap:
    lens = LensCalibration(
        projection="kannala_brandt", focal_length_mm=1.8, k=K, centre_px=centre_px
    )
    dome = Geometry(**{"shape": shape, "R": R, "D": D, "usable_theta_r_deg": 90} | geometry)
    return PixelMap(CAMERA, lens, dome, mapping)


def chief_rays(n_theta=12, n_phi=16, theta_max_deg=85.0):
    theta, phi, weight = hemisphere_quadrature(n_theta, n_phi, np.radians(theta_max_deg))
    return unit_vectors(theta, phi), weight


def angle_between(a, b):
    """Angle between unit vectors, radians, exact for small ones."""
    return 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1))


def reflect(w_c, shape, mapping="exact", pupil=(0.0, -D, 0.0), ratio=None):
    d = D if ratio is None else ratio * R
    pupil = np.array([0.0, -d, 0.0]) if ratio is not None else np.array(pupil)
    return reflected_directions(pupil, w_c, R=R, D=d, shape=shape, mapping=mapping)[0]


def by_fermat(pupil, w_c, shape, d=D):
    """Direction from the sample by Fermat's principle: |C - P| + |P - L| is stationary.

    For the dome point P on the ray from the pupil C, the landing point L of the plane z = 0 is
    sought against which every shift of P along the dome leaves the length of the path unchanged.
    """
    axes = np.array([R, np.hypot(R, d) if shape == "ellipsoid" else R, R])
    inside = root(lambda t: np.sum(((pupil + t * w_c) / axes) ** 2) - 1, R + 2 * d, tol=1e-14)
    point = pupil + inside.x * w_c
    normal = point / axes**2
    e1 = np.cross(normal, [0.3, -0.5, 0.8])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(normal / np.linalg.norm(normal), e1)

    def change_of_path(landing):
        legs = [pupil - point, np.array([*landing, 0.0]) - point]
        pull = sum(leg / np.linalg.norm(leg) for leg in legs)
        return [pull @ e1, pull @ e2]

    found = root(change_of_path, [0.0, d], tol=1e-13)
    assert np.linalg.norm(change_of_path(found.x)) < 1e-11
    w_r = point - np.array([*found.x, 0.0])
    return w_r / np.linalg.norm(w_r), found.x - [0.0, d]


class TestReflection:
    @pytest.mark.parametrize("shape", SHAPES)
    def test_eq_3_from_the_nominal_pupil_is_eq_3(self, shape):
        w_c, _ = chief_rays()
        expected = unit_vectors(*reflected_angles(*angles(w_c), R=R, D=D))
        assert angle_between(reflect(w_c, shape, "eq3"), expected).max() < 1e-10

    @pytest.mark.parametrize("mapping", MAPPINGS)
    def test_eq_3_of_a_displaced_pupil_looks_from_the_target_at_the_same_point(self, mapping):
        w_c, _ = chief_rays()
        pupil = np.array([0.5, -14.0, 1.0])
        w_r = reflect(w_c, "sphere", mapping, pupil)
        # The point of the sphere: the same distance from the centre, on both rays.
        if mapping == "eq3":
            start = np.broadcast_to([0.0, D, 0.0], w_r.shape)
        else:
            at = landing_points(pupil, w_c, R=R, D=D, shape="sphere")
            start = np.stack([at[:, 0], at[:, 1] + D, np.zeros(len(at))], axis=1)
        b = np.sum(start * w_r, axis=1)
        along = -b + np.sqrt(b**2 + R**2 - np.sum(start**2, axis=1))
        point = start + along[:, None] * w_r
        seen = point - pupil
        assert angle_between(seen / np.linalg.norm(seen, axis=1)[:, None], w_c).max() < 1e-10

    @pytest.mark.parametrize("pupil", [(0.0, -D, 0.0), (0.4, -15.3, 0.8)])
    @pytest.mark.parametrize("shape", SHAPES)
    def test_exact_obeys_fermat(self, shape, pupil):
        w_c, _ = chief_rays(5, 6, 80.0)
        expected, landing = zip(*[by_fermat(np.array(pupil), w, shape) for w in w_c], strict=True)
        assert angle_between(reflect(w_c, shape, pupil=pupil), np.array(expected)).max() < 1e-8
        got = landing_points(np.array(pupil), w_c, R=R, D=D, shape=shape)
        np.testing.assert_allclose(got, landing, atol=1e-6)  # mm

    @pytest.mark.parametrize("ratio", [0.02, 0.10, 0.15])
    def test_exact_ellipsoid_is_the_polar_equation_about_its_focus(self, ratio):
        w_r, _ = chief_rays()
        d = ratio * R
        r_t = R**2 / (np.hypot(R, d) + d * w_r[:, 1])
        w_c = r_t[:, None] * w_r + [0.0, 2 * d, 0.0]
        w_c /= np.linalg.norm(w_c, axis=1, keepdims=True)
        assert angle_between(reflect(w_c, "ellipsoid", ratio=ratio), w_r).max() < 1e-10
        landing = landing_points(np.array([0, -d, 0]), w_c, R=R, D=d, shape="ellipsoid")
        assert np.abs(landing).max() < 1e-9

    @pytest.mark.parametrize("shape", SHAPES)
    def test_exact_agrees_with_the_simulated_dome(self, shape):
        w_c, _ = chief_rays(30, 32, 89.0)
        dome = Dome(shape=shape, R=R, D=D)
        for pupil in ((0.0, -D, 0.0), (0.4, -15.3, 0.8)):
            w_r, landing = dome.trace(np.broadcast_to(pupil, w_c.shape), w_c)
            assert angle_between(reflect(w_c, shape, pupil=pupil), w_r).max() < 1e-12
            got = landing_points(np.array(pupil), w_c, R=R, D=D, shape=shape)
            np.testing.assert_allclose(got, landing, atol=1e-9)

    @pytest.mark.parametrize("mapping", MAPPINGS)
    @pytest.mark.parametrize("shape", SHAPES)
    def test_derivatives_are_those_of_the_directions(self, shape, mapping):
        w_c, _ = chief_rays(6, 8, 80.0)
        rng = np.random.default_rng(1)
        pupil = np.array([0.4, -15.3, 0.8])
        d_pupil = rng.normal(size=w_c.shape)
        d_w = np.cross(w_c, rng.normal(size=w_c.shape))
        given = {"R": R, "D": D, "shape": shape, "mapping": mapping}
        _, (d_w_r,) = reflected_directions(pupil, w_c, [(d_pupil, d_w)], **given)

        def moved(h):
            # Along the great circle, so that the ray stays a unit vector to second order.
            size = np.linalg.norm(d_w, axis=1, keepdims=True)
            w = np.cos(h * size) * w_c + np.sin(h * size) * d_w / size
            return reflected_directions(pupil + h * d_pupil, w, **given)[0]

        h = 1e-3
        numeric = (8 * (moved(h) - moved(-h)) - moved(2 * h) + moved(-2 * h)) / (12 * h)
        np.testing.assert_allclose(d_w_r, numeric, atol=1e-10)


def weighted_median(values, weights):
    order = np.argsort(values)
    share = np.cumsum(weights[order]) - weights[order] / 2
    return np.interp(0.5 * weights.sum(), share, values[order])


class TestTables:
    """The tables of docs: eq. (3) against the mirror, and what misalignment does."""

    @staticmethod
    def rays(shape, ratio, n=300):
        """Exact directions over half the hemisphere (the other half is its mirror image)."""
        d = ratio * R
        theta, phi, weight = hemisphere_quadrature(n, 2 * n)
        half = np.abs(phi - np.pi) > np.pi / 2
        theta, phi, weight = theta[half], phi[half], weight[half]
        w_c, zero = unit_vectors(theta, phi), np.zeros(3)
        e1, e2 = unit_vectors(theta + np.pi / 2, phi), unit_vectors(np.pi / 2, phi + np.pi / 2)
        w_r, (d1, d2) = reflected_directions(
            np.array([0.0, -d, 0.0]), w_c, ((zero, e1), (zero, e2)),
            R=R, D=d, shape=shape, mapping="exact",
        )  # fmt: skip
        return w_c, w_r, weight * np.linalg.norm(np.cross(d1, d2), axis=1)

    # Median and largest error of eq. (3), deg, over theta_r <= 60, 75, 85.
    @pytest.mark.parametrize(
        ("shape", "ratio", "medians", "largest", "digits"),
        [
            ("sphere", 0.02, (0.016, 0.017, 0.017), 0.023, 3),
            ("sphere", 0.05, (0.101, 0.109, 0.108), 0.143, 3),
            ("sphere", 0.10, (0.400, 0.433, 0.430), 0.573, 3),
            ("sphere", 0.15, (0.891, 0.967, 0.963), 1.289, 3),
            ("ellipsoid", 0.02, (0.0001, 0.0001, 0.0001), 0.0002, 4),
            ("ellipsoid", 0.05, (0.001, 0.001, 0.001), 0.003, 3),
            ("ellipsoid", 0.10, (0.008, 0.010, 0.011), 0.024, 3),
            ("ellipsoid", 0.15, (0.027, 0.036, 0.039), 0.084, 3),
        ],
    )
    def test_error_of_eq_3(self, shape, ratio, medians, largest, digits):
        w_c, exact, weight = self.rays(shape, ratio)
        error = np.degrees(angle_between(exact, reflect(w_c, shape, "eq3", ratio=ratio)))
        for limit, median in zip((60, 75, 85), medians, strict=True):
            inside = exact[:, 2] >= np.cos(np.radians(limit))
            found = weighted_median(error[inside], weight[inside])
            assert round(found, digits) == median
            assert round(error[inside].max(), digits) == largest

    # The same, the largest error over theta_r <= 85, for other lengths put in the place of R.
    @pytest.mark.parametrize(
        ("ratio", "semi_major", "mean"),
        [(0.02, 0.0005, 0.0002), (0.05, 0.007, 0.0024), (0.10, 0.056, 0.019), (0.15, 0.187, 0.063)],
    )
    def test_error_of_eq_3_on_an_ellipsoid_with_another_r(self, ratio, semi_major, mean):
        w_c, exact, _ = self.rays("ellipsoid", ratio, n=200)
        inside = exact[:, 2] >= np.cos(np.radians(85))
        a = R * np.hypot(1, ratio)
        for length, largest in ((a, semi_major), ((2 * R + a) / 3, mean)):
            ward = unit_vectors(*reflected_angles(*angles(w_c), R=length, D=ratio * R))
            found = np.degrees(angle_between(exact, ward))[inside].max()
            # Half of the last printed digit.
            assert found == pytest.approx(largest, abs=5e-5 if largest < 0.003 else 5e-4)

    # Largest distance from the target, in R, where chief rays land on a sphere's sample.
    @pytest.mark.parametrize(
        ("ratio", "expected", "digits"),
        [
            (0.02, (0.0007, 0.0008, 0.0008), 4),
            (0.05, (0.0047, 0.0053, 0.0055), 4),
            (0.10, (0.020, 0.024, 0.025), 3),
            (0.15, (0.048, 0.060, 0.064), 3),
        ],
    )
    def test_where_the_chief_ray_lands(self, ratio, expected, digits):
        w_c, exact, _ = self.rays("sphere", ratio, n=700)  # the largest lies at the edge
        at = landing_points(np.array([0.0, -ratio * R, 0]), w_c, R=R, D=ratio * R, shape="sphere")
        offset = np.linalg.norm(at, axis=1) / R
        for limit, value in zip((60, 75, 85), expected, strict=True):
            inside = exact[:, 2] >= np.cos(np.radians(limit))
            assert round(offset[inside].max(), digits) == value

    # Median and largest error of the exact directions, deg, theta_r <= 75, ellipsoid, R = 150.
    @pytest.mark.parametrize(
        ("wrong", "median", "largest"),
        [
            ({"pupil_mm": (0.0, 0.0, 1.0)}, 0.59, 0.75),
            ({"pupil_mm": (0.0, 1.0, 0.0)}, 0.68, 0.76),
            ({"pupil_mm": (1.0, 0.0, 0.0)}, 0.68, 0.77),
            ({"D": D + 1}, 0.68, 0.76),
            ({"R": 0.99 * R}, 0.10, 0.115),
            ({"pupil_walk_mm": 2.0}, 0.38, 1.11),
        ],
        ids=["up", "y", "x", "D", "R", "walk"],
    )
    def test_sensitivities(self, wrong, median, largest):
        w_c, weight = chief_rays(100, 96, 90.0)
        right = pixel_map()
        columns, rows = right.pixels(reflect(w_c, "ellipsoid"))
        seen = right.directions(columns, rows)
        error = np.degrees(angle_between(seen, pixel_map(**wrong).directions(columns, rows)))
        inside = seen[:, 2] >= np.cos(np.radians(75))
        # The camera's solid angle weighs; half a digit and 2 % for the weights of the table.
        found = weighted_median(error[inside], weight[inside])
        assert found == pytest.approx(median, abs=0.005 + 0.02 * median)
        assert error[inside].max() == pytest.approx(largest, abs=0.005 + 0.01 * largest)

    def test_eq_3_sees_half_of_a_displaced_pupil(self):
        w_c, _ = chief_rays(20, 24, 75.0)
        up = (0.0, -D, 1.0)
        exact = angle_between(reflect(w_c, "ellipsoid"), reflect(w_c, "ellipsoid", pupil=up))
        ward = angle_between(
            reflect(w_c, "ellipsoid", "eq3"), reflect(w_c, "ellipsoid", "eq3", pupil=up)
        )
        assert np.median(ward / exact) == pytest.approx(0.5, abs=2 * D / R * 0.5)


class TestPixels:
    @pytest.mark.parametrize("mapping", MAPPINGS)
    @pytest.mark.parametrize("shape", SHAPES)
    @pytest.mark.parametrize("geometry", [{}, ASKEW], ids=["nominal", "askew"])
    def test_pixels_and_directions_are_inverse(self, geometry, shape, mapping):
        seen = pixel_map(shape, mapping, centre_px=(207.3, 209.1), **geometry)
        rng = np.random.default_rng(2)
        columns, rows = rng.uniform(70, 340, (2, 300))
        w_r = seen.directions(columns, rows)
        assert np.isfinite(w_r).all()
        back = seen.pixels(w_r)
        np.testing.assert_allclose(back, (columns, rows), atol=1e-8)

    @pytest.mark.parametrize("mapping", MAPPINGS)
    @pytest.mark.parametrize("shape", SHAPES)
    @pytest.mark.parametrize("geometry", [{}, ASKEW], ids=["nominal", "askew"])
    def test_solid_angles_are_those_of_small_areas(self, geometry, shape, mapping):
        seen = pixel_map(shape, mapping, centre_px=(207.3, 209.1), **geometry)
        rng = np.random.default_rng(3)
        columns, rows = rng.uniform(80, 330, (2, 100))
        h = 0.05

        def along(dx, dy):
            at = [seen.directions(columns + s * dx, rows + s * dy) for s in (-2, -1, 1, 2)]
            return (8 * (at[2] - at[1]) - at[3] + at[0]) / (12 * h)

        area = np.linalg.norm(np.cross(along(h, 0), along(0, h)), axis=1)
        np.testing.assert_allclose(seen.solid_angles(columns, rows), area, rtol=1e-8)

    def test_the_nominal_jacobian_of_eq_3_is_the_closed_form(self):
        seen = pixel_map(mapping="eq3")
        columns, rows = np.random.default_rng(4).uniform(60, 350, (2, 200))
        x = (columns - 209.5) * 0.0138
        y = (rows - 207.5) * 0.0137
        lens = preset("ideal12").lens
        theta = lens.polar_angle(np.hypot(x, y))
        on_axis = 0.0138 * 0.0137 / lens.focal_length_mm**2
        expected = lens.solid_angle(theta) * on_axis
        expected *= solid_angle_ratio(theta, np.arctan2(y, x), R=R, D=D)
        np.testing.assert_allclose(seen.solid_angles(columns, rows), expected, rtol=1e-10)

    @pytest.mark.parametrize("mapping", MAPPINGS)
    def test_all_pixels_together_see_what_the_edge_of_the_image_encloses(self, mapping):
        seen = pixel_map("sphere", mapping, **ASKEW)
        columns, rows = np.meshgrid(np.arange(420.0), np.arange(416.0))
        each = seen.solid_angles(columns, rows)
        total, largest = np.nansum(each), np.nanmax(each)
        # Inside a closed curve of directions lies the integral of (1 - cos theta_r) dphi_r.
        turn = np.linspace(0, 2 * np.pi, 20_001)
        r = float(preset("ideal12").lens.radius(np.pi / 2)) * (1 - 1e-12)
        edge = seen.directions(209.5 + r * np.cos(turn) / 0.0138, 207.5 + r * np.sin(turn) / 0.0137)
        height, phi = 1 - edge[:, 2], np.unwrap(np.arctan2(edge[:, 1], edge[:, 0]))
        enclosed = np.sum((height[1:] + height[:-1]) / 2 * np.diff(phi))
        # The rim is drawn in pixels: each of 1250 is cut at random.
        assert total == pytest.approx(enclosed, abs=3 * np.sqrt(1250 / 12) * largest)

    def test_outside_the_image_circle_there_is_no_direction(self):
        seen = pixel_map()
        assert np.isnan(seen.directions(0, 0)).all()
        assert np.isnan(seen.solid_angles(0, 0))

    def test_the_image_centre_moves_the_picture_and_the_azimuth_turns_it(self):
        nominal, moved = pixel_map(), pixel_map(centre_px=(209.5 + 3, 207.5 - 2))
        np.testing.assert_allclose(
            moved.directions(103, 98), nominal.directions(100, 100), atol=1e-14
        )
        # Counter-clockwise by 90 deg: the pixel on the right looks to +y instead of +x.
        turned = pixel_map(mapping="eq3", D=1e-9, camera_azimuth_deg=90.0)
        w = turned.directions(300, 207.5)
        assert w[1] > 0.5
        assert abs(w[0]) < 1e-9

    def test_the_walk_raises_the_pupil_at_the_rim(self):
        seen, low = pixel_map(pupil_walk_mm=2.0), pixel_map()
        w_c = unit_vectors(np.radians([0.0, 45.0]), np.pi / 2)
        at = low.pixels(reflect(w_c, "ellipsoid"))
        raised = np.stack(
            [reflect(w_c[:1], "ellipsoid")[0],
             reflect(w_c[1:], "ellipsoid", pupil=(0.0, -D, 0.5))[0]]
        )  # fmt: skip
        assert angle_between(seen.directions(*at), raised).max() < 1e-9

    def test_the_history_line_tells_all_that_is_not_nominal(self):
        assert pixel_map(mapping="eq3").describe() == (
            "eq. (3) with R = 150 mm, D = 15 mm (ellipsoid)"
        )
        assert pixel_map("sphere", centre_px=(200.25, 201.0), **ASKEW).describe() == (
            "exact law of reflection with R = 150 mm, D = 15 mm (sphere), pupil displaced by "
            "(0.4, -0.3, 0.8) mm, pupil rising 1.5 mm to the rim, camera turned by 3 deg, image "
            "centre at (200.25, 201) px"
        )

    def test_what_cannot_be_is_refused(self):
        with pytest.raises(ConfigurationError, match=r"mapping 'ward' is unknown; allowed are eq3"):
            pixel_map(mapping="ward")
        message = r"the pupil lies 160 mm from the dome's centre and R is 150 mm: the camera must"
        with pytest.raises(ConfigurationError, match=message):
            pixel_map(pupil_mm=(0.0, -145.0, 0.0))


NAMES = ("R", "D", "pupil_x", "pupil_y", "pupil_z", "camera_azimuth")
SD = (0.3, 0.1, 0.1, 0.12, 0.15, 0.2)


def covariance(seed=5, sd=SD):
    """A covariance with correlations."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(len(sd), 3 * len(sd)))
    c = a @ a.T
    c /= np.sqrt(np.outer(c.diagonal(), c.diagonal()))
    return c * np.outer(sd, sd)


class TestErrors:
    AT = (np.linspace(90, 330, 9), np.linspace(320, 110, 9))

    @pytest.mark.parametrize("mapping", MAPPINGS)
    @pytest.mark.parametrize(
        ("names", "sd"),
        [
            (NAMES, SD),
            (("focal_length", "k1", "k2", "centre_x", "centre_y"), (2e-3, 1e-3, 1e-3, 0.3, 0.2)),
            (("D", "centre_y", "pupil_z"), (0.1, 0.2, 0.1)),
        ],
        ids=["geometry", "lens", "both"],
    )
    def test_modes_are_the_scatter_of_monte_carlo(self, names, sd, mapping):
        seen = pixel_map(mapping=mapping, **ASKEW)
        matrix = covariance(sd=sd)
        uncertain = Uncertain(names=names, covariance=matrix.tolist())
        modes = error_modes(seen, uncertain, *self.AT)
        stated = sum(np.einsum("ni,nj->nij", m.shift, m.shift) for m in modes)
        rng = np.random.default_rng(6)
        draws = []
        for step in rng.multivariate_normal(np.zeros(len(sd)), matrix, 500):
            moved = seen
            for name, value in zip(names, step, strict=True):
                moved = moved.changed(name, float(value))
            draws.append(moved.directions(*self.AT))
        scatter = np.array(draws) - seen.directions(*self.AT)
        found = np.einsum("kni,knj->nij", scatter, scatter) / len(draws)
        # A variance of 500 draws is good to sqrt(2/500) = 6 %.
        size = np.einsum("nii->n", stated)
        np.testing.assert_allclose(found, stated, atol=4 * 0.063 * size.max())
        np.testing.assert_allclose(np.einsum("nii->n", found), size, rtol=4 * 0.063)

    def test_few_modes_hold_nearly_all(self):
        seen = pixel_map()
        uncertain = Uncertain(names=NAMES, covariance=covariance().tolist())
        modes = error_modes(seen, uncertain, *self.AT)
        size = [np.sum(m.shift**2) for m in modes]
        assert size == sorted(size, reverse=True)
        assert 2 <= len(modes) <= 6
        w_r = seen.directions(*self.AT)
        for mode in modes:
            assert np.abs(np.sum(mode.shift * w_r, axis=1)).max() < 1e-15
            assert set(mode.quantities) <= set(NAMES)

    def test_modes_do_not_depend_on_units(self):
        """A figure in other units is another figure with another size: the modes stay."""
        seen = pixel_map()
        one = Uncertain(names=("pupil_z", "camera_azimuth"), covariance=((0.01, 0.0), (0.0, 1e-6)))
        modes = error_modes(seen, one, *self.AT)
        alone = error_modes(seen, Uncertain(names=("pupil_z",), covariance=((0.01,),)), *self.AT)
        # The azimuth's milli-degree does not show.
        assert modes[0].quantities == ("pupil_z",)
        np.testing.assert_allclose(np.abs(modes[0].shift), np.abs(alone[0].shift), rtol=1e-3)

    def test_a_figure_that_is_certain_makes_no_error(self):
        seen = pixel_map()
        nothing = Uncertain(names=("R", "D"), covariance=((0.0, 0.0), (0.0, 0.0)))
        assert error_modes(seen, nothing, *self.AT) == []

    @pytest.mark.parametrize("shape", SHAPES)
    def test_what_eq_3_leaves_out_is_the_way_to_the_exact_direction(self, shape):
        seen = pixel_map(shape, "eq3", **ASKEW)
        shift = left_out(seen, *self.AT)
        ward = seen.directions(*self.AT)
        exact = replace(seen, mapping="exact").directions(*self.AT)
        arrived = (ward + shift) / np.linalg.norm(ward + shift, axis=1, keepdims=True)
        # A tangent vector of length s falls short of the arc by s^3/3.
        s = np.linalg.norm(shift, axis=1)
        assert np.all(angle_between(arrived, exact) < s**3)
        assert s.max() < 0.02
