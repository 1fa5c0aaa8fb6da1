"""Material and slope errors of the dome together, from samples alone.

Most tests make samples by hand: a lobe seen through a field of displacements that the test draws,
not the simulator. Nothing of the field is known to the solver.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gonio
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.dome_field.calibrated_samples import calibrated_samples
from gonio.fitting.dome_field.equations import Prior, sums
from gonio.fitting.dome_field.evidence import FieldData
from gonio.fitting.dome_field.findings import Findings
from gonio.fitting.dome_field.held_out import Prediction, predictions
from gonio.fitting.dome_field.part import Part, lab_directions, numbered
from gonio.fitting.dome_field.posterior import Uncertainty, change_of_samples, modes
from gonio.fitting.dome_field.rig import Rig
from gonio.fitting.dome_field.self_calibration import SelfCalibration, self_calibrated
from gonio.fitting.dome_field.solve import Joint, solve
from gonio.fitting.dome_field.state import Layout, State
from gonio.fitting.minimum.find import find_minimum
from gonio.geometry import Directions, angles, equal_area, from_equal_area, rotated
from gonio.samples import BRDFSamples
from gonio.shared_term import SharedTerm
from gonio.tangent_field import FieldPrior, Nodes, tangents

METAL = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.15}
NOISE, DRIFT, U_STANDARD = 0.003, 0.003, 0.005
THETA_I = np.radians([10.0, 18, 26, 34, 42, 50])
TURNS = np.radians([0.0, 45.0, 90.0])
RIG = {
    "identity": "rig one", "instrument": "by hand", "shape": "ellipsoid", "mapping": "eq3",
    "R_mm": 150.0, "D_mm": 15.0, "slope_error_deg": 0.05, "rim_slope_error_deg": 0.0,
    "slope_correlation_deg": 12.0, "lamp_drift": DRIFT,
}  # fmt: skip
PRIOR = FieldPrior(float(np.radians(0.1)), 0.0, float(np.radians(12.0)))


def waves(w: np.ndarray, rng: np.random.Generator, length_deg: float = 12.0) -> np.ndarray:
    """Displacements of 0.1 deg sd: plane waves in space, two components."""
    k = rng.normal(size=(40, 3)) / np.radians(length_deg)
    phase = rng.uniform(0, 2 * np.pi, size=(2, 40))
    parts = [np.cos(w @ k.T + each).sum(axis=1) * np.sqrt(2 / 40) for each in phase]
    return np.radians(0.1) * (
        parts[0][:, None] * tangents(w)[0] + parts[1][:, None] * tangents(w)[1]
    )


def ripple(w: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A ripple along x of 25 deg wavelength: regular, as no Gaussian process is."""
    size = np.radians(0.15) * np.sin(2 * np.pi * w[:, 0] / np.radians(25))
    return size[:, None] * tangents(w)[0]


def dent(w: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One dent of 15 deg, towards whose middle directions are moved."""
    middle = np.array([-0.4, 0.1, np.sqrt(1 - 0.17)])
    pull = middle - (w @ middle)[:, None] * w
    near = np.exp(-0.5 * (np.arccos(np.clip(w @ middle, -1, 1)) / np.radians(15)) ** 2)
    return np.radians(0.3) / np.radians(15) * near[:, None] * pull * 0.5


def measured(
    seed: int, field=waves, model: str = "ward", parameters=METAL, turns=TURNS, n: int = 22,
    rig_seed: int = 0, session: str | None = None,
) -> BRDFSamples:  # fmt: skip
    """Samples of a session: a lobe through a field, a lamp that drifts, a standard that is off."""
    rng = np.random.default_rng(seed)
    line = np.linspace(-0.85, 0.85, n)
    x, y = (each.ravel() for each in np.meshgrid(line, line))
    inside = np.hypot(x, y) < 0.85
    lab = from_equal_area(x[inside], y[inside])
    seen = lab + field(lab, np.random.default_rng(1000 + rig_seed))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    values, columns, images = [], [], []
    chosen = gonio.models.get(model)
    for k, (theta_i, turn) in enumerate((t, psi) for t in THETA_I for psi in turns):
        there = angles(rotated(seen, turn))
        stated = angles(rotated(lab, turn))
        f = chosen(Directions(theta_i, -turn, *there), **parameters)
        f = f * (1 + DRIFT * rng.standard_normal())
        values.append(f * (1 + NOISE * rng.standard_normal(len(f))))
        columns.append(np.stack([np.full(len(f), theta_i), np.full(len(f), -turn), *stated]))
        images.append(np.full(len(f), k))
    value, image = np.concatenate(values), np.concatenate(images)
    typical = SharedTerm("dome slope, shift", "", shift=np.zeros((len(value), 3)), typical=True)
    return BRDFSamples(
        Directions(*np.concatenate(columns, axis=1)), value, NOISE * value,
        image=image,
        shared=(
            typical,
            SharedTerm("standard", "", U_STANDARD, belongs_to="rig"),
            SharedTerm("lamp, sample", "", DRIFT, group=image, belongs_to="session"),
        ),
        metadata={
            "rig": RIG | {"turn_deg": np.degrees(np.tile(turns, len(THETA_I))).tolist()},
            "session_sha256": session or f"{seed:064d}",
        },
    )  # fmt: skip


@pytest.fixture(scope="module")
def joint() -> Joint:
    return solve([find_minimum(measured(1), gonio.models.get("ward"), threads=1)], PRIOR)


def test_material_and_field_are_found_together(joint):
    u = Uncertainty.of(joint.information)
    sd = np.sqrt(np.diag(u.covariance)[:4])
    truth = np.array(list(METAL.values()))
    assert joint.chi2_before / joint.n > 5
    assert joint.chi2 / joint.n == pytest.approx(1.0, abs=0.06)
    assert np.all(np.abs(joint.state.p[0] - truth)[2:] < 4 * sd[2:])
    assert np.all(sd[2:] < 1e-3 * truth[2:])
    # Where a lobe went, the field is that of the dome to a tenth of its sd.
    lab = from_equal_area(np.array([-0.25, -0.4, -0.3]), np.array([0.0, 0.05, -0.05]))
    near = joint.nodes.interpolation(lab)
    x, y = tangents(lab)
    found = near(joint.state.field[0])[:, None] * x + near(joint.state.field[1])[:, None] * y
    true = waves(lab, np.random.default_rng(1000))
    assert np.max(np.linalg.norm(found - true, axis=1)) < 0.15 * np.radians(0.1)


def test_derivatives_are_differences_of_the_values(joint):
    part, state = joint.parts[0], joint.state
    slope = part.slope(state.p[0], state.field, state.z)
    h = 1e-6
    for node in (3, 40):
        field = np.array(state.field)
        field[1, node] += h
        change = (part.slope(state.p[0], field, state.z).value - slope.value) / h
        weight = np.where(part.interpolation.index == node, part.interpolation.weight, 0).sum(
            axis=1
        )
        expected = slope.by_field[:, 1] * weight
        assert np.max(np.abs(change - expected)) < 2e-3 * np.max(np.abs(expected))
    z = np.array(state.z)
    z[2] += 1e-4
    change = (part.slope(state.p[0], state.field, z).value - slope.value) / 1e-4
    expected = np.where(part.draws[0].draw == 2, slope.by_draw[:, 0], 0.0)
    assert np.allclose(change, expected, atol=1e-6 * np.max(np.abs(expected)))


def test_sums_are_those_of_dense_matrices(joint):
    rows = joint.rows[0]
    some = slice(0, 300)
    dense = np.zeros((300, joint.layout.size))
    np.put_along_axis(dense, rows.index[some], rows.column[some], axis=1)
    chosen = np.arange(len(rows.residual)) < 300
    found = sums([rows], joint.layout, [chosen])
    assert np.allclose(found.information, dense.T @ dense, rtol=1e-10, atol=1e-6)
    assert np.allclose(found.gradient, dense.T @ rows.residual[some], rtol=1e-8, atol=1e-6)


def test_evidence_is_the_density_of_the_data():
    """Against the normal density of data with the field integrated out, without any elimination."""
    rng = np.random.default_rng(4)
    nodes = Nodes.on_cap(FieldPrior(0.5, 0.0, 0.6), 0.8, 15)
    k = len(nodes)
    columns, noise = rng.normal(size=(30, 2 * k)), 0.7
    y = columns @ rng.normal(size=2 * k) * 0.3 + noise * rng.normal(size=30)
    data = FieldData(columns.T @ y / noise**2, columns.T @ columns / noise**2)
    prior = np.kron(np.eye(2), nodes.root @ nodes.root.T)

    def log_density(covariance):
        _, logdet = np.linalg.slogdet(covariance)
        return -0.5 * (logdet + y @ np.linalg.solve(covariance, y))

    alone = noise**2 * np.eye(30)
    expected = log_density(alone + columns @ prior @ columns.T) - log_density(alone)
    assert data.log_evidence(nodes) == pytest.approx(expected, rel=1e-8)


def test_modes_of_the_other_unknowns_reproduce_the_covariance(joint):
    """cov(p) of all unknowns together = that with the others held + what the modes add."""
    u = Uncertainty.of(joint.information)
    v = modes(joint, u, 0)
    own = joint.layout.of_session(0)
    change = change_of_samples(joint, 0, v)
    rows = joint.rows[0]
    j = rows.column[:, :4] * 1.0
    h_pp = j.T @ j
    moved = np.linalg.solve(h_pp, j.T @ (rows.root[:, None] * change))
    whole = np.linalg.inv(h_pp) + moved @ moved.T
    assert np.allclose(whole, u.covariance[np.ix_(own, own)], rtol=1e-6)


def test_a_fit_of_calibrated_samples_ends_at_the_joint_solution(joint):
    u = Uncertainty.of(joint.information)
    samples = calibrated_samples(joint, u, 0)
    assert not any(term.typical or term.name == "lamp, sample" for term in samples.shared)
    result = gonio.fit(samples, model="ward")
    sd = np.sqrt(np.diag(u.covariance)[:4])
    found = np.array(list(result.values().values()))
    assert np.all(np.abs(found - joint.state.p[0]) < 0.1 * sd)
    # The floor of image formation is added, and to the reflectances the standard.
    stderr = np.array([each.stderr for each in result.parameters.values()])
    floor = 1e-4 * found
    assert stderr[2:] == pytest.approx(np.hypot(sd, floor)[2:], rel=0.05)
    assert stderr[0] == pytest.approx(np.hypot(sd[0], U_STANDARD * found[0]), rel=0.05)


def test_leaving_out_is_solving_without(joint):
    """The predictive chi-squared equals the fall of the penalised sum when a group is left out."""
    p = predictions(joint)[0]
    d = joint.parts[0].problem.samples.directions
    chosen = np.isclose(np.broadcast_to(d.phi_i, joint.n), 0.0)
    assert p.left_out == "rotation 0 deg"
    assert p.n == np.count_nonzero(chosen)
    rest = sums(joint.rows, joint.layout, [~chosen])
    group = sums(joint.rows, joint.layout, [chosen])
    prior = Prior.of(joint.nodes, joint.layout)
    gradient, information = prior.added(rest, joint.state)
    step = np.linalg.solve(information, gradient)
    fall = group.chi2 + float(gradient @ step)
    # At the solution the gradients of group and rest cancel.
    assert p.chi2 == pytest.approx(fall, rel=1e-3)
    assert all(0.85 < each.ratio < 1.15 for each in predictions(joint))
    assert not any(each.fails for each in predictions(joint))


@pytest.mark.parametrize(("field", "rig_seed"), [(waves, 1), (waves, 2), (ripple, 0), (dent, 0)])
def test_the_right_model_fits_whatever_the_field(field, rig_seed):
    result = gonio.fit(
        measured(7 + rig_seed, field, rig_seed=rig_seed), model="ward", self_calibrate=True
    )
    assert result.verdict.fits, result.verdict.line
    assert result.chi2 / result.dof < 1.15
    for name in ("alpha_x", "alpha_y"):
        each = result.parameters[name]
        assert abs(each.value - METAL[name]) < 4 * each.stderr + 2e-4 * METAL[name], name


@pytest.mark.parametrize("model", ["ward_duer", "ward_gmd"])
def test_a_field_does_not_hide_a_wrong_model(model):
    result = gonio.fit(measured(3), model=model, self_calibrate=True)
    assert result.verdict.kind == "does_not_fit", result.verdict.line


def test_a_matte_sample_teaches_nothing():
    matte = measured(5, model="lambert", parameters={"rho": 0.5})
    result = gonio.fit(matte, model="lambert", self_calibrate=True)
    assert any("tell nothing of the dome's slope errors" in line for line in result.warnings)
    assert result.parameters["rho"].value == pytest.approx(0.5, rel=0.02)


def test_what_was_done_is_said():
    result = gonio.fit(measured(1), model="ward", self_calibrate=True)
    found = result.diagnostics["self_calibration"]
    first, second = found["notes"]
    assert first.startswith("self-calibrated: with the dome's slope errors as unknowns chi2/n is")
    assert "of the misfit" in first
    assert "of the directions are known better than before" in second
    # These are no warnings, and the table shows them.
    assert not result.warnings
    assert f"\n{first}\n{second}\n" in str(result)
    assert found["by_cone"] < 0.01  # a lobe of 0.04 rad is wider than what the cone leaves open
    assert found["share"] == pytest.approx(1 - found["chi2_after"] / found["chi2_before"])
    assert found["share"] > 0.8
    assert {p["fails"] for p in found["predictions"]} == {False}


def test_two_sessions_of_one_rig_share_the_dome():
    one, two = measured(1), measured(2, parameters=METAL | {"alpha_x": 0.12, "rho_s": 0.1})
    together = gonio.calibrate_dome([one, two], "ward")
    alone = gonio.calibrate_dome(one, "ward")
    assert together.findings.chi2_after == pytest.approx(1.0, abs=0.06)
    assert len(together.map.sessions) == 2
    where = from_equal_area(np.array([-0.3, -0.1]), np.array([0.05, -0.1]))
    assert np.all(together.map.sd(where)[0] < alone.map.sd(where)[0])
    assert together.parameters[1]["alpha_x"][0] == pytest.approx(0.12, rel=1e-3)


def test_threads_change_nothing(joint):
    first = self_calibrated(measured(1), gonio.models.get("ward"), threads=3)
    u = Uncertainty.of(joint.information)
    assert np.array_equal(first.samples.value, calibrated_samples(joint, u, 0).value)


# ---------------------------------------------------------------- refusals


def test_samples_must_name_their_rig():
    bare = replace(measured(1), metadata={})
    with pytest.raises(
        DataError, match=r"do not say on which rig they were measured.*gonio reduce"
    ):
        gonio.fit(bare, model="ward", self_calibrate=True)


def test_a_dome_without_slope_errors_has_nothing_to_find():
    samples = measured(1)
    flat = replace(samples, metadata=samples.metadata | {"rig": RIG | {"slope_error_deg": 0.0}})
    with pytest.raises(ConfigurationError, match="states no slope errors of the dome"):
        gonio.fit(flat, model="ward", self_calibrate=True)


def test_two_rigs_have_two_maps():
    one, two = measured(1), measured(2)
    other = replace(two, metadata=two.metadata | {"rig": RIG | {"identity": "rig two"}})
    with pytest.raises(ConfigurationError, match="sessions of two rigs, 'rig one' and 'rig two'"):
        gonio.calibrate_dome([one, other], "ward")
    with pytest.raises(ConfigurationError, match="one session is given twice"):
        gonio.calibrate_dome([one, one], "ward")
    with pytest.raises(ConfigurationError, match="2 models for 1 session"):
        gonio.calibrate_dome(one, ["ward", "ward"])


def test_self_calibration_does_not_go_with_share_or_losses():
    with pytest.raises(ConfigurationError, match="leave share and nuisance out"):
        gonio.fit(measured(1), model="ward", self_calibrate=True, nuisance="all")
    with pytest.raises(ConfigurationError, match="loss chi2; leave weights and loss out"):
        gonio.fit(measured(1), model="ward", self_calibrate=True, loss="student_t")


def test_draws_of_the_rig_are_shared_and_turns_are_not():
    one, two = (
        replace(
            measured(k),
            shared=(
                SharedTerm("azimuth", "", turn=0.01, belongs_to="rig"),
                SharedTerm("standard, shape", "", 0.01, profile=np.ones(len(measured(k))),
                           belongs_to="rig"),
            ),
        )
        for k in (1, 2)
    )  # fmt: skip
    model = gonio.models.get("ward")
    problems = [find_minimum(each, model).problem for each in (one, two)]
    draws, n = numbered(problems)
    assert n == 3
    assert draws[0][0].draw[0] != draws[1][0].draw[0]
    assert draws[0][1].draw[0] == draws[1][1].draw[0]


def test_a_state_moves_within_limits(joint):
    layout = Layout((2,), 1, 1)
    state = State((np.array([0.5, 0.5]),), np.zeros((2, 1)), np.zeros(1))
    step = np.array([1.0, -0.1, 0.2, 0.3, 0.4])
    moved = state.moved(layout, step, [np.array([[0.0, 0.0], [1.0, 1.0]])])
    assert moved.p[0].tolist() == [1.0, 0.4]
    assert moved.field.tolist() == [[0.2], [0.3]]
    assert moved.z.tolist() == [0.4]


def test_directions_are_those_of_the_laboratory():
    problem = find_minimum(measured(1), gonio.models.get("ward")).problem
    lab = lab_directions(problem)
    n = problem.n // (len(THETA_I) * len(TURNS))
    # Every image looks at the same places of the dome.
    assert np.allclose(lab[:n], lab[n : 2 * n], atol=1e-12)
    rig = Rig.of(problem.samples)
    assert rig.prior.zenith == pytest.approx(np.radians(0.1))
    part = Part.of(problem, Nodes.on_cap(rig.prior, 1.0, 500), ())
    axis = part.axes[0]
    assert np.allclose(np.sum(axis * problem.samples.directions.vectors()[1], axis=1), 0, atol=1e-9)
    assert equal_area(lab)[0].max() < 0.86


@pytest.mark.parametrize(("by_cone", "kind"), [(0.005, "does_not_fit"), (0.02, "undecided")])
def test_what_the_cone_of_the_lamp_may_cause_is_not_held_against_a_model(by_cone, kind):
    failed = Prediction("rotation 90 deg", chi2=1500.0, n=1000)
    findings = Findings(
        chi2_before=100.0, chi2_after=1.3, share=0.98, sd_factor=1.0, correlation=0.17,
        log_evidence=10.0, field_chi2=100.0, field_n=100, field_p=0.5, known=0.5,
        predictions=(failed,), settled=True, by_cone=by_cone,
    )  # fmt: skip
    fitted = gonio.fit(measured(1), model="ward")
    fits = replace(fitted, verdict=replace(fitted.verdict, kind="fits"))
    verdict = SelfCalibration(measured(1), findings).noted(fits).verdict
    assert verdict.kind == kind
    assert "do not predict images that were left out (rotation 90 deg: chi2/n 1.5)" in verdict.line
    asked = "the uncertainty of the lamp's half-angle changes it by 2 %" in verdict.line
    assert asked == (kind == "undecided")
