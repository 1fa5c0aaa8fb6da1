"""The random numbers behind the noise: their distributions, far into the tails."""

import numpy as np
import pytest
from scipy import special, stats

from gonio.instrument import noise
from gonio.instrument.noise import BLOCK, expose

N = 1_000_000
CAMERA = {
    "full_well_e": 1e9,
    "gain_dn_per_e": 1.0,
    "noise_dn": 0.0,
    "black_dn": 0.0,
    "saturation_dn": 65535,
    "seed": 2026,
    "threads": 1,
}


def electrons(mean, n=N, frame=0):
    """Poisson numbers of n pixels that expect `mean` electrons each."""
    return expose(np.full((1, n), float(mean)), 1.0, frame=frame, **CAMERA)[0]


def normals(n, frame=0):
    """Read noise in standard deviations, rounded to 1/2000, half of which is added evenly."""
    camera = CAMERA | {"noise_dn": 2000.0, "black_dn": 32768.0}
    counts = expose(np.zeros((1, n)), 1.0, frame=frame, **camera)[0]
    return (counts - 32768.0) / 2000


class TestPoisson:
    # Small means are drawn from a table with steps of 1/2, large ones from 64 on another way.
    @pytest.mark.parametrize(
        "mean", [0.1, 0.49, 1.0, 5.0, 20.0, 30.0, 40.0, 63.9, 64.0, 100.0, 1000.0]
    )
    def test_numbers_have_the_probabilities_of_the_law(self, mean):
        sample, law = electrons(mean), stats.poisson(mean)
        n = np.arange(sample.max() + 2)
        expected = N * law.pmf(n)
        expected[-1] = N * law.sf(n[-2])
        observed = np.bincount(sample, minlength=len(n)).astype(float)
        # The ends are put together until ten are expected in each.
        low = int(np.argmax(np.cumsum(expected) >= 10))
        high = len(n) - 1 - int(np.argmax(np.cumsum(expected[::-1]) >= 10))
        edges = [0, *range(low + 1, high + 1)]
        observed, expected = (np.add.reduceat(a, edges) for a in (observed, expected))
        assert len(expected) >= 3
        # 11 means: a true generator fails one of them once in a thousand runs of a new seed.
        assert stats.chisquare(observed, expected).pvalue > 1e-4

    @pytest.mark.parametrize("mean", [1.0, 20.0, 63.9, 64.0, 1000.0])
    def test_tails_are_as_long_as_those_of_the_law(self, mean):
        sample, law = electrons(mean, 4 * N), stats.poisson(mean)
        for q in (1e-3, 1e-5):
            above, below = law.isf(q), law.ppf(q)
            for found, expected in (
                (np.count_nonzero(sample > above), 4 * N * law.sf(above)),
                (np.count_nonzero(sample < below), 4 * N * law.cdf(below - 1)),
            ):
                least, most = stats.poisson(expected).interval(1 - 1e-4)
                assert least <= found <= most

    def test_the_table_holds_the_probabilities_of_the_law(self):
        table = noise._alias_table().reshape(-1, 256)
        kept, alias = (table >> 8) / 2.0**24, table & 0xFF
        for row in (0, 1, 2, 11, 64, 127):
            p = kept[row].copy()
            np.add.at(p, alias[row], 1 - kept[row])
            # Each of 256 thresholds is cut to 2^-24 of a column, which is 2^-8 of all.
            np.testing.assert_allclose(
                p / 256, stats.poisson(row / 2).pmf(np.arange(256)), atol=256 * 2.0**-32
            )

    @pytest.mark.parametrize("mean", [64.0, 200.0, 1e4])
    def test_large_means_follow_the_inverse_of_the_law(self, mean):
        w = np.linspace(-4, 4, BLOCK).astype(np.float32)
        found = np.empty(BLOCK, np.float32)
        noise._bright.py_func(np.full(BLOCK, mean, np.float32), w, found)
        # The number is k where P(N <= k - 1) <= u < P(N <= k); in between the same is continuous.
        exact = special.pdtrik(special.ndtr(w.astype(float)), mean) + 1
        # The next correction is of the order of w^5 mean^-3/2 / 500; rounding is 1e-7 of 1e4.
        clear = np.abs(exact - np.round(exact)) > 0.02
        assert clear.mean() > 0.9
        np.testing.assert_array_equal(found[clear], np.floor(exact[clear]))

    def test_no_light_no_electrons(self):
        assert not electrons(0.0).any()

    def test_a_mean_beyond_all_counts_fills_the_well(self):
        full = CAMERA | {"full_well_e": 5e4}
        assert np.all(expose(np.full((2, 3), 1e15), 1.0, frame=0, **full) == 50_000)


class TestNormal:
    def test_numbers_fall_evenly_into_bins_of_equal_probability(self):
        sample = normals(N) + np.random.default_rng(1).uniform(-0.5, 0.5, N) / 2000
        edges = stats.norm.ppf(np.linspace(0, 1, 401)[1:-1])
        observed = np.bincount(np.searchsorted(edges, sample), minlength=400)
        assert stats.chisquare(observed).pvalue > 1e-4

    def test_tails_reach_five_standard_deviations(self):
        n = 16 * N
        sample = normals(n)
        half = 0.5 / 2000  # of a count
        for limit in (3.0, 4.0, 4.5, 5.0):
            expected = n * stats.norm.sf(limit - half)
            for found in (np.count_nonzero(sample >= limit), np.count_nonzero(sample <= -limit)):
                least, most = stats.poisson(expected).interval(1 - 1e-4)
                assert least <= found <= most
        assert 5.0 < abs(sample).max() < 6.8  # sqrt(2 ln 2^33)

    def test_mean_and_variance(self):
        sample = normals(N)
        assert abs(sample.mean()) < 4 / np.sqrt(N)
        assert abs(sample.var() - 1) < 4 * np.sqrt(2 / N)


class TestStages:
    """Mean and variance of each stage over 200 frames, within four standard errors."""

    FRAMES, SHAPE = 200, (60, 70)

    # Light in e-, what is changed about a camera without noise of its own, mean, variance.
    @pytest.mark.parametrize(
        ("light", "changed", "mean", "variance"),
        [
            pytest.param(7.0, {}, 7.0, 7.0, id="shot noise of dim light"),
            pytest.param(900.0, {}, 900.0, 900.0, id="shot noise"),
            pytest.param(3.0, {"dark_e_per_s": 40.0}, 43.0, 43.0, id="dark current"),
            pytest.param(
                500.0, {"gain_dn_per_e": 6.0}, 3000.0, 36 * 500.0, id="gain"
            ),
            pytest.param(
                0.0, {"noise_dn": 5.0, "black_dn": 64.0}, 64.0, 25 + 1 / 12, id="read noise"
            ),
            pytest.param(
                200.0, {"black_dn": 64.3, "noise_dn": 3.0}, 264.3, 209 + 1 / 12, id="black level"
            ),
            pytest.param(
                1e4, {"full_well_e": 5e3, "noise_dn": 2.0}, 5e3, 4 + 1 / 12, id="full well"
            ),
        ],
    )  # fmt: skip
    def test_mean_and_variance(self, light, changed, mean, variance):
        rate = np.full(self.SHAPE, light)
        frames = np.array(
            [expose(rate, 1.0, frame=k, **CAMERA | changed) for k in range(self.FRAMES)], float
        )
        n = frames.size
        assert abs(frames.mean() - mean) < 4 * np.sqrt(variance / n)
        fourth = np.mean((frames - mean) ** 4)
        assert abs(frames.var() - variance) < 4 * np.sqrt((fourth - variance**2) / n)
        # And pixel by pixel: no pixel is special, no frame is.
        by_pixel = (frames.mean(axis=0) - mean) / np.sqrt(variance / self.FRAMES)
        by_frame = (frames.mean(axis=(1, 2)) - mean) / np.sqrt(variance / rate.size)
        for z in (by_pixel, by_frame):
            assert abs(z.var() - 1) < 4 * np.sqrt(2 / z.size)
            assert abs(z).max() < stats.norm.isf(1e-5 / z.size)

    def test_the_response_bends_electrons_and_not_the_read_noise(self):
        camera = CAMERA | {
            "full_well_e": 1e4, "gain_dn_per_e": 4.0, "noise_dn": 3.0, "black_dn": 100.0,
            "gamma": 0.5,
        }  # fmt: skip
        dark = expose(np.zeros((500, 600)), 1.0, frame=0, **camera).astype(float)
        assert abs(dark.var() - 9 - 1 / 12) < 4 * np.sqrt(2 / dark.size) * 9.1
        light = expose(np.full((500, 600), 2500.0), 1.0, frame=1, **camera).astype(float)
        # gain well sqrt(e/well), whose second derivative -1/4 e^-3/2 meets the variance e.
        curved = 4 * 1e4 * (0.5 - 0.125 / 2500 * 0.5)
        # Slope gain/2 sqrt(well/e) = 4.
        variance = 16 * 2500 + 9
        assert abs(light.mean() - 100 - curved) < 4 * np.sqrt(variance / light.size)
        assert light.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / light.size))

    def test_a_straight_response_is_none(self):
        rate = np.linspace(0, 5e3, 5000).reshape(50, 100)
        straight = expose(rate, 1.0, frame=0, **CAMERA)
        np.testing.assert_array_equal(straight, expose(rate, 1.0, frame=0, gamma=1.0, **CAMERA))
        nearly = expose(rate, 1.0, frame=0, gamma=1 + 1e-12, **CAMERA)
        # Electrons of float32 may come out an ulp off whole numbers, and are rounded.
        np.testing.assert_array_equal(straight, nearly)


class TestIndependence:
    def test_a_pixel_does_not_see_how_bright_others_are(self):
        rate = np.full((1, 3 * BLOCK), 500.0)
        mixed = rate.copy()
        mixed[0, ::7] = 3.0
        camera = CAMERA | {"noise_dn": 2.0, "black_dn": 50.0}
        a, b = (expose(r, 1.0, frame=3, **camera)[0] for r in (rate, mixed))
        others = np.arange(rate.size) % 7 > 0
        np.testing.assert_array_equal(a[others], b[others])

    def test_a_pixel_does_not_see_how_many_follow(self):
        rate = np.random.default_rng(2).uniform(0, 200, (1, 3 * BLOCK + 17))
        camera = CAMERA | {"noise_dn": 2.0, "black_dn": 50.0}
        whole = expose(rate, 1.0, frame=3, **camera)[0]
        for n in (1, BLOCK - 1, BLOCK + 1, 3 * BLOCK):
            np.testing.assert_array_equal(expose(rate[:, :n], 1.0, frame=3, **camera)[0], whole[:n])

    # In a block, a pixel and its twin half a block on share a counter of the generator.
    @pytest.mark.parametrize("lag", [1, BLOCK // 2, BLOCK])
    @pytest.mark.parametrize("mean", [5.0, 500.0])
    def test_pixels_are_independent(self, mean, lag):
        camera = CAMERA | {"noise_dn": np.sqrt(mean), "black_dn": 100.0}
        counts = expose(np.full((1, N), mean), 1.0, frame=0, **camera)[0].astype(float)
        z = (counts - counts.mean()) / counts.std()
        assert abs(np.mean(z[lag:] * z[:-lag])) < 4 / np.sqrt(N)

    def test_dim_numbers_and_read_noise_are_independent(self):
        camera = CAMERA | {"noise_dn": 3.0, "black_dn": 100.0, "gain_dn_per_e": 1.0}
        counts = expose(np.full((1, N), 9.0), 1.0, frame=0, **camera)[0]
        assert counts.var() == pytest.approx(9 + 9 + 1 / 12, rel=4 * np.sqrt(2 / N) * 1.1)
