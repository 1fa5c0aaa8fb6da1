"""The fisheye: projections, their inverses, the solid angle of a pixel."""

import numpy as np
import pytest

from gonio.calibration.lens.projection import (
    camera_angles,
    image_centre,
    pixel_positions,
    sensor_radius,
    solid_angle_per_area,
)
from gonio.errors import ConfigurationError
from gonio.instrument import Lens
from gonio.metadata import Camera, LensCalibration

K = (-0.012, 0.004, -0.0015, 0.0002)
LENSES = {
    "equidistant": Lens(projection="equidistant", focal_length_mm=1.8, pupil_mm=0.45),
    "equisolid": Lens(projection="equisolid", focal_length_mm=2.4, pupil_mm=3.0),
    "kannala_brandt": Lens(
        projection="kannala_brandt", focal_length_mm=1.8, k=K, pupil_mm=0.45, vignetting=0.25
    ),
}
THETA = np.radians(np.linspace(0, 90, 1801))

each_lens = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())


class TestProjection:
    def test_formulas(self):
        t = np.radians(60)
        assert LENSES["equidistant"].radius(t) == pytest.approx(1.8 * np.pi / 3, rel=1e-15)
        assert LENSES["equisolid"].radius(t) == pytest.approx(2 * 2.4 * 0.5, rel=1e-15)
        series = t + K[0] * t**3 + K[1] * t**5 + K[2] * t**7 + K[3] * t**9
        assert LENSES["kannala_brandt"].radius(t) == pytest.approx(1.8 * series, rel=1e-15)

    def test_k_belongs_to_kannala_brandt_only(self):
        other = LENSES["equidistant"].model_copy(update={"k": K})
        np.testing.assert_array_equal(other.radius(THETA), 1.8 * THETA)

    @each_lens
    def test_slope_is_the_derivative(self, lens):
        h = 1e-5
        inner = THETA[1:-1]
        numeric = (lens.radius(inner + h) - lens.radius(inner - h)) / (2 * h)
        # Central differences: h^2 r'''/6 and rounding 1e-16/h, both below 1e-9 here.
        np.testing.assert_allclose(lens.slope(inner), numeric, rtol=1e-9)

    @each_lens
    def test_inverse_returns_the_angle(self, lens):
        np.testing.assert_allclose(lens.polar_angle(lens.radius(THETA)), THETA, atol=1e-12)

    @each_lens
    def test_outside_the_field_there_is_no_direction(self, lens):
        edge = float(lens.radius(np.pi / 2))
        assert np.isfinite(lens.polar_angle(edge))
        assert np.all(np.isnan(lens.polar_angle([edge * 1.001, edge * 2, 50.0])))

    def test_a_narrower_field_ends_earlier(self):
        lens = Lens(focal_length_mm=2.0, pupil_mm=0.0, field_deg=160)
        inside, outside = lens.polar_angle([2.0 * np.radians(79.9), 2.0 * np.radians(80.1)])
        assert np.degrees(inside) == pytest.approx(79.9)
        assert np.isnan(outside)


class TestSolidAngle:
    @each_lens
    def test_equals_the_numeric_derivative(self, lens):
        theta = np.radians(np.arange(5.0, 90.0, 5.0))
        h = 1e-4
        # A ring of the image and the ring of directions that it sees.
        area = lens.radius(theta + h) ** 2 - lens.radius(theta - h) ** 2
        seen = 2 * (np.cos(theta - h) - np.cos(theta + h))
        expected = seen / area * lens.focal_length_mm**2
        np.testing.assert_allclose(lens.solid_angle(theta), expected, rtol=1e-7)

    @each_lens
    def test_is_one_on_the_axis_and_continuous(self, lens):
        np.testing.assert_allclose(lens.solid_angle([0.0, 1e-7, 1e-5]), 1, atol=1e-9)

    def test_equisolid_keeps_it(self):
        np.testing.assert_allclose(LENSES["equisolid"].solid_angle(THETA), 1, rtol=1e-9)

    @each_lens
    def test_the_image_sees_the_whole_hemisphere(self, lens):
        r = np.linspace(0, float(lens.radius(np.pi / 2)), 20001)
        ring = lens.solid_angle(lens.polar_angle(r)) * r / lens.focal_length_mm**2
        assert np.trapezoid(ring, r) == pytest.approx(1, rel=1e-6)  # 2 pi sr over 2 pi

    def test_vignetting_falls_with_the_square_of_the_angle(self):
        v = LENSES["kannala_brandt"].relative_illumination(np.radians([0.0, 45.0, 90.0]))
        np.testing.assert_allclose(v, [1.0, 0.9375, 0.75], rtol=1e-15)


def known(lens: Lens, **changes) -> LensCalibration:
    """What a session states of a lens."""
    return LensCalibration(
        projection=lens.projection,
        focal_length_mm=lens.focal_length_mm,
        k=lens.k if lens.projection == "kannala_brandt" else (0.0, 0.0, 0.0, 0.0),
        **changes,
    )


class TestAgainstCalibration:
    """The reduction has a lens of its own, both ways."""

    @each_lens
    def test_both_inverses_agree(self, lens):
        radius = np.linspace(0, 1.2 * float(lens.radius(np.pi / 2)), 997)
        phi = np.linspace(-3.1, 3.1, 997)
        theta_c, phi_c = camera_angles(known(lens), radius * np.cos(phi), radius * np.sin(phi))
        theta = lens.polar_angle(radius)
        np.testing.assert_array_equal(np.isnan(theta_c), np.isnan(theta))
        np.testing.assert_allclose(theta_c, theta, atol=1e-10)
        np.testing.assert_allclose(phi_c[1:], phi[1:], atol=1e-12)

    @each_lens
    def test_both_projections_and_solid_angles_agree(self, lens):
        np.testing.assert_allclose(
            sensor_radius(known(lens), THETA), lens.radius(THETA), rtol=1e-14
        )
        expected = lens.solid_angle(THETA[1:]) / lens.focal_length_mm**2
        np.testing.assert_allclose(
            solid_angle_per_area(known(lens), THETA[1:]), expected, rtol=1e-9
        )
        on_axis = 1 / lens.focal_length_mm**2
        assert solid_angle_per_area(known(lens), 0.0) == pytest.approx(on_axis, rel=1e-15)

    @each_lens
    def test_one_point_is_as_good_as_many(self, lens):
        theta_c, _ = camera_angles(known(lens), 1.0, 0.5)
        many, _ = camera_angles(known(lens), [1.0, 0.2], [0.5, 0.0])
        assert theta_c == many[0]

    def test_a_polynomial_that_turns_back_is_refused(self):
        lens = known(LENSES["kannala_brandt"]).model_copy(update={"k": (-0.3, 0.0, 0.0, 0.0)})
        # 1 - 0.9 theta^2 = 0 at 1.054 rad = 60.4 deg.
        message = (
            r"k = -0\.3, 0, 0, 0: the lens polynomial stops growing at 60\.4 deg, inside the field "
            r"of 180 deg; calibrate with points nearer to the rim, or give a smaller field_deg\."
        )
        with pytest.raises(ConfigurationError, match=message):
            camera_angles(lens, 1.0, 0.0)
        narrow = lens.model_copy(update={"field_deg": 110.0})
        assert np.isfinite(camera_angles(narrow, 1.0, 0.0)[0])


class TestImageCentre:
    CAMERA = Camera(
        rows=100, columns=121, pitch_mm=(0.01, 0.02), gain_dn_per_e=1, black_dn=0,
        saturation_dn=255, full_well_e=255, noise_dn=1, dark_e_per_s=0,
    )  # fmt: skip

    def test_it_is_the_middle_of_the_frame_unless_calibrated(self):
        lens = known(LENSES["equidistant"])
        assert image_centre(self.CAMERA, lens) == image_centre(self.CAMERA) == (60.0, 49.5)
        moved = known(LENSES["equidistant"], centre_px=(61.25, 48.0))
        assert image_centre(self.CAMERA, moved) == (61.25, 48.0)
        x, y = pixel_positions(self.CAMERA, [61.25, 62.25], [48.0, 50.0], moved)
        np.testing.assert_allclose(x, [0, 0.01], atol=1e-15)
        np.testing.assert_allclose(y, [0, 0.04], atol=1e-15)
