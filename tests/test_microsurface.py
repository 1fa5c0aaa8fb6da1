"""Photons in V-cavities against the integrals of the models, and against themselves."""

import numpy as np
import pytest
from scipy.stats import chi2

from gonio.errors import ConfigurationError
from gonio.models._vcavity import gaussian, shares, unidirectional
from gonio.models.microsurface import gaussian_slopes, trace

DEG = np.pi / 180


def agree(z: np.ndarray) -> bool:
    """Whether standard scores of n draws look like n draws of a normal variable."""
    z = np.ravel(z)
    return bool(np.sum(z**2) < chi2.ppf(0.999, z.size) and np.sum(np.abs(z) > 3) <= 1)


def test_one_and_two_bounces_equal_the_integral_of_the_gaussian_surface():
    rng = np.random.default_rng(1)
    z = []
    for _ in range(20):
        theta_i, theta_r = rng.uniform(0, 83 * DEG, 2)
        dphi, sigma = rng.uniform(0, 2 * np.pi), rng.uniform(5, 60) * DEG
        traced = trace(theta_i, theta_r, dphi, gaussian_slopes(sigma), rng)
        exact = np.array(shares(gaussian, theta_i, theta_r, dphi, sigma)) / np.pi
        z.append((traced.f[:2, 0] - exact) / traced.f_stderr[:2, 0])
    z = np.array(z)
    assert agree(z[:, 0])
    assert agree(z[:, 1])


def test_one_and_two_bounces_equal_the_formula_of_parallel_cavities():
    rng = np.random.default_rng(2)
    z = []
    for _ in range(20):
        theta_i, theta_r = rng.uniform(0, 83 * DEG, 2)
        dphi, azimuth = rng.uniform(0, 2 * np.pi, 2)
        slope = rng.uniform(11, 72) * DEG
        traced = trace(theta_i, theta_r, dphi, slope, rng, azimuth=azimuth)
        exact = (
            np.array(shares(unidirectional, theta_i, theta_r, dphi, slope, azimuth=azimuth)) / np.pi
        )
        for k in range(2):
            if traced.f_stderr[k, 0] > 0:
                z.append((traced.f[k, 0] - exact[k]) / traced.f_stderr[k, 0])
            elif exact[k] < 1e-6:
                assert traced.f[k, 0] == pytest.approx(exact[k], abs=1e-6)
            else:
                # Every photon that can be seen at all is seen alike.
                assert traced.f[k, 0] == pytest.approx(exact[k], rel=1e-9)
    assert agree(np.array(z))


@pytest.mark.parametrize(
    ("sigma", "theta_i", "escaped", "cosine"),
    [(30, 60, 0.7757, 0.4925), (42, 20, 0.4260, 0.2658)],
)
def test_mirror_facets_send_away_what_torrance_and_sparrow_say(sigma, theta_i, escaped, cosine):
    traced = trace(
        theta_i * DEG,
        0.0,
        0.0,
        gaussian_slopes(sigma * DEG),
        np.random.default_rng(3),
        photons=400_000,
        mirror=True,
    )
    assert traced.escaped[1] == pytest.approx(escaped, abs=2.5e-3)
    assert traced.mean_cosine[1] == pytest.approx(cosine, abs=2.5e-3)
    assert not traced.f.any()
    # The rest is between facets that are nearly upright.
    assert traced.escaped.sum() == pytest.approx(1, abs=3e-3)


@pytest.mark.parametrize(("sigma", "low", "high"), [(10, 0.001, 0.003), (30, 0.06, 0.08)])
def test_three_and_more_bounces_matter_when_it_is_rough(sigma, low, high):
    traced = trace(0.5, 0.3, 1.0, gaussian_slopes(sigma * DEG), np.random.default_rng(4))
    parts = 0.9 ** np.arange(len(traced.by_bounce)) * traced.by_bounce[:, 0]
    assert low < parts[3:].sum() / traced.total(0.9)[0] < high
    assert traced.total(1.0)[0] == pytest.approx(traced.f[:, 0].sum(), rel=1e-12)


def test_at_sigma_60_they_carry_a_sixth():
    traced = trace(0.8, 0.3, 1.0, gaussian_slopes(60 * DEG), np.random.default_rng(5))
    parts = 0.9 ** np.arange(len(traced.by_bounce)) * traced.by_bounce[:, 0]
    assert 0.13 < parts[3:].sum() / parts.sum() < 0.18


@pytest.mark.parametrize("slope", [10, 45, 60])
@pytest.mark.parametrize("theta_i", [0, 80])
def test_all_light_comes_out_again(slope, theta_i):
    traced = trace(theta_i * DEG, 0.0, 0.0, slope * DEG, np.random.default_rng(6), photons=20_000)
    assert traced.escaped.sum() == pytest.approx(1, abs=1e-12)
    assert traced.trapped == pytest.approx(0, abs=1e-12)
    assert traced.escaped[0] == 0


def test_all_light_comes_out_of_a_rough_surface_after_many_bounces():
    slopes = gaussian_slopes(60 * DEG)
    short, long = (
        trace(0.3, 0.0, 0.0, slopes, np.random.default_rng(7), photons=20_000, bounces=bounces)
        for bounces in (50, 20_000)
    )
    assert short.trapped > 0.01
    assert long.trapped < 2e-4


def test_flat_facets_are_lambertian():
    traced = trace(0.7, [0.2, 1.2], [0.0, 2.0], 1e-4, np.random.default_rng(8), photons=1000)
    np.testing.assert_allclose(traced.f[0], 1 / np.pi, rtol=1e-3)
    assert traced.mean_cosine[1] == pytest.approx(2 / 3, abs=0.03)


def test_slopes_have_the_density_of_a_share_of_area():
    sigma = 40 * DEG
    slopes = np.sort(gaussian_slopes(sigma)(np.random.default_rng(9), 50_000))
    t = np.linspace(0, np.pi / 2, 4001)
    density = np.exp(-(t**2) / (2 * sigma**2)) * np.sin(t)
    cumulative = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
    cumulative /= cumulative[-1]
    distance = np.abs(np.interp(slopes, t, cumulative) - (np.arange(50_000) + 0.5) / 50_000)
    # Kolmogorov and Smirnov's limit for one in a thousand.
    assert distance.max() < 1.95 / np.sqrt(50_000)


def test_one_seed_gives_the_same_photons():
    one, two = (
        trace(0.4, 0.5, 0.6, gaussian_slopes(0.4), np.random.default_rng(10), photons=2000)
        for _ in range(2)
    )
    np.testing.assert_array_equal(one.f, two.f)
    np.testing.assert_array_equal(one.escaped, two.escaped)


def test_directions_below_the_horizon_and_flat_slopes_are_refused():
    rng = np.random.default_rng(11)
    with pytest.raises(ConfigurationError, match=r"theta_i = 1\.6 is not above the horizon; give"):
        trace(1.6, 0.0, 0.0, 0.3, rng)
    with pytest.raises(ConfigurationError, match=r"theta_r = 1\.7 is not above the horizon; give"):
        trace(0.1, 1.7, 0.0, 0.3, rng)
    with pytest.raises(ConfigurationError, match=r"slopes must be 100000 numbers, .* excluded"):
        trace(0.1, 0.1, 0.0, 0.0, rng)
