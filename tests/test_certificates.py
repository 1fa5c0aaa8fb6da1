"""What is certified of the white standard: kinds, conversions between them, unknown shapes."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from virtual import Drawn, images, small

import gonio
from gonio import models
from gonio.calibration.budget import budget
from gonio.calibration.effects import standard_certificate, standard_shape
from gonio.calibration.frames.certified import describe, estimate, total_reflectance
from gonio.certificate import Certificate, ListedBRDF
from gonio.instrument import preset
from gonio.instrument.records import metadata
from gonio.instrument.standard import Standard
from gonio.metadata import Plan

PLAN = Plan(
    theta_i_deg=(0.0, 15.0, 30.0, 45.0, 60.0, 75.0), rotations_deg=(0.0,),
    exposures_s=(1e-3, 4e-3, 16e-3, 64e-3), repeats=4,
)  # fmt: skip
WARD = {"rho_d": 0.1, "rho_s": 0.33, "alpha_x": 0.2, "alpha_y": 0.2}
LISTED = tuple((float(i), float(r), float(p)) for i in (0, 30, 60) for r in (0, 20, 45, 65, 75)
               for p in (0, 90, 180) if r or not p)  # fmt: skip


def fall(theta):
    return (theta / np.radians(75)) ** 4


def session(standard, knows=None, model="ward", n=52, **parameters) -> Drawn:
    """Raw frames with a true standard; the session says `knows` of it, or its certificate."""
    scene = images(small(n=n, standard=standard), PLAN, model, **(parameters or WARD))
    known = metadata(scene.instrument, PLAN, model, "")
    if knows is not None:
        certificate = known.standard.model_dump() | knows
        known = known.model_copy(update={"standard": Certificate(**certificate)})
    return Drawn(scene, known=known)


def estimator(samples, p=WARD):
    """Matrix A of shape (4, N): parameters of a weighted fit change by A times a change of f."""
    ward, d = models.get("ward"), samples.directions
    steps = {name: 1e-5 * value for name, value in p.items()}
    columns = [
        (ward(d, **(p | {k: p[k] + h})) - ward(d, **(p | {k: p[k] - h}))) / (2 * h)
        for k, h in steps.items()
    ]
    jacobian = np.stack(columns, axis=1)
    weighted = jacobian / samples.u_independent[:, None] ** 2
    return np.linalg.solve(jacobian.T @ weighted, weighted.T)


# ---------------------------------------------------------------- conversion between the kinds


@pytest.mark.parametrize("reciprocal", [False, True])
def test_a_total_reflectance_is_the_integral_over_the_hemisphere(reciprocal):
    certificate = Certificate(
        kind="total", reflectance=0.97, uncertainty=0.005, rolloff=0.1, reciprocal=reciprocal
    )
    at_8 = np.radians(8)

    def light(theta_r):
        f = float(estimate(certificate).brdf(at_8, theta_r, 0.0))
        return 2 * np.pi * f * np.cos(theta_r) * np.sin(theta_r)

    assert quad(light, 0, np.pi / 2)[0] == pytest.approx(0.97, rel=1e-9)
    # <(theta/75 deg)^4> over the projected hemisphere.
    mean = quad(lambda t: np.sin(2 * t) * fall(t), 0, np.pi / 2)[0]
    own = 1 - 0.1 * fall(at_8) if reciprocal else 1.0
    normal = float(np.pi * estimate(certificate).brdf(0.0, 0.0, 0.0))
    assert normal == pytest.approx(0.97 / (own * (1 - 0.1 * mean)), rel=1e-9)


def test_a_factor_0_45_is_met_at_0_and_45_degrees():
    certificate = Certificate(kind="0/45", reflectance=1.01, uncertainty=0.0, rolloff=0.1)
    f = estimate(certificate).brdf
    assert np.pi * f(0.0, np.radians(45), 0.0) == pytest.approx(1.01)
    assert np.pi * f(0.0, 0.0, 0.0) == pytest.approx(1.01 / (1 - 0.1 * 0.6**4))


def test_a_table_serves_as_shape_of_a_total_reflectance():
    theta = np.radians(np.linspace(0, 90, 91))
    factor = tuple((float(x),) for x in 0.8 * (1 - 0.1 * fall(theta)))
    table = {"theta_i_deg": [0], "theta_r_deg": np.degrees(theta).tolist(), "factor": [factor]}
    stated = {"kind": "total", "reflectance": 0.9, "uncertainty": 0.0}
    by_table = estimate(Certificate(**stated, table=table)).brdf(0.3, theta[:80], 0.0)
    by_formula = estimate(Certificate(**stated, rolloff=0.1)).brdf(0.3, theta[:80], 0.0)
    np.testing.assert_allclose(by_table, by_formula, rtol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_instrument_and_reduction_convert_alike_by_formulas_of_their_own(seed):
    rng = np.random.default_rng(seed)
    where = np.radians([rng.uniform(0, 75, 20), rng.uniform(0, 80, 20), rng.uniform(0, 360, 20)])
    for kind in ("pi_f0", "total", "0/45"):
        rolloff = float(rng.uniform(0, 0.2))
        true = Standard(
            kind=kind, reflectance=0.95, uncertainty=0.0, rolloff=rolloff, reciprocal=True
        )
        found = estimate(true.certificate()).brdf(*where)
        np.testing.assert_allclose(found, true.brdf(*where), rtol=2e-6)


def test_a_list_of_f_is_met_and_smooth_in_between():
    true = Standard(
        kind="brdf_table", reflectance=0.98, uncertainty=0.002, rolloff=0.1, reciprocal=True,
        shape_sd=0.03, seed=4, u_shape=0.1, listed_deg=LISTED, u_listed=1e-3,
    )  # fmt: skip
    found = estimate(true.certificate())
    listed = np.radians(np.transpose(LISTED))
    off = found.brdf(*listed) / true.brdf(*listed) - 1
    assert np.sqrt(np.mean(off**2)) < 0.004
    between = np.radians([[20, 50, 40], [35, 55, 70], [40, 130, 300]])
    error = found.brdf(*between) / true.brdf(*between) - 1
    u = np.sqrt(np.sum(found.modes(*between) ** 2, axis=0))
    assert np.all(np.abs(error) < 3 * u)
    assert np.all(u < 0.01)
    integral = true.shape.albedo(np.radians(8)) * 0.98
    assert total_reflectance(true.certificate()) == pytest.approx(integral, rel=0.005)


# ---------------------------------------------------------------- a shape that nobody certified


@pytest.mark.parametrize("kind", ["pi_f0", "total", "0/45"])
def test_modes_of_an_uncertified_shape_are_reciprocal_and_keep_the_certified_number(kind):
    found = estimate(Certificate(kind=kind, reflectance=0.9, uncertainty=0.0, u_shape=0.04))
    rng = np.random.default_rng(2)
    (i, r), p = rng.uniform(0, 1.3, (2, 30)), rng.uniform(0, 6, 30)
    np.testing.assert_allclose(found.modes(i, r, p), found.modes(r, i, -p), atol=1e-12)
    if kind == "total":
        theta, phi = np.meshgrid(np.linspace(0, np.pi / 2, 2001), np.linspace(0, np.pi, 41))
        weight = np.sin(2 * theta)
        kept = np.trapezoid(
            np.mean(found.modes(np.radians(8), theta, phi)[:, 1:] * weight[1:], axis=1), theta[0]
        )
    else:
        kept = found.modes(0.0, np.radians(45 if kind == "0/45" else 0), 0.0)
    assert np.abs(kept).max() < 2e-4
    # Against the normal f is uncertain by u_shape at 75 deg.
    change = found.modes(0.0, np.radians(75), 0.0) - found.modes(0.0, 0.0, 0.0)
    assert np.sqrt(np.sum(change**2)) == pytest.approx(0.04, rel=0.01)


def test_a_shape_that_nobody_certified_is_unknown_and_never_0():
    samples = gonio.reduce(session({"rolloff": 0.1, "rolloff_certified": False}))
    line = "shape of the white standard, which nobody certified (standard.u_shape)"
    assert line in samples.metadata["unknown"]
    assert line in budget(samples).unknown
    assert any("shape unknown and taken as Lambertian" in line for line in samples.history)
    assert not [term for term in samples.shared if term.effect == "standard_shape"]


def test_its_typical_size_becomes_shared_errors_that_no_data_can_tell():
    standard = {"rolloff": 0.1, "rolloff_certified": False, "u_shape": 0.08}
    samples = gonio.reduce(session(standard))
    assert not [line for line in samples.metadata["unknown"] if "standard" in line]
    terms = [term for term in samples.shared if term.effect == "standard_shape"]
    assert [term.name for term in terms][:2] == ["standard, shape mode 1", "standard, shape mode 2"]
    assert all(term.typical and term.of_rig for term in terms)
    rows = {source.name for source in budget(samples).counted}
    assert {term.name for term in terms} <= rows


def test_a_rolloff_of_theta_r_alone_leaves_theta_i_unknown():
    line = "change of the white standard with theta_i (standard.reciprocal)"
    for reciprocal, unknown in ((None, True), (False, False), (True, False)):
        knows = {"rolloff": 0.05, "reciprocal": reciprocal}
        samples = gonio.reduce(session({"rolloff": 0.05}, knows, n=26))
        assert (line in samples.metadata["unknown"]) == unknown


def test_a_list_without_a_typical_shape_is_unknown_between_its_geometries():
    standard = {"kind": "brdf_table", "listed_deg": LISTED, "u_listed": 0.002}
    samples = gonio.reduce(session(standard, n=26))
    assert (
        "white standard between the listed geometries (standard.u_shape)"
        in (samples.metadata["unknown"])
    )
    # The uncertainty of the listed values counts nevertheless.
    (row, *_) = (s for s in budget(samples).counted if s.effect == "standard_shape")
    assert 0 < np.median(row.u / samples.value) < 0.002


def test_the_uncertainty_of_a_certified_rolloff_follows_the_kind():
    theta = np.radians(np.arange(5, 80, 5))
    part = SimpleNamespace(theta_i=np.radians(60), psi=0.4, centroid=np.stack(
        [np.sin(theta), 0 * theta, np.cos(theta)], axis=1))  # fmt: skip
    for kind, kept in (("pi_f0", 0.0), ("0/45", 0.6**4)):
        certificate = Certificate(
            kind=kind, reflectance=0.9, uncertainty=0.0, rolloff=0.0, rolloff_uncertainty=0.02,
            reciprocal=True,
        )  # fmt: skip
        measured = SimpleNamespace(
            metadata=SimpleNamespace(standard=certificate, plan=PLAN), images=[part],
            centroid=part.centroid,
        )  # fmt: skip
        (term,) = standard_certificate.terms(measured)
        expected = 0.02 * (fall(theta) + fall(part.theta_i) - kept)
        np.testing.assert_allclose(term.relative * term.profile, expected, rtol=1e-12)


# ---------------------------------------------------------------- frames of a drawn standard


@pytest.mark.parametrize("alone", [None, 45.0], ids=["every incidence", "one incidence"])
def test_frames_show_the_true_shape_in_the_directions_of_the_laboratory(alone):
    """The sample is turned and the standard is not: its f belongs to the laboratory's azimuth."""
    turned = PLAN.model_copy(
        update={"rotations_deg": (40.0,), "standard_theta_i_deg": alone, "theta_i_deg": (45, 60)}
    )
    standard = {"shape_sd": 0.08, "seed": 3, "rolloff_certified": False, "u_shape": 0.05}
    rig = small(n=52, standard=standard)
    samples = gonio.reduce(Drawn(images(rig, turned, "lambert", rho=0.5)))
    d, true = samples.directions, rig.standard
    incidence = d.theta_i if alone is None else np.full(len(samples), np.radians(alone))
    where = incidence, d.theta_r, d.phi_r - d.phi_i
    change = 0.99 / np.pi / true.brdf(*where)
    # It depends on azimuth, or this would be no test.
    assert np.ptp(change[(d.theta_r > 1.0) & (d.theta_r < 1.1)]) > 0.02
    measured = samples.value * np.pi / 0.5
    score = (measured - change) / (samples.u_independent * np.pi / 0.5)
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1, abs=0.15)
    modes = estimate(true.certificate()).modes(*where)
    terms = [term for term in samples.shared if term.effect == "standard_shape"]
    for term, mode in zip(terms, modes, strict=True):
        # A cell's mean direction is not quite the mean of the cell's f.
        np.testing.assert_allclose(term.relative * term.profile, mode, atol=1e-9)


def test_the_certificate_knows_nothing_of_the_drawn_shape(tmp_path):
    rig = small(n=26, standard={"shape_sd": 0.05, "seed": 12345, "rolloff_certified": False})
    plan = PLAN.model_copy(update={"theta_i_deg": (0.0,), "exposures_s": (0.01,), "repeats": 1})
    recorded = gonio.simulate(
        model="lambert", output=tmp_path / "s.gonio", instrument=rig, plan=plan, seed=1
    )
    text = (recorded.path / "session.json").read_text()
    assert "12345" not in text
    assert "shape_sd" not in text
    other = rig.altered(standard=rig.standard.model_dump() | {"seed": 2})
    assert metadata(other, plan, "a", "").standard == recorded.metadata.standard
    assert json.loads(text)["standard"]["rolloff"] is None


def test_a_rolloff_of_0_in_a_session_of_0_1_was_stated_by_nobody():
    old = {"reflectance": 0.99, "uncertainty": 0.005, "rolloff": 0.0, "rolloff_uncertainty": 0.0}
    assert not Certificate(**old).shape_is_certified
    assert Certificate(**old, kind="pi_f0").shape_is_certified
    assert Certificate(**(old | {"rolloff_uncertainty": 0.02})).rolloff == 0
    assert Certificate(**(old | {"rolloff": 0.1})).rolloff == 0.1


def test_modern12_says_that_its_shape_is_certified():
    known = metadata(preset("modern12"), PLAN, "sample", "")
    assert describe(known.standard) == "pi f(0 deg) = 0.99, less 0.1 (theta_r/75 deg)^4"
    assert known.standard.shape_is_certified


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"kind": "brdf_table", "reflectance": 0.9}, "brdf_table needs the list brdf"),
        ({"kind": "total", "reflectance": 1.1}, r"reflectance = 1\.1: a total reflectance is at"),
        ({"kind": "total"}, "give either reflectance or, with kind brdf_table, the list brdf"),
        ({"reflectance": 0.9, "rolloff": 0.1, "u_shape": 0.1, "rolloff_uncertainty": 0.1},
         "give either rolloff_uncertainty or u_shape"),
        ({"kind": "8/d", "reflectance": 0.9}, "Input should be 'pi_f0', 'total', '0/45' or"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_certificate_is_said(stated, message):
    with pytest.raises(ValueError, match=message):
        Certificate(uncertainty=0.01, **stated)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"brdf": (0.3,)}, "the lists must have one value for each geometry; theta_i_deg has 2"),
        ({"theta_r_deg": (0.0, 95.0)}, "theta_r_deg must lie in 0 to 90"),
        ({"u_brdf": (0.1, 0.4)}, "u_brdf must be at least 0 and smaller than brdf"),
        ({"brdf": (0.3, -0.1)}, "brdf must be positive"),
    ],
)
def test_what_is_wrong_with_a_list_is_said(change, message):
    right = {
        "theta_i_deg": (0.0, 0.0), "theta_r_deg": (0.0, 45.0), "dphi_deg": (0.0, 0.0),
        "brdf": (0.31, 0.3), "u_brdf": (0.001, 0.001),
    }  # fmt: skip
    ListedBRDF(**right)
    with pytest.raises(ValueError, match=message):
        ListedBRDF(**(right | change))


# ---------------------------------------------------------------- what a wrong statement costs


def bias(standard, knows, change, p=WARD):
    """Relative bias of a fit to raw frames, and the prediction from a relative change of f."""
    samples = gonio.reduce(session(standard, knows))
    fit = gonio.fit(samples, model="ward").values()
    found = {name: fit[name] / p[name] - 1 for name in ("rho_d", "rho_s")}
    d = samples.directions
    f = models.get("ward")(d, **p)
    off = estimator(samples) @ (f * change(d.theta_i, d.theta_r))
    predicted = {n: off[list(p).index(n)] / p[n] for n in found}
    return found, predicted, samples, off


@pytest.mark.parametrize(
    ("standard", "knows", "change", "published"),
    [
        # 10 % down at 75 deg, and nobody certified it: rho_d 5.2 % high.
        ({"rolloff": 0.1}, {"rolloff": None},
         lambda i, r: 1 / (1 - 0.1 * fall(r)) - 1, 0.052),
        # A total reflectance taken for pi f(0 deg): everything 2.9 % low.
        ({"rolloff": 0.1, "kind": "total"}, {"kind": "pi_f0"},
         lambda i, r: -0.1 * quad(lambda t: np.sin(2 * t) * fall(t), 0, np.pi / 2)[0] + 0 * r,
         -0.029),
        # It falls in theta_i as well, and the certificate tells of theta_r alone.
        ({"rolloff": 0.05, "reciprocal": True}, {"reciprocal": False},
         lambda i, r: 1 / (1 - 0.05 * fall(i)) - 1, 0.008),
    ],
    ids=["no shape", "total", "theta_i"],
)  # fmt: skip
def test_the_bias_of_a_wrong_certificate_is_the_predicted_one(standard, knows, change, published):
    found, predicted, *_ = bias(standard, knows, change)
    for name in found:
        assert found[name] == pytest.approx(predicted[name], rel=0.1)
    assert found["rho_d"] == pytest.approx(published, rel=0.1)


@pytest.mark.parametrize(
    "standard",
    [
        {"rolloff": 0.1, "kind": "total"},
        {"rolloff": 0.1, "kind": "0/45"},
        {"rolloff": 0.05, "reciprocal": True},
        {"rolloff": 0.05, "reciprocal": True, "kind": "brdf_table", "listed_deg": LISTED,
         "u_listed": 1e-4},
    ],
    ids=["total", "0/45", "theta_i", "brdf_table"],
)  # fmt: skip
def test_there_is_no_bias_where_the_certificate_is_stated_rightly(standard):
    found, *_ = bias(standard, {}, lambda i, r: 0 * r)
    assert abs(found["rho_d"]) < 1e-3
    assert abs(found["rho_s"]) < 1e-3


def test_a_stated_typical_shape_covers_the_bias():
    standard = {"rolloff": 0.1, "rolloff_certified": False, "u_shape": 0.08}
    samples = gonio.reduce(session(standard))
    fit = gonio.fit(samples, model="ward")
    off, u = fit.values()["rho_d"] / 0.1 - 1, fit.parameters["rho_d"].stderr / 0.1
    assert off == pytest.approx(0.052, rel=0.1)
    assert 0.5 < off / u < 2


# ---------------------------------------------------------------- coverage over drawn standards


def terms_for(certificate, samples):
    """Shared errors of the standard as the reduction of these samples would state them."""
    w_r = samples.directions.vectors()[1]
    parts = [
        SimpleNamespace(theta_i=np.radians(theta), psi=0.0, centroid=w_r[samples.image == k])
        for k, theta in enumerate(PLAN.theta_i_deg)
    ]
    measured = SimpleNamespace(
        metadata=SimpleNamespace(standard=certificate, plan=PLAN), images=parts, centroid=w_r
    )
    return [*standard_certificate.terms(measured), *standard_shape.terms(measured)]


@pytest.fixture(scope="module")
def exact():
    """Samples of a session with a standard that is known exactly."""
    return gonio.reduce(session({}, n=40))


@pytest.mark.parametrize("kind", ["pi_f0", "total", "0/45", "brdf_table"])
def test_intervals_hold_over_drawn_standards(exact, kind):
    """True shapes are drawn from a family that the reduction does not have."""
    n, u, sd = 400, 0.005, 0.05
    more = {"listed_deg": LISTED, "u_listed": 0.004} if kind == "brdf_table" else {}
    matrix, d = estimator(exact), exact.directions
    f = models.get("ward")(d, **WARD)
    where = d.theta_i, d.theta_r, d.phi_r - d.phi_i
    rng = np.random.default_rng(7)
    inside, z = [], []
    covariance, columns = None, None
    for seed in range(n):
        true = Standard(
            kind=kind, reflectance=0.98, uncertainty=u, shape_sd=sd, u_shape=sd,
            rolloff_certified=False, seed=seed, **more,
        )  # fmt: skip
        known = true.certificate()
        if columns is None or kind == "brdf_table":
            columns = [matrix @ term.change(f) for term in terms_for(known, exact)]
            covariance = np.einsum("ki,kj->ij", columns, columns)
        scale = 1 + u * rng.standard_normal()
        ratio = estimate(known).brdf(*where) / (scale * true.brdf(*where))
        noise = exact.u_independent * rng.standard_normal(len(f))
        off = matrix @ (f * ratio - f + noise)
        own = np.einsum("in,n,in->i", matrix, exact.u_independent**2, matrix)
        score = off[:2] / np.sqrt(np.diag(covariance) + own)[:2]
        inside.append(np.abs(score) < 1.96)
        z.append(score)
    for k, name in enumerate(("rho_d", "rho_s")):
        count = int(np.sum(inside, axis=0)[k])
        rms = np.sqrt(np.mean(np.square(z), axis=0))[k]
        assert stats.binomtest(count, n, 0.95, alternative="less").pvalue > 0.01, name
        assert rms > 0.5, name  # nor are they too wide to mean anything
