"""Parameters that a fit holds fixed or ties to others."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gonio import models
from gonio.errors import ConfigurationError
from gonio.fitting.comparison.compare import compare
from gonio.fitting.fit import fit
from gonio.fitting.minimum.derivative_check import gradient_faults
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.reduced import ReducedProblem
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.samples import BRDFSamples
from gonio.shared_term import SharedTerm

WARD = {"rho_d": 0.2, "rho_s": 0.1, "alpha_x": 0.15, "alpha_y": 0.15}


def in_plane(n=240, seed=1, noise=0.01, **columns):
    """Samples of an isotropic lobe in the plane of incidence, which tell one width of two."""
    rng = np.random.default_rng(seed)
    theta_i = np.radians(rng.choice([10.0, 30.0, 50.0, 65.0], n))
    side = np.pi * rng.integers(0, 2, n)
    where = Directions(theta_i, np.zeros(n), np.radians(rng.uniform(0, 75, n)), side)
    f = models.get("ward")(where, **WARD)
    u = noise * f + 1e-4
    return BRDFSamples(where, f + u * rng.standard_normal(n), u, **columns)


def reduced(samples, model="ward", **constraints):
    chosen = models.get(model)
    held = Constraints.of(chosen, **constraints)
    return ReducedProblem.of(SingleProblem.from_samples(samples, chosen), held)


def conditional_covariance(samples, found):
    """Of rho_s and alpha_x where rho_d and alpha_y are known."""
    problem = find_minimum(samples, models.get("ward")).problem
    h = problem.normal_equations(np.array(list(found.values().values())))[2]
    return np.linalg.inv(h[np.ix_([1, 2], [1, 2])])


# ---------------------------------------------------------------------- ties


def test_an_elliptical_lobe_with_tied_widths_is_the_isotropic_one():
    samples = in_plane()
    tied = fit(samples, model="ward", tied={"alpha_y": "alpha_x"})
    round_ = fit(samples, model="ward_isotropic")
    pairs = [("rho_d", "rho_d"), ("rho_s", "rho_s"), ("alpha_x", "alpha"), ("alpha_y", "alpha")]
    for mine, theirs in pairs:
        ours, other = tied.parameters[mine], round_.parameters[theirs]
        assert ours.value == pytest.approx(other.value, rel=1e-9)
        assert ours.stderr == pytest.approx(other.stderr, rel=1e-9)
        np.testing.assert_allclose(ours.interval_95, other.interval_95, rtol=1e-9)
    assert tied.chi2 == pytest.approx(round_.chi2, rel=1e-9)
    assert tied.dof == round_.dof == len(samples) - 3
    assert tied.parameters["alpha_y"].tied_to == "alpha_x"
    assert tied.parameters["alpha_x"].tied_to is None
    c = np.array(tied.covariance)
    np.testing.assert_array_equal(c[2], c[3])
    np.testing.assert_allclose(c[:3, :3], round_.covariance, rtol=1e-9)


@pytest.mark.parametrize(
    "constraints",
    [
        {"tied": {"alpha_y": "alpha_x"}},
        {"fixed": {"rho_d": 0.2}},
        {"fixed": {"rho_s": 0.1}, "tied": {"alpha_x": "alpha_y"}},
    ],
)
def test_derivatives_by_unknowns_are_those_of_the_model(constraints):
    problem = reduced(in_plane(60), **constraints)
    p = problem.vector({q.name: WARD[q.name] * 1.1 for q in problem.parameters})
    assert gradient_faults(problem, p) == []
    chi2, g, h = problem.normal_equations(p)
    f, jac = problem.jacobian(p)
    r = problem.samples.value - f
    assert chi2 == pytest.approx(problem.chi2(p), rel=1e-12)
    assert chi2 == pytest.approx(problem.batch_chi2(np.array([p, p]))[1], rel=1e-12)
    np.testing.assert_allclose(g, problem.weighted(jac).T @ r, rtol=1e-8)
    np.testing.assert_allclose(h, problem.weighted(jac).T @ jac, rtol=1e-8)
    rows = np.array([0, 1, len(p)])
    whole = np.block([[np.array([[chi2]]), g[None]], [g[:, None], h]])
    np.testing.assert_allclose(
        problem.products(p[None], rows)[0], whole[np.ix_(rows, rows)], rtol=1e-8
    )


def test_tied_amplitudes_are_one_amplitude():
    samples = in_plane()
    found = fit(samples, model="lambert+lambert", tied={"rho_2": "rho_1"})
    one = fit(samples, model="lambert")
    assert found.parameters["rho_1"].value == pytest.approx(one.parameters["rho"].value / 2)
    assert found.parameters["rho_1"].stderr == pytest.approx(one.parameters["rho"].stderr / 2)


# ---------------------------------------------------------------------- fixed


def test_a_fixed_parameter_is_no_unknown():
    samples = in_plane()
    found = fit(samples, model="ward", fixed={"alpha_y": 0.15, "rho_d": 0.2})
    held = found.parameters["alpha_y"]
    assert (held.value, held.stderr, held.interval_95, held.fixed) == (0.15, None, None, True)
    assert found.dof == len(samples) - 2
    c = np.array(found.covariance)
    assert not c[[0, 3]].any()
    assert c[1, 1] == pytest.approx(found.parameters["rho_s"].stderr ** 2)
    assert found.warnings == ()
    # The information of the whole problem with the other parameters known.
    conditional = conditional_covariance(samples, found)
    stderr = [found.parameters[name].stderr for name in ("rho_s", "alpha_x")]
    scale = found.noise_scale
    np.testing.assert_allclose(stderr, scale * np.sqrt(np.diag(conditional)), rtol=1e-6)


def test_a_lobe_that_is_fixed_to_nothing_leaves_lambert():
    samples = in_plane()
    fixed = {"rho_s": 0.0, "alpha_x": 0.1, "alpha_y": 0.1}
    found = fit(samples, model="ward", fixed=fixed)
    lambert = fit(samples, model="lambert")
    assert found.parameters["rho_d"].value == pytest.approx(lambert.parameters["rho"].value)
    assert found.chi2 == pytest.approx(lambert.chi2)
    assert found.dof == lambert.dof


def test_a_fixed_albedo_leaves_the_rest_of_the_light():
    """rho_d + k_s <= 1 bounds what is left."""
    held = Constraints.of(models.get("ggx"), {"rho_d": 0.7})
    unknowns, kernel, _ = held.unknowns(models.get("ggx"))
    assert {q.name: q.upper for q in unknowns}["k_s"] == pytest.approx(0.3)
    assert kernel.expanded(np.arange(1.0, len(unknowns) + 1))[0] == 0.7


def test_the_posterior_of_a_fixed_fit_is_the_conditional_gaussian():
    samples = in_plane(noise=0.003)
    fixed = {"alpha_y": 0.15, "rho_d": 0.2}
    found = fit(samples, model="ward", fixed=fixed, posterior=True, sampler="auto", seed=2)
    assert found.posterior.sampler == "marginal"
    assert found.posterior.converged
    assert set(found.posterior.priors) == {"rho_s", "alpha_x"}
    conditional = conditional_covariance(samples, found)
    for k, name in enumerate(("rho_s", "alpha_x")):
        low, high = found.parameters[name].interval_95
        width = 2 * 1.96 * found.noise_scale * np.sqrt(conditional[k, k])
        assert high - low == pytest.approx(width, rel=0.08)
    assert found.parameters["alpha_y"].fixed


def test_shared_errors_move_what_is_left():
    samples = in_plane(shared=(SharedTerm("standard", "its certificate", 0.01),))
    found = fit(samples, model="ward", tied={"alpha_y": "alpha_x"})
    one = fit(samples, model="ward_isotropic")
    assert found.parameters["rho_s"].components["standard"] == pytest.approx(
        one.parameters["rho_s"].components["standard"], rel=1e-9
    )


# ---------------------------------------------------------------------- several parts, models


def spectrum():
    parts = [in_plane(80, seed=k) for k in (1, 2)]
    angles = [
        np.concatenate([np.broadcast_to(getattr(s.directions, name), (80,)) for s in parts])
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    ]
    return BRDFSamples(
        Directions(*angles),
        np.concatenate([s.value for s in parts]),
        np.concatenate([s.u_independent for s in parts]),
        wavelength_nm=np.repeat([450.0, 650.0], 80),
    )


def test_constraints_hold_in_all_parts():
    samples = spectrum()
    found = fit(
        samples, model="ward", share="alpha_x", tied={"alpha_y": "alpha_x"}, fixed={"rho_d": 0.2}
    )
    one = fit(samples, model="ward_isotropic", share="alpha", fixed={"rho_d": 0.2})
    assert list(found.parameters) == [
        "rho_d", "alpha_x", "alpha_y", "rho_s[450 nm]", "rho_s[650 nm]"
    ]  # fmt: skip
    assert found.parameters["rho_d"].fixed
    assert found.parameters["alpha_y"].tied_to == "alpha_x"
    assert found.parameters["alpha_x"].value == pytest.approx(
        one.parameters["alpha"].value, rel=1e-9
    )
    assert found.parts[1].parameters["rho_s"] == "rho_s[650 nm]"
    part = found.part("650 nm")
    assert list(part.parameters) == list(WARD)
    own = fit(samples, model="ward", share=(), tied={"alpha_y": "alpha_x"})
    assert own.parameters["alpha_y[650 nm]"].tied_to == "alpha_x[650 nm]"


def test_a_comparison_fixes_what_models_have():
    found = compare(
        in_plane(), ["ward", "ward_isotropic"], fixed={"rho_d": 0.2}, tied={"alpha_y": "alpha_x"}
    )
    first, second = found.entry("ward"), found.entry("ward_isotropic")
    assert first.n_parameters == second.n_parameters == 2
    assert first.chi2 == pytest.approx(second.chi2, rel=1e-9)
    assert first.values["rho_d"] == 0.2
    assert first.values["alpha_y"] == first.values["alpha_x"]
    assert found.to_dict()["fixed"] == {"rho_d": 0.2}


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("model", "words", "text"),
    [
        ("ward", {"fixed": {"alpha": 0.1}},
         "unknown fixed parameter 'alpha' of ward: did you mean 'alpha_y'?"),
        ("ward", {"tied": {"alpha_y": "alpha"}}, "unknown tied parameter 'alpha' of ward"),
        ("ward", {"fixed": {"alpha_y": 99}},
         "alpha_y = 99 is out of range; allowed is 0.005 to 2."),
        ("oren_nayar", {"tied": {"sigma": "rho"}}, "sigma cannot be tied to rho: one is deg, the "
         "other is a number; tie parameters of one unit."),
        ("ward", {"tied": {"alpha_y": "alpha_x", "alpha_x": "alpha_y"}},
         "the ties alpha_y -> alpha_x -> alpha_y form a circle: none of them would be an unknown; "
         "leave one of the ties out."),
        ("ward", {"fixed": {"alpha_y": 0.1}, "tied": {"alpha_y": "alpha_x"}},
         "alpha_y is fixed and tied at once; leave one of the two out."),
        ("lambert", {"fixed": {"rho": 0.1}}, "all parameters of lambert are fixed or tied to fixed "
         "ones: nothing is left to fit; leave one of them free."),
        ("ward", {"fixed": {"alpha_y": 0.1}, "start": {"alpha_y": 0.2}},
         "alpha_y is fixed and has no starting value; leave one of the two out."),
        ("ward", {"tied": {"alpha_y": "alpha_x"}, "start": {"alpha_y": 0.2}},
         "alpha_y is tied to alpha_x and has no starting value of its own; give that of alpha_x."),
        ("ward", {"fixed": {"alpha_y": 0.1}, "posterior": True, "priors": {"alpha_y": "flat"}},
         "alpha_y is fixed and has no prior; leave one of the two out."),
        ("lambert+phong", {"fixed": {"rho": 0.6, "rho_d": 0.6}},
         "rho + rho_d is fixed to 1.2, and rho + rho_d + rho_s is at most 1; fix smaller values."),
    ],
)  # fmt: skip
def test_bad_constraints_are_reported_in_a_sentence(model, words, text):
    with pytest.raises(ConfigurationError) as error:
        fit(in_plane(40), model=model, **words)
    assert text in str(error.value)


# ---------------------------------------------------------------------- the command line


@pytest.fixture
def table(tmp_path):
    samples = in_plane(120)
    d = samples.directions
    columns = [np.degrees(np.broadcast_to(a, 120)) for a in
               (d.theta_i, d.phi_i, d.theta_r, d.phi_r)]  # fmt: skip
    path = tmp_path / "plane.csv"
    np.savetxt(
        path, np.column_stack([*columns, samples.value, samples.u_independent]), delimiter=",",
        header="theta_i,phi_i,theta_r,phi_r,brdf,u_brdf", comments="",
    )  # fmt: skip
    return str(path)


def test_the_table_says_what_is_fixed_and_tied(gonio, table, tmp_path):
    out = tmp_path / "fit.json"
    code, text, _ = gonio("fit", table, "--model", "ward", "--fix", "rho_d=0.2", "--tie",
                     "alpha_y=alpha_x", "-o", str(out))  # fmt: skip
    assert code == 0, text
    rows = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert rows["rho_d"].split() == ["rho_d", "0.2000", "fixed"]
    assert rows["alpha_y"].split()[:3] == ["alpha_y", "=", "alpha_x"]
    assert rows["alpha_y"].split()[3:] == rows["alpha_x"].split()[1:]
    entries = json.loads(out.read_text())["parameters"]
    assert entries["rho_d"]["fixed"] is True
    assert entries["rho_d"]["stderr"] is None
    assert entries["alpha_y"]["tied_to"] == "alpha_x"
    assert not {"fixed", "tied_to"} & set(entries["alpha_x"])
    again = FitResult.load(out)
    assert again.parameters["rho_d"].fixed
    assert again.parameters["alpha_y"].tied_to == "alpha_x"


def test_fixed_angles_are_degrees_on_the_command_line(gonio, table):
    code, text, _ = gonio("fit", table, "--model", "oren_nayar", "--fix", "sigma=20", "--json")
    assert code in (0, 1)
    entry = json.loads(text)["parameters"]["sigma"]
    assert entry["value"] == pytest.approx(20)
    assert entry["unit"] == "deg"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--fix", "alpha_y"), "--fix 'alpha_y' is not NAME=VALUE; write for example"),
        (("--fix", "alpha_y=9"), "alpha_y = 9 is out of range; allowed is 0.005 to 2."),
        (("--tie", "alpha_y"), "--tie 'alpha_y' is not NAME=NAME; write for example "
         "--tie alpha_y=alpha_x."),
        (("--tie", "alpha_y=alpha_x", "--tie", "alpha_y=rho_d"),
         "--tie alpha_y is given twice; give it once."),
        (("--fix", "alpha_y=0.1", "--tie", "alpha_y=alpha_x"),
         "alpha_y is fixed and tied at once; leave one of the two out."),
    ],
)  # fmt: skip
def test_bad_words_on_the_command_line(gonio, table, words, text):
    code, _, out = gonio("fit", table, "--model", "ward", *words)
    assert code == 2
    assert text in " ".join(out.split())


def test_compare_on_the_command_line(gonio, table):
    code, text, _ = gonio("compare", table, "--models", "ward,ward_isotropic", "--fix", "rho_d=0.2",
                     "--tie", "alpha_y=alpha_x")  # fmt: skip
    assert code == 0, text
    assert "fixed: rho_d = 0.2; tied: alpha_y = alpha_x" in text
