"""What eq. (2) cancels and what it does not, on expected images without noise, row by row."""

import numpy as np
import pytest
from eq3_theory import mapping_error
from scipy.ndimage import gaussian_filter
from virtual import DOME, images, small

from gonio import models
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.frames.exposure import Rate, merge
from gonio.calibration.frames.standard import brdf, irradiance_ratio, reference, standard_brdf
from gonio.geometry import angles, unit_vectors
from gonio.instrument import Instrument, imaging
from gonio.instrument.records import metadata
from gonio.metadata import Camera, Plan

WARD = models.get("ward")
METAL = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2}
DARK = 32.0
N = 52


def rig(name: str = "ideal12", **parts) -> Instrument:
    return small(name, N, **parts)


def plan(*theta_i_deg: float, **more) -> Plan:
    return Plan(theta_i_deg=theta_i_deg, rotations_deg=(0.0,), exposures_s=(1.0,), **more)


class Scene:
    """Expected images of one incidence, reduced by eq. (2) without noise.

    Parameters
    ----------
    instrument : Instrument
    theta_i_deg : float
    lobe : mapping, optional
        Parameters of Ward's model.
    more
        Fields of the plan, for a standard at another incidence or transmission.
    """

    def __init__(self, instrument, theta_i_deg, lobe=METAL, standard_scale=1.0, **more) -> None:
        self.rig, self.plan = instrument, plan(theta_i_deg, **more)
        self.lobe, self.theta_i = WARD.vector(lobe), np.radians(theta_i_deg)
        self.images = images(instrument, self.plan, "ward", standard_scale, **lobe)
        self.metadata = metadata(instrument, self.plan, "metal", "")
        self.shape = instrument.sensor.shape
        rays = self.rays = self.images.rays
        self.f = np.full(self.shape, np.nan)
        self.f.ravel()[rays.pixel] = self.seen(self.lobe)
        mean = self.images.mean_directions
        self.theta_r, self.phi_r = (np.full(self.shape, np.nan) for _ in "tp")
        self.theta_r.ravel()[rays.pixel], self.phi_r.ravel()[rays.pixel] = angles(mean)

    def seen(self, lobe) -> np.ndarray:
        """f over the rays of each pixel that land on lit sample, what eq. (2) can find at best."""
        lit = imaging.lit_weights(self.rig, self.rays, self.theta_i)
        w_i = self.rig.lamp.directions(self.theta_i, self.rays.source)
        m = lit.sum(axis=1)
        f = imaging.mean_brdf(WARD, lobe, w_i, self.rays.w_r, lit)
        return np.where(m > 0, f / np.where(m > 0, m, 1), np.nan)

    def rate(self, role: str, incidence: int = 0, lamp: float = 1.0) -> np.ndarray:
        return self.images.rates(role, 0, incidence, [lamp])[0]

    def found(self, factor=1.0, offset=0.0, *, f_std=None, **changed) -> np.ndarray:
        """f of every pixel by eq. (2), NaN where masked; `changed` rates by role."""
        alone = self.plan.standard_theta_i_deg is not None
        rates = {role: self.rate(role) for role in ("background", "standard", "sample")}
        rates |= changed
        made = {role: still(rate * factor + offset) for role, rate in rates.items()}
        if f_std is None:
            theta_std = np.radians(self.plan.standard_theta_i_deg) if alone else self.theta_i
            f_std = standard_brdf(self.metadata.standard, theta_std, self.theta_r, self.phi_r)
        own = still(self.rate("background", 1) * factor + offset) if alone else None
        ref = reference(
            made["background"],
            made["standard"],
            f_std,
            dark_e_per_s=float(np.mean(offset)),
            irradiance=irradiance_ratio(self.metadata, self.theta_i),
            standard_background=own,
        )
        use = ref.usable & (self.theta_r < np.radians(78))
        assert use.sum() > 0.7 * np.count_nonzero(self.theta_r < np.radians(78))
        return np.where(use, brdf(made["sample"], ref), np.nan)

    def excess(self, **how) -> np.ndarray:
        """f found over f seen, less one, of the usable pixels."""
        ratio = self.found(**how) / self.f - 1
        return ratio[np.isfinite(ratio)]


def still(rate: np.ndarray) -> Rate:
    """An image without noise."""
    shape = rate.shape
    return Rate(rate, np.full(shape, 1e6), np.zeros(shape), np.zeros(shape, bool))


# ---------------------------------------------------------------- what cancels

RNG = np.random.default_rng(6)
PRNU = 1 + 0.05 * RNG.standard_normal((N, N))
CANCELS = {
    "as it is": (rig(), {}),
    "quantum efficiency, lamp": (rig(lamp={"white_rate_e_per_s": 2.3e5}), {}),
    "lens vignetting": (rig(lens={"vignetting": 0.6}), {}),
    "area of the pupil": (rig(lens={"pupil_mm": 1.5}), {}),
    "projection of the lens": (rig(lens={"projection": "equisolid", "k": (0.0,) * 4}), {}),
    "area of the pixels": (rig(), {"factor": np.linspace(0.8, 1.2, N)}),
    "reflectance of the dome": (rig(dome={"reflectance": 0.2}), {}),
    "reflectance of the dome by position": (rig(dome={"reflectance_variation": 0.1}), {}),
    "PRNU": (rig(), {"factor": PRNU}),
    "PRNU of the sensor": (rig(sensor={"prnu": 0.05}), {}),
    "pixels dead in part": (rig(sensor={"dead_fraction": 0.05}), {}),
    "gain": (rig(), {"factor": 1.7}),
    "lamp stray independent of the sample": (rig(surroundings={"stray": 0.03}), {}),
    "no stray": (rig(surroundings={"stray": 0.0, "entry_patch": 0.0}), {}),
    "room light on its own way": (rig(surroundings={"ambient": 0.05}), {}),
    "black level and dark current": (rig(), {"offset": DARK}),
    "dark current by pixel": (rig(), {"offset": RNG.uniform(0, 60, (N, N))}),
    "transmittance of the dome": (rig(dome={"transmittance": 0.3}), {}),
    "transmittance by position": (rig(dome={"transmittance_variation": 0.1}), {}),
    "lit diameter": (rig(lamp={"lit_diameter_mm": 10.0}), {}),
    "a beam that is not even": (rig(lamp={"edge_falloff": 0.3}), {}),
    "a sphere, spot smaller than what is seen": (
        rig(dome={"shape": "sphere"}, lamp={"lit_diameter_mm": 5.0}, lens={"pupil_mm": 3.0}),
        {},
    ),
}


@pytest.mark.parametrize("theta_i_deg", [0.0, 60.0])
@pytest.mark.parametrize("name", CANCELS)
def test_what_multiplies_or_adds_to_all_images_cancels(name, theta_i_deg):
    instrument, how = CANCELS[name]
    # Nothing but rounding is left; 1e-6 is the least that any use could ask for.
    np.testing.assert_allclose(Scene(instrument, theta_i_deg).excess(**how), 0, atol=1e-6)


def test_a_certified_standard_that_is_not_lambertian_cancels():
    scene = Scene(rig(standard={"rolloff": 0.1, "rolloff_certified": True}), 30.0)
    theta_r = scene.theta_r[np.isfinite(scene.found())]
    # The standard is averaged over a pixel of width w, the certificate taken at its mean
    # direction: t^4 differs by its Laplacian 16 t^2 times w^2/24. The dome stretches pixels by up
    # to 20 % for D/R = 0.1.
    w = 2 * scene.rig.sensor.pitch_um[0] * 1e-3 / 1.8
    fall = 0.1 * (theta_r / np.radians(75)) ** 4
    curved = 0.1 * 16 * theta_r**2 * w**2 / 24 / np.radians(75) ** 4 / (1 - fall)
    assert np.all(np.abs(scene.excess()) < 1.2**2 * curved + 1e-6)


def test_a_response_made_linear_cancels_and_one_that_is_not_is_the_bias():
    scene = Scene(rig(surroundings={"stray": 0.0, "entry_patch": 0.0}), 30.0)
    gamma = 0.7
    well = 1.05 * max(scene.rate(role).max() for role in ("standard", "sample"))
    camera = Camera(
        rows=N, columns=N, pitch_mm=(0.1, 0.1), gain_dn_per_e=65000 / well, black_dn=0,
        saturation_dn=65535, full_well_e=well, noise_dn=0, dark_e_per_s=0, gamma=gamma,
    )  # fmt: skip

    def read(role, cam):
        counts = np.rint(65000 * (scene.rate(role) / well) ** gamma).astype(np.uint16)
        rate = merge(counts[None], (1.0,), cam)
        return Rate(rate.value, np.full((N, N), 1e6), np.zeros((N, N)), np.zeros((N, N), bool))

    linear = {role: read(role, camera).value for role in ("background", "standard", "sample")}
    # Rounding of counts of some thousand.
    np.testing.assert_allclose(scene.excess(**linear), 0, atol=1e-3)
    bent = camera.model_copy(update={"gamma": 1.0})
    curved = {role: read(role, bent).value for role in ("background", "standard", "sample")}
    excess = scene.excess(**curved)
    f = scene.f[np.isfinite(scene.found())]
    np.testing.assert_allclose(excess, (f * np.pi / 0.99) ** (gamma - 1) - 1, rtol=0.05, atol=1e-3)
    assert np.abs(excess).max() > 0.3


# ---------------------------------------------------------------- what cancels on a condition


def test_the_cosine_cancels_at_the_same_incidence_and_is_corrected_at_another():
    here, other = Scene(rig(), 60.0), Scene(rig(), 60.0, standard_theta_i_deg=0.0)
    np.testing.assert_allclose(here.excess(), 0, atol=1e-6)
    np.testing.assert_allclose(other.excess(), 0, atol=1e-6)
    # Uncorrected: half of f.
    at_normal = Scene(rig(), 0.0)
    signal = at_normal.rate("standard") - at_normal.rate("background")
    wrong = here.excess(standard=here.rate("background") + signal)
    np.testing.assert_allclose(wrong, -0.5, rtol=1e-6)


def test_transmittance_by_position_is_left_where_the_standard_is_at_another_incidence():
    uneven = rig(dome={"transmittance_variation": 0.1})
    scene = Scene(uneven, 60.0, standard_theta_i_deg=10.0)
    t = [imaging.entry_transmittance(uneven, np.radians(a), DOME) for a in (60, 10)]
    predicted = t[0] / t[1] - 1
    assert abs(predicted) > 0.02
    np.testing.assert_allclose(scene.excess(), predicted, rtol=0.05)
    # What the simulator states for its price is of that size.
    assert scene.plan.u_irradiance is None
    assert abs(predicted) < 3 * np.sqrt(2) * 0.1


def test_an_uneven_beam_is_left_where_the_standard_is_at_another_incidence():
    # On a sample 2 mm too high the footprint moves by 2 mm tan(theta_i) towards the lamp, and what
    # a pixel sees by 2 mm tan(theta_r).
    height, theta_i = 2.0, np.radians(60)
    uneven = rig(lamp={"edge_falloff": 0.5}, holder={"height_mm": height})
    scene = Scene(uneven, 60.0, METAL | {"rho_s": 0.0}, standard_theta_i_deg=0.0)
    columns, rows = np.meshgrid(np.arange(N), np.arange(N))
    w = np.moveaxis(PixelMap.of(scene.metadata, "exact").directions(columns, rows), -1, 0)
    x, y = height * w[0] / w[2], height * w[1] / w[2]
    across = ((x - height * np.tan(theta_i)) * np.cos(theta_i)) ** 2 + y**2
    predicted = (1 - 0.5 * across / 8**2) / (1 - 0.5 * (x**2 + y**2) / 8**2) - 1
    excess = scene.found() / scene.f - 1
    seen = np.isfinite(excess) & (np.abs(predicted) > 0.02) & (scene.theta_r < np.radians(65))
    assert seen.sum() > 100
    np.testing.assert_allclose(excess[seen], predicted[seen], rtol=0.05)


def test_transmission_needs_the_dome_s_transmittance():
    how = {"mode": "transmission", "standard_theta_i_deg": 20.0}
    scene = Scene(rig(dome={"transmittance": 0.4}), 50.0, **how)
    np.testing.assert_allclose(scene.excess(), 0, atol=1e-6)
    limits = scene.metadata.limits.model_copy(update={"transmittance": 0.412})
    scene.metadata = scene.metadata.model_copy(update={"limits": limits})
    np.testing.assert_allclose(scene.excess(), 0.03, rtol=1e-4)


# ---------------------------------------------------------------- what does not cancel


def test_a_standard_that_is_not_lambertian_is_the_bias_where_nobody_says_so():
    scene = Scene(rig(standard={"rolloff": 0.1, "rolloff_certified": False}), 30.0)
    excess = scene.excess()
    fall = 0.1 * (scene.theta_r[np.isfinite(scene.found())] / np.radians(75)) ** 4
    predicted = 1 / (1 - fall) - 1
    seen = predicted > 0.01
    np.testing.assert_allclose(excess[seen], predicted[seen], rtol=0.05)
    assert excess.max() > 0.1


def test_a_wrong_reflectance_of_the_standard_scales_f():
    np.testing.assert_allclose(
        Scene(rig(), 30.0, standard_scale=0.97).excess(), 1 / 0.97 - 1, rtol=1e-6
    )


def test_lamp_drift_between_sample_and_standard_scales_f():
    scene = Scene(rig(), 30.0)
    lamp = {"sample": 1.006, "standard": 0.997}
    excess = scene.excess(**{role: scene.rate(role, lamp=x) for role, x in lamp.items()})
    # The stray light drifts too, which moves f by 1e-3 of the drift over f in units of white.
    np.testing.assert_allclose(excess, 1.006 / 0.997 - 1, rtol=0.05)


def test_light_that_goes_round_twice_makes_a_dark_sample_too_dark():
    g = 0.03
    scene = Scene(rig(surroundings={"multibounce": g}), 30.0)
    rho = imaging.albedo(WARD, scene.lobe, unit_vectors(np.radians(30), 0.0))
    predicted = (1 + g * rho) / (1 + g * 0.99) - 1
    assert predicted < -0.015
    np.testing.assert_allclose(scene.excess(), predicted, rtol=0.05)


def test_room_light_that_the_sample_reflects():
    a, theta_i = 0.05, np.radians(30)
    scene = Scene(rig(surroundings={"ambient_reflected": a}), 30.0)
    use = np.isfinite(scene.found())
    # By reciprocity a sample in even light shows its albedo for light from the viewer.
    some = np.flatnonzero(use)[::40]
    w_r = unit_vectors(scene.theta_r.ravel()[some], scene.phi_r.ravel()[some])
    rho = np.array([imaging.albedo(WARD, scene.lobe, w) for w in w_r])
    f = scene.f.ravel()[some]
    predicted = (f * np.cos(theta_i) + a * rho / np.pi) / (np.cos(theta_i) + a) / f - 1
    excess = scene.found().ravel()[some] / f - 1
    seen = np.abs(predicted) > 0.01
    assert seen.sum() > 10
    np.testing.assert_allclose(excess[seen], predicted[seen], rtol=0.05)


BROAD = {"rho_d": 0.05, "rho_s": 0.3, "alpha_x": 0.2, "alpha_y": 0.2}


def test_the_lamp_s_cone_lowers_the_peak_by_the_blur_rule():
    half_angle = 4.0
    no_stray = {"stray": 0.0, "entry_patch": 0.0}
    wide = rig(lamp={"half_angle_deg": half_angle}, surroundings=no_stray)
    scene, point = Scene(wide, 0.0, BROAD), Scene(rig(), 0.0, BROAD)
    peak = np.unravel_index(np.nanargmax(point.f), point.shape)
    # alpha^2 grows by sb^2/2 with sb = a/2 on each axis, and the lobe's peak is 1/(alpha_x
    # alpha_y): rho_d/pi is left alone.
    grown = (np.radians(half_angle) / 2) ** 2 / 2 / 0.2**2
    predicted = (point.f[peak] - 0.05 / np.pi) * (1 / (1 + grown) - 1)
    assert predicted / point.f[peak] < -0.01
    assert scene.found()[peak] - point.f[peak] == pytest.approx(predicted, rel=0.05)


def test_the_size_of_a_pixel_lowers_the_peak():
    one = {"rays_per_pixel": 1}
    point = Scene(rig().model_copy(update=one), 20.0, BROAD)
    found = Scene(rig().model_copy(update={"rays_per_pixel": 64}), 20.0, BROAD).found()
    peak = np.unravel_index(np.nanargmax(point.f), point.shape)
    # The mean over a pixel of width w adds w^2/24 times the second derivatives.
    i, j = peak
    f = point.f
    second = f[i + 1, j] + f[i - 1, j] + f[i, j + 1] + f[i, j - 1] - 4 * f[i, j]
    assert second / 24 / f[peak] < -0.002
    assert found[peak] - f[peak] == pytest.approx(second / 24, rel=0.05)


def test_point_spread_blurs_the_image_of_f():
    scene = Scene(rig(lens={"psf_px": 2.0}), 20.0, BROAD)  # one pixel of two
    sharp = Scene(rig(), 20.0, BROAD)
    white = sharp.rate("standard") - sharp.rate("background")
    light, white = (
        gaussian_filter(image, 1.0, truncate=6) for image in (np.nan_to_num(sharp.f) * white, white)
    )
    blurred = light / np.where(white > 0, white, np.nan) - sharp.f
    found = scene.found() - sharp.f
    # Where the lobe bends.
    bends = np.abs(blurred) > 0.5 * np.nanmax(np.abs(blurred * np.isfinite(found)))
    bends &= np.isfinite(found) & (sharp.theta_r < np.radians(60))
    assert bends.sum() > 5
    np.testing.assert_allclose(found[bends], blurred[bends], rtol=0.05)


def test_slope_errors_of_the_dome_turn_what_a_pixel_sees():
    uneven = rig(dome={"slope_error_deg": 0.3, "rim_slope_error_deg": 0.0})
    scene, even = Scene(uneven, 20.0, BROAD), Scene(rig(), 20.0, BROAD)
    turned, straight = (s.images.mean_directions for s in (scene, even))
    w_i = np.broadcast_to(unit_vectors(np.radians(20), 0.0), straight.shape)
    predicted = np.full(scene.shape, np.nan)
    predicted.ravel()[scene.rays.pixel] = WARD.evaluate(w_i, turned, scene.lobe) - WARD.evaluate(
        w_i, straight, scene.lobe
    )
    found = scene.found() - even.f
    seen = np.isfinite(found) & (np.abs(predicted) > 0.004)
    assert seen.sum() > 20
    # A mirror's slope counts twice.
    size = np.linalg.norm(turned - straight, axis=1)
    assert np.sqrt(np.mean(size**2)) == pytest.approx(2 * np.radians(0.3) * np.sqrt(2), rel=0.4)
    np.testing.assert_allclose(found[seen], predicted[seen], rtol=0.05)


def test_what_eq_3_leaves_out_on_a_sphere_moves_the_lobe():
    sphere = rig(dome={"shape": "sphere", "D": 7.5}, lens={"pupil_mm": 0.0})
    scene = Scene(sphere.model_copy(update={"rays_per_pixel": 1}), 40.0, BROAD)
    columns, rows = np.meshgrid(np.arange(N), np.arange(N))
    w_r = PixelMap.of(scene.metadata, "eq3").directions(columns, rows)
    use = np.isfinite(scene.found()) & np.isfinite(w_r[..., 0])
    w_r = w_r[use]
    w_i = np.broadcast_to(unit_vectors(np.radians(40), 0.0), w_r.shape)
    left = mapping_error(w_r, R=150.0, D=7.5, shape="sphere")
    by_eq3 = WARD.evaluate(w_i, w_r, scene.lobe)
    moved = w_r + left
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    predicted = WARD.evaluate(w_i, moved, scene.lobe) - by_eq3
    off = scene.found()[use] - by_eq3
    # One figure for all: the leading order is right to some D/R, pixel by pixel.
    slope = np.sum(off * predicted) / np.sum(predicted**2)
    assert abs(slope) == pytest.approx(1, rel=0.05)
    assert np.abs(off).max() > 1e-3


def test_a_converter_that_cuts_at_zero_brightens_dark_pixels():
    noise = 5.0
    camera = Camera(
        rows=300, columns=300, pitch_mm=(0.1, 0.1), gain_dn_per_e=0.5, black_dn=0,
        saturation_dn=4095, full_well_e=8000, noise_dn=noise, dark_e_per_s=0,
    )  # fmt: skip
    counts = np.random.default_rng(4).normal(0, noise, (1, 300, 300))
    seen = merge(np.clip(np.rint(counts), 0, 4095).astype(np.uint16), (0.1,), camera)
    # The mean of the positive half of a normal distribution.
    predicted = noise / np.sqrt(2 * np.pi) / 0.5 / 0.1
    assert seen.value.mean() == pytest.approx(predicted, rel=0.05)
