"""Each stage of the instrument alone: switched on, measured, and where it must cancel, seen to."""

import numpy as np
import pytest

from gonio import models, simulation
from gonio.errors import ConfigurationError
from gonio.geometry import angles, hemisphere_quadrature, unit_vectors
from gonio.instrument import Filter, Holder, Instrument, Lamp, Sensor, imaging, preset
from gonio.instrument.holder import tilted
from gonio.instrument.images import Fixed, Images, Surface
from gonio.instrument.noise import expose
from gonio.instrument.plans import is_anisotropic
from gonio.instrument.realisation import Realisation
from gonio.instrument.records import irradiance_uncertainty, metadata
from gonio.metadata import Plan

LAMBERT, WARD = models.get("lambert"), models.get("ward")
METAL = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2}
DOME_SEED = 11
QUIET = {"stray": 0.0, "entry_patch": 0.0}


def small(name="ideal12", n=52, *, rays=16, channels=None, **parts) -> Instrument:
    """A preset with n x n pixels over the same image circle, parts changed as given."""
    rig = preset(name)
    pitch = rig.sensor.columns * rig.sensor.pitch_um[0] / n
    sensor = {"rows": n, "columns": n, "pitch_um": (pitch, pitch), "binning": 1}
    parts["sensor"] = sensor | parts.get("sensor", {})
    changed = {part: getattr(rig, part).model_dump() | new for part, new in parts.items()}
    more = {"channels": channels} if channels else {}
    return Instrument.model_validate(rig.model_dump() | changed | {"rays_per_pixel": rays} | more)


def plan(theta_i_deg=(30.0,), **more) -> Plan:
    given = {"rotations_deg": (0.0,), "exposures_s": (1e-3,)} | more
    return Plan(theta_i_deg=theta_i_deg, **given)


def images(rig, planned=None, model=LAMBERT, **parameters) -> Images:
    p = model.vector(parameters or {"rho": 0.5})
    surface = Surface("", model, (p,) * len(rig.channels))
    return Images(rig, surface, planned or plan(), Fixed(DOME_SEED, 12), threads=1)


def expected(rig, planned=None, model=LAMBERT, **parameters) -> dict:
    """Noise-free images, e-/s, by role and incidence, of the first channel."""
    made = images(rig, planned, model, **parameters)
    lamp = np.ones(len(rig.channels))
    return {
        (role, incidence): made.rates(role, take, incidence, lamp)[0]
        for role, take, incidence in made.plan.images()
        if take == 0
    }


def inside(rig, theta_r_deg=75.0):
    """The pixels (rows, columns) that look at directions inside a cone."""
    rays = imaging.trace_rays(rig, DOME_SEED)
    mask = np.zeros(rig.sensor.shape, bool)
    mask.ravel()[rays.pixel] = rays.w_r[..., 2].min(axis=1) > np.cos(np.radians(theta_r_deg))
    return mask


def eq_2(rates, mask, incidence=0, standard=None, background=None):
    """(M - B)/(S - B') of some pixels, with the same incidence where no other is named."""
    standard = incidence if standard is None else standard
    background = standard if background is None else background
    signal = rates["sample", incidence] - rates["background", incidence]
    return signal[mask] / (rates["standard", standard] - rates["background", background])[mask]


class TestCoating:
    POINTS = 150 * unit_vectors(np.radians([0.0, 30.0, 60.0, 85.0]), 0.4)

    def fields(self, **variation):
        dome = preset("ideal12").dome.model_copy(update=variation)
        return np.array(
            [dome.coating(self.POINTS, np.random.default_rng(seed)) for seed in range(400)]
        )

    def test_mean_and_spread_are_the_stated_ones(self):
        found = self.fields(reflectance_variation=0.1, transmittance_variation=0.03)
        error = 4 / np.sqrt(400)
        for values, sd in zip(np.moveaxis(found, 1, 0), (0.1, 0.03), strict=True):
            np.testing.assert_allclose(values.mean(axis=0), 1, atol=error * sd)
            np.testing.assert_allclose(values.std(axis=0), sd, rtol=error)
            assert values.min() > 0
        between = np.corrcoef(found[:, 0, 0], found[:, 1, 0])[0, 1]
        assert abs(between) < error

    def test_is_smooth_over_its_correlation_length(self):
        found = self.fields(reflectance_variation=0.1, coating_correlation_deg=60.0)[:, 0]
        chord = 2 * np.sin(np.radians(30.0) / 2)
        alike = np.exp(-(chord**2) / 2 / np.radians(60.0) ** 2)
        correlation = np.corrcoef(found[:, 0], found[:, 1])[0, 1]
        assert correlation == pytest.approx(alike, abs=4 * (1 - alike**2) / np.sqrt(400))

    def test_an_even_coating_is_one(self):
        np.testing.assert_array_equal(self.fields(), 1)

    def test_belongs_to_the_dome_and_is_not_the_field_of_its_slopes(self):
        rig = small(dome={"reflectance_variation": 0.1})
        one, again, other = (imaging.trace_rays(rig, s).throughput for s in (1, 1, 2))
        np.testing.assert_array_equal(one, again)
        assert np.abs(one / other - 1).max() > 0.05

    def test_reflectance_scales_the_image_and_cancels(self):
        even, spotted = (
            small(dome={"reflectance_variation": v}, sensor={"prnu": 0.0}) for v in (0, 0.1)
        )
        rays = imaging.trace_rays(spotted, DOME_SEED)
        a, b = (expected(rig, model=WARD, **METAL) for rig in (even, spotted))
        field = imaging.coating_reflectance(spotted, rays.point, DOME_SEED)
        bright, dim = (image["sample", 0].ravel()[rays.pixel] for image in (b, a))
        np.testing.assert_allclose(bright, field * dim, rtol=1e-12)
        assert field.std() > 0.03
        mask = inside(even)
        np.testing.assert_allclose(eq_2(a, mask), eq_2(b, mask), rtol=1e-9)

    def test_transmittance_cancels_at_equal_incidence_only(self):
        rig = small(dome={"transmittance_variation": 0.1}, surroundings=QUIET)
        mask = inside(rig)
        same = eq_2(expected(rig, plan((20.0, 60.0))), mask, 1)
        np.testing.assert_allclose(same, 0.5 / 0.99, rtol=1e-9)
        once = eq_2(expected(rig, plan((60.0,), standard_theta_i_deg=20.0)), mask, 0, 0, 1)
        entry = [imaging.entry_transmittance(rig, np.radians(t), DOME_SEED) for t in (20, 60)]
        ratio = 0.5 * 0.5 / np.cos(np.radians(20)) * entry[1] / entry[0] / 0.99
        np.testing.assert_allclose(once, ratio, rtol=1e-9)
        assert abs(entry[1] / entry[0] - 1) > 1e-3

    def test_the_operator_knows_how_well_the_irradiance_is_known(self):
        rig = small(dome={"transmittance_variation": 0.02})
        assert irradiance_uncertainty(rig, plan()) is None
        once = plan(standard_theta_i_deg=20.0)
        assert irradiance_uncertainty(rig, once) == pytest.approx(0.02 * np.sqrt(2))
        below = plan(standard_theta_i_deg=20.0, mode="transmission")
        assert irradiance_uncertainty(rig, below) == pytest.approx(0.02)

    def test_the_beam_enters_where_it_points(self):
        dome = preset("ideal12").dome
        for theta_i in (-0.5, 0.0, 1.0):
            point = dome.entry_point(theta_i)
            w = point - [0.0, dome.D, 0.0]
            np.testing.assert_allclose(
                w / np.linalg.norm(w), unit_vectors(theta_i, 0.0), atol=1e-12
            )
            x, y, z = point
            assert (x**2 + z**2) / dome.R**2 + y**2 / dome.semi_axis_y**2 == pytest.approx(1)


class TestPupil:
    """Directions of an ellipsoid of R = 150 mm, D = 15 mm, whose camera stands elsewhere."""

    def directions(self, **lens):
        """Directions of the pixels, and weights in the measure of solid angle."""
        rig = small(n=104, rays=1, lens={"pupil_mm": 0.0, "vignetting": 0.0} | lens)
        rays = imaging.trace_rays(rig, 0)
        return rays.w_r[:, 0], rays.throughput

    # Median and largest error, deg, over theta_r <= 75 deg: two published digits.
    @pytest.mark.parametrize(
        ("lens", "median", "largest"),
        [
            ({"pupil_offset_mm": (0.0, 0.0, 1.0)}, 0.59, 0.75),
            ({"pupil_offset_mm": (0.0, 1.0, 0.0)}, 0.68, 0.76),
            ({"pupil_offset_mm": (1.0, 0.0, 0.0)}, 0.68, 0.77),
            ({"pupil_walk_mm": 2.0}, 0.38, 1.12),
        ],
    )
    def test_a_pupil_out_of_place_turns_directions(self, lens, median, largest):
        (nominal, weight), (moved, _) = self.directions(), self.directions(**lens)
        error = np.degrees(2 * np.arcsin(np.linalg.norm(moved - nominal, axis=1) / 2))
        use = nominal[:, 2] >= np.cos(np.radians(75))
        order = np.argsort(error[use])
        share = np.cumsum(weight[use][order]) / weight[use].sum()
        found = error[use][order][np.searchsorted(share, 0.5)]
        # The median hangs on whose solid angle weighs, the camera's or the sample's: 4 %.
        assert found == pytest.approx(median, abs=0.005 + 0.04 * median)
        assert error[use].max() == pytest.approx(largest, abs=0.005 + 0.02 * largest)

    def test_the_walk_grows_as_the_square_of_the_angle(self):
        lens = preset("ideal12").lens.model_copy(
            update={"pupil_walk_mm": 2.0, "pupil_offset_mm": (0.1, 0.2, 0.3)}
        )
        centre = lens.pupil_centre(np.radians([0.0, 45.0, 90.0]), 15.0)
        np.testing.assert_allclose(centre[:, :2], [[0.1, -14.8]] * 3)
        np.testing.assert_allclose(centre[:, 2], [0.3, 0.8, 2.3])

    def test_a_turned_camera_sees_turned_directions(self):
        # Camera and target together: what a pixel sees turns with the camera.
        rigs = [
            small(rays=1, lens={"azimuth_deg": a, "pupil_mm": 0.0}, dome={"D": 1e-9})
            for a in (0.0, 10.0)
        ]
        straight, turned = (imaging.trace_rays(rig, 0).w_r[:, 0] for rig in rigs)
        (theta, phi), (theta_t, phi_t) = angles(straight), angles(turned)
        np.testing.assert_allclose(theta_t, theta, atol=1e-9)
        by = np.degrees((phi_t - phi + np.pi) % (2 * np.pi) - np.pi)
        np.testing.assert_allclose(by[theta > 0.1], 10, atol=1e-6)

    def test_a_moved_image_is_the_same_image_elsewhere(self):
        # Two binned pixels to the right and one up: six and minus three unbinned ones.
        parts = {"sensor": {"prnu": 0.0, "rows": 156, "columns": 156, "binning": 3}}
        pitch = 1664 * 3.45 / 156
        parts["sensor"]["pitch_um"] = (pitch, pitch)
        still = small(surroundings=QUIET, **parts)
        parts["sensor"]["centre_offset_px"] = (6.0, -3.0)
        moved = small(surroundings=QUIET, **parts)
        a, b = (expected(rig, model=WARD, **METAL)["sample", 0] for rig in (still, moved))
        np.testing.assert_allclose(b[:-1, 2:], a[1:, :-2], rtol=1e-9, atol=1e-9 * a.max())
        assert moved.sensor.centre_px() == pytest.approx((25.5 + 2, 25.5 - 1))

    @pytest.mark.parametrize("known", [False, True])
    def test_the_session_states_what_the_operator_knows(self, known):
        lens = {
            "pupil_offset_mm": (0.1, -0.2, 0.3), "pupil_walk_mm": 1.5, "azimuth_deg": 0.7,
            "alignment_known": known,
        }  # fmt: skip
        record = metadata(
            small(lens=lens, sensor={"centre_offset_px": (3.0, 4.0)}), plan(), "tile", ""
        )
        geometry = record.geometry
        assert geometry.pupil_mm == ((0.1, -0.2, 0.3) if known else (0, 0, 0))
        assert geometry.pupil_walk_mm == (1.5 if known else 0)
        assert geometry.camera_azimuth_deg == (0.7 if known else 0)
        assert record.lens.centre_px == ((28.5, 29.5) if known else None)

    def test_a_pupil_outside_the_dome_is_refused(self):
        with pytest.raises(ValueError, match=r"pupil lies up to 150.7 mm .* stay inside R = 150"):
            small(lens={"pupil_offset_mm": (0.0, 0.0, 150.0)})


class TestBeam:
    LAMP = Lamp(
        white_rate_e_per_s=1.0, half_angle_deg=0.5, lit_diameter_mm=20.0, drift=0, edge_falloff=0.4
    )

    def test_falls_off_towards_its_edge(self):
        u = self.LAMP.lit(0.0, np.array([0.0, 5.0, 9.999, 10.001]), np.zeros(4))
        np.testing.assert_allclose(u, [1, 1 - 0.4 / 4, 0.6, 0], atol=1e-4)

    @pytest.mark.parametrize("theta_i", [0.0, 1.0])
    def test_loses_half_the_edge_falloff_on_the_whole(self, theta_i):
        side = np.linspace(-40, 40, 1601)
        x, y = np.meshgrid(side, side)
        u = self.LAMP.lit(theta_i, x, y)
        # The mean of r^2/R^2 over a disc is 1/2, and so over its projection.
        assert u[u > 0].mean() == pytest.approx(0.8, abs=1e-3)

    def test_cancels_where_the_standard_lies_in_the_same_beam(self):
        # A sphere: rays land up to 3 mm from the target.
        even, uneven = (
            small(dome={"shape": "sphere"}, lamp={"edge_falloff": e}, surroundings=QUIET)
            for e in (0.0, 0.5)
        )
        mask = inside(even)
        a, b = (expected(rig) for rig in (even, uneven))
        change = b["sample", 0][mask] / a["sample", 0][mask]
        assert change.min() < 0.95
        assert change.max() <= 1
        np.testing.assert_allclose(eq_2(b, mask), eq_2(a, mask), rtol=1e-9)


class TestHolder:
    def test_tilting_a_frame_takes_its_axis_along(self):
        v = np.random.default_rng(1).normal(size=(50, 3))
        for azimuth in (0.0, 1.0, -2.5):
            turned = tilted(v, 0.2, azimuth)
            np.testing.assert_allclose(turned @ turned.T, v @ v.T, atol=1e-12)
            axis = unit_vectors(0.2, azimuth)
            np.testing.assert_allclose(turned[:, 2], v @ axis, atol=1e-12)
            np.testing.assert_allclose(tilted(turned, -0.2, azimuth), v, atol=1e-12)

    def test_a_tilted_sample_shines_twice_the_tilt_aside(self):
        rig = small(n=208, holder={"tilt_deg": 5.0, "tilt_azimuth_deg": 90.0}, surroundings=QUIET)
        lobe = {"rho_d": 0.0, "rho_s": 0.2, "alpha_x": 0.02, "alpha_y": 0.02}
        rate = expected(rig, plan((0.0,)), WARD, **lobe)["sample", 0]
        rays = imaging.trace_rays(rig, DOME_SEED)
        bright = rate.ravel()[rays.pixel] > 0.5 * rate.max()
        theta_r, phi_r = angles(rays.w_r[bright].mean(axis=(0, 1)))
        # Pixels of 0.9 deg.
        assert np.degrees(theta_r) == pytest.approx(10, abs=0.2)
        assert np.degrees(phi_r) == pytest.approx(90, abs=1)

    def test_a_tilted_sample_is_lit_under_another_angle(self):
        for azimuth, cosine in ((0.0, np.cos(np.radians(25))), (180.0, np.cos(np.radians(35)))):
            rig = small(holder={"tilt_deg": 5.0, "tilt_azimuth_deg": azimuth})
            assert imaging.irradiance(rig, np.radians(30), 0) == pytest.approx(cosine)

    def test_on_a_sample_too_high_the_spot_moves_towards_the_lamp(self):
        # One ray a pixel; the sphere sends them to places up to 9 mm from the target.
        rig = small(
            n=104, rays=1, dome={"shape": "sphere", "D": 22.5}, lens={"pupil_mm": 0.0},
            lamp={"lit_diameter_mm": 6.0}, holder={"height_mm": 4.0},
        )  # fmt: skip
        rays = imaging.trace_rays(rig, 0)
        theta_i = np.radians(50)
        lit = imaging.lit_weights(rig, rays, theta_i)[:, 0] > 0
        # The beam's axis passes through the target: where is it at the height of the surface?
        x, y = rays.landing[:, 0].T
        distance = np.hypot((x - 4 * np.tan(theta_i)) * np.cos(theta_i), y)
        np.testing.assert_array_equal(lit, (distance <= 3.0) & (rays.w_r[:, 0, 2] > 0))
        assert 0 < lit.sum() < lit.size
        # And the rays meet the surface, not the plane below it.
        flat = imaging.trace_rays(small(
            n=104, rays=1, dome={"shape": "sphere", "D": 22.5}, lens={"pupil_mm": 0.0},
        ), 0)  # fmt: skip
        w = rays.w_r[:, 0]
        good = w[:, 2] > 0.1
        step = 4 * w[good, :2] / w[good, 2:]
        np.testing.assert_allclose((rays.landing - flat.landing)[good, 0], step, atol=1e-9)

    def test_a_level_holder_changes_nothing(self):
        v = np.ones((4, 3))
        assert Holder(sample_diameter_mm=10.0).on_surface(v) is v


class TestPointSpread:
    @pytest.mark.parametrize("sd", [0.15, 0.6, 2.0, 7.5])
    def test_keeps_the_light_and_has_its_variance(self, sd):
        image = np.zeros((201, 181))
        image[100, 90] = 3.0
        spread = imaging.point_spread(image, sd)
        assert spread.sum() == pytest.approx(3.0, rel=1e-12)
        assert spread.min() >= 0
        rows, columns = np.indices(image.shape)
        for axis, centre in ((rows, 100), (columns, 90)):
            assert np.sum(axis * spread) / 3 == pytest.approx(centre, abs=1e-9)
            variance = np.sum((axis - centre) ** 2 * spread) / 3
            assert variance == pytest.approx(sd**2, rel=1e-7)

    def test_is_a_gaussian_where_pixels_are_small(self):
        image = np.zeros((101, 101))
        image[50, 50] = 1.0
        row = imaging.point_spread(image, 6.0)[50, 50:70]
        gauss = np.exp(-(np.arange(20.0) ** 2) / 2 / 36) / (2 * np.pi * 36)
        # The next term is 1/(4 sd^2) of the peak, and those that follow a tenth of it.
        np.testing.assert_allclose(row, gauss, atol=1.1 * gauss[0] / (4 * 36))

    def test_loses_no_light_at_the_edges(self):
        image = np.random.default_rng(1).uniform(0, 1, (30, 40))
        assert imaging.point_spread(image, 4.0).sum() == pytest.approx(image.sum(), rel=1e-12)

    def test_none_is_none(self):
        image = np.ones((3, 3))
        assert imaging.point_spread(image, 0.0) is image

    def test_of_an_instrument_is_given_in_unbinned_pixels(self):
        sensor = {"rows": 208, "columns": 208, "pitch_um": (27.6, 27.6), "binning": 4, "prnu": 0.0}
        sharp, soft = (
            small(surroundings=QUIET, sensor=sensor, lens={"psf_px": psf}) for psf in (0.0, 6.0)
        )
        a, b = (expected(rig, model=WARD, **METAL)["sample", 0] for rig in (sharp, soft))
        np.testing.assert_allclose(b, imaging.point_spread(a, 1.5), rtol=1e-12, atol=1e-6)
        assert abs(b - a).max() > 0.01 * a.max()


class TestAmbient:
    def test_reflected_room_light_needs_a_sample(self):
        parts = {"ambient": 0.02, "ambient_reflected": 0.03} | QUIET
        dark = small(surroundings=QUIET, sensor={"prnu": 0.0})
        lit = small(surroundings=parts, sensor={"prnu": 0.0})
        a, b = expected(dark, rho=0.4), expected(lit, rho=0.4)
        white = np.zeros(dark.sensor.shape)
        rays = imaging.trace_rays(dark, DOME_SEED)
        white.ravel()[rays.pixel] = imaging.white_rate(dark, rays)
        mask = inside(dark, 84)
        for role, share in (
            ("background", 0.02), ("standard", 0.02 + 0.03 * 0.99), ("sample", 0.02 + 0.03 * 0.4),
        ):  # fmt: skip
            more = b[role, 0] - a[role, 0]
            # A Lambertian surface in even light: the table is exact.
            np.testing.assert_allclose(more[mask], share * white[mask], rtol=1e-6)

    def test_it_does_not_cancel(self):
        rig = small(surroundings=QUIET | {"ambient_reflected": 0.05})
        mask = inside(rig)
        # (rho cos + a rho)/(0.99 cos + a 0.99) is right for a Lambertian sample ...
        np.testing.assert_allclose(eq_2(expected(rig), mask), 0.5 / 0.99, rtol=1e-6)
        # ... and not for a metal.
        clean = small(surroundings=QUIET)
        a, b = (eq_2(expected(each, model=WARD, **METAL), mask) for each in (clean, rig))
        assert np.max(abs(b / a - 1)) > 0.03

    def test_a_surface_in_even_light_shows_its_albedo(self):
        p = WARD.vector({"rho_d": 0.2, "rho_s": 0.3, "alpha_x": 0.08, "alpha_y": 0.3})
        theta, phi, weight = hemisphere_quadrature(128, 256)
        w_i = unit_vectors(theta, phi)
        directions = unit_vectors(np.radians([0.0, 33.0, 61.0, 75.0]), [0.0, 1.0, 2.2, -2.0])
        found = imaging.even_light_reflectance(WARD, p, directions)
        # Light from everywhere: the integral of f cos over the incident directions.
        for w, value in zip(directions, found, strict=True):
            f = WARD.evaluate(w_i, np.broadcast_to(w, w_i.shape), p)
            # Linear in tables of 4 and 30 deg.
            assert value == pytest.approx(np.sum(f * w_i[:, 2] * weight), rel=0.02)


class TestFixedPatterns:
    SENSOR = preset("modern12").sensor

    def sensor(self, **changed):
        return Sensor.model_validate(self.SENSOR.model_dump() | changed)

    @pytest.mark.parametrize("binning", [1, 4])
    def test_dead_and_hot_pixels_are_as_many_as_stated(self, binning):
        sensor = self.sensor(dead_fraction=0.003, hot_fraction=0.01, binning=binning)
        dead, hot = sensor.bad_pixels(5)
        n = sensor.rows * sensor.columns
        for found, fraction in ((dead, 0.003), (hot, 0.01 * 0.997)):
            assert abs(found.sum() - n * fraction) < 4 * np.sqrt(n * fraction)
        assert dead.max() <= binning**2
        np.testing.assert_array_equal(sensor.bad_pixels(5)[0], dead)
        assert np.any(sensor.bad_pixels(6)[0] != dead)

    def test_a_dead_pixel_sees_nothing_at_all(self):
        sensor = self.sensor(dead_fraction=0.01, binning=1, dsnu_e_per_s=1.0)
        dead, _ = sensor.bad_pixels(5)
        response, dark = sensor.response(5), sensor.dark_current(5)
        assert np.all(response[dead > 0] == 0)
        assert np.all(dark[dead > 0] == 0)
        assert np.all(response[dead == 0] > 0.9)

    def test_a_bin_loses_the_share_of_its_dead_pixels(self):
        sensor = self.sensor(dead_fraction=0.05)
        dead, _ = sensor.bad_pixels(5)
        ratio = sensor.response(5) / self.SENSOR.response(5)
        np.testing.assert_allclose(ratio, 1 - dead / 16, rtol=1e-12)

    def test_without_bad_pixels_the_pattern_is_prnu_alone(self):
        np.testing.assert_array_equal(
            self.sensor(hot_fraction=0.01, hot_e_per_s=9.0).response(5), self.SENSOR.response(5)
        )
        dead, hot = self.SENSOR.bad_pixels(5)
        assert not dead.any()
        assert not hot.any()
        np.testing.assert_array_equal(self.SENSOR.dark_current(5), 2.0 * 16)

    @pytest.mark.parametrize("binning", [1, 4])
    def test_dark_current_has_the_stated_mean_and_spread(self, binning):
        sensor = self.sensor(dsnu_e_per_s=3.0, binning=binning)
        dark = sensor.dark_current(5)
        n = binning**2
        assert dark.min() >= 0
        # Independent pixels: sums of n have n times the mean and the variance.
        variance = 9.0 * n
        assert abs(dark.mean() - 2.0 * n) < 4 * np.sqrt(variance / dark.size)
        fourth = np.mean((dark - dark.mean()) ** 4)
        assert abs(dark.var() - variance) < 4 * np.sqrt((fourth - variance**2) / dark.size)

    def test_hot_pixels_glow(self):
        sensor = self.sensor(hot_fraction=0.02, hot_e_per_s=500.0, binning=1)
        _, hot = sensor.bad_pixels(5)
        dark = sensor.dark_current(5)
        np.testing.assert_allclose(dark[hot == 0], 2.0)
        glow = dark[hot > 0] - 2.0
        assert abs(glow.mean() - 500) < 4 * 500 / np.sqrt(glow.size)

    def test_patterns_are_independent_of_each_other(self):
        sensor = self.sensor(dsnu_e_per_s=1.0)
        a, b = sensor.response(5).ravel(), sensor.dark_current(5).ravel()
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(a.size)

    def test_dark_current_that_varies_about_nothing_is_refused(self):
        with pytest.raises(ValueError, match="dsnu_e_per_s needs a dark current that varies"):
            self.sensor(dsnu_e_per_s=1.0, dark_e_per_s=0.0)


class TestManyBits:
    """Counts of 14 bits, 16 of them summed and divided by 4 to fit into 16 bits."""

    SENSOR = preset("modern14").sensor

    def test_figures(self):
        s = self.SENSOR
        assert s.saturation_dn == 16 * 16383 // 4 == 65532
        assert s.binned_gain_dn_per_e == pytest.approx(0.08)
        assert s.binned_black_dn == 1024

    @pytest.mark.parametrize("electrons", [0.0, 3.0, 2000.0, 70_000.0])
    def test_equals_the_explicit_sum(self, electrons):
        s, rng, n = self.SENSOR, np.random.default_rng(3), 20_000
        e = np.minimum(rng.poisson(electrons, (16, n)), s.full_well_e)
        counts = np.round(s.gain_dn_per_e * (e + rng.normal(0, s.read_noise_e, e.shape))
                          + s.black_dn)  # fmt: skip
        # Quarters, halves rounded up: an eighth of a count more, which belongs to the black level.
        many = np.floor(np.clip(counts, 0, 2**14 - 1).sum(axis=0) / 4 + 0.5) - 0.125
        readout = s.readout() | {"seed": 1, "frame": 0, "threads": 1}
        one = expose(np.full((1, 200_000), 16 * electrons), 1.0, **readout)[0].astype(float)
        error = np.sqrt(one.var() / one.size + many.var() / n)
        assert abs(one.mean() - many.mean()) <= 4 * error
        assert one.var() == pytest.approx(many.var(), rel=4 * np.sqrt(2 / n))

    def test_too_many_bits_say_what_to_do(self):
        with pytest.raises(ValueError, match="exceed 16 bits a frame; a binned_divisor of 4 or"):
            Sensor.model_validate(self.SENSOR.model_dump() | {"binned_divisor": 3})


class TestDrift:
    def draws(self, planned=None, channels=None, **lamp):
        rig = small(lamp=lamp, channels=channels)
        planned = planned or plan(tuple(np.linspace(0, 70, 60)), repeats=20)
        if channels:
            planned = planned.model_copy(update={"channels": channels})
        return Realisation.from_seed(3, rig, planned)

    def test_of_images_is_white_and_a_slow_one_walks(self):
        n = 2 * 20 * 60 + 60
        fast = self.draws(drift=0.01).lamp[:, 0]
        slow = self.draws(slow_drift=0.01).lamp[:, 0]
        assert fast.shape == slow.shape == (n,)
        assert np.std(fast) == pytest.approx(0.01, rel=4 / np.sqrt(2 * n))
        steps = np.diff(np.log(slow))
        assert np.std(steps) == pytest.approx(0.01, rel=4 / np.sqrt(2 * n))
        assert abs(np.corrcoef(steps[1:], steps[:-1])[0, 1]) < 4 / np.sqrt(n)
        assert abs(np.corrcoef(fast[1:], fast[:-1])[0, 1]) < 4 / np.sqrt(n)

    def test_a_slow_drift_is_drawn_after_all_else(self):
        one, two = self.draws(drift=0.01), self.draws(drift=0.01, slow_drift=0.01)
        assert one.noise_seed == two.noise_seed
        assert not np.allclose(one.lamp, two.lamp)

    def test_channels_share_the_slow_drift(self):
        channels = ({"name": "red"}, {"name": "blue"})
        slow = self.draws(slow_drift=0.01, channels=channels).lamp
        np.testing.assert_array_equal(slow[:, 0], slow[:, 1])
        fast = self.draws(drift=0.01, channels=channels).lamp
        assert abs(np.corrcoef(fast.T)[0, 1]) < 4 / np.sqrt(len(fast))
        # The first channel draws what it would draw alone.
        np.testing.assert_array_equal(fast[:, 0], self.draws(drift=0.01).lamp[:, 0])

    def test_the_record_holds_both(self):
        rig = small(lamp={"drift": 0.003, "slow_drift": 0.002})
        record = metadata(rig, plan(tuple(range(0, 63, 7))), "", "").lamp
        # Nine steps of the arm lie between an image of the standard and one of the sample.
        assert record.drift == pytest.approx(np.hypot(0.003, 0.002 * 3))


class TestChannels:
    FILTERS = ({"name": "red", "wavelength_nm": 620.0, "relative_rate": 0.8},
               {"name": "green", "wavelength_nm": 530.0, "relative_rate": 1.0},
               {"name": "blue", "relative_rate": 0.25})  # fmt: skip

    def test_each_has_its_rate_and_its_parameters(self):
        rig = small(channels=self.FILTERS, surroundings=QUIET)
        surface = Surface("", LAMBERT, tuple(np.array([rho]) for rho in (0.1, 0.4, 0.4)))
        three = plan(channels=[{"name": f["name"]} for f in self.FILTERS])
        made = Images(rig, surface, three, Fixed(1, 2), threads=1)
        red, green, blue = made.rates("sample", 0, 0, [1.0, 1.0, 1.1])
        mask = inside(rig)
        np.testing.assert_allclose(red[mask] / green[mask], 0.8 * 0.1 / 0.4, rtol=1e-12)
        np.testing.assert_allclose(blue[mask] / green[mask], 0.25 * 1.1, rtol=1e-12)

    def test_one_value_or_one_for_each(self):
        rig = small(channels=self.FILTERS)
        given = {"rho_d": (0.1, 0.2, 0.3), "rho_s": 0.05}
        vectors = simulation.parameter_vectors(rig, WARD, given)
        assert [p[0] for p in vectors] == [0.1, 0.2, 0.3]
        assert [p[1] for p in vectors] == [0.05] * 3
        with pytest.raises(ConfigurationError, match="rho_d has 2 values and ideal12 has 3 ch"):
            simulation.parameter_vectors(rig, WARD, {"rho_d": (0.1, 0.2)})

    def test_must_differ_in_name(self):
        with pytest.raises(ValueError, match="channels must have different names"):
            small(channels=(Filter(), Filter()))

    def test_surfaces_that_look_alike_in_red_only_are_turned_too(self):
        values = {"alpha_x": (0.1, 0.2), "alpha_y": 0.1}
        assert is_anisotropic(WARD, values)
        assert not is_anisotropic(WARD, values | {"alpha_y": (0.1, 0.2)})


class TestTransmission:
    PLAN = plan((0.0, 40.0, 65.0), mode="transmission", standard_theta_i_deg=45.0)

    def test_the_ratio_of_images_is_the_btdf(self):
        rig = small(dome={"transmittance": 0.4, "reflectance": 0.5})
        made = images(rig, self.PLAN, WARD, **METAL)
        rates = expected(rig, self.PLAN, WARD, **METAL)
        mask = inside(rig, 70)
        for incidence, theta_deg in enumerate(self.PLAN.theta_i_deg):
            # E_std/E_t = T_d cos(theta_std)/cos(theta_i): the lamp below passes no dome.
            ratio = eq_2(rates, mask, incidence, 0, 3)
            e_ratio = 0.4 * np.cos(np.radians(45)) / np.cos(np.radians(theta_deg))
            f = ratio * e_ratio * 0.99 / np.pi
            # Light that goes straight through leaves where a mirror would send it.
            w_i = unit_vectors(np.radians(theta_deg), 0.0)
            w_r = made.rays.w_r
            full = WARD.evaluate(np.broadcast_to(w_i, w_r.shape), w_r, WARD.vector(METAL))
            image = np.zeros(rig.sensor.shape)
            image.ravel()[made.rays.pixel] = full.mean(axis=1)
            # The entry patch of the standard's incidence is not in the sample's background.
            np.testing.assert_allclose(f, image[mask], rtol=1e-9)

    def test_a_clear_sheet_sends_light_straight_through(self):
        rig = small(n=208, surroundings=QUIET)
        clear = {"rho_d": 0.0, "rho_s": 0.2, "alpha_x": 0.02, "alpha_y": 0.02}
        rate = expected(rig, self.PLAN, WARD, **clear)["sample", 1]
        rays = imaging.trace_rays(rig, DOME_SEED)
        bright = rate.ravel()[rays.pixel] > 0.5 * rate.max()
        w = rays.w_r[bright].mean(axis=(0, 1))
        lamp = np.array([np.sin(np.radians(40)), 0, -np.cos(np.radians(40))])
        # A pixel is 0.9 deg; the direction is that in which the light travels, away from the lamp.
        assert np.degrees(np.arccos(-lamp @ w / np.linalg.norm(w))) < 0.45

    def test_the_lamp_below_leaves_no_entry_patch(self):
        rig = small(n=104, surroundings={"stray": 0.0, "entry_patch": 3.0})
        rates = expected(rig, self.PLAN)
        assert all(rates["background", k].max() == 0 for k in range(3))
        assert rates["background", 3].max() > 0

    def test_nothing_goes_round_twice_that_nobody_knows(self):
        quiet, loud = (
            small(surroundings=QUIET | {"multibounce": g}) for g in (0.0, 0.05)
        )  # fmt: skip
        a, b = (expected(rig, self.PLAN) for rig in (quiet, loud))
        np.testing.assert_array_equal(a["sample", 1], b["sample", 1])
        assert np.any(a["standard", 0] != b["standard", 0])
