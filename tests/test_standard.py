"""Eq. (2): what cancels between sample and standard, what does not, and the variance of f."""

import numpy as np
import pytest

from gonio import models
from gonio.calibration.exposure import Rate
from gonio.calibration.standard import brdf, reference, standard_brdf, variances
from gonio.instrument import Instrument, imaging, preset
from gonio.metadata import Certificate

WARD = models.get("ward")
METAL = WARD.vector({"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2})
DARK = 32.0


def small(**parts) -> Instrument:
    """ideal12 with 52 x 52 pixels and a few changed figures of its parts."""
    rig = preset("ideal12")
    coarse = {"rows": 104, "columns": 104, "pitch_um": (55.2, 55.2), "binning": 2}
    parts = {"sensor": {}} | parts
    parts["sensor"] = coarse | parts["sensor"]
    changed = {name: getattr(rig, name).model_copy(update=new) for name, new in parts.items()}
    return rig.model_copy(update=changed)


class Scene:
    """Noise-free images of one incidence: sample, background, standard, and the true f."""

    def __init__(self, rig: Instrument, theta_i_deg: float, standard_scale: float = 1.0) -> None:
        theta_i = np.radians(theta_i_deg)
        rays = imaging.trace_rays(rig, 0)
        lit = imaging.lit_weights(rig, rays, theta_i)
        w_i = rig.lamp.directions(theta_i, rays.source)
        self.shape = rig.sensor.shape
        self.pixel = rays.pixel
        self.white = imaging.white_rate(rig, rays)
        theta_r = np.arccos(rays.w_r[..., 2])
        self.f = imaging.mean_brdf(WARD, METAL, w_i, rays.w_r, lit)
        f_std = standard_scale * np.sum(lit * rig.standard.brdf(theta_r), axis=1)
        irradiance = self.white * np.cos(theta_i) * np.pi
        self.background = imaging.stray_rate(rig, rays, theta_i)
        self.sample = irradiance * self.f + self.background
        self.standard = irradiance * f_std + self.background
        self.theta_r = np.full(self.shape, np.nan)
        self.theta_r.ravel()[self.pixel] = theta_r.mean(axis=1)
        self.certificate = Certificate(
            reflectance=rig.standard.reflectance,
            uncertainty=0.0,
            rolloff=rig.standard.rolloff if rig.standard.rolloff_certified else 0.0,
        )
        # The full kernel around the patch is masked, and what the lens cannot see.
        self.far = (theta_r.max(axis=1) < np.radians(80)) & (
            self.background < 2 * rig.surroundings.stray * self.white + 1e-9
        )

    def image(self, values: np.ndarray, factor=1.0, offset=0.0) -> Rate:
        full = np.zeros(self.shape)
        full.ravel()[self.pixel] = values
        full = full * factor + offset
        return Rate(full, np.ones(self.shape), np.zeros(self.shape), np.zeros(self.shape, bool))

    def ratio(self, factor=1.0, offset=0.0, *, sample=None, standard=None) -> np.ndarray:
        """f by eq. (2) over the true f, of the pixels away from rim and entry patch."""
        sample = self.sample if sample is None else sample
        standard = self.standard if standard is None else standard
        ref = reference(
            self.image(self.background, factor, offset),
            self.image(standard, factor, offset),
            self.certificate,
            self.theta_r,
            dark_e_per_s=float(np.mean(offset)),
        )
        f = brdf(self.image(sample, factor, offset), ref)
        use = self.far & ref.usable.ravel()[self.pixel]
        assert use.sum() > 0.8 * self.far.sum()
        self.use = use
        return f.ravel()[self.pixel][use] / self.f[use]


def smooth_map(rig: Instrument) -> np.ndarray:
    """A coating that varies over the dome by 30 %."""
    rows, columns = rig.sensor.shape
    y, x = np.mgrid[0:rows, 0:columns] / rows
    return 0.85 + 0.15 * np.sin(5 * x) * np.cos(3 * y)


RIG = small()
RNG = np.random.default_rng(6)
CANCELS = {
    "as it is": (small(), {}),
    "quantum efficiency": (small(lamp={"white_rate_e_per_s": 2.3e5}), {}),
    "lens vignetting": (small(lens={"vignetting": 0.6}), {}),
    "reflectance of the dome": (small(dome={"reflectance": 0.2}), {}),
    "reflectance of the dome by position": (small(), {"factor": smooth_map(RIG)}),
    "area of the pixels": (small(), {"factor": np.linspace(0.8, 1.2, RIG.sensor.shape[1])}),
    "PRNU": (small(), {"factor": 1 + 0.05 * RNG.standard_normal(RIG.sensor.shape)}),
    "gain": (small(), {"factor": 1.7}),
    "lamp stray independent of the sample": (small(surroundings={"stray": 0.03}), {}),
    "no stray": (small(surroundings={"stray": 0.0, "entry_patch": 0.0}), {}),
    "black level and dark current": (small(), {"offset": DARK}),
    "dark current by pixel": (small(), {"offset": RNG.uniform(0, 60, RIG.sensor.shape)}),
    "lit diameter": (small(lamp={"lit_diameter_mm": 10.0}), {}),
}


@pytest.mark.parametrize("theta_i_deg", [0.0, 60.0])
@pytest.mark.parametrize("name", CANCELS)
def test_what_multiplies_or_adds_to_all_images_cancels(name, theta_i_deg):
    rig, how = CANCELS[name]
    # Nothing but rounding is left; 1e-6 is the least that any use could ask for.
    np.testing.assert_allclose(Scene(rig, theta_i_deg).ratio(**how), 1, rtol=1e-6)


def test_footprint_and_cosine_cancel_only_at_the_same_incidence():
    scene, at_normal = Scene(RIG, 60.0), Scene(RIG, 0.0)
    np.testing.assert_allclose(scene.ratio(), 1, rtol=1e-6)
    # A standard taken at normal incidence leaves cos(60 deg): half of f.
    other = at_normal.standard - at_normal.background + scene.background
    np.testing.assert_allclose(scene.ratio(standard=other), 0.5, rtol=1e-6)


def test_a_certified_rolloff_cancels_and_one_that_is_not_stated_is_the_bias():
    for certified in (True, False):
        rig = small(standard={"rolloff": 0.1, "rolloff_certified": certified})
        scene = Scene(rig, 30.0)
        excess = scene.ratio() - 1
        theta_r = scene.theta_r.ravel()[scene.pixel][scene.use]
        fall = 0.1 * (theta_r / np.radians(75)) ** 4
        if certified:
            # The standard is averaged over a pixel of width w, the certificate taken at its mean
            # direction: t^4 differs by its Laplacian 16 t^2 times w^2/24. Eq. (3) stretches
            # pixels by up to 20 % for D/R = 0.1.
            w = 2 * 55.2e-3 / 1.8
            curved = 0.1 * 16 * theta_r**2 * w**2 / 24 / np.radians(75) ** 4 / (1 - fall)
            assert np.all(np.abs(excess) < 1.2**2 * curved + 1e-6)
        else:
            predicted = 1 / (1 - fall) - 1
            seen = predicted > 0.01
            np.testing.assert_allclose(excess[seen], predicted[seen], rtol=0.05)
            assert excess.max() > 0.1


def test_light_that_goes_round_twice_makes_a_dark_sample_too_dark():
    scene, g = Scene(RIG, 30.0), 0.03
    rho = imaging.albedo(WARD, METAL, np.array([0.5, 0.0, np.sqrt(0.75)]))
    rho_std = RIG.standard.reflectance
    B = scene.background
    sample = (scene.sample - B) * (1 + g * rho) + B
    standard = (scene.standard - B) * (1 + g * rho_std) + B
    excess = scene.ratio(sample=sample, standard=standard) - 1
    predicted = (1 + g * rho) / (1 + g * rho_std) - 1
    assert predicted < -0.015
    np.testing.assert_allclose(excess, predicted, rtol=0.05)


def test_lamp_drift_between_sample_and_standard_scales_f():
    scene = Scene(RIG, 30.0)
    excess = scene.ratio(sample=1.006 * scene.sample, standard=0.997 * scene.standard) - 1
    # The stray light drifts too, which moves f by 1e-3 of the drift.
    np.testing.assert_allclose(excess, 1.006 / 0.997 - 1, rtol=0.05)


def test_ambient_light_reflected_by_the_sample_stays():
    scene, a = Scene(RIG, 30.0), 0.02
    cos_i = np.cos(np.radians(30))
    rho, rho_std = 0.3, RIG.standard.reflectance  # albedos for light from everywhere
    excess = (
        scene.ratio(
            sample=scene.sample + a * rho * scene.white,
            standard=scene.standard + a * rho_std * scene.white,
        )
        - 1
    )
    predicted = a * (rho / (np.pi * scene.f[scene.use]) - 1) / (cos_i + a)
    seen = np.abs(predicted) > 0.005
    np.testing.assert_allclose(excess[seen], predicted[seen], rtol=0.05)
    assert seen.sum() > 100


def test_standard_brdf_is_the_factor_of_eq_2():
    lambertian = Certificate(reflectance=0.98, uncertainty=0.01)
    assert standard_brdf(lambertian, np.array(1.2)) == pytest.approx(0.98 / np.pi, rel=1e-15)
    rolling = Certificate(reflectance=0.98, uncertainty=0.01, rolloff=0.1)
    at_75 = standard_brdf(rolling, np.array(np.radians(75)))
    assert at_75 == pytest.approx(0.9 * 0.98 / np.pi, rel=1e-14)


def flat(value: float, time: float, rng: np.random.Generator | None = None, n: int = 300) -> Rate:
    """A uniform image of n x n pixels with shot noise and a read noise of 5 electrons."""
    shape = (n, n)
    electrons = np.full(shape, value * time)
    if rng is not None:
        electrons = rng.poisson(electrons) + 5 * rng.standard_normal(shape)
    full = np.full(shape, time)
    return Rate(electrons / time, full, np.full(shape, 25 / time**2), np.zeros(shape, bool))


WHITE = Certificate(reflectance=0.99, uncertainty=0.0)


@pytest.mark.parametrize("sample", [1e3, 3e4, 1e5, 1.5e6])
def test_the_variance_of_f_is_the_scatter_of_many_trials(sample):
    S, B, times = 1e5, 5e3, (0.2, 0.05, 0.1)  # e-/s; s of sample, background, standard
    rng = np.random.default_rng(8)
    M_, B_, S_ = (flat(v, t, rng) for v, t in zip((sample + B, B, S), times, strict=True))
    zero = np.zeros((300, 300))
    ref = reference(B_, S_, WHITE, zero, dark_e_per_s=B)
    assert ref.usable.all()
    f = brdf(M_, ref)
    own, shared = variances(M_, ref, np.full(f.shape, sample / (S - B) * 0.99 / np.pi))
    # The formula in the letters of the rates, with their true values.
    N, Sg = sample, S - B
    var_m, var_b, var_s = (
        v / t + 25 / t**2 for v, t in zip((sample + B, B, S), times, strict=True)
    )
    relative = var_m / N**2 + var_s / Sg**2 + var_b * (1 / N - 1 / Sg) ** 2
    true_f = N / Sg * 0.99 / np.pi
    stated = float(np.mean(own + shared))
    # 1/pi stands for f_std in the leverage of B; its share of the variance times 1 %.
    assert stated == pytest.approx(relative * true_f**2, rel=0.01)
    scatter = float(np.var(f))
    # A variance from n trials has the relative standard error sqrt(2/n); the ratio's second
    # order adds 3 var(Sg)/Sg^2, here 6e-4.
    assert scatter == pytest.approx(stated, rel=3 * np.sqrt(2 / f.size) + 0.01)
    # The mean of a ratio is off by var(Sg)/Sg^2 + the covariance through B.
    second_order = (var_s + var_b) / Sg**2 - var_b / (N * Sg)
    error = np.sqrt(scatter / f.size)
    assert abs(f.mean() / true_f - 1 - second_order) < 3 * error / true_f


def test_a_shared_background_cancels_where_the_sample_is_as_bright_as_the_standard():
    B, S = flat(1e4, 0.1), flat(1e5, 1e9)
    ref = reference(B, S, WHITE, np.zeros((300, 300)), dark_e_per_s=1e4)
    f_std = 0.99 / np.pi
    _, equal = variances(S, ref, np.full((300, 300), f_std))
    _, dim = variances(S, ref, np.full((300, 300), 0.1 * f_std))
    assert equal.max() < 1e-3 * dim.min()


def test_the_entry_patch_is_masked():
    scene = Scene(RIG, 30.0)
    patch = scene.background > 2 * RIG.surroundings.stray * scene.white
    assert patch.any()
    ref = reference(
        scene.image(scene.background),
        scene.image(scene.standard),
        scene.certificate,
        scene.theta_r,
        dark_e_per_s=0.0,
    )
    usable = ref.usable.ravel()[scene.pixel]
    assert not usable[patch].any()
    assert np.all(ref.f_per_rate[~ref.usable] == 0)
    assert not ref.usable[~np.isfinite(scene.theta_r)].any()


def test_dark_current_is_not_an_entry_patch():
    B, S = flat(5e4, 0.1), flat(1e5, 0.1)
    zero = np.zeros((300, 300))
    assert reference(B, S, WHITE, zero, dark_e_per_s=5e4).usable.all()
    assert not reference(B, S, WHITE, zero, dark_e_per_s=0.0).usable.any()


def test_a_standard_too_dark_for_a_ratio_is_masked():
    zero = np.zeros((300, 300))
    # Signal to noise of 15 and of 40 with a background of 0 and a read noise of 5 electrons.
    for electrons, usable in ((250, False), (1700, True)):
        ref = reference(flat(0, 1.0), flat(electrons, 1.0), WHITE, zero, dark_e_per_s=0)
        assert ref.usable.all() == usable
        assert ref.usable.any() == usable


def test_saturated_pixels_of_standard_or_background_are_masked():
    B, S = flat(0, 1.0), flat(1e5, 1.0)
    hot = np.zeros((300, 300), bool)
    hot[7, 9] = True
    for b, s in ((Rate(B.value, B.time, B.read_variance, hot), S),
                 (B, Rate(S.value, S.time, S.read_variance, hot))):  # fmt: skip
        ref = reference(b, s, WHITE, np.zeros((300, 300)), dark_e_per_s=0)
        np.testing.assert_array_equal(~ref.usable, hot)


def test_choosing_bright_pixels_does_not_choose_their_noise():
    # A standard that stands 25 standard deviations high, where about half of the pixels pass.
    signal = (25**2 + np.sqrt(25.0**4 + 4 * 25**2 * 2 * 25)) / 2
    standard = flat(signal, 1.0, np.random.default_rng(9))
    background = flat(0.0, 1.0, np.random.default_rng(10))
    ref = reference(background, standard, WHITE, np.zeros((300, 300)), dark_e_per_s=0)
    chosen = (standard.value - background.value)[ref.usable]
    assert 0.2 < ref.usable.mean() < 0.8
    # Neighbours decide together: the error comes from blocks of 30 x 30 pixels.
    used = np.where(ref.usable, standard.value - background.value - signal, 0.0)
    blocks = used.reshape(10, 30, 10, 30).sum(axis=(1, 3)).ravel()
    error = np.sqrt(blocks.size) * blocks.std(ddof=1) / ref.usable.sum()
    assert abs(chosen.mean() - signal) < 3 * error
    # The pixels' own values would have been off by much more than this test can see.
    own = (standard.value - background.value)[standard.value - background.value > signal]
    assert own.mean() - signal > 20 * error
