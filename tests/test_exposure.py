"""Merging bracketed exposures: unbiased at any brightness, the stated variance, the flags."""

import numpy as np
import pytest

from gonio.calibration.frames.exposure import Rate, average, merge, response_tables
from gonio.metadata import Camera

TIMES = (0.25e-3, 1e-3, 4e-3, 16e-3, 64e-3, 256e-3)
GAIN, BLACK, NOISE = 0.38, 64.0, 0.38 * 2.3
WELL_E = (4095 - BLACK) / GAIN  # electrons at which the counts saturate, below the full well


def camera(**changes) -> Camera:
    figures = {
        "rows": 300,
        "columns": 300,
        "pitch_mm": (0.00345, 0.00345),
        "gain_dn_per_e": GAIN,
        "black_dn": BLACK,
        "saturation_dn": 4095,
        "full_well_e": 10_700.0,
        "noise_dn": NOISE,
        "dark_e_per_s": 2.0,
    }
    return Camera(**(figures | changes))


def frames(rate, seed: int, shape=(300, 300), times=TIMES) -> np.ndarray:
    """Counts of a 12-bit camera, from the rate in e-/s, with numpy's own random numbers."""
    rng = np.random.default_rng(seed)
    out = []
    for t in times:
        electrons = np.minimum(rng.poisson(np.broadcast_to(rate, shape) * t), 10_700)
        counts = BLACK + GAIN * electrons + NOISE * rng.standard_normal(shape)
        out.append(np.clip(np.rint(counts), 0, 4095))
    return np.array(out).astype(np.uint16)


def curved_frames(rate: float, seed: int, cam: Camera, shape=(300, 300), times=TIMES) -> np.ndarray:
    """Counts of a camera with a response: electrons, power law, then read noise and rounding."""
    rng = np.random.default_rng(seed)
    well, top = cam.full_well_e, cam.saturation_dn
    out = []
    for t in times:
        electrons = np.minimum(rng.poisson(rate * t, shape), well)
        counts = cam.gain_dn_per_e * well * (electrons / well) ** cam.gamma + cam.black_dn
        counts += cam.noise_dn * rng.standard_normal(shape)
        out.append(np.clip(np.rint(counts), 0, top))
    return np.array(out).astype(np.uint16)


def mean_and_error(x: np.ndarray) -> tuple[float, float]:
    """Mean with its standard error from blocks: neighbours share their decisions."""
    blocks = x.reshape(30, 10, 30, 10).mean(axis=(1, 3))
    return float(x.mean()), float(blocks.std(ddof=1) / 30)


# Means (as a share of the saturation) where an own-value mask or the guard at 0.9 would bite,
# in the 16 ms frame; then the dark, the dim and the brightest that the bracket can hold.
AT_THE_LIMIT = [s * WELL_E / 16e-3 for s in (0.7, 0.86, 0.88, 0.89, 0.9, 0.91, 0.94, 0.98, 1, 1.05)]
RATES = [2.0, 50.0, 1e3, 2e4, *AT_THE_LIMIT, 0.9 * WELL_E / 1e-3, 0.9 * WELL_E / 0.25e-3]


@pytest.mark.parametrize("rate", RATES)
def test_no_bias_and_the_stated_variance_at_every_brightness(rate):
    merged = merge(frames(rate, seed=11), TIMES, camera())
    assert not merged.saturated.any()
    mean, error = mean_and_error(merged.value)
    assert abs(mean - rate) < 3 * error
    z2 = (merged.value - rate) ** 2 / merged.variance(np.full(merged.value.shape, rate))
    mean, error = mean_and_error(z2)
    assert abs(mean - 1) < 3 * error


def test_masking_by_the_own_value_would_bias():
    """The bias that the guard avoids is one that this test's statistics can see."""
    rate = 0.95 * WELL_E / 16e-3
    bracket = frames(rate, seed=12).astype(float)
    times = np.array(TIMES)[:, None, None]
    used = bracket < BLACK + 0.95 * (4095 - BLACK)
    naive = np.sum((bracket - BLACK) * used, axis=0) / GAIN / np.sum(times * used, axis=0)
    mean, error = mean_and_error(naive)
    assert (mean - rate) / rate < -0.001
    assert abs(mean - rate) > 10 * error


def test_an_exposure_is_used_up_to_the_guard_and_not_beyond():
    times = (1e-3, 4e-3)
    for share, expected in ((0.85, 5e-3), (0.95, 1e-3)):
        merged = merge(frames(share * WELL_E / 4e-3, 13, times=times), times, camera())
        # The mean of eight neighbours scatters by 0.7 %: five standard deviations are 3.5 %.
        assert np.all(merged.time == expected)


def test_saturated_in_every_exposure_is_flagged():
    rate = np.full((300, 300), 100.0)
    rate[100:110, 50:60] = 20 * WELL_E / TIMES[0]
    merged = merge(frames(rate, seed=14), TIMES, camera())
    bright = np.zeros((300, 300), bool)
    bright[100:110, 50:60] = True
    assert merged.saturated[bright].all()
    assert (merged.time[bright] == 0).all()
    assert (merged.value[bright] == 0).all()
    # Beside it the long exposures are left out, not flagged, and what is left is right.
    assert not merged.saturated[~bright].any()
    assert (merged.time[~bright] > 0).all()
    beside = ~bright & (merged.time < sum(TIMES))
    assert beside.sum() == 4 * 10  # a corner has one bright neighbour of eight, too few
    error = np.sqrt(merged.variance(np.full(rate.shape, 100.0))[beside].mean() / beside.sum())
    assert abs(merged.value[beside].mean() - 100) < 3 * error


def test_a_full_well_below_the_last_count_saturates_too():
    bracket = np.full((1, 5, 5), 64 + 0.99 * 0.38 * 5000).astype(np.uint16)
    assert merge(bracket, (1e-3,), camera(full_well_e=5000.0)).saturated.all()
    assert not merge(bracket, (1e-3,), camera()).saturated.any()


def test_a_hot_pixel_is_flagged_and_its_neighbours_are_kept():
    bracket = frames(1e3, seed=15)
    bracket[5, 40, 60] = 4095  # dark until the last exposure, then full
    merged = merge(bracket, TIMES, camera())
    assert merged.saturated[40, 60]
    assert merged.saturated.sum() == 1
    assert merged.time[40, 60] == 0
    assert merged.time[40, 61] == pytest.approx(sum(TIMES))


def test_a_pixel_brighter_than_its_neighbours_falls_back_to_shorter_exposures():
    rate = np.full((300, 300), 1e3)
    peak = 0.5 * WELL_E / 16e-3
    rate[::10, ::10] = peak
    merged = merge(frames(rate, seed=16), TIMES, camera())
    peaks = merged.value[::10, ::10]
    assert not merged.saturated.any()
    assert np.all(merged.time[::10, ::10] == pytest.approx(sum(TIMES[:4])))
    error = np.sqrt(merged.variance(rate)[::10, ::10].mean() / peaks.size)
    assert abs(peaks.mean() - peak) < 3 * error


def test_black_frames_are_zero_within_their_noise():
    merged = merge(frames(0.0, seed=17), TIMES, camera(dark_e_per_s=0.0))
    mean, error = mean_and_error(merged.value)
    assert abs(mean) < 3 * error
    # Read noise and rounding of six frames over the sum of their times.
    expected = 6 * (NOISE**2 + 1 / 12) / GAIN**2 / sum(TIMES) ** 2
    np.testing.assert_allclose(merged.variance(np.zeros((300, 300))), expected, rtol=1e-12)
    exact = merge(np.full((6, 4, 4), 64, np.uint16), TIMES, camera())
    assert np.all(exact.value == 0)


def test_one_pixel_and_one_row_have_fewer_neighbours():
    for shape in ((1, 1), (1, 7), (7, 1)):
        merged = merge(frames(1e3, 18, shape), TIMES, camera())
        assert merged.value.shape == shape
        assert np.all(np.abs(merged.value - 1e3) < 6 * np.sqrt(merged.variance(merged.value)))


def test_repeated_takes_are_weighted_by_their_exposure():
    one = np.ones((2, 2))
    no = np.zeros((2, 2), bool)
    first = Rate(10 * one, 1.0 * one, 4.0 * one, no)
    second = Rate(16 * one, 2.0 * one, 1.0 * one, no)
    both = average([first, second])
    assert np.all(both.value == (10 * 1 + 16 * 2) / 3)  # counts over time
    assert np.all(both.time == 3)
    np.testing.assert_allclose(both.read_variance, (4 * 1 + 1 * 4) / 9)
    assert average([first]) is first


def test_the_mean_of_repeated_takes_has_the_stated_variance():
    rate = 3e3
    takes = [merge(frames(rate, seed), TIMES, camera()) for seed in (21, 22, 23, 24)]
    both = average(takes)
    z2 = (both.value - rate) ** 2 / both.variance(np.full(both.value.shape, rate))
    mean, error = mean_and_error(z2)
    assert abs(mean - 1) < 3 * error
    ratio = both.variance(both.value).mean() / takes[0].variance(takes[0].value).mean()
    assert ratio == pytest.approx(1 / 4, rel=0.01)


def test_a_pixel_saturated_in_one_take_is_flagged_in_the_mean():
    one = np.ones((1, 2))
    good = Rate(5 * one, one, one, np.array([[False, False]]))
    bad = Rate(np.array([[5.0, 0.0]]), np.array([[1.0, 0.0]]), one, np.array([[False, True]]))
    both = average([good, bad])
    assert both.saturated.tolist() == [[False, True]]
    np.testing.assert_allclose(both.value, 5)


TWELVE_BITS = {"gain_dn_per_e": 0.38, "full_well_e": 10_600.0}
EIGHT_BITS = {
    "gain_dn_per_e": 0.006175,
    "black_dn": 8.0,
    "saturation_dn": 255,
    "full_well_e": 40_000.0,
    "noise_dn": 0.4,
}


@pytest.mark.parametrize("gamma", [0.45, 0.9, 1.2])
@pytest.mark.parametrize("figures", [TWELVE_BITS, EIGHT_BITS], ids=["12 bit", "8 bit"])
@pytest.mark.parametrize("share", [0.01, 0.08, 0.3, 0.7, 0.95])
def test_a_curved_response_is_made_linear_with_the_stated_variance(gamma, figures, share):
    cam = camera(**figures, gamma=gamma)
    times = (1e-3, 4e-3)
    rate = share * cam.full_well_e / times[1]
    merged = merge(curved_frames(rate, 31, cam, times=times), times, cam)
    assert not merged.saturated.any()
    mean, error = mean_and_error(merged.value)
    sd = np.sqrt(merged.variance(np.full(merged.value.shape, rate)).mean())
    signal_dn = cam.gain_dn_per_e * cam.full_well_e * (share / 4) ** gamma
    if signal_dn < 5 * np.sqrt(cam.noise_dn**2 + 1 / 12):
        # A count or two above black: the inverse bends more than its second order says.
        assert abs(mean - rate) < 0.15 * sd
        return
    assert abs(mean - rate) < 3 * error + 1e-3 * sd
    z2 = (merged.value - rate) ** 2 / merged.variance(np.full(merged.value.shape, rate))
    mean, error = mean_and_error(z2)
    # The slope of the inverse is taken at each count and not at its mean.
    assert abs(mean - 1) < 3 * error + 0.01


def test_a_response_that_is_not_made_linear_is_a_bias():
    cam = camera(**TWELVE_BITS, gamma=0.9)
    rate = 0.08 * cam.full_well_e / 4e-3
    bracket = curved_frames(rate, 31, cam, times=(4e-3,))
    taken_as_linear = merge(bracket, (4e-3,), cam.model_copy(update={"gamma": 1.0}))
    # (0.08)^0.9 in place of 0.08
    assert taken_as_linear.value.mean() / rate == pytest.approx(0.08**-0.1, rel=1e-3)


def test_the_tables_of_a_straight_response_are_the_gain():
    cam = camera()
    electrons, variance = response_tables(cam)
    counts = np.arange(65536)
    np.testing.assert_allclose(electrons, (counts - BLACK) / GAIN, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(variance, (NOISE**2 + 1 / 12) / GAIN**2, rtol=1e-9)


def test_a_curved_response_saturates_and_is_guarded_in_electrons():
    cam = camera(**EIGHT_BITS, gamma=0.45)
    times = (1e-3, 4e-3)
    for share, expected in ((0.8, 5e-3), (1.0, 1e-3)):
        rate = share * 0.9 * cam.full_well_e / 4e-3
        merged = merge(curved_frames(rate, 33, cam, times=times), times, cam)
        if share < 1:
            # At 0.72 of the well by a frame of 0.18: every pixel uses both.
            assert np.all(merged.time == expected)
        assert set(np.unique(merged.time)) <= {1e-3, 5e-3}
    full = merge(np.full((2, 5, 5), 255, np.uint16), times, cam)
    assert full.saturated.all()
    # Dark until the last exposure, then full: flagged, not used.
    bracket = np.stack([np.full((5, 5), 8), np.full((5, 5), 255)]).astype(np.uint16)
    assert merge(bracket, times, cam).saturated.all()
