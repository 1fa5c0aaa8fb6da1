"""Image formation: where light goes, how much of it, and how sharp the lobe stays."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from gonio import models
from gonio.geometry import angles, hemisphere_quadrature, unit_vectors
from gonio.instrument import Instrument, imaging, preset
from gonio.instrument.images import Fixed, Images, Surface
from gonio.metadata import Plan

LAMBERT, WARD = models.get("lambert"), models.get("ward")


def small(name="ideal12", n=104, **parts) -> Instrument:
    """A preset with n x n pixels over the same image circle, parts changed as given."""
    rig = preset(name)
    pitch = rig.sensor.columns * rig.sensor.pitch_um[0] / n
    sensor = {"rows": n, "columns": n, "pitch_um": (pitch, pitch), "binning": 1}
    parts = {"sensor": {}, **parts}
    parts["sensor"] = sensor | parts["sensor"]
    changed = {
        part: getattr(rig, part).model_copy(update=update)
        for part, update in parts.items()
        if isinstance(update, dict)
    }
    return Instrument.model_validate(
        rig.model_copy(update=changed).model_dump()
        | {key: value for key, value in parts.items() if not isinstance(value, dict)}
    )


NO_STRAY = {"stray": 0.0, "entry_patch": 0.0}


def expected_rates(rig, model, theta_i_deg, psi_deg=0.0, **parameters):
    """Noise-free images, e-/s, by role."""
    plan = Plan(theta_i_deg=(theta_i_deg,), rotations_deg=(psi_deg,), exposures_s=(1.0,))
    surface = Surface("", model, (model.vector(parameters),))
    made = Images(rig, surface, plan, Fixed(dome_seed=1, pattern_seed=2), threads=1)
    return {image[0]: made.rates(*image, [1.0])[0] for image in plan.images()}


def directions(rig):
    """theta_r, phi_r of the pixels' chief rays (rows, columns); NaN off the image circle."""
    x, y = np.meshgrid(*rig.sensor.positions_mm())
    return rig.dome.reflected_angles(rig.lens.polar_angle(np.hypot(x, y)), np.arctan2(y, x))


class TestRayPattern:
    @pytest.mark.parametrize("n", [16, 64])
    def test_moments_are_those_of_the_square_and_the_discs(self, n):
        pixel, pupil, source = imaging.ray_pattern(n)
        both = np.concatenate([pixel, pupil, source], axis=1)
        assert both.shape == (n, 6)
        np.testing.assert_allclose(both.mean(axis=0), 0, atol=1e-14)
        # Uniform on a side of 1: 1/12. Uniform on a disc of radius 1: 1/4 an axis.
        expected = np.diag([1 / 12] * 2 + [1 / 4] * 4)
        np.testing.assert_allclose(both.T @ both / n, expected, atol=1e-13)

    @pytest.mark.parametrize("n", [16, 32])
    def test_few_rays_give_a_lobe_no_skew(self, n):
        both = np.concatenate(imaging.ray_pattern(n), axis=1)
        # All third moments of a symmetric source are 0: x^3, x^2 y and x y z.
        third = np.einsum("na,nb,nc->abc", both, both, both) / n
        np.testing.assert_allclose(third, 0, atol=1e-14)

    @pytest.mark.parametrize("n", [16, 32, 64, 256])
    def test_pupil_and_source_are_discs(self, n):
        _, pupil, source = imaging.ray_pattern(n)
        if n in (16, 32):
            assert np.hypot(*pupil.T).max() < 1.1
            assert np.hypot(*source.T).max() < 1.1
        # E r^4 of a uniform disc is 1/3; the few rays of an image know it to a quarter.
        for disc in (pupil, source):
            assert np.mean(np.sum(disc**2, axis=1) ** 2) == pytest.approx(1 / 3, rel=0.25)

    def test_one_ray_is_the_chief_ray(self):
        assert all(np.all(part == 0) for part in imaging.ray_pattern(1))

    def test_is_always_the_same(self):
        for a, b in zip(imaging.ray_pattern(16), imaging.ray_pattern(16), strict=True):
            np.testing.assert_array_equal(a, b)


class TestRadiometry:
    @pytest.mark.parametrize("theta_i", [0.0, 40.0, 75.0])
    def test_a_lambertian_sample_is_as_bright_as_cosine_and_reflectance_say(self, theta_i):
        rig = small(surroundings=NO_STRAY, sensor={"prnu": 0.0})
        rate = expected_rates(rig, LAMBERT, theta_i, rho=0.37)["sample"]
        # White standard at normal incidence through a dome of T R = 0.45^2, lens falloff and the
        # solid angle of the pixel on top.
        x, y = np.meshgrid(*rig.sensor.positions_mm())
        theta_c = rig.lens.polar_angle(np.hypot(x, y))
        falloff = rig.lens.relative_illumination(theta_c) * rig.lens.solid_angle(theta_c)
        expected = 9.9e5 * 0.45**2 * falloff * np.cos(np.radians(theta_i)) * 0.37
        inside = directions(rig)[0] < np.radians(85)
        assert inside.sum() > 5000
        np.testing.assert_allclose(rate[inside], expected[inside], rtol=1e-12)
        assert np.all(rate[np.isnan(theta_c)] == 0)

    def test_eq_2_gives_back_the_brdf_of_a_lambertian_sample(self):
        rig = small(surroundings=NO_STRAY | {"stray": 0.01})
        rate = expected_rates(rig, LAMBERT, 30.0, rho=0.5)
        inside = directions(rig)[0] < np.radians(85)
        m, s, b = (rate[role][inside] for role in ("sample", "standard", "background"))
        np.testing.assert_allclose((m - b) / (s - b) * 0.99 / np.pi, 0.5 / np.pi, rtol=1e-12)

    def test_multiple_reflections_add_g_times_the_albedo(self):
        quiet, loud = (
            expected_rates(
                small(surroundings=NO_STRAY | {"multibounce": g}), LAMBERT, 30.0, rho=0.6
            )["sample"]
            for g in (0.0, 0.05)
        )
        lit = quiet > 0
        np.testing.assert_allclose(loud[lit] / quiet[lit], 1 + 0.05 * 0.6, rtol=1e-10)

    def test_albedo_of_ward_at_normal_incidence_is_nearly_rho_d_plus_rho_s(self):
        # The lobe's normalisation holds there to order alpha^2, with a coefficient of some units.
        missing = []
        for alpha in (0.05, 0.1):
            p = WARD.vector({"rho_d": 0.2, "rho_s": 0.3, "alpha_x": alpha, "alpha_y": alpha})
            missing.append(0.5 - imaging.albedo(WARD, p, np.array([0.0, 0.0, 1.0])))
            assert 0 < missing[-1] < 0.3 * 5 * alpha**2
        assert missing[1] / missing[0] == pytest.approx(4, rel=0.1)

    def test_stray_light_does_not_need_the_sample(self):
        rig = small(surroundings=NO_STRAY | {"stray": 1e-3}, sensor={"prnu": 0.0})
        background = expected_rates(rig, LAMBERT, 20.0, rho=1.0)["background"]
        white = expected_rates(
            small(surroundings=NO_STRAY, sensor={"prnu": 0.0}), LAMBERT, 0.0, rho=1.0
        )["sample"]
        inside = directions(rig)[0] < np.radians(85)
        np.testing.assert_allclose(background[inside], 1e-3 * white[inside], rtol=1e-12)

    def test_ambient_light_is_in_every_frame(self):
        rig = small(surroundings=NO_STRAY | {"ambient": 0.01}, sensor={"prnu": 0.0})
        rate = expected_rates(rig, LAMBERT, 0.0, rho=1.0)
        inside = directions(rig)[0] < np.radians(85)
        ratio = rate["sample"][inside] / rate["background"][inside]
        np.testing.assert_allclose(ratio, 101, rtol=1e-12)


class TestPlaces:
    @pytest.mark.parametrize("theta_i", [20.0, 50.0])
    def test_the_entry_patch_lies_at_the_retro_direction(self, theta_i):
        rig = small(n=208, surroundings={"stray": 0.0, "entry_patch": 3.0, "multibounce": 0.0})
        patch = expected_rates(rig, LAMBERT, theta_i, rho=0.5)["background"] > 0
        theta_r, phi_r = (a[patch] for a in directions(rig))
        w = unit_vectors(theta_r, phi_r)
        # Pixels of 0.9 deg; a beam of 16 mm opens a patch of 3.05 deg radius on the dome.
        centre = w.mean(axis=0) / np.linalg.norm(w.mean(axis=0))
        lamp = unit_vectors(np.radians(theta_i), 0.0)
        assert np.degrees(np.arccos(centre @ lamp)) < 0.45
        assert np.degrees(np.arccos((w @ lamp).min())) < 3.05 + 0.7
        assert np.median(np.nonzero(patch)[1]) > 104  # right of the middle: phi = 0

    @pytest.mark.parametrize("theta_i", [0.0, 35.0, 60.0])
    def test_a_mirror_like_sample_shines_opposite_the_lamp(self, theta_i):
        rig = small(n=208, surroundings=NO_STRAY)
        lobe = {"rho_d": 0.0, "rho_s": 0.2, "alpha_x": 0.02, "alpha_y": 0.02}
        rate = expected_rates(rig, WARD, theta_i, **lobe)["sample"]
        theta_r, phi_r = directions(rig)
        bright = rate > 0.5 * rate.max()
        w = unit_vectors(theta_r[bright], phi_r[bright])
        centre = w.mean(axis=0) / np.linalg.norm(w.mean(axis=0))
        peak = unit_vectors(np.radians(theta_i), np.pi)
        # Half a pixel is 0.45 deg. At 60 deg Ward's 1/sqrt(cos) leans the lobe by
        # alpha^2 tan(theta_r) ~ 0.04 deg more.
        assert np.degrees(np.arccos(min(centre @ peak, 1.0))) < 0.45
        rows, columns = np.nonzero(bright)
        if theta_i > 0:
            assert columns.mean() < 103.5  # left of the middle: phi = 180 deg
        else:
            assert rows.mean() > 103.5  # the target's normal is seen below the middle

    def test_a_turned_anisotropic_sample_turns_its_highlight_the_right_way(self):
        # Camera and target all but together: the picture is the hemisphere itself, x to the
        # right, y down, phi from x towards y. Rough in the sample's y, so the highlight of
        # normal incidence is a streak along phi = 90 deg of the sample, turned by psi = 30 deg.
        rig = small(n=208, surroundings=NO_STRAY, dome={"D": 1e-3})
        lobe = {"rho_d": 0.0, "rho_s": 0.2, "alpha_x": 0.05, "alpha_y": 0.15}
        rate = expected_rates(rig, WARD, 0.0, psi_deg=30.0, **lobe)["sample"]
        rows, columns = np.indices(rate.shape) - 103.5
        xx, yy, xy = (np.sum(rate * m) for m in (columns**2, rows**2, rows * columns))
        streak = np.degrees(0.5 * np.arctan2(2 * xy, xx - yy)) % 180
        assert streak == pytest.approx(120, abs=0.2)

    def test_the_lit_spot_grows_along_x_with_incidence(self):
        lamp = preset("ideal12").lamp
        side = np.linspace(-60, 60, 1201)
        x, y = np.meshgrid(side, side)
        for theta_i in (0.0, 45.0, 60.0):
            spot = lamp.lit(np.radians(theta_i), x, y)
            # An ellipse of 8 mm by 8 mm / cos; counted on a grid of 0.1 mm.
            area = np.pi * 8**2 / np.cos(np.radians(theta_i))
            assert spot.sum() * 0.01 == pytest.approx(area, rel=0.01)
            half_width = np.abs(x[spot > 0]).max()
            assert half_width == pytest.approx(8 / np.cos(np.radians(theta_i)), abs=0.11)
            assert np.abs(y[spot > 0]).max() == pytest.approx(8, abs=0.11)

    def test_rays_that_miss_the_spot_do_not_count(self):
        # On the sphere chief rays land up to 0.06 R = 9 mm away from the target.
        rig = small(dome={"shape": "sphere", "D": 22.5}, lamp={"lit_diameter_mm": 10.0})
        rays = imaging.trace_rays(rig, 1)
        weight = imaging.lit_weights(rig, rays, 0.0).sum(axis=1)
        far = np.linalg.norm(rays.landing, axis=-1)
        assert np.all(weight[far.min(axis=1) > 5.0] == 0)
        np.testing.assert_allclose(weight[far.max(axis=1) <= 5.0], 1, rtol=1e-12)
        assert np.any(weight == 0)

    def test_a_small_sample_hides_the_rest_of_the_spot(self):
        rig = small(holder={"sample_diameter_mm": 1e-6})
        rays = imaging.trace_rays(rig, 1)
        assert np.all(imaging.lit_weights(rig, rays, 0.0) == 0)


class TestShortCuts:
    """Pixels that cannot be concerned are left out; that must not change a number."""

    @pytest.mark.parametrize("name", ["modern12", "lbl1992"])
    @pytest.mark.parametrize("theta_i", [0.0, 0.8, 1.2])
    def test_equal_a_look_at_every_ray(self, name, theta_i):
        rig = small(name)
        rays = imaging.trace_rays(rig, 1)
        x, y = rays.landing[..., 0], rays.landing[..., 1]
        lands = (x**2 + y**2 <= (rig.holder.sample_diameter_mm / 2) ** 2) & (rays.w_r[..., 2] > 0)
        expected = rig.lamp.lit(theta_i, x, y) * lands / rays.w_r.shape[1]
        np.testing.assert_array_equal(imaging.lit_weights(rig, rays, theta_i), expected)
        patch = np.arctan(rig.lamp.lit_diameter_mm / 2 / rig.dome.R)
        inside = np.mean(rays.w_r @ unit_vectors(theta_i, 0.0) > np.cos(patch), axis=1)
        share = rig.surroundings.stray + rig.surroundings.entry_patch * inside
        rate = imaging.stray_rate(rig, rays, theta_i)
        np.testing.assert_allclose(rate, share * imaging.white_rate(rig, rays), rtol=1e-13)


class TestTracedRays:
    def test_do_not_depend_on_threads(self):
        rig = small("modern12")
        one, three = (imaging.trace_rays(rig, 1, threads=n) for n in (1, 3))
        np.testing.assert_array_equal(one.w_r, three.w_r)
        np.testing.assert_array_equal(one.landing, three.landing)

    def test_without_pupil_and_pixel_they_are_the_chief_rays(self):
        rig = small(rays_per_pixel=1)
        rays = imaging.trace_rays(rig, 1)
        theta_r, phi_r = (a.ravel()[rays.pixel] for a in directions(rig))
        np.testing.assert_allclose(rays.w_r[:, 0], unit_vectors(theta_r, phi_r), atol=1e-12)

    def test_slope_errors_spread_the_directions(self):
        smooth, rough = (
            imaging.trace_rays(small("modern12", dome=slopes), 1).w_r
            for slopes in (
                {"slope_error_deg": 0.0, "rim_slope_error_deg": 0.0},
                {"slope_error_deg": 0.05, "rim_slope_error_deg": 0.0},
            )
        )
        turned = np.degrees(np.linalg.norm(rough - smooth, axis=-1))
        # A slope of sd 0.05 deg on two axes turns rays by twice as much: rms 0.1 sqrt(2) deg,
        # from some 100 independent patches of 10 deg.
        assert np.sqrt(np.mean(turned**2)) == pytest.approx(0.141, rel=4 / np.sqrt(200))


class TestBlur:
    def fitted_alphas(self, theta_i_deg, half_angle_deg, alpha):
        """alpha_x and alpha_y of Ward's model fitted to the lobe that a wide source shows."""
        lamp = preset("ideal12").lamp.model_copy(update={"half_angle_deg": half_angle_deg})
        theta_i = np.radians(theta_i_deg)
        w_i = lamp.directions(theta_i, imaging.ray_pattern(64)[2])
        step = np.radians(np.linspace(-12, 12, 61))
        dx, dy = (grid.ravel() for grid in np.meshgrid(step, step))
        # A patch of viewing directions about the specular one.
        tilted = np.stack([dx, dy, np.sqrt(1 - dx**2 - dy**2)], -1)
        c, s = np.cos(theta_i), np.sin(theta_i)
        w_r = tilted @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        assert angles(w_r[len(w_r) // 2])[1] == pytest.approx(np.pi) or theta_i == 0
        p = WARD.vector({"rho_d": 0.1, "rho_s": 0.2, "alpha_x": alpha, "alpha_y": alpha})
        repeated = np.repeat(w_r[:, None, :], len(w_i), axis=1)
        weights = np.full(repeated.shape[:2], 1 / len(w_i))
        blurred = imaging.mean_brdf(WARD, p, w_i, repeated, weights, threads=1)
        one = np.broadcast_to(unit_vectors(theta_i, 0.0), w_r.shape)
        fit = least_squares(
            lambda q: WARD.evaluate(one, w_r, q, threads=1) - blurred, p, x_scale=p, xtol=1e-12
        )
        return fit.x[2:]

    # Half-angle 1 deg on alpha = 0.04: par and perp of the rule, and what full cones gave.
    @pytest.mark.parametrize(("theta_i", "perpendicular"), [(0.0, 1.2), (30.0, 1.6), (60.0, 4.8)])
    def test_a_source_cone_widens_the_lobe_by_the_rule(self, theta_i, perpendicular):
        alpha, spread = 0.04, np.radians(1.0) / 2  # sd of a uniform disc along one axis
        found = self.fitted_alphas(theta_i, 1.0, alpha)
        cos = np.cos(np.radians(theta_i))
        rule = np.sqrt(alpha**2 + np.array([spread**2 / 2, spread**2 / (2 * cos**2)]))
        # The rule is the leading order in (spread/alpha)^2; the next one is its square.
        order = (spread / (2 * alpha * cos)) ** 2
        np.testing.assert_allclose(found / alpha, rule / alpha, atol=4 * order**2)
        growth = (found / alpha - 1) * 100
        assert growth[0] == pytest.approx(1.16, abs=0.05)
        assert growth[1] == pytest.approx(perpendicular, abs=0.1)

    def test_a_point_source_leaves_the_lobe_alone(self):
        np.testing.assert_allclose(self.fitted_alphas(30.0, 0.0, 0.04), 0.04, rtol=1e-6)

    # RMS blur in deg, median and maximum over theta_r <= 75 deg: sphere, D/R = 0.1.
    @pytest.mark.parametrize(
        ("pupil_mm", "focus", "median", "largest"),
        [
            (2.0, "R/2", 0.048, 0.105),
            (8.0, "R/2", 0.193, 0.420),
            (2.0, "R", 0.271, 0.321),
        ],
    )
    def test_focus_at_half_the_radius_keeps_directions_apart(
        self, pupil_mm, focus, median, largest
    ):
        rig = small(dome={"shape": "sphere"}, lens={"pupil_mm": pupil_mm, "focus": focus})
        theta_c, phi_c, weight = hemisphere_quadrature(48, 48)
        r = rig.lens.radius(theta_c)
        in_pupil = imaging.ray_pattern(64)[1]
        points = np.stack([r * np.cos(phi_c), r * np.sin(phi_c)], -1)
        points = np.repeat(points[:, None, :], len(in_pupil), axis=1)
        w_r, _ = rig.dome.trace(*imaging._through_lens(rig, points, in_pupil))
        mean = w_r.mean(axis=1)
        mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
        off = np.degrees(np.linalg.norm(w_r - mean[:, None, :], axis=-1))
        rms = np.sqrt(np.mean(off**2, axis=1))
        inside = mean[:, 2] > np.cos(np.radians(75))
        order = np.argsort(rms[inside])
        share = np.cumsum(weight[inside][order]) / weight[inside].sum()
        # The median hangs on how directions are weighted and the pupil sampled: 5 %.
        assert rms[inside][order][np.searchsorted(share, 0.5)] == pytest.approx(median, rel=0.05)
        assert rms[inside].max() == pytest.approx(largest, rel=0.05)
