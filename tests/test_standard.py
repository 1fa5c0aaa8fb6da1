"""Eq. (2): the standard by direction, masks, and the variance of f."""

import numpy as np
import pytest
from virtual import Drawn, images, small

import gonio
from gonio.calibration.frames.exposure import Rate, merge
from gonio.calibration.frames.standard import (
    brdf,
    describe,
    irradiance_ratio,
    reference,
    standard_brdf,
    variances,
)
from gonio.certificate import Certificate, StandardTable
from gonio.errors import ConfigurationError
from gonio.instrument import preset
from gonio.instrument.records import metadata
from gonio.metadata import Metadata, Plan


def test_standard_brdf_is_the_factor_of_eq_2():
    lambertian = Certificate(reflectance=0.98, uncertainty=0.01)
    assert standard_brdf(lambertian, 0.4, 1.2, 0.0) == pytest.approx(0.98 / np.pi, rel=1e-15)
    rolling = Certificate(reflectance=0.98, uncertainty=0.01, rolloff=0.1)
    at_75 = standard_brdf(rolling, 0.4, np.radians(75), 0.0)
    assert at_75 == pytest.approx(0.9 * 0.98 / np.pi, rel=1e-14)


def test_the_standard_by_direction_is_linear_between_the_nodes_of_its_table():
    theta_i, theta_r, dphi = (0.0, 30.0, 60.0), (0.0, 40.0, 80.0), (0.0, 90.0, 180.0)

    def trilinear(i, r, p):
        return 1 + 0.001 * i - 0.002 * r + 1e-4 * p + 1e-5 * i * r - 1e-6 * i * p + 2e-8 * i * r * p

    table = StandardTable(
        theta_i_deg=theta_i,
        theta_r_deg=theta_r,
        dphi_deg=dphi,
        factor=tuple(tuple(tuple(trilinear(i, r, p) for p in dphi) for r in theta_r)
                     for i in theta_i),
    )  # fmt: skip
    known = Certificate(reflectance=0.9, uncertainty=0.01, table=table)
    rng = np.random.default_rng(1)
    r, p = rng.uniform(0, 80, 50), rng.uniform(0, 180, 50)
    for i in (0.0, 12.0, 30.0, 59.0):
        found = standard_brdf(known, np.radians(i), np.radians(r), np.radians(p))
        np.testing.assert_allclose(found, 0.9 / np.pi * trilinear(i, r, p), rtol=1e-12)
        # Both sides of the plane of incidence are alike, whole turns do not count.
        for other in (-p, 360 - p, p + 720):
            again = standard_brdf(known, np.radians(i), np.radians(r), np.radians(other))
            np.testing.assert_allclose(again, found, rtol=1e-9)
    # Outside the grid the nearest value holds.
    beyond = standard_brdf(known, np.radians(75), np.radians(89), np.radians(180))
    assert beyond == pytest.approx(0.9 / np.pi * trilinear(60, 80, 180), rel=1e-12)


def test_a_table_of_one_incidence_or_azimuth_holds_for_all():
    one = StandardTable(theta_i_deg=(45.0,), theta_r_deg=(0.0, 80.0), factor=(((1.0,), (0.8,)),))
    known = Certificate(reflectance=1.0, uncertainty=0.0, table=one)
    theta_r = np.array([0.0, 0.5, np.nan])
    for theta_i, dphi in ((0.0, 0.0), (1.2, 2.0)):
        found = standard_brdf(known, theta_i, theta_r, dphi)
        fall = 1 - 0.2 * np.degrees(theta_r) / 80
        np.testing.assert_allclose(found, fall / np.pi, rtol=1e-12)


def known(mode="reflection", standard_theta_i_deg=None, transmittance=None, **more) -> Metadata:
    once = Plan(
        theta_i_deg=(0.0, 60.0), rotations_deg=(0.0,), exposures_s=(0.01,), mode=mode,
        standard_theta_i_deg=standard_theta_i_deg, **more,
    )  # fmt: skip
    found = metadata(preset("ideal12"), once, "sheet", "")
    limits = found.limits.model_copy(update={"transmittance": transmittance})
    return found.model_copy(update={"limits": limits})


def test_the_irradiance_of_another_incidence_is_computed_by_its_cosine():
    assert irradiance_ratio(known(), 1.0) == 1
    at_20 = np.cos(np.radians(20)) / np.cos(1.0)
    assert irradiance_ratio(known(standard_theta_i_deg=20), 1.0) == pytest.approx(at_20)
    through = known("transmission", 20.0, transmittance=0.45)
    assert irradiance_ratio(through, 1.0) == pytest.approx(0.45 * at_20)


def test_transmission_without_the_dome_s_transmittance_is_refused():
    message = r"transmission needs T_d.*Measure it with a detector at the sample's place, with and"
    with pytest.raises(ConfigurationError, match=message):
        irradiance_ratio(known("transmission", 20.0), 0.5)


def test_a_grazing_lamp_is_refused_where_its_irradiance_is_computed():
    with pytest.raises(ConfigurationError, match=r"theta_i = 90 deg: the lamp grazes the sample"):
        irradiance_ratio(known(standard_theta_i_deg=20), np.pi / 2)


def test_the_history_says_what_is_taken_for_known_of_the_standard():
    assert describe(known()) == "eq. (2) with a standard of pi f(0 deg) = 0.99"
    assert describe(known(standard_theta_i_deg=10)) == (
        "eq. (2) with a standard of pi f(0 deg) = 0.99, taken at 10 deg: irradiance by "
        "cos(10 deg)/cos(theta_i), lamp spot and dome taken as equal; relative uncertainty: "
        "unknown, not included"
    )
    through = known("transmission", 10.0, transmittance=0.45, u_irradiance=0.02)
    assert describe(through) == (
        "eq. (2) with a standard of pi f(0 deg) = 0.99, taken in reflection at 10 deg: irradiance "
        "by T_d cos(10 deg)/cos(theta_i) with T_d = 0.45, lamp spot and dome taken as equal; "
        "relative uncertainty: 0.02"
    )


class TestOneStandardForAll:
    """A standard that was taken at one incidence only, and transmission: from frames to samples."""

    THETAS = (10.0, 40.0, 60.0)

    def drawn(self, seed=0, dome=None, u=None, **more) -> Drawn:
        once = Plan(
            theta_i_deg=self.THETAS, rotations_deg=(0.0, 90.0), exposures_s=(1e-3, 16e-3),
            u_irradiance=u, **more,
        )  # fmt: skip
        return Drawn(images(small(n=52, dome=dome or {}), once, rho=0.3), seed)

    @pytest.mark.parametrize("mode", ["reflection", "transmission"])
    def test_f_and_its_noise_are_right(self, mode):
        z = []
        for seed in range(6):
            session = self.drawn(seed, mode=mode, standard_theta_i_deg=20.0)
            samples = gonio.reduce(session)
            z.append((samples.value - 0.3 / np.pi) / samples.u_independent)
            assert samples.metadata["findings"] == []
        # A standard of one image is shared by all six: its noise does not average over them.
        z = np.concatenate(z)
        assert np.mean(z**2) == pytest.approx(1, abs=4 * np.sqrt(6 * 2 / len(z)))
        assert samples.reference_sharing == 6
        assert samples.quantity == ("BTDF" if mode == "transmission" else "BRDF")
        assert (
            "irradiance at another incidence than the standard's (plan.u_irradiance)"
            in (samples.metadata["unknown"])
        )

    def test_a_lobe_of_transmission_is_fitted_by_a_model_of_reflection(self):
        lobe = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.25, "alpha_y": 0.15}
        once = Plan(
            theta_i_deg=self.THETAS, rotations_deg=(0.0, 90.0), exposures_s=(1e-3, 16e-3),
            mode="transmission", standard_theta_i_deg=20.0,
        )  # fmt: skip
        samples = gonio.reduce(Drawn(images(small(), once, "ward", **lobe)))
        # Light that goes straight on leaves opposite the mirrored lamp.
        brightest = np.argmax(np.where(samples.image == 2, samples.value, 0))
        w_i, w_r = samples.directions.vectors()
        assert w_i[brightest] * [-1, -1, 1] @ w_r[brightest] > np.cos(np.radians(8))
        fit = gonio.fit(samples, model="ward").parameters
        for name, value in lobe.items():
            assert abs(fit[name].value - value) < 4 * fit[name].stderr

    def test_its_price_is_shared_by_the_samples(self):
        def terms(**how):
            session = self.drawn(standard_theta_i_deg=20.0, u=0.04, **how)
            samples = gonio.reduce(session)
            return samples, {term.name: term for term in samples.shared}

        samples, found = terms()
        halves = [found[name] for name in ("irradiance", "irradiance, incidence")]
        assert [term.relative for term in halves] == [pytest.approx(0.04 / np.sqrt(2))] * 2
        assert halves[0].group is None
        np.testing.assert_array_equal(halves[1].group, samples.image // 2)
        _, found = terms(mode="transmission")
        assert found["irradiance"].relative == 0.04
        assert "irradiance, incidence" not in found

    def test_an_uneven_dome_is_inside_the_price(self):
        uneven = {"transmittance_variation": 0.03}
        session = self.drawn(dome=uneven, standard_theta_i_deg=20.0, u=np.sqrt(2) * 0.03)
        samples = gonio.reduce(session)
        off = samples.value / (0.3 / np.pi) - 1
        means = [off[samples.image // 2 == i].mean() for i in range(3)]
        assert max(map(abs, means)) > 1e-3
        assert max(map(abs, means)) < 3 * np.sqrt(2) * 0.03


def flat(value: float, time: float, rng: np.random.Generator | None = None, n: int = 300) -> Rate:
    """A uniform image of n x n pixels with shot noise and a read noise of 5 electrons."""
    shape = (n, n)
    electrons = np.full(shape, value * time)
    if rng is not None:
        electrons = rng.poisson(electrons) + 5 * rng.standard_normal(shape)
    full = np.full(shape, time)
    return Rate(electrons / time, full, np.full(shape, 25 / time**2), np.zeros(shape, bool))


WHITE = np.full((300, 300), 0.99 / np.pi)


@pytest.mark.parametrize("sample", [1e3, 3e4, 1e5, 1.5e6])
def test_the_variance_of_f_is_the_scatter_of_many_trials(sample):
    S, B, times = 1e5, 5e3, (0.2, 0.05, 0.1)  # e-/s; s of sample, background, standard
    rng = np.random.default_rng(8)
    M_, B_, S_ = (flat(v, t, rng) for v, t in zip((sample + B, B, S), times, strict=True))
    ref = reference(B_, S_, WHITE, dark_e_per_s=B)
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
    ref = reference(B, S, WHITE, dark_e_per_s=1e4)
    f_std = 0.99 / np.pi
    _, equal = variances(S, ref, np.full((300, 300), f_std))
    _, dim = variances(S, ref, np.full((300, 300), 0.1 * f_std))
    assert equal.max() < 1e-3 * dim.min()


def test_the_entry_patch_is_masked():
    rig = small(n=52)
    once = Plan(theta_i_deg=(30.0,), rotations_deg=(0.0,), exposures_s=(1e-3, 8e-3))
    session = Drawn(images(rig, once, rho=0.5))
    camera = session.metadata.camera
    B, S = (merge(session.bracket(role, 0, 0), once.exposures_s, camera)
            for role in ("background", "standard"))  # fmt: skip
    ref = reference(B, S, np.full(S.value.shape, 0.99 / np.pi), dark_e_per_s=camera.dark_e_per_s)
    # Three white surfaces at normal incidence, and one in 1000 of it elsewhere.
    patch = B.value > 0.5 * np.median(S.value[ref.usable])
    assert 4 < patch.sum() < 30
    assert not ref.usable[patch].any()
    # It is told from what cannot be used at all.
    assert ref.entry[patch].all()
    assert not np.any(ref.entry & ref.usable)
    nowhere = reference(B, S, np.full(S.value.shape, np.nan), dark_e_per_s=0.0)
    assert not (nowhere.usable | nowhere.entry).any()
    assert np.all(nowhere.f_per_rate == 0)


def test_dead_and_hot_pixels_are_masked_and_distinguished():
    rng = np.random.default_rng(3)
    B, S = flat(1e3, 1.0, rng), flat(1e5, 1.0, rng)
    S.value[10, 10] = B.value[10, 10] + 100  # sees nothing
    S.value[20:22, 20] = 1.5e4  # two side by side see a seventh
    S.value[25, 25] = 3e4  # a third of the light: it cancels
    B.value[30, 30] += 1e4  # a dark current of a tenth of the light
    S.value[30, 30] += 1e4
    B.value[40, 40] += 500  # half a per cent: its noise is counted and it may stay
    S.value[40, 40] += 500
    S.value[60:, :] = B.value[60:, :] + 1e4  # the edge of the lit spot is no dead pixel
    ref = reference(B, S, WHITE, dark_e_per_s=0)
    assert [tuple(p) for p in np.argwhere(ref.dead)] == [(10, 10), (20, 20), (21, 20)]
    assert [tuple(p) for p in np.argwhere(ref.hot)] == [(30, 30)]
    assert not ref.usable[ref.dead | ref.hot].any()
    assert ref.usable[25, 25]
    assert ref.usable[40, 40]
    assert ref.usable[57:63].all()


def test_neither_dark_current_nor_even_room_light_is_an_entry_patch():
    B, S = flat(5e4, 0.1), flat(1e5, 0.1)
    for dark in (5e4, 0.0):
        ref = reference(B, S, WHITE, dark_e_per_s=dark)
        assert ref.usable.all()
        assert not ref.entry.any()


def test_a_standard_too_dark_for_a_ratio_is_masked():
    # Signal to noise of 15 and of 40 with a background of 0 and a read noise of 5 electrons.
    for electrons, usable in ((250, False), (1700, True)):
        ref = reference(flat(0, 1.0), flat(electrons, 1.0), WHITE, dark_e_per_s=0)
        assert ref.usable.all() == usable
        assert ref.usable.any() == usable


def test_saturated_pixels_of_standard_or_background_are_masked():
    B, S = flat(0, 1.0), flat(1e5, 1.0)
    hot = np.zeros((300, 300), bool)
    hot[7, 9] = True
    for b, s in ((Rate(B.value, B.time, B.read_variance, hot), S),
                 (B, Rate(S.value, S.time, S.read_variance, hot))):  # fmt: skip
        ref = reference(b, s, WHITE, dark_e_per_s=0)
        np.testing.assert_array_equal(~ref.usable, hot)


def test_choosing_bright_pixels_does_not_choose_their_noise():
    # A standard that stands 25 standard deviations high, where about half of the pixels pass.
    signal = (25**2 + np.sqrt(25.0**4 + 4 * 25**2 * 2 * 25)) / 2
    standard = flat(signal, 1.0, np.random.default_rng(9))
    background = flat(0.0, 1.0, np.random.default_rng(10))
    ref = reference(background, standard, WHITE, dark_e_per_s=0)
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
