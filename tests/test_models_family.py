"""The numbers of the models beyond Ward's and Oren and Nayar's papers.

Each is held against a computation that shares no code with the kernels: quadrature that takes a
model as f(i, r) only, closed forms, or formulas written another way.
"""

import numpy as np
import pytest
from scipy.integrate import quad

from gonio import models
from gonio.geometry import Directions, unit_vectors
from gonio.models._microfacet import fresnel_conductor, fresnel_dielectric, ggx, ggx_smith
from gonio.models.rough_plastic import seen, seen_mean

DEG = np.pi / 180


def panels(edges, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on each interval between the edges."""
    x, w = np.polynomial.legendre.leggauss(n)
    edges = np.unique(edges)
    half, middle = np.diff(edges)[:, None] / 2, (edges[1:] + edges[:-1])[:, None] / 2
    return (middle + half * x).ravel(), (half * w).ravel()


def lobe_albedo(name: str, theta_i: float, *, width: float, phi_i: float = 0.0, **given) -> float:
    """int f cos_r dw_r over half vectors, for a narrow lobe; theta_i in radians.

    r is i mirrored at h, dw_r = 4 (h.i) dw_h; directions below the horizon count nothing.
    """
    model = models.get(name)
    cut = np.pi / 4 + theta_i / 2 * np.array([-1, 1])  # where the horizon cuts circles around n
    scales = width * np.array([0, 0.5, 1, 2, 3, 5, 8, 14, 30, 60])
    delta, w_delta = panels([*scales[scales < np.pi / 2], *cut, np.pi / 2], 32)
    n_phi = 720
    phi = (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
    h = unit_vectors(delta[:, None], phi)
    i = unit_vectors(theta_i, phi_i)
    cos_h = h @ i
    r = 2 * cos_h[..., None] * h - i
    dw = 4 * np.maximum(cos_h, 0) * (np.sin(delta) * w_delta)[:, None] * 2 * np.pi / n_phi
    return float(np.sum(model.evaluate(i, r, model.vector(given)) * np.maximum(r[..., 2], 0) * dw))


def body_albedo(name: str, theta_i: float, **given) -> float:
    """int f cos_r dw_r for a surface without a narrow lobe; kinks at theta_r = theta_i, 90 deg."""
    model = models.get(name)
    theta, w_theta = panels([0, theta_i / 2, theta_i, (theta_i + np.pi / 2) / 2, np.pi / 2], 24)
    phi, w_phi = panels([0, np.pi / 2, np.pi], 24)
    r = unit_vectors(theta[:, None], phi)
    f = model.evaluate(unit_vectors(theta_i, 0.0), r, model.vector(given))
    return float(np.sum(f * (np.sin(theta) * np.cos(theta) * w_theta)[:, None] * 2 * w_phi))


# --- Ward's lobe with better normalisations -------------------------------------------------------

ALBEDO_ANGLES = (0, 30, 45, 60, 70, 75, 80, 85)
ALBEDO = {
    ("ward_duer", 0.10): (0.981, 0.981, 0.981, 0.981, 0.978, 0.968, 0.948, 0.977),
    ("ward_duer", 0.20): (0.928, 0.928, 0.928, 0.917, 0.895, 0.889, 0.918, 1.128),
    ("ward_duer", 0.50): (0.695, 0.679, 0.663, 0.657, 0.691, 0.746, 0.880, 1.333),
    ("ward_gmd", 0.10): (0.990, 0.988, 0.985, 0.974, 0.948, 0.918, 0.867, 0.813),
    ("ward_gmd", 0.20): (0.960, 0.953, 0.937, 0.898, 0.849, 0.821, 0.799, 0.806),
    ("ward_gmd", 0.50): (0.755, 0.734, 0.717, 0.708, 0.719, 0.735, 0.765, 0.825),
}


@pytest.mark.parametrize(("name", "alpha"), ALBEDO)
def test_the_albedo_of_wards_lobe_with_better_normalisations(name, alpha):
    lobe = {"rho_d": 0, "rho_s": 1, "alpha_x": alpha, "alpha_y": alpha}
    found = [lobe_albedo(name, t * DEG, width=alpha, **lobe) for t in ALBEDO_ANGLES]
    np.testing.assert_allclose(found, ALBEDO[name, alpha], atol=5.6e-4)


@pytest.mark.parametrize(("name", "factor"), [("ward_duer", 1.9), ("ward_gmd", 1.0)])
def test_what_these_lobes_lose_at_normal_incidence(name, factor):
    alpha = 0.05
    lobe = {"rho_d": 0, "rho_s": 1, "alpha_x": alpha, "alpha_y": alpha}
    lost = 1 - lobe_albedo(name, 0.0, width=alpha, **lobe)
    assert lost / alpha**2 == pytest.approx(factor, abs=0.1)


@pytest.mark.parametrize("theta", [0, 40, 60, 75])
def test_the_albedo_tends_to_rho_s_at_every_incidence(theta):
    """Where Ward's own falls as cos theta_i."""
    for name, expected in (("ward_duer", 1), ("ward_gmd", 1), ("ward", np.cos(theta * DEG))):
        lobe = {"rho_d": 0, "rho_s": 1, "alpha_x": 0.01, "alpha_y": 0.01}
        found = lobe_albedo(name, theta * DEG, width=0.01, **lobe)
        assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("alpha_x", "alpha_y"), [(0.05, 0.05), (0.3, 0.3), (1, 1), (0.05, 0.4)])
def test_the_bounded_albedo_is_bounded(alpha_x, alpha_y):
    lobe = {"rho_d": 0, "rho_s": 1, "alpha_x": alpha_x, "alpha_y": alpha_y}
    for theta in (0, 30, 60, 80, 88, 89.9):
        for phi in (0, np.pi / 2):
            width = min(alpha_x, alpha_y)
            assert lobe_albedo("ward_gmd", theta * DEG, width=width, phi_i=phi, **lobe) < 1


# --- Losasso's set --------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 5, 20, 300])
def test_phongs_lobe_reflects_rho_s_at_normal_incidence_and_less_elsewhere(n):
    found = [
        lobe_albedo("phong", t * DEG, width=n**-0.5 / 2, rho_d=0, rho_s=1, n=n)
        for t in (0, 30, 60, 85)
    ]
    assert found[0] == pytest.approx(1, abs=2e-6)
    assert max(found) < 1 + 2e-6
    if n == 20:
        assert found[2] == pytest.approx(0.50, abs=5e-3)


@pytest.mark.parametrize("k", [0.7, 1.0, 1.5])
def test_the_albedo_of_minnaerts_law(k):
    for theta in (0, 40, 60):
        expected = 0.5 * np.cos(theta * DEG) ** (k - 1)
        assert body_albedo("minnaert", theta * DEG, rho=0.5, k=k) == pytest.approx(
            expected, rel=1e-4
        )
    assert np.cos(60 * DEG) ** (0.7 - 1) == pytest.approx(1.23, abs=5e-3)


def test_minnaerts_law_as_printed_is_not_reciprocal():
    """With the cosine of the irradiance taken out of (N.L)(N.L)^k (1 - N.E)^(1-k)."""

    def printed(ni, nr, k):
        return ni**k * (1 - nr) ** (1 - k)

    assert printed(0.3, 0.8, 0.5) != pytest.approx(printed(0.8, 0.3, 0.5), rel=0.1)
    angles = np.arccos([0.3, 0.8])
    one = models.get("minnaert")(Directions(angles[0], 0, angles[1], 1), k=0.5)
    other = models.get("minnaert")(Directions(angles[1], 1, angles[0], 0), k=0.5)
    assert one == pytest.approx(other, rel=1e-14)


V_CAVITIES = {
    ("cook_torrance", "m"): (0.996, 0.981, 0.925, 0.927, 0.970),
    ("blinn", "c"): (0.864, 0.865, 0.886, 0.918, 0.967),
}


@pytest.mark.parametrize(("name", "slope"), V_CAVITIES)
def test_the_albedo_of_mirror_facets_in_v_cavities(name, slope):
    """F = 1 by a division: F is known from the closed form and enters as a factor."""
    model, found = models.get(name), []
    for t in (0, 30, 60, 75, 85):
        delta, w_delta = panels(
            [0, 0.1, 0.3, 0.6, 1.0, np.pi / 4 - t / 2 * DEG, np.pi / 4 + t / 2 * DEG, np.pi / 2], 48
        )
        n_phi = 1440
        h = unit_vectors(delta[:, None], (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi)
        i = unit_vectors(t * DEG, 0.0)
        cos_h = np.maximum(h @ i, 1e-12)
        r = 2 * cos_h[..., None] * h - i
        f = model.evaluate(i, r, model.vector({"rho_d": 0, "k_s": 1, slope: 0.3, "eta": 1.5}))
        f /= exact_fresnel(cos_h, 1.5)
        dw = 4 * cos_h * (np.sin(delta) * w_delta)[:, None] * 2 * np.pi / n_phi
        found.append(np.sum(f * np.maximum(r[..., 2], 0) * dw))
    np.testing.assert_allclose(found, V_CAVITIES[name, slope], atol=6e-4)


def test_cook_torrance_and_blinn_as_corrected():
    rng = np.random.default_rng(11)
    d = Directions(*rng.uniform(0, 1.5, (4, 300)))
    w_i, w_r = d.vectors()
    h = (w_i + w_r) / np.linalg.norm(w_i + w_r, axis=-1, keepdims=True)
    nh, ni, nr, hi = h[:, 2], w_i[:, 2], w_r[:, 2], np.sum(h * w_i, axis=-1)
    G = np.minimum(1, np.minimum(2 * nh * ni / hi, 2 * nh * nr / hi))
    F = exact_fresnel(hi, 1.7)
    # As printed: 4 m^2 beside a division by pi; and D of Blinn, 4 pi c^2 too high.
    beta = np.arccos(nh)
    D = np.exp(-((np.tan(beta) / 0.3) ** 2)) / (4 * 0.3**2 * np.cos(beta) ** 4)
    expected = 0.1 / np.pi + 0.5 * D * G * F / (np.pi * ni * nr)
    f = models.get("cook_torrance")(d, rho_d=0.1, k_s=0.5, m=0.3, eta=1.7)
    np.testing.assert_allclose(f, expected, rtol=1e-10)
    D = (0.3**2 / (nh**2 * (0.3**2 - 1) + 1)) ** 2
    expected = 0.1 / np.pi + 0.5 * D * G * F / (ni * nr) / (4 * np.pi * 0.3**2)
    f = models.get("blinn")(d, rho_d=0.1, k_s=0.5, c=0.3, eta=1.7)
    np.testing.assert_allclose(f, expected, rtol=1e-10)


def test_beckmanns_and_blinns_densities_as_printed_are_not_normalised():
    def beckmann(b):
        return np.exp(-((np.tan(b) / 0.3) ** 2)) / (4 * 0.3**2 * np.cos(b) ** 4)

    def blinn(b):
        return (0.3**2 / (np.cos(b) ** 2 * (0.3**2 - 1) + 1)) ** 2

    for density, expected in ((beckmann, np.pi / 4), (blinn, np.pi * 0.3**2)):
        total = quad(lambda b, d=density: 2 * np.pi * d(b) * np.cos(b) * np.sin(b), 0, np.pi / 2)
        assert total[0] == pytest.approx(expected, rel=1e-8)


# --- Fresnel --------------------------------------------------------------------------------------


def exact_fresnel(c, m):
    """Unpolarised reflectance by Snell's law with a complex angle of refraction."""
    cos_t = np.sqrt(1 - (1 - np.square(c)) / np.square(np.asarray(m, complex)))
    r_s = (c - m * cos_t) / (c + m * cos_t)
    r_p = (m * c - cos_t) / (m * c + cos_t)
    return (np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2


def conductor_by_real_numbers(c, eta, kappa):
    """The textbook form with a^2 + b^2, real throughout."""
    s2 = 1 - c * c
    t0 = eta**2 - kappa**2 - s2
    root = np.sqrt(t0**2 + 4 * eta**2 * kappa**2)
    a = np.sqrt((root + t0) / 2)
    r_s = (root + c * c - 2 * a * c) / (root + c * c + 2 * a * c)
    r_p = r_s * (c * c * root + s2**2 - 2 * a * c * s2) / (c * c * root + s2**2 + 2 * a * c * s2)
    return (r_s + r_p) / 2


@pytest.mark.parametrize("eta", [1.1, 1.33, 1.5, 2.4, 4.0])
def test_fresnels_formula_is_exact(eta):
    c = np.concatenate([[1e-6, 1e-3], np.linspace(0.01, 1, 100)])
    found = np.array([fresnel_dielectric(x, eta)[0] for x in c])
    np.testing.assert_allclose(found, exact_fresnel(c, eta), rtol=0, atol=1e-14)
    metal = np.array([fresnel_conductor(x, eta, 0.0)[0] for x in c])
    np.testing.assert_allclose(metal, found, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("eta", "kappa"), [(0.2, 3.4), (0.05, 0.01), (1.5, 7.6), (2.9, 3.1)])
def test_fresnels_formula_for_metals_is_exact(eta, kappa):
    c = np.concatenate([[1e-6, 1e-3], np.linspace(0.01, 1, 100)])
    found = np.array([fresnel_conductor(x, eta, kappa)[0] for x in c])
    np.testing.assert_allclose(found, exact_fresnel(c, eta + 1j * kappa), rtol=0, atol=1e-14)
    np.testing.assert_allclose(found, conductor_by_real_numbers(c, eta, kappa), rtol=0, atol=1e-12)


def test_fresnel_at_normal_incidence_and_beyond_the_critical_angle():
    assert fresnel_dielectric(0.3, 1.0)[0] == 0
    assert fresnel_dielectric(1.0, 1.5)[0] == pytest.approx(0.04, abs=1e-16)
    assert fresnel_conductor(1.0, 0.2, 3.4)[0] == pytest.approx((0.64 + 11.56) / (1.44 + 11.56))
    assert fresnel_conductor(0.5, 0.8, 0.0)[0] == pytest.approx(1, abs=1e-15)
    # The root as printed, g = sqrt(n^2 + c^2) - 1 with c = 1.
    g = np.sqrt(1.5**2 + 1) - 1
    printed = 0.5 * ((g - 1) / (g + 1)) ** 2 * (1 + (g / (g - 0)) ** 2)
    assert printed == pytest.approx(0.012, abs=1e-3)


def test_schlicks_approximation_as_printed_swaps_its_ends():
    """(1 - (1 - NE)^5) + n (1 - NE)^5 against F_0 + (1 - F_0)(1 - L.H)^5."""
    c = np.linspace(0, 1, 50)[1:]
    exact = exact_fresnel(c, 1.5)
    printed = (1 - (1 - c) ** 5) + 1.5 * (1 - c) ** 5
    assert printed.min() >= 1
    np.testing.assert_allclose(0.04 + 0.96 * (1 - c) ** 5, exact, atol=0.05)


@pytest.mark.parametrize(("c", "eta", "kappa"), [(0.2, 1.5, 0.3), (0.9, 0.3, 4), (0.5, 2.5, 1)])
def test_fresnels_derivatives(c, eta, kappa):
    h = 1e-5

    def slope(f):
        return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)

    _, by_eta, by_kappa = fresnel_conductor(c, eta, kappa)
    assert by_eta == pytest.approx(slope(lambda e: fresnel_conductor(c, eta + e, kappa)[0]))
    assert by_kappa == pytest.approx(slope(lambda e: fresnel_conductor(c, eta, kappa + e)[0]))
    _, by_c, by_eta = fresnel_dielectric(c, 1 + eta)
    assert by_c == pytest.approx(slope(lambda e: fresnel_dielectric(c + e, 1 + eta)[0]))
    assert by_eta == pytest.approx(slope(lambda e: fresnel_dielectric(c, 1 + eta + e)[0]))


# --- GGX ------------------------------------------------------------------------------------------


def facet_grid(alpha_x, alpha_y):
    """Facet normals, D of each and solid angles, even over the unit disc of stretched slopes."""
    u, w = panels([0, 1], 200)
    phi = (np.arange(400) + 0.5) * 2 * np.pi / 400
    # u = sin^2 of the stretched normal's angle, for which D cos is constant; 1 - u is a square, so
    # that the steepest facets, seen with a weight of tan, are summed without a pole.
    u, w = 1 - u**2, 2 * u * w
    tan = np.sqrt(u / (1 - u))[:, None]
    slope = np.stack([alpha_x * tan * np.cos(phi), alpha_y * tan * np.sin(phi)], -1)
    h = np.concatenate([slope, np.ones_like(slope[..., :1])], -1)
    length = np.linalg.norm(h, axis=-1)
    h /= length[..., None]
    d = np.vectorize(lambda x, y, z: ggx(x, y, z, alpha_x, alpha_y)[0])(*np.moveaxis(h, -1, 0))
    # d slope = alpha_x alpha_y du dphi / 2 (1 - u)^2, dw = cos^3 d slope
    dw = alpha_x * alpha_y * (w / (2 * (1 - u) ** 2))[:, None] * 2 * np.pi / 400 / length**3
    return h, d, dw


@pytest.mark.parametrize(("alpha_x", "alpha_y"), [(0.1, 0.1), (0.3, 0.05), (1.0, 0.4)])
def test_ggx_is_a_share_of_area_and_smith_shows_as_much_of_it_as_there_is(alpha_x, alpha_y):
    h, d, dw = facet_grid(alpha_x, alpha_y)
    assert np.sum(d * h[..., 2] * dw) == pytest.approx(1, abs=1e-10)
    for theta, phi in ((0.0, 0.0), (0.8, 0.3), (1.3, 1.5), (1.5, 0.0)):
        o = unit_vectors(theta, phi)
        g1 = 2 * o[2] / (o[2] + ggx_smith(*o, alpha_x, alpha_y)[0])
        # The weak white furnace: int G_1 D |o.h|+ dw = cos_o, the projected area of what is seen.
        seen_area = np.sum(g1 * d * np.maximum(h @ o, 0) * dw)
        assert seen_area == pytest.approx(o[2], rel=1e-4)


def ggx_closed_form(d, alpha, eta, *, correlated=True):
    """Isotropic GGX in angles, with tan^2 and Smith's Lambda."""
    w_i, w_r = d.vectors()
    h = (w_i + w_r) / np.linalg.norm(w_i + w_r, axis=-1, keepdims=True)
    tan2 = 1 / h[..., 2] ** 2 - 1
    D = alpha**2 / (np.pi * h[..., 2] ** 4 * (alpha**2 + tan2) ** 2)
    lam = [(np.sqrt(1 + alpha**2 * np.tan(t) ** 2) - 1) / 2 for t in (d.theta_i, d.theta_r)]
    G = 1 / (1 + lam[0] + lam[1]) if correlated else 1 / ((1 + lam[0]) * (1 + lam[1]))
    F = exact_fresnel(np.sum(h * w_i, axis=-1), eta)
    return D * F * G / (4 * np.cos(d.theta_i) * np.cos(d.theta_r))


def test_equal_alphas_give_the_isotropic_closed_form():
    rng = np.random.default_rng(12)
    d = Directions(*rng.uniform(0, 1.5, (4, 500)))
    f = models.get("ggx")(d, rho_d=0, k_s=1, alpha_x=0.3, alpha_y=0.3, eta=0.3, kappa=2.5)
    np.testing.assert_allclose(f, ggx_closed_form(d, 0.3, 0.3 + 2.5j), rtol=1e-9)
    assert np.all(f >= ggx_closed_form(d, 0.3, 0.3 + 2.5j, correlated=False))
    f = models.get("ggx")(d, rho_d=0, k_s=1, alpha_x=0.3, alpha_y=0.3, eta=1.5, kappa=0)
    np.testing.assert_allclose(f, ggx_closed_form(d, 0.3, 1.5), rtol=1e-9)
    # Blinn's density is the same, in V-cavities: equal where nothing is masked.
    flat = Directions(0.2, 0.0, 0.2, np.pi)
    blinn = models.get("blinn")(flat, rho_d=0, k_s=1, c=0.02, eta=1.5)
    smith = models.get("ggx")(flat, rho_d=0, k_s=1, alpha_x=0.02, alpha_y=0.02)
    assert smith == pytest.approx(blinn, rel=1e-4)


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_ggx_reflects_less_than_it_receives(alpha):
    """Facets with F = 0.998: nearly all at small alpha, less where light meets a second facet.

    At alpha = 1 all S are 1 and int_0^{1/2} (1 - 2 u)/(1 - u) du = 1 - ln 2, u = sin^2 delta.
    """
    mirror = {"rho_d": 0, "k_s": 1, "alpha_x": alpha, "alpha_y": alpha, "eta": 0.05, "kappa": 10}
    found = [lobe_albedo("ggx", t * DEG, width=alpha, **mirror) for t in (0, 40, 70, 85)]
    assert max(found) < 1
    if alpha == 0.05:
        assert min(found[:3]) > 0.97
    if alpha == 1.0:
        mirror_at_normal = (0.95**2 + 100) / (1.05**2 + 100)
        assert found[0] == pytest.approx(mirror_at_normal * (1 - np.log(2)), rel=1e-3)


# --- Ashikhmin-Shirley ----------------------------------------------------------------------------


def test_ashikhmin_shirley_as_printed():
    rng = np.random.default_rng(13)
    d = Directions(*rng.uniform(0.01, 1.5, (4, 300)))
    w_i, w_r = d.vectors()
    h = (w_i + w_r) / np.linalg.norm(w_i + w_r, axis=-1, keepdims=True)
    nh, ni, nr, hi = h[:, 2], w_i[:, 2], w_r[:, 2], np.sum(h * w_i, axis=-1)
    exponent = (20 * h[:, 0] ** 2 + 500 * h[:, 1] ** 2) / (1 - nh**2)
    F = 0.3 + 0.7 * (1 - hi) ** 5
    lobe = np.sqrt(21 * 501) / (8 * np.pi) * nh**exponent / (hi * np.maximum(ni, nr)) * F
    body = 28 * 0.4 / (23 * np.pi) * (1 - 0.3) * (1 - (1 - ni / 2) ** 5) * (1 - (1 - nr / 2) ** 5)
    model = models.get("ashikhmin_shirley")
    given = {"rho_d": 0.4, "rho_s": 0.3, "n_u": 20, "n_v": 500}
    f = model(d, **given)
    np.testing.assert_allclose(f, lobe + body, rtol=1e-9)
    swapped = model(Directions(d.theta_r, d.phi_r, d.theta_i, d.phi_i), **given)
    np.testing.assert_allclose(f, swapped, rtol=1e-12)


@pytest.mark.parametrize(("n_u", "n_v"), [(1, 1), (10, 10), (1000, 1000), (5, 500)])
def test_ashikhmin_shirley_reflects_no_more_than_it_receives(n_u, n_v):
    for rho_d, rho_s in ((1, 0), (1, 0.5), (1, 1)):
        for theta in (0, 30, 60, 80, 88):
            given = {"rho_d": rho_d, "rho_s": rho_s, "n_u": n_u, "n_v": n_v}
            width = max(n_u, n_v) ** -0.5
            assert lobe_albedo("ashikhmin_shirley", theta * DEG, width=width, **given) < 1 + 1e-6


# --- EON ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("r", [0.0, 0.01, 0.3, 1.0])
def test_eon_returns_all_light_where_facets_absorb_none(r):
    for theta in (0, 20, 50, 75, 85, 89):
        assert body_albedo("eon", theta * DEG, rho=1, r=r) == pytest.approx(1, abs=2e-5)
        assert body_albedo("eon", theta * DEG, rho=0.6, r=r) < 0.6 + 2e-5


@pytest.mark.parametrize("r", [0.2, 1.0])
def test_eon_as_published(r):
    """With E by quadrature of the single-bounce term in place of the closed form."""
    c1 = 0.5 - 2 / (3 * np.pi)

    def single(ni, nr, dphi):
        s = np.cos(dphi) * np.sqrt((1 - ni**2) * (1 - nr**2))
        return (1 + r * np.where(s > 0, s / np.maximum(ni, nr), s)) / (1 + c1 * r)

    def albedo(ni):
        theta, w = panels([0, np.arccos(ni), np.pi / 2], 64)
        phi, v = panels([0, np.pi / 2, np.pi], 32)
        part = single(ni, np.cos(theta)[:, None], phi) * 2 * v
        return np.sum(part * (np.sin(theta) * np.cos(theta) * w)[:, None]) / np.pi

    mu, w = panels([0, 1], 48)
    mean = np.sum(2 * mu * w * np.array([albedo(x) for x in mu]))
    rho = 0.7
    for theta_i, theta_r, dphi in ((0.0, 0.7, 0.0), (1.0, 1.3, 0.4), (1.2, 0.5, 2.8)):
        ni, nr = np.cos(theta_i), np.cos(theta_r)
        rho_ms = rho**2 * mean / (1 - rho * (1 - mean))
        more = rho_ms * (1 - albedo(ni)) * (1 - albedo(nr)) / (1 - mean)
        expected = (rho * single(ni, nr, dphi) + more) / np.pi
        f = models.get("eon")(Directions(theta_i, 0, theta_r, dphi), rho=rho, r=r)
        assert f == pytest.approx(expected, rel=2e-5)


# --- Rough plastic --------------------------------------------------------------------------------


def smooth_plastic_base(theta_i, theta_r, rho, eta):
    """The diffuse part under a smooth interface."""
    mean = quad(lambda c: 2 * c * exact_fresnel(c, eta), 0, 1, epsabs=1e-12)[0]
    inside = 1 - (1 - mean) / eta**2
    through = (1 - exact_fresnel(np.cos(theta_i), eta)) * (1 - exact_fresnel(np.cos(theta_r), eta))
    return rho * through / (np.pi * eta**2 * (1 - rho * inside))


@pytest.mark.parametrize("eta", [1.2, 1.5, 2.0])
def test_rough_plastic_tends_to_smooth_plastic(eta):
    theta_i, theta_r = np.array([0.0, 0.5, 1.0, 1.2]), np.array([0.4, 1.1, 0.2, 0.9])
    # Off the plane of incidence, where the narrow lobe is not.
    d = Directions(theta_i, 0.0, theta_r, 1.0)
    smooth = smooth_plastic_base(theta_i, theta_r, 0.8, eta)
    for alpha, tolerance in ((0.005, 2e-4), (0.02, 2e-3)):
        lobe, whole = (
            models.get("rough_plastic")(d, rho=r, alpha=alpha, eta=eta) for r in (0, 0.8)
        )
        np.testing.assert_allclose(whole - lobe, smooth, rtol=tolerance)


@pytest.mark.parametrize("alpha", [0.005, 0.02, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("eta", [1.2, 1.5, 2.0])
def test_rough_plastic_returns_no_more_light_than_it_receives(alpha, eta):
    interface = {"rho_d": 0, "k_s": 1, "alpha_x": alpha, "alpha_y": alpha, "eta": eta, "kappa": 0}
    rng = np.random.default_rng(14)
    d = Directions(*rng.uniform(0, 1.5, (4, 20)))
    f = models.get("rough_plastic")(d, rho=0, alpha=alpha, eta=eta)
    np.testing.assert_allclose(f, models.get("ggx")(d, **interface), rtol=1e-10)
    for theta in (0, 40, 70, 85):
        lobe = lobe_albedo("ggx", theta * DEG, width=alpha, **interface)
        dark, light = (plastic_base(theta * DEG, rho, alpha, eta) for rho in (0.5, 1.0))
        assert lobe + light < 1
        assert lobe + light > 0.8 - 0.3 * (theta == 85)
        assert dark < 0.5 * light


def plastic_base(theta_i, rho, alpha, eta):
    """Albedo of the diffuse part: what rho adds to the lobe."""
    model, c = models.get("rough_plastic"), panels([0, 0.02, 0.1, 0.3, 1], 16)
    # It does not depend on phi; a constant phi keeps the difference clear of the lobe's peak.
    r = unit_vectors(np.arccos(c[0]), 1.5)
    i = unit_vectors(theta_i, 0.0)
    whole, lobe = (
        model.evaluate(i, r, model.vector({"rho": x, "alpha": alpha, "eta": eta})) for x in (rho, 0)
    )
    return float(np.sum((whole - lobe) * 2 * np.pi * c[0] * c[1]))


@pytest.mark.parametrize(("alpha", "eta"), [(0.02, 1.5), (0.1, 1.3), (0.4, 1.5), (1.0, 2.0)])
def test_the_sum_over_48_facets_is_the_mean_over_those_seen(alpha, eta):
    h, d, dw = facet_grid(alpha, alpha)
    for theta in (0.0, 0.8, 1.3):
        o = unit_vectors(theta, 0.0)
        cos = np.maximum(h @ o, 0)
        weight = d * cos * dw
        mean = np.sum(weight * exact_fresnel(cos, eta)) / np.sum(weight)
        assert seen(*o, alpha, eta)[0] == pytest.approx(mean, abs=2e-4)


@pytest.mark.parametrize(("alpha", "eta"), [(0.005, 1.2), (0.1, 1.5), (0.4, 1.37), (1.0, 2.0)])
def test_the_polynomial_is_the_mean_of_the_sums(alpha, eta):
    x, w = panels([0, 1], 60)
    mean = sum(
        6 * t**5 * v * seen((1 - t**6) ** 0.5, 0.0, t**3, alpha, eta)[0]
        for t, v in zip(x, w, strict=True)
    )
    # 5e-6 low on purpose.
    assert mean - 1e-5 < seen_mean(alpha, eta)[0] < mean


# --- ABg ------------------------------------------------------------------------------------------


def test_abg_as_written_in_the_plane_of_incidence():
    theta_i, theta_r = 0.3, np.array([-0.8, -0.2, 0.0, 0.3, 0.31, 1.2])
    # Angles towards the mirror direction are positive.
    d = Directions(theta_i, np.pi, np.abs(theta_r), np.where(theta_r < 0, np.pi, 0.0))
    f = models.get("abg")(d, A=2e-3, B=1e-4, g=1.7)
    expected = 2e-3 / (1e-4 + np.abs(np.sin(theta_r) - np.sin(theta_i)) ** 1.7)
    np.testing.assert_allclose(f, expected, rtol=1e-11)


def test_abg_falls_with_the_distance_of_projections_out_of_the_plane():
    """A direction as far from the normal as the mirror direction, and not near it."""
    theta, phi = 0.6, 1.1
    f = models.get("abg")(Directions(theta, 0.0, theta, np.pi + phi), A=1e-3, B=1e-5, g=2.0)
    chord = 2 * np.sin(theta) * np.sin(phi / 2)
    assert f == pytest.approx(1e-3 / (1e-5 + chord**2), rel=1e-12)


@pytest.mark.parametrize("b", [1e-6, 1e-3, 0.5])
def test_the_albedo_of_abg_at_normal_incidence(b):
    from gonio.checks import directional_albedo

    given = {"A": 1e-3, "B": b, "g": 2.0}
    found = directional_albedo(models.get("abg"), given, 0.0, rtol=1e-4)
    assert found.value == pytest.approx(np.pi * 1e-3 * np.log(1 + 1 / b), rel=1e-3)
