"""The models' numbers, each against a computation that shares no code with the kernels.

The sums below use a model only as f(i, r); nodes, weights and reference formulas are their own.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from gonio import models
from gonio.geometry import Directions, unit_vectors
from gonio.models.torrance_sparrow import slope_norm

DEG = np.pi / 180


def panels(edges, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on each interval between the sorted edges."""
    x, w = np.polynomial.legendre.leggauss(n)
    edges = np.unique(edges)
    half, middle = np.diff(edges)[:, None] / 2, (edges[1:] + edges[:-1])[:, None] / 2
    return (middle + half * x).ravel(), (half * w).ravel()


def lobe_integrals(model, p, theta_i, phi_i=0.0, width=0.1) -> tuple[float, float]:
    """int f cos_r dw_r and int f cos_r^2 dw_r, over half vectors so that narrow lobes resolve.

    r is i mirrored at h, dw_r = 4 (h.i) dw_h; directions below the horizon count nothing.
    """
    # Between these two the horizon cuts the circle of half vectors around the normal.
    cut = np.pi / 4 + theta_i / 2 * np.array([-1, 1])
    scales = width * np.array([0, 1, 2, 3, 5, 8, 14])
    edges = np.concatenate([scales[scales < np.pi / 2], cut, [np.pi / 2]])
    delta, w_delta = panels(edges, 48)
    n_phi = 1440
    phi = (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
    h = unit_vectors(delta[:, None], phi)
    i = unit_vectors(theta_i, phi_i)
    cos_h = h @ i
    r = 2 * cos_h[..., None] * h - i
    f = model.evaluate(i, r, p)
    dw = 4 * np.maximum(cos_h, 0) * (np.sin(delta) * w_delta)[:, None] * 2 * np.pi / n_phi
    share = f * np.maximum(r[..., 2], 0) * dw
    return float(share.sum()), float((share * r[..., 2]).sum())


def smooth_albedo(model, p, theta_i) -> float:
    """int f cos_r dw_r for a surface without a narrow lobe; panels end where Oren-Nayar kinks."""
    theta, w_theta = panels([0, theta_i / 2, theta_i, (theta_i + np.pi / 2) / 2, np.pi / 2], 32)
    phi, w_phi = panels([0, np.pi / 2, np.pi], 24)
    r = unit_vectors(theta[:, None], phi)
    f = model.evaluate(unit_vectors(theta_i, 0.0), r, p)
    weight = (np.sin(theta) * np.cos(theta) * w_theta)[:, None] * 2 * w_phi
    return float(np.sum(f * weight))


# --- Ward -----------------------------------------------------------------------------------------

ALBEDO_ANGLES = (0, 30, 45, 60, 70, 75, 80, 85)
WARD_ALBEDO = {
    ("ward", 0.04): (0.995, 0.862, 0.704, 0.498, 0.341, 0.259, 0.175, 0.091),
    ("ward", 0.10): (0.971, 0.842, 0.688, 0.489, 0.338, 0.260, 0.184, 0.120),
    ("ward", 0.20): (0.895, 0.777, 0.638, 0.459, 0.330, 0.269, 0.216, 0.182),
    ("ward", 0.30): (0.794, 0.691, 0.571, 0.422, 0.324, 0.280, 0.245, 0.234),
    ("ward", 0.50): (0.586, 0.514, 0.437, 0.351, 0.298, 0.277, 0.267, 0.286),
    ("ward_approx", 0.10): (0.985, 0.854, 0.698, 0.496, 0.343, 0.264, 0.187, 0.122),
    ("ward_approx", 0.20): (0.941, 0.817, 0.671, 0.484, 0.351, 0.288, 0.234, 0.200),
    ("ward_approx", 0.50): (0.656, 0.592, 0.523, 0.446, 0.402, 0.389, 0.393, 0.447),
}


@pytest.mark.parametrize(("name", "alpha"), WARD_ALBEDO)
def test_the_albedo_of_wards_lobe_falls_with_incidence(name, alpha):
    model, p = models.get(name), np.array([0.0, 1.0, alpha, alpha])
    found = [lobe_integrals(model, p, t * DEG, width=alpha)[0] for t in ALBEDO_ANGLES]
    np.testing.assert_allclose(found, WARD_ALBEDO[name, alpha], atol=5.6e-4)


def test_rolled_brass_reflects_by_its_direction():
    model, p = models.get("ward"), np.array([0.0, 1.0, 0.05, 0.16])
    found = [
        lobe_integrals(model, p, theta * DEG, phi * DEG)[0]
        for theta, phi in ((0, 0), (60, 0), (60, 90))
    ]
    np.testing.assert_allclose(found, [0.961, 0.481, 0.488], atol=6e-4)


def test_wards_lobe_diverges_at_grazing_incidence():
    model, p = models.get("ward"), np.array([0.0, 1.0, 0.4, 0.4])
    found = [lobe_integrals(model, p, t * DEG, width=0.4)[0] for t in (85, 89.5, 89.9)]
    np.testing.assert_allclose(found, [0.27, 0.61, 1.31], atol=6e-3)


@pytest.mark.parametrize(("name", "factor"), [("ward", 2.9), ("ward_approx", 1.5)])
def test_wards_lobe_loses_a_multiple_of_alpha_squared_at_normal_incidence(name, factor):
    alpha = 0.08
    albedo = lobe_integrals(models.get(name), np.array([0, 1, alpha, alpha]), 0.0, width=alpha)[0]
    assert (1 - albedo) / alpha**2 == pytest.approx(factor, abs=0.1)


@pytest.mark.parametrize(
    ("alpha", "level", "low", "high"),
    [
        (0.1, 0.5, 1.003, 1.005),
        (0.1, 0.1, 1.035, 1.045),
        (0.1, 0.01, 1.16, 1.17),
        (0.2, 0.5, 1.01, 1.02),
        (0.2, 0.1, 1.15, 1.17),
        (0.2, 0.01, 1.70, 1.78),
        (0.5, 0.5, 1.06, 1.11),
        (0.5, 0.1, 1.9, 2.1),
        (0.5, 0.01, 7, 8),
    ],
)
def test_wards_approximation_has_a_heavier_tail(alpha, level, low, high):
    delta = np.arctan(alpha * np.sqrt(-np.log(level)))
    retro = Directions(delta, 0.4, delta, 0.4)
    lobe = {"rho_d": 0, "rho_s": 1, "alpha_x": alpha, "alpha_y": alpha}
    assert low <= models.get("ward_approx")(retro, **lobe) / models.get("ward")(retro, **lobe)
    assert models.get("ward_approx")(retro, **lobe) / models.get("ward")(retro, **lobe) <= high


def test_wards_alpha_is_the_rms_of_the_two_dimensional_slope():
    """With both directions along h the exponential is the density of slopes: variance alpha^2/2."""
    alpha = 0.3
    slope = np.linspace(-2, 2, 401)
    px, py = np.meshgrid(slope, slope)
    theta, phi = np.arctan(np.hypot(px, py)), np.arctan2(py, px)
    f = models.get("ward_isotropic")(
        Directions(theta, phi, theta, phi), rho_d=0, rho_s=1, alpha=alpha
    )
    density = f * np.cos(theta)
    assert np.sum(density * px**2) / np.sum(density) == pytest.approx(0.045, rel=1e-6)
    assert np.sum(density * (px**2 + py**2)) / np.sum(density) == pytest.approx(0.09, rel=1e-6)


def test_wards_isotropic_and_elliptical_forms_agree_where_alphas_are_equal():
    rng = np.random.default_rng(0)
    d = Directions(*rng.uniform(0, 1.5, (4, 200)))
    two = models.get("ward")(d, rho_d=0.1, rho_s=0.3, alpha_x=0.2, alpha_y=0.2)
    one = models.get("ward_isotropic")(d, rho_d=0.1, rho_s=0.3, alpha=0.2)
    np.testing.assert_allclose(one, two, rtol=1e-13)


def test_wards_approximation_as_printed():
    rng = np.random.default_rng(1)
    d = Directions(*rng.uniform(0, 1.5, (4, 200)))
    w_i, w_r = d.vectors()
    h = (w_i + w_r) / np.linalg.norm(w_i + w_r, axis=-1, keepdims=True)
    ax, ay = 0.12, 0.31
    exponent = -2 * ((h[:, 0] / ax) ** 2 + (h[:, 1] / ay) ** 2) / (1 + h[:, 2])
    root = np.sqrt(np.cos(d.theta_i) * np.cos(d.theta_r))
    expected = 0.1 / np.pi + 0.3 / root / (4 * np.pi * ax * ay) * np.exp(exponent)
    f = models.get("ward_approx")(d, rho_d=0.1, rho_s=0.3, alpha_x=ax, alpha_y=ay)
    np.testing.assert_allclose(f, expected, rtol=1e-12)


@pytest.mark.parametrize("name", ["ward", "ward_approx", "ward_isotropic"])
def test_without_a_specular_lobe_ward_is_lambert(name):
    d = Directions(np.linspace(0, 1.5, 9), 0.2, np.linspace(1.5, 0.1, 9), 2.0)
    f = models.get(name)(d, rho_d=0.42, rho_s=0)
    np.testing.assert_allclose(f, 0.42 / np.pi, rtol=1e-15)


# --- Oren-Nayar -----------------------------------------------------------------------------------


def oren_nayar_printed(theta_i, phi_i, theta_r, phi_r, rho, sigma):
    """Eqs (14)-(16), letter by letter."""
    alpha, beta = np.maximum(theta_i, theta_r), np.minimum(theta_i, theta_r)
    cos = np.cos(phi_r - phi_i)
    s2 = sigma**2
    C1 = 1 - 0.5 * s2 / (s2 + 0.33)
    C2 = 0.45 * s2 / (s2 + 0.09) * (np.sin(alpha) - np.where(cos >= 0, 0, (2 * beta / np.pi) ** 3))
    C3 = 0.125 * s2 / (s2 + 0.09) * (4 * alpha * beta / np.pi**2) ** 2
    L1 = C1 + cos * C2 * np.tan(beta) + (1 - abs(cos)) * C3 * np.tan((alpha + beta) / 2)
    L2 = 0.17 * s2 / (s2 + 0.13) * (1 - cos * (2 * beta / np.pi) ** 2)
    return rho / np.pi * L1 + rho**2 / np.pi * L2


@pytest.mark.parametrize("sigma_deg", [0, 2, 20, 42, 60])
def test_the_functional_model_as_printed(sigma_deg):
    rng = np.random.default_rng(2)
    d = Directions(*rng.uniform(0, 1.5, (4, 500)))
    f = models.get("oren_nayar")(d, rho=0.8, sigma=sigma_deg * DEG)
    expected = oren_nayar_printed(d.theta_i, d.phi_i, d.theta_r, d.phi_r, 0.8, sigma_deg * DEG)
    np.testing.assert_allclose(f, expected, rtol=1e-11)


@pytest.mark.parametrize(
    ("sigma_deg", "direct", "twice"), [(10, 0.958, 0.032), (30, 0.773, 0.115), (60, 0.616, 0.152)]
)
@pytest.mark.parametrize("theta_r_deg", [0, 35, 80])
def test_at_normal_incidence_only_c1_and_one_bounce_are_left(sigma_deg, direct, twice, theta_r_deg):
    d = Directions(0.0, 0.3, theta_r_deg * DEG, 2.0)
    dark, bright = (
        np.pi * models.get("oren_nayar")(d, rho=rho, sigma=sigma_deg * DEG) / rho
        for rho in (1e-9, 1.0)
    )
    assert dark == pytest.approx(direct, abs=6e-4)
    assert bright - dark == pytest.approx(twice, abs=6e-4)
    sketch = models.get("oren_nayar_qualitative")(d, rho=1.0, sigma=sigma_deg * DEG)
    assert np.pi * sketch == pytest.approx(direct, abs=6e-4)


def gain_threshold(name: str, sigma_deg: float) -> float:
    """Incidence, degrees, beyond which a surface with rho = 1 reflects more than it receives."""
    model, p = models.get(name), np.array([1.0, sigma_deg * DEG])
    return brentq(lambda t: smooth_albedo(model, p, t * DEG) - 1, 5, 89.9, xtol=1e-3)


@pytest.mark.parametrize(
    ("name", "sigma_deg", "threshold"),
    [
        ("oren_nayar", 2, 48),
        ("oren_nayar", 5, 51),
        ("oren_nayar", 10, 59),
        ("oren_nayar", 15, 69),
        ("oren_nayar", 20, 77),
        ("oren_nayar", 25, 83),
        ("oren_nayar", 30, 88),
        ("oren_nayar_qualitative", 2, 62),
        ("oren_nayar_qualitative", 10, 71),
        ("oren_nayar_qualitative", 15, 81),
    ],
)
def test_oren_nayar_gains_energy_beyond_an_incidence(name, sigma_deg, threshold):
    assert np.ceil(gain_threshold(name, sigma_deg)) == threshold


def test_oren_nayar_gains_no_energy_when_very_rough_and_at_most_4_percent():
    model = models.get("oren_nayar")
    for theta in (0, 30, 60, 80, 85, 89):
        assert smooth_albedo(model, np.array([1.0, 40 * DEG]), theta * DEG) < 1
    most = smooth_albedo(model, np.array([1.0, 16 * DEG]), 89 * DEG)
    assert most == pytest.approx(1.044, abs=6e-4)


def direct_part(theta_i, theta_r, dphi, sigma_deg):
    """pi f / rho of light that bounced once, degrees: the limit of a dark facet."""
    d = Directions(np.multiply(theta_i, DEG), 0.0, np.multiply(theta_r, DEG), dphi * DEG)
    return np.pi * models.get("oren_nayar")(d, rho=1e-9, sigma=sigma_deg * DEG) / 1e-9


def test_the_direct_part_turns_negative_forward_on_very_rough_surfaces():
    assert direct_part(89, 89, 180, 60) == pytest.approx(-0.166, abs=6e-4)
    theta = np.arange(0.0, 90.0)
    grid = np.array([direct_part(t, theta, 180, 60) for t in theta])
    assert grid.min() == pytest.approx(-0.166, abs=6e-4)
    beta = np.minimum(theta[:, None], theta)
    assert beta[grid < 0].min() == pytest.approx(73, abs=1)
    for dphi in (0, 45, 90, 120, 150, 180):
        assert min(direct_part(t, theta, dphi, 30).min() for t in theta) > 0


def test_the_total_is_negative_for_dark_facets_only():
    forward = Directions(89 * DEG, 0.0, 89 * DEG, np.pi)
    f = [models.get("oren_nayar")(forward, rho=rho, sigma=60 * DEG) for rho in (0.1, 0.5, 0.6, 1)]
    assert np.sign(f).tolist() == [-1, -1, 1, 1]


@pytest.mark.parametrize("name", ["oren_nayar", "oren_nayar_qualitative"])
def test_eq_17_with_its_bracket_where_it_belongs_is_lambert_at_sigma_0(name):
    """The bracket as printed would give half of rho/pi here: sin 60 deg tan 30 deg = 0.5."""
    f = models.get(name)(Directions(30 * DEG, 0.0, 60 * DEG, 1.0), rho=0.9, sigma=0)
    assert f == pytest.approx(0.9 / np.pi, rel=1e-15)
    assert np.sin(60 * DEG) * np.tan(30 * DEG) == pytest.approx(0.5)


def test_the_qualitative_model_as_corrected():
    rng = np.random.default_rng(3)
    d = Directions(*rng.uniform(0, 1.5, (4, 500)))
    s2 = (33 * DEG) ** 2
    A, B = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    alpha, beta = np.maximum(d.theta_i, d.theta_r), np.minimum(d.theta_i, d.theta_r)
    shape = A + B * np.maximum(0, np.cos(d.phi_r - d.phi_i)) * np.sin(alpha) * np.tan(beta)
    f = models.get("oren_nayar_qualitative")(d, rho=0.7, sigma=33 * DEG)
    np.testing.assert_allclose(f, 0.7 / np.pi * shape, rtol=1e-12)


def test_brightness_grows_with_roughness_only_towards_the_light():
    retro, normal = Directions(60 * DEG, 0, 60 * DEG, 0), Directions(0, 0, 0, 0)
    sigma = np.arange(5, 61, 5) * DEG
    f_retro = [float(models.get("oren_nayar_qualitative")(retro, rho=1, sigma=s)) for s in sigma]
    f_normal = [float(models.get("oren_nayar_qualitative")(normal, rho=1, sigma=s)) for s in sigma]
    assert f_retro[-1] > f_retro[0]
    assert np.all(np.diff(f_normal) < 0)


# --- Torrance-Sparrow -----------------------------------------------------------------------------


@pytest.mark.parametrize("sigma_deg", [0.5, 1, 3, 8, 10, 12, 17, 20, 30, 42, 50, 60])
def test_the_slope_norm_and_its_derivative_equal_quadrature(sigma_deg):
    sigma = sigma_deg * DEG
    top = min(np.pi / 2, 12 * sigma)
    options = {"epsabs": 0, "epsrel": 1e-13, "limit": 200}
    s = quad(lambda t: np.exp(-0.5 * (t / sigma) ** 2) * np.sin(t), 0, top, **options)[0]
    d_s = quad(
        lambda t: np.exp(-0.5 * (t / sigma) ** 2) * np.sin(t) * t**2 / sigma**3, 0, top, **options
    )[0]
    found = slope_norm(sigma)
    assert found[0] == pytest.approx(s, rel=1e-12)
    assert found[1] == pytest.approx(d_s, rel=1e-12)


@pytest.mark.parametrize(
    ("sigma_deg", "by_area", "without_sine", "c1"),
    [(10, 0.970, 0.985, 0.958), (30, 0.776, 0.875, 0.773), (60, 0.590, 0.728, 0.616)],
)
def test_a_share_of_area_explains_c1(sigma_deg, by_area, without_sine, c1):
    """At normal incidence the direct part of eq. (13) is the mean of cos theta_a over facets."""

    def mean_cos(weight):
        def density(t):
            return np.exp(-0.5 * (t / (sigma_deg * DEG)) ** 2) * weight(t)

        norm = quad(density, 0, np.pi / 2)[0]
        return quad(lambda t: density(t) * np.cos(t), 0, np.pi / 2)[0] / norm

    assert mean_cos(np.sin) == pytest.approx(by_area, abs=6e-4)
    assert mean_cos(np.ones_like) == pytest.approx(without_sine, abs=6e-4)
    assert abs(by_area - c1) < abs(without_sine - c1)


@pytest.mark.parametrize(("sigma_deg", "factor"), [(20, 1.360), (42, 0.376)])
def test_the_factor_to_the_unnormalised_convention(sigma_deg, factor):
    assert 1 / (2 * np.pi * slope_norm(sigma_deg * DEG)[0]) == pytest.approx(factor, abs=6e-4)


def test_torrance_sparrow_as_written():
    rng = np.random.default_rng(4)
    d = Directions(*rng.uniform(0, 1.5, (4, 500)))
    sigma = 25 * DEG
    w_i, w_r = d.vectors()
    h = (w_i + w_r) / np.linalg.norm(w_i + w_r, axis=-1, keepdims=True)
    nh, ni, nr, hi = h[:, 2], w_i[:, 2], w_r[:, 2], np.sum(h * w_i, axis=-1)
    norm = quad(lambda t: np.exp(-0.5 * (t / sigma) ** 2) * np.sin(t), 0, np.pi / 2)[0]
    P = np.exp(-0.5 * (np.arccos(nh) / sigma) ** 2) / norm
    G = np.minimum(1, np.minimum(2 * nh * ni / hi, 2 * nh * nr / hi))
    f = models.get("torrance_sparrow")(d, k_s=0.3, sigma=sigma)
    np.testing.assert_allclose(f, 0.3 * G * P / (8 * np.pi * nh * ni * nr), rtol=1e-9)


def test_the_mirror_facets_send_out_less_than_they_receive():
    model, p = models.get("torrance_sparrow"), np.array([1.0, 30 * DEG])
    found = [lobe_integrals(model, p, t * DEG, width=0.2)[0] for t in (0, 30, 60, 75, 85)]
    np.testing.assert_allclose(found, [0.579, 0.615, 0.776, 0.885, 0.960], atol=5e-4)


@pytest.mark.parametrize(
    ("sigma_deg", "theta_deg", "escaped", "upward"),
    [(30, 60, 0.7757, 0.4925), (42, 20, 0.4260, 0.2658)],
)
def test_what_escapes_equals_rays_traced_in_mirror_cavities(sigma_deg, theta_deg, escaped, upward):
    model, p = models.get("torrance_sparrow"), np.array([1.0, sigma_deg * DEG])
    total, weighted = lobe_integrals(model, p, theta_deg * DEG, width=0.2)
    assert total == pytest.approx(escaped, abs=2e-4)
    assert weighted == pytest.approx(upward, abs=2e-4)


def peak(name: str, theta_i: float, **parameters) -> float:
    """Polar angle, degrees, of the largest f on the mirror side of the plane of incidence."""
    theta_r = np.linspace(0, 89, 8901)
    f = models.get(name)(Directions(theta_i * DEG, 0, theta_r * DEG, np.pi), **parameters)
    return float(theta_r[np.argmax(f)])


@pytest.mark.parametrize(
    ("name", "narrow", "wide"),
    [
        ("ward", {"alpha_x": 0.02, "alpha_y": 0.02}, {"alpha_x": 0.15, "alpha_y": 0.15}),
        ("ward_approx", {"alpha_x": 0.02, "alpha_y": 0.02}, {"alpha_x": 0.15, "alpha_y": 0.15}),
        ("ward_isotropic", {"alpha": 0.02}, {"alpha": 0.15}),
        ("torrance_sparrow", {"sigma": 1 * DEG}, {"sigma": 6 * DEG}),
    ],
)
def test_the_lobe_peaks_at_the_mirror_angle_and_beyond_it_where_rough(name, narrow, wide):
    assert peak(name, 0, **wide) == 0
    assert peak(name, 45, **narrow) == pytest.approx(45, abs=0.2)
    assert 46 < peak(name, 45, **wide) < 60


def test_the_combined_model_is_the_sum_of_its_parts():
    rng = np.random.default_rng(5)
    d = Directions(*rng.uniform(0, 1.5, (4, 300)))
    both = models.get("oren_nayar_torrance_sparrow")(d, sigma=0.4, rho=0.7, ks_over_kb=0.1)
    body = models.get("oren_nayar")(d, sigma=0.4, rho=0.7)
    lobe = models.get("torrance_sparrow")(d, sigma=0.4, k_s=0.1)
    np.testing.assert_allclose(both, body + lobe, rtol=1e-14)


@pytest.mark.parametrize(
    ("sigma_deg", "rho", "q", "share"), [(20, 0.80, 0.019, 0.13), (42, 0.75, 0.085, 0.23)]
)
def test_the_published_fits_hold_a_weak_lobe(sigma_deg, rho, q, share):
    d = Directions(60 * DEG, 0, 60 * DEG, np.pi)
    both = models.get("oren_nayar_torrance_sparrow")(
        d, sigma=sigma_deg * DEG, rho=rho, ks_over_kb=q
    )
    lobe = models.get("torrance_sparrow")(d, sigma=sigma_deg * DEG, k_s=q)
    assert lobe / both == pytest.approx(share, abs=0.006)
