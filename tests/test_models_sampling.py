"""Draws of every model against their density, and their weights against quadrature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from gonio import models
from gonio.checks import directional_albedo
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import angles, unit_vectors
from gonio.models._lobes import GaussianSlopes, slopes_below
from gonio.models.base import Model
from gonio.models.sampling import Cosine, Draws
from gonio.models.torrance_sparrow import slope_norm

DEG = np.pi / 180
NAMES = [*models.names(), "lambert+ward_duer", "phong+ggx"]
# Normal and grazing incidence, and one whose azimuth is no axis of an anisotropic surface.
INCIDENCES = ((0.0, 0.0), (45.0, 40.0), (80.0, 205.0))
SETS = 3
CASES = [(name, k, where) for name in NAMES for k in range(SETS) for where in INCIDENCES]
every_case = pytest.mark.parametrize(("name", "k", "where"), CASES)
# All tests of the file together fail by chance once in a hundred seeds (Sidak).
LEVEL = 1 - 0.99 ** (1 / len(CASES))


def parameters(model: Model, k: int) -> np.ndarray:
    """Defaults for k = 0, else values inside the range in which a fit starts."""
    if k == 0:
        return model.vector({})
    rng = np.random.default_rng([k, len(model.name)])
    values = []
    for q in model.parameters:
        low, high = q.start or (q.lower, q.upper)
        t = rng.uniform(0.1, 0.9)
        values.append(low * (high / low) ** t if q.scale == "log" else low + (high - low) * t)
    return np.array(values)


# --- the chi-squared test -------------------------------------------------------------------------


def rule(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(n)
    a, b = np.meshgrid(x, x, indexing="ij")
    return a.ravel(), b.ravel(), np.outer(w, w).ravel() / 4


FINE, COARSE = rule(6), rule(4)


def masses(model: Model, p: np.ndarray, i: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Integral of the density over cells (theta low, high, phi low, high).

    A cell is quartered until two rules agree to 1e-7.
    """

    def by(rule, cells):
        x, y, w = rule
        t0, t1, p0, p1 = cells.T[:, :, None]
        theta, phi = (t0 + t1 + (t1 - t0) * x) / 2, (p0 + p1 + (p1 - p0) * y) / 2
        pdf = model.density(i, unit_vectors(theta, phi), p)
        return np.sum(w * pdf * np.sin(theta) * (t1 - t0) * (p1 - p0), axis=1)

    total, owner = np.zeros(len(cells)), np.arange(len(cells))
    for _ in range(12):
        fine = by(FINE, cells)
        rough = np.abs(fine - by(COARSE, cells)) > 1e-7
        np.add.at(total, owner[~rough], fine[~rough])
        if not rough.any():
            return total
        t0, t1, p0, p1 = cells[rough].T
        t, f = (t0 + t1) / 2, (p0 + p1) / 2
        quarters = [(t0, t, p0, f), (t0, t, f, p1), (t, t1, p0, f), (t, t1, f, p1)]
        cells = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        owner = np.tile(owner[rough], 4)
    np.add.at(total, owner, by(FINE, cells))
    return total


@dataclass(frozen=True)
class Comparison:
    """Draws counted in cells against the density integrated over them."""

    p_value: float
    kept: float
    expected_kept: float


def compared(model: Model, p: np.ndarray, where: tuple[float, float], draws: Draws) -> Comparison:
    """Chi-squared over cells whose edges are quantiles of other draws, and of the lost ones."""
    i = unit_vectors(where[0] * DEG, where[1] * DEG)
    pilot = model.sample(np.broadcast_to(i, (1500, 3)), p, np.random.default_rng(7)).w_r
    theta, phi = angles(pilot[pilot[:, 2] > 0])
    # Graded outwards, so that no cell holds the flank of a narrow lobe and a wide nothing.
    tail = np.array([0.001, 0.004, 0.015, 0.05])
    inner = np.concatenate([tail, np.linspace(0.15, 0.85, 8), 1 - tail[::-1]])
    t = np.concatenate([[0], np.quantile(theta, inner), [np.pi / 2]])
    f = np.concatenate([[0], np.quantile(phi % (2 * np.pi), inner), [2 * np.pi]])
    above = draws.w_r[:, 2] > 0
    theta, phi = angles(draws.w_r[above])
    seen = np.histogram2d(theta, phi % (2 * np.pi), [t, f])[0].ravel()
    low_t, low_f = np.meshgrid(t[:-1], f[:-1], indexing="ij")
    high_t, high_f = np.meshgrid(t[1:], f[1:], indexing="ij")
    cells = np.stack([x.ravel() for x in (low_t, high_t, low_f, high_f)], axis=1)
    share = masses(model, p, i, cells)
    n = len(above)
    seen = np.append(seen, n - above.sum())
    wanted = n * np.append(share, max(1 - share.sum(), 0))
    # Cells with little in them are pooled, the smallest first.
    order = np.argsort(wanted)
    small = order[: np.searchsorted(np.cumsum(wanted[order]), 5) + 1]
    small = np.union1d(small, np.flatnonzero(wanted < 5))
    rest = np.setdiff1d(order, small)
    seen = np.append(seen[rest], seen[small].sum())
    wanted = np.append(wanted[rest], wanted[small].sum())
    statistic = np.sum((seen - wanted) ** 2 / wanted)
    return Comparison(
        float(chi2.sf(statistic, len(wanted) - 1)), float(above.mean()), float(share.sum())
    )


@cache
def drawn(name: str, k: int, where: tuple[float, float]) -> Draws:
    model = models.get(name)
    n = 3000 if model.costly else 20_000
    i = unit_vectors(where[0] * DEG, where[1] * DEG)
    seed = [k, NAMES.index(name), int(where[0])]
    return model.sample(
        np.broadcast_to(i, (n, 3)), parameters(model, k), np.random.default_rng(seed)
    )


@every_case
def test_draws_have_the_density_that_is_returned(name, k, where):
    model = models.get(name)
    found = compared(model, parameters(model, k), where, drawn(name, k, where))
    assert found.p_value > LEVEL
    # What the density lacks to 1 over the hemisphere is lost below the horizon.
    assert found.expected_kept < 1 + 5e-6
    n = len(drawn(name, k, where).weight)
    noise = np.sqrt(max(1 - found.expected_kept, 1 / n) / n)
    assert found.kept == pytest.approx(found.expected_kept, abs=4 * noise)


@pytest.mark.parametrize(
    ("name", "k", "where"),
    [
        (name, k, INCIDENCES[2 - k])
        for name in NAMES
        for k in range(1 if models.get(name).costly else SETS)
    ],
)
def test_the_mean_weight_is_the_albedo(name, k, where):
    model = models.get(name)
    weight = drawn(name, k, where).weight
    given = dict(zip(model.names, parameters(model, k).tolist(), strict=True))
    theta, phi = where[0] * DEG, where[1] * DEG
    albedo = directional_albedo(model, given, theta, phi, rtol=1e-4)
    slack = 4 * weight.std() / np.sqrt(len(weight)) + albedo.error
    assert weight.mean() == pytest.approx(albedo.value, abs=slack)


@pytest.mark.parametrize("name", NAMES)
def test_what_comes_with_a_draw_belongs_to_it(name):
    model = models.get(name)
    p = parameters(model, 1)
    rng = np.random.default_rng(3)
    w_i = unit_vectors(rng.uniform(0, 1.5, (4, 25)), rng.uniform(0, 6, (4, 25)))
    draws = model.sample(w_i, p, rng)
    assert draws.w_r.shape == (4, 25, 3)
    assert draws.weight.shape == draws.density.shape == (4, 25)
    np.testing.assert_allclose(np.linalg.norm(draws.w_r, axis=-1), 1, rtol=1e-12)
    lost = draws.w_r[..., 2] <= 0
    assert not np.any(draws.density[lost])
    assert not np.any(draws.weight[lost])
    assert np.all(draws.density[~lost] > 0)
    np.testing.assert_allclose(model.density(w_i, draws.w_r, p), draws.density, rtol=1e-12)
    reflected = model.evaluate(w_i, draws.w_r, p) * draws.w_r[..., 2]
    np.testing.assert_allclose((draws.weight * draws.density)[~lost], reflected[~lost], rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_one_seed_gives_one_set_of_draws(name):
    model = models.get(name)
    w_i = np.broadcast_to(unit_vectors(0.7, 0.2), (50, 3))
    one, again, other = (
        model.sample(w_i, parameters(model, 1), np.random.default_rng(s)) for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.w_r, again.w_r)
    np.testing.assert_array_equal(one.weight, again.weight)
    np.testing.assert_array_equal(one.density, again.density)
    assert not np.array_equal(one.w_r, other.w_r)


# --- weights --------------------------------------------------------------------------------------

# All of the model in its lobe, and the largest weight at an incidence with this cosine.
LARGEST = {
    "ward": ({"rho_d": 0, "rho_s": 1}, lambda cos: cos**-0.5),
    "ward_isotropic": ({"rho_d": 0, "rho_s": 1}, lambda cos: cos**-0.5),
    "ward_approx": ({"rho_d": 0, "rho_s": 1}, lambda cos: cos**-0.5),
    "ward_duer": ({"rho_d": 0, "rho_s": 1}, lambda cos: 1 / cos),
    "ward_gmd": ({"rho_d": 0, "rho_s": 1}, lambda cos: 2),
    "phong": ({"rho_d": 0, "rho_s": 1, "n": 20}, lambda cos: 22 / 21),
    "blinn": ({"rho_d": 0}, lambda cos: 2),
    "cook_torrance": ({"rho_d": 0}, lambda cos: 2),
    "torrance_sparrow": ({"k_s": 1}, lambda cos: 2),
    "ggx": ({"rho_d": 0}, lambda cos: 1),
    "rough_plastic": ({"rho": 0}, lambda cos: 1),
    "ashikhmin_shirley": ({"rho_d": 0, "rho_s": 1}, lambda cos: 1),
}


@pytest.mark.parametrize("name", LARGEST)
@pytest.mark.parametrize("theta", [0, 60, 85, 89.9])
@pytest.mark.parametrize("width", ["narrow", "wide"])
def test_weights_of_a_lobe_have_the_bound_that_is_stated(name, theta, width):
    given, largest = LARGEST[name]
    model = models.get(name)
    wide = {q.name: q.upper for q in model.parameters if q.scale == "log" and q.name != "n"}
    p = model.vector({**given, **(wide if width == "wide" else {})})
    w_i = np.broadcast_to(unit_vectors(theta * DEG, 1.0), (4000, 3))
    weight = model.sample(w_i, p, np.random.default_rng(4)).weight
    assert weight.max() <= largest(np.cos(theta * DEG)) * (1 + 1e-9)
    assert weight.max() > 0


@pytest.mark.parametrize("name", LARGEST)
def test_the_lobes_of_a_model_follow_it_better_than_the_cosine(name):
    model = models.get(name)
    w_i = np.broadcast_to(unit_vectors(50 * DEG, 1.0), (4000, 3))
    own, plain = (
        m.sample(w_i, model.vector({}), np.random.default_rng(4)).weight.std()
        for m in (model, replace(model, lobes=(Cosine(),)))
    )
    assert own < 0.8 * plain


@pytest.mark.parametrize(("theta", "k"), [(0, 0.4), (60, 0.4), (85, 2.5)])
def test_minnaerts_weights_are_all_the_same(theta, k):
    model = models.get("minnaert")
    w_i = np.broadcast_to(unit_vectors(theta * DEG, 1.0), (500, 3))
    draws = model.sample(w_i, model.vector({"rho": 0.8, "k": k}), np.random.default_rng(5))
    np.testing.assert_allclose(draws.weight, 0.8 * np.cos(theta * DEG) ** (k - 1), rtol=1e-10)


def test_a_surface_that_reflects_nothing_is_drawn_from_all_the_same():
    for name in ("lambert", "ward", "ggx"):
        model = models.get(name)
        zero = {q.name: 0 for q in model.parameters if q.linear}
        w_i = np.broadcast_to(unit_vectors(0.5, 1.0), (1000, 3))
        draws = model.sample(w_i, model.vector(zero), np.random.default_rng(6))
        assert not draws.weight.any()
        assert draws.density.max() > 0


def test_a_model_that_names_no_lobe_is_drawn_from_by_the_cosine():
    ward = models.get("ward")
    plain = Model("plain", "", "", ward.parameters, ward.kernel)
    assert plain.lobes == (Cosine(),)
    p = plain.vector({"alpha_x": 0.05, "alpha_y": 0.1})
    w_i = np.broadcast_to(unit_vectors(0.8, 0.3), (20_000, 3))
    plainly = plain.sample(w_i, p, np.random.default_rng(8))
    np.testing.assert_allclose(plainly.density, plainly.w_r[:, 2] / np.pi, rtol=1e-12)
    well = ward.sample(w_i, p, np.random.default_rng(8))
    slack = 4 * plainly.weight.std() / np.sqrt(20_000)
    assert plainly.weight.mean() == pytest.approx(well.weight.mean(), abs=slack)
    assert well.weight.std() < 0.25 * plainly.weight.std()


@pytest.mark.parametrize("sigma_deg", [0.5, 5, 20, 60])
def test_the_slopes_add_up_to_the_norm_of_torrance_and_sparrow(sigma_deg):
    sigma = sigma_deg * DEG
    assert slopes_below(np.pi / 2, sigma) == pytest.approx(slope_norm(sigma)[0], rel=1e-12)
    assert slopes_below(0.0, sigma) == 0


# --- Ward's section 5 -----------------------------------------------------------------------------

# alpha_x, alpha_y, theta_i and phi_i (rad), and the albedo for rho_s = 1 by quadrature.
WARD = [((0.05, 0.16), 30 * DEG, 0.3, 0.83212), ((0.5, 0.5), 60 * DEG, 0.0, 0.35067)]


def ward_draws(alphas, theta, phi, n, seed=9, lobe: GaussianSlopes | None = None):
    """Draws from Ward's lobe alone; from another lobe with the same density if given."""
    model = models.get("ward")
    if lobe is not None:
        model = replace(model, lobes=(lobe,))
    p = model.vector({"rho_d": 0, "rho_s": 1, "alpha_x": alphas[0], "alpha_y": alphas[1]})
    w_i = np.broadcast_to(unit_vectors(theta, phi), (n, 3))
    return model, p, model.sample(w_i, p, np.random.default_rng(seed))


@pytest.mark.parametrize(("alphas", "theta", "phi", "albedo"), WARD)
def test_eq_7_corrected_gives_wards_albedo(alphas, theta, phi, albedo):
    n = 400_000
    weight = ward_draws(alphas, theta, phi, n)[2].weight
    stderr = weight.std() / np.sqrt(n)
    assert stderr < 6e-4
    assert weight.mean() == pytest.approx(albedo, abs=4 * stderr)


@pytest.mark.parametrize(("alphas", "theta", "phi", "albedo"), WARD)
def test_wards_weight_is_not_uniform(alphas, theta, phi, albedo):
    """rho_s (h.i) cos^3 delta sqrt(cos_r/cos_i), by the model alone: f cos_r/pdf."""
    _, _, draws = ward_draws(alphas, theta, phi, 2000)
    kept = draws.density > 0
    i, r = unit_vectors(theta, phi), draws.w_r[kept]
    h = (i + r) / np.linalg.norm(i + r, axis=-1, keepdims=True)
    expected = (h @ i) * h[:, 2] ** 3 * np.sqrt(r[:, 2] / i[2])
    np.testing.assert_allclose(draws.weight[kept], expected, rtol=1e-9)
    assert np.std(expected) > 0.02 * np.mean(expected)


@pytest.mark.parametrize(("alphas", "theta", "phi", "albedo"), WARD)
def test_uniform_weights_reflect_as_another_model_does(alphas, theta, phi, albedo):
    """Each ray the same, as the text has it: what is reflected is nearer to Duer's lobe."""
    n = 100_000
    draws = ward_draws(alphas, theta, phi, n)[2]
    uniform = float(np.mean(draws.density > 0))
    assert uniform > albedo + 0.15
    given = {"rho_d": 0, "rho_s": 1, "alpha_x": alphas[0], "alpha_y": alphas[1]}
    duer = directional_albedo(models.get("ward_duer"), given, theta, phi).value
    assert abs(uniform - duer) < 0.4 * abs(uniform - albedo)


def test_a_quarter_of_a_wide_lobe_is_lost_at_60_degrees():
    draws = ward_draws((0.5, 0.5), 60 * DEG, 0.0, 100_000)[2]
    assert np.mean(draws.density == 0) == pytest.approx(0.25, abs=0.01)


class WithoutArctangent(GaussianSlopes):
    """Eq. (7a) as printed: delta is the root itself."""

    def normals(self, p, w_i, u):
        theta, phi = angles(super().normals(p, w_i, u))
        return unit_vectors(np.tan(theta), phi)


class OneBranch(GaussianSlopes):
    """Eq. (7b) as printed: phi = arctan[(alpha_y/alpha_x) tan 2 pi u_2]."""

    def normals(self, p, w_i, u):
        theta = angles(super().normals(p, w_i, u))[0]
        ratio = p[self.alpha_y] / p[self.alpha_x]
        return unit_vectors(theta, np.arctan(ratio * np.tan(2 * np.pi * u[1])))


@pytest.mark.parametrize(
    ("lobe", "right"), [(GaussianSlopes, True), (WithoutArctangent, False), (OneBranch, False)]
)
@pytest.mark.parametrize("theta", [0.0, 45.0])
def test_eq_7_as_printed_has_not_the_density_of_its_lobe(lobe, right, theta):
    alphas = (0.3, 0.2)
    lobe = lobe(alpha_x="alpha_x", alpha_y="alpha_y")
    model, p, draws = ward_draws(alphas, theta * DEG, 0.7, 20_000, lobe=lobe)
    found = compared(model, p, (theta, 0.7 / DEG), draws)
    assert (found.p_value > LEVEL) == right
    if not right:
        assert found.p_value < 1e-9


def test_eq_7_as_printed_draws_slopes_too_wide_and_half_of_the_plane():
    n, alpha = 200_000, 0.3
    u = np.random.default_rng(10).random((2, n))
    p, up = {"a": alpha}, np.broadcast_to([0.0, 0.0, 1.0], (n, 3))
    right, wide, half = (
        kind(alpha_x="a", alpha_y="a").normals(p, up, u)
        for kind in (GaussianSlopes, WithoutArctangent, OneBranch)
    )
    slopes = right[:, 0] / right[:, 2]
    assert slopes.var() == pytest.approx(alpha**2 / 2, rel=0.02)
    # tan^2 x = x^2 + 2 x^4/3 + ..., and <x^4> = 2 alpha^4: larger by some 4/3 alpha^2.
    steep = wide[wide[:, 2] > 0]
    assert (steep[:, 0] / steep[:, 2]).var() > slopes.var() * (1 + alpha**2)
    azimuth = np.arctan2(right[:, 1], right[:, 0])
    assert abs(np.cos(azimuth).mean()) < 4 / np.sqrt(n)
    assert half[:, 0].min() >= 0
    assert np.cos(np.arctan2(half[:, 1], half[:, 0])).mean() == pytest.approx(2 / np.pi, abs=0.01)


# --- errors ---------------------------------------------------------------------------------------


def test_light_from_below_is_refused():
    model = models.get("ward")
    match = r"w_i has z = -0.0998\d*, which is not above the horizon; give the direction towards"
    for call in (
        lambda w: model.sample(w, model.vector({}), np.random.default_rng(1)),
        lambda w: model.density(w, [0, 0, 1], model.vector({})),
    ):
        with pytest.raises(DataError, match=match) as caught:
            call([unit_vectors(0.3, 0), unit_vectors(np.pi / 2 + 0.1, 0)])
        assert caught.value.value < 0
        with pytest.raises(DataError, match=r"w_i has z = 0, which is not above the horizon"):
            call(unit_vectors(np.pi / 2, 0))


@pytest.mark.parametrize(
    ("w_i", "match"),
    [
        (
            [0.0, 1.0],
            r"w_i has shape \(2,\); give unit vectors of shape \(\.\.\., 3\), as gonio.geo",
        ),
        (1.0, r"w_i has shape \(\); give unit vectors"),
        ([0.0, 0.0, 2.0], "w_i holds a vector of length 2; give unit vectors, as gonio.geometry"),
        ([0.0, 0.0, np.nan], "w_i holds a vector of length nan; give unit vectors"),
    ],
)
def test_what_is_no_direction_is_refused(w_i, match):
    model = models.get("lambert")
    with pytest.raises(DataError, match=match):
        model.sample(w_i, model.vector({}), np.random.default_rng(1))
    with pytest.raises(DataError, match=match.replace("w_i", "w_r")):
        model.density([0, 0, 1], w_i, model.vector({}))


def test_directions_that_do_not_broadcast_are_refused():
    up = np.broadcast_to([0.0, 0.0, 1.0], (4, 3))
    match = r"w_i of shape \(4, 3\) and w_r of shape \(3, 3\) do not broadcast; give equal shapes"
    with pytest.raises(DataError, match=match):
        models.get("lambert").density(up, up[:3], [0.5])


@pytest.mark.parametrize("p", [[0.5], 0.5, [[0.1, 0.2, 0.1, 0.1]], [0.1] * 5])
def test_a_parameter_vector_of_another_length_is_refused(p):
    match = r"p has shape \(.*\); ward takes the 4 values rho_d, rho_s, alpha_x, alpha_y, as its m"
    with pytest.raises(ConfigurationError, match=match):
        models.get("ward").sample([0, 0, 1], p, np.random.default_rng(1))
    with pytest.raises(ConfigurationError, match=match):
        models.get("ward").density([0, 0, 1], [0, 0, 1], p)


def test_no_directions_give_no_draws():
    model = models.get("ward")
    draws = model.sample(np.empty((0, 3)), model.vector({}), np.random.default_rng(1))
    assert draws.w_r.shape == (0, 3)
    assert draws.weight.shape == (0,)
