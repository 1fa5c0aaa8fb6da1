"""The sensor: what statistics and a real camera's data sheet demand of raw counts."""

import numpy as np
import pytest
from scipy import stats

from gonio.instrument import Sensor, preset
from gonio.instrument.noise import expose, philox

N = 200_000
CAMERA = {
    "dark_e_per_s": 0.0,
    "full_well_e": 1e9,
    "gain_dn_per_e": 1.0,
    "noise_dn": 0.0,
    "black_dn": 0.0,
    "saturation_dn": 65535,
    "seed": 12345,
    "frame": 0,
}


def counts(mean, n=N, *, time_s=1.0, threads=1, **camera):
    """Raw counts, as floats, of n equal pixels that expect `mean` electrons a second."""
    rate = np.full((1, n), float(mean))
    return expose(rate, time_s, **{**CAMERA, **camera}, threads=threads)[0].astype(float)


def assert_moments(sample, mean, variance):
    """Mean and variance within four standard errors of what is expected."""
    n = len(sample)
    found = sample.var()
    assert abs(sample.mean() - mean) < 4 * np.sqrt(variance / n)
    fourth = np.mean((sample - sample.mean()) ** 4)
    assert abs(found - variance) < 4 * np.sqrt((fourth - found**2) / n)


class TestPhilox:
    # Known answers of Random123 for philox4x32-10: counter, key, output.
    @pytest.mark.parametrize(
        ("counter", "key", "answer"),
        [
            ("00000000 00000000 00000000 00000000", "00000000 00000000",
             "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
            ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff",
             "408f276d 41c83b0e a20bc7c6 6d5451fd"),
            ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0",
             "d16cfe09 94fdcceb 5001e420 24126ea1"),
        ],
    )  # fmt: skip
    def test_known_answers(self, counter, key, answer):
        words = [np.uint32(int(word, 16)) for word in (counter + " " + key).split()]
        assert [f"{int(word):08x}" for word in philox(*words)] == answer.split()


class TestShotNoise:
    # 29.9 and 30.1 lie on either side of the change of algorithm.
    @pytest.mark.parametrize("mean", [0.3, 3.0, 29.9, 30.1, 100.0, 1e4])
    def test_electrons_are_poisson_numbers(self, mean):
        sample = counts(mean)
        law = stats.poisson(mean)
        # Bins of equal probability where the law allows, at least about 1000 draws in each.
        edges = np.unique(law.ppf(np.linspace(0, 1, 101)[1:-1]))
        expected = N * np.diff(np.concatenate([[0.0], law.cdf(edges), [1.0]]))
        observed = np.bincount(np.searchsorted(edges, sample), minlength=len(expected))
        keep = expected > 10
        expected = np.append(expected[keep], expected[~keep].sum())
        observed = np.append(observed[keep], observed[~keep].sum())
        if expected[-1] == 0:
            expected, observed = expected[:-1], observed[:-1]
        assert stats.chisquare(observed, expected * N / expected.sum()).pvalue > 1e-4
        assert_moments(sample, mean, mean)

    def test_no_light_no_electrons(self):
        assert np.all(counts(0.0) == 0)

    def test_tails_reach_as_far_as_the_law(self):
        for mean in (3.0, 50.0):
            top = counts(mean).max()
            # The largest of N draws exceeds the 1 - 1e-3/N quantile with probability 1e-3.
            assert stats.poisson(mean).isf(10 / N) <= top <= stats.poisson(mean).isf(1e-3 / N)


class TestStages:
    def test_zero_light_is_the_black_level(self):
        sample = counts(0.0, noise_dn=0.9, black_dn=64.0)
        # Rounding adds 1/12 to the variance of the read noise.
        assert_moments(sample, 64.0, 0.9**2 + 1 / 12)

    def test_without_noise_and_light_every_count_is_the_black_level(self):
        assert np.all(counts(0.0, black_dn=64.0) == 64)

    def test_dark_current_grows_with_time_only(self):
        assert_moments(counts(0.0, time_s=4.0, dark_e_per_s=25.0), 100.0, 100.0)

    def test_light_grows_with_time(self):
        assert_moments(counts(200.0, time_s=0.5), 100.0, 100.0)

    def test_gain_read_noise_and_black_level(self):
        sample = counts(500.0, gain_dn_per_e=4.0, noise_dn=5.0, black_dn=100.0)
        assert_moments(sample, 2100.0, 16 * 500.0 + 25.0 + 1 / 12)

    def test_clips_at_the_full_well(self):
        sample = counts(2000.0, full_well_e=1000.0, gain_dn_per_e=2.0, black_dn=10.0)
        assert np.all(sample == 2010)
        # The read noise comes after the well: a full pixel still flickers.
        sample = counts(2000.0, full_well_e=1000.0, gain_dn_per_e=2.0, black_dn=10.0, noise_dn=3.0)
        assert_moments(sample, 2010.0, 9 + 1 / 12)

    def test_clips_at_both_ends_of_the_converter(self):
        assert np.all(counts(5000.0, saturation_dn=4095) == 4095)
        # Without a black level the converter cuts off the lower half of the read noise: the mean
        # of max(N(0, s), 0) is s/sqrt(2 pi), rounding included since s is large.
        sample = counts(0.0, noise_dn=50.0)
        assert sample.min() == 0
        half_normal = 50 / np.sqrt(2 * np.pi)
        assert abs(sample.mean() - half_normal) < 4 * sample.std() / np.sqrt(N)

    def test_prnu_is_a_fixed_pattern_of_the_stated_size(self):
        sensor = preset("modern12").sensor
        pattern = sensor.response(3)
        np.testing.assert_array_equal(pattern, sensor.response(3))
        assert abs(np.corrcoef(pattern.ravel(), sensor.response(4).ravel())[0, 1]) < (
            4 / np.sqrt(pattern.size)
        )
        # The mean of 16 independent pixels of 0.6 %.
        assert_moments(pattern.ravel(), 1.0, (0.006 / 4) ** 2)

    def test_photon_transfer_gives_back_gain_read_noise_and_full_well(self):
        camera = {"gain_dn_per_e": 0.38, "noise_dn": 0.38 * 2.3, "black_dn": 64.0}
        camera |= {"saturation_dn": 4095, "full_well_e": 9000.0}
        mean, variance = [], []
        for k, electrons in enumerate((0, 50, 200, 800, 2000, 4000, 7000)):
            # The difference of two frames holds no fixed pattern and twice the noise.
            a, b = (counts(electrons, frame=2 * k + j, **camera) for j in range(2))
            mean.append((a.mean() + b.mean()) / 2 - 64.0)
            variance.append((a - b).var() / 2)
        # A variance of n numbers has the relative standard error sqrt(2/n): weights 1/variance.
        slope, offset = np.polyfit(mean, variance, 1, w=1 / np.array(variance))
        assert slope == pytest.approx(0.38, rel=4 * np.sqrt(2 / N))
        read_noise_e = np.sqrt(offset - 1 / 12) / slope
        assert read_noise_e == pytest.approx(2.3, rel=4 * np.sqrt(2 / N))
        top = counts(50_000, **camera)
        well = (top.mean() - 64.0) / slope
        assert well == pytest.approx(9000, rel=4 * np.sqrt(2 / N))


class TestBinning:
    """A binned frame has the statistics of sums of pixels that were digitised one by one."""

    SENSOR = preset("modern12").sensor

    def binned(self, rate_of_pixel, time_s):
        s = self.SENSOR
        return counts(
            rate_of_pixel * s.n_summed,
            time_s=time_s,
            dark_e_per_s=s.dark_e_per_s * s.n_summed,
            full_well_e=s.binned_full_well_e,
            gain_dn_per_e=s.gain_dn_per_e,
            noise_dn=s.binned_noise_dn,
            black_dn=s.binned_black_dn,
            saturation_dn=s.saturation_dn,
        )

    def summed(self, rate_of_pixel, time_s, n):
        s, rng = self.SENSOR, np.random.default_rng(1)
        electrons = rng.poisson(time_s * (rate_of_pixel + s.dark_e_per_s), (s.n_summed, n))
        electrons = np.minimum(electrons, s.full_well_e)
        volts = electrons + rng.normal(0, s.read_noise_e, electrons.shape)
        counted = np.round(s.gain_dn_per_e * volts + s.black_dn)
        return np.clip(counted, 0, 2**s.bits - 1).sum(axis=0)

    # Electrons of one pixel: none, a few, mid-range, far beyond saturation.
    @pytest.mark.parametrize("electrons", [0.0, 2.0, 300.0, 8000.0, 40_000.0])
    def test_equals_the_explicit_sum(self, electrons):
        time_s = 0.25
        one = self.binned(electrons / time_s, time_s)
        n = 50_000
        many = self.summed(electrons / time_s, time_s, n)
        error = np.sqrt(one.var() / N + many.var() / n)
        assert abs(one.mean() - many.mean()) <= 4 * error
        # Both are close to normal: relative standard error sqrt(2/n) of each variance.
        assert abs(one.var() - many.var()) <= 4 * many.var() * np.sqrt(2 / N + 2 / n)

    def test_figures(self):
        s = self.SENSOR
        assert s.shape == (416, 416)
        assert s.n_summed == 16
        assert s.saturation_dn == 16 * 4095
        assert s.binned_black_dn == 16 * 64
        assert s.binned_full_well_e == 16 * 10_700

    @pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
    def test_bits_set_the_largest_count(self, bits):
        sensor = Sensor.model_validate(
            self.SENSOR.model_dump() | {"bits": bits, "binning": 1, "rows": 4, "columns": 4}
        )
        assert sensor.saturation_dn == 2**bits - 1
        assert np.all(counts(1e6, 10, saturation_dn=sensor.saturation_dn) == 2**bits - 1)

    def test_positions_are_centred_and_a_bin_apart(self):
        x, y = self.SENSOR.positions_mm()
        assert x.sum() == pytest.approx(0, abs=1e-10)
        np.testing.assert_allclose(np.diff(x), 4 * 3.45e-3)
        assert y[-1] == pytest.approx((1664 / 2 - 2) * 3.45e-3)


class TestReproducibility:
    @staticmethod
    def frame(**changed):
        rate = np.linspace(0, 500, 300 * 400).reshape(300, 400)
        return expose(rate, 1.0, **{**CAMERA, "noise_dn": 2.0, "black_dn": 50.0, **changed})

    @pytest.mark.parametrize("threads", [2, 3])
    def test_the_same_bits_at_any_number_of_threads(self, threads):
        np.testing.assert_array_equal(self.frame(threads=1), self.frame(threads=threads))

    @pytest.mark.parametrize("changed", [{"seed": 12346}, {"seed": 12345 + 2**32}, {"frame": 1}])
    def test_other_seeds_and_frames_are_independent(self, changed):
        rate = np.linspace(0, 500, 300 * 400).reshape(300, 400)
        sd = np.sqrt(rate + 4)
        noise = [(f - 50.0 - rate) / sd for f in (self.frame(), self.frame(**changed))]
        correlation = np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]
        assert abs(correlation) < 4 / np.sqrt(rate.size)

    def test_neighbouring_pixels_are_independent(self):
        sample = counts(100.0, noise_dn=3.0, black_dn=50.0)
        sample = sample - sample.mean()
        for lag in (1, 2, 416):
            r = np.mean(sample[lag:] * sample[:-lag]) / sample.var()
            assert abs(r) < 4 / np.sqrt(N)

    def test_shot_and_read_noise_are_independent(self):
        variance = counts(1e3, noise_dn=30.0, black_dn=500.0).var()
        assert variance == pytest.approx(1e3 + 900 + 1 / 12, rel=4 * np.sqrt(2 / N))
