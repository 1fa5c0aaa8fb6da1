"""The verdict: its classes, exit codes and words; noise laws, stated errors and scores."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hemisphere import GRID, INCIDENCE, ISOTROPIC, grid, noisy
from scipy import stats

import gonio
from gonio import models
from gonio.errors import ConfigurationError
from gonio.fitting.fit import fit
from gonio.fitting.problem.noise_law import noise_law
from gonio.fitting.result import FitResult, Verdict
from gonio.fitting.result.noncentrality import noncentrality
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm
from gonio.samples.stated_errors import with_shared_errors

CASES = Path(__file__).parents[2] / "shared" / "cases"


@pytest.fixture
def run(request):
    """Run the command line in this process."""

    def command(*words):
        code, out, err = request.getfixturevalue("gonio")(*words)
        return SimpleNamespace(exit_code=code, stdout=out, output=out, stderr=err)

    return command


def glossy(rng, **kept):
    return noisy(rng, "ward_isotropic", ISOTROPIC, **kept)


def verdict(samples, model="ward_isotropic", **options):
    return fit(samples, model, **options).verdict


# ---------------------------------------------------------------- classes


def test_a_true_model_fits_and_the_error_that_is_excluded_is_said():
    found = verdict(glossy(np.random.default_rng(1)))
    assert found.kind == "fits"
    assert found.fits
    assert found.interval[1] < 0.01
    assert found.line.startswith("verdict: fits: no error of the model beyond 0.")


@pytest.mark.parametrize("wrong", ["ward_duer", "phong", "lambert"])
def test_a_wrong_model_does_not_fit_and_by_how_much_is_said(wrong):
    samples = glossy(np.random.default_rng(1))
    result = fit(samples, wrong)
    found = result.verdict
    assert found.kind == "does_not_fit"
    f = samples.value - result.residuals
    true = models.get("ward_isotropic")(samples.directions, **ISOTROPIC)
    error = np.sqrt(np.mean((true / f - 1) ** 2))
    # Weighted as the noise weights, which here is equal in parts of f.
    assert found.typical_misfit == pytest.approx(error, rel=0.3)
    assert found.interval[0] < found.typical_misfit < found.interval[1]
    assert "typically off by" in found.reason
    assert found.where is not None
    assert found.where in found.reason
    if abs(found.most) > found.typical_misfit:
        side = "low" if found.most > 0 else "high"
        assert f"most (too {side} by" in found.reason
    else:  # its sign changes within the groups
        assert f"seen most clearly {found.where}" in found.reason


def test_true_models_are_rejected_at_most_at_the_stated_level():
    """Noise of 3 %: an error of 1 % of f is within it, so that the tolerance helps nobody."""
    classes = [
        verdict(noisy(np.random.default_rng(k), sd=0.05), "lambert").kind for k in range(100)
    ]
    assert classes.count("does_not_fit") + classes.count("undecided") <= stats.binom.isf(
        0.001, 100, 0.01
    )


def test_a_small_error_fits_within_the_tolerance_however_clear_it_is():
    shape = 0.004 * np.cos(4 * GRID.theta_r)
    found = verdict(noisy(np.random.default_rng(1), sd=0.001, error=shape), "lambert")
    assert found.kind == "fits"
    assert found.p < 1e-6
    assert found.typical_misfit == pytest.approx(np.sqrt(np.mean(shape**2)), rel=0.2)
    assert "within the tolerance of 1 %" in found.reason


def test_shared_errors_as_stated_make_a_class_of_their_own():
    factors = np.array([0.04, -0.03, 0.02, -0.05])[INCIDENCE]
    samples = noisy(np.random.default_rng(1), error=factors)
    assert verdict(samples, "lambert").kind == "does_not_fit"
    lamp = gonio.samples.SharedTerm("lamp", "", 0.04, group=INCIDENCE)
    stated = BRDFSamples(samples.directions, samples.value, samples.u_independent, shared=(lamp,))
    found = verdict(stated, "lambert")
    assert found.kind == "fits_within_shared"
    assert found.line.startswith("verdict: fits within the stated shared errors: ")


def test_unknown_noise_without_structure_is_undecided_and_with_structure_does_not_fit():
    samples = glossy(np.random.default_rng(1), sd=0.03, stated=False)
    found = verdict(samples)
    assert found.kind == "undecided"
    assert "the noise is not stated" in found.reason
    assert verdict(samples, "phong").kind == "does_not_fit"


def test_residuals_smaller_than_the_tolerance_fit_whatever_they_are():
    found = verdict(glossy(np.random.default_rng(1), sd=0.003, stated=False))
    assert found.kind == "fits"
    assert "all residuals together are" in found.reason


def test_a_handful_of_readings_is_undecided():
    where = Directions(np.full(7, 0.8), 0.0, np.linspace(0, 1.1, 7), np.pi)
    for stated in (True, False):
        samples = glossy(np.random.default_rng(1), stated=stated, where=where)
        found = verdict(samples)
        assert found.kind == "undecided"
        assert "degrees of freedom" in found.reason


def test_noise_that_is_stated_too_small_is_not_blamed_on_the_model():
    samples = noisy(np.random.default_rng(1), sd=0.04)
    samples = BRDFSamples(samples.directions, samples.value, samples.u_independent / 2)
    found = verdict(samples, "lambert")
    assert found.kind == "undecided"
    assert "times the stated noise but have no structure" in found.reason


def test_the_interval_of_the_excess_holds_its_share():
    rng = np.random.default_rng(1)
    draws = stats.ncx2.rvs(60, 40, size=2000, random_state=rng)
    held = np.mean([low <= 40 <= high for low, high in (noncentrality(x, 60) for x in draws)])
    assert 0.93 < held < 0.97


# ---------------------------------------------------------------- of use or not


def test_a_constant_for_a_glossy_surface_is_no_use():
    result = fit(glossy(np.random.default_rng(1)), "lambert")
    assert result.converged
    assert result.verdict.explained == pytest.approx(0, abs=0.01)
    assert not result.ok
    assert "explains" in result.verdict.reason


def test_a_model_that_is_off_by_a_little_is_of_use():
    result = fit(glossy(np.random.default_rng(1)), "ward_duer")
    assert result.verdict.explained > 0.5
    assert result.ok


def test_a_constant_fits_a_constant_surface():
    assert fit(noisy(np.random.default_rng(1)), "lambert").ok


def saved(samples, path):
    samples.save(path)
    return str(path)


def test_exit_codes_follow_the_verdict(tmp_path, run):
    path = saved(glossy(np.random.default_rng(1)), tmp_path / "a.csv")
    assert run("fit", path, "--model", "ward_isotropic", "--strict").exit_code == 0
    assert run("fit", path, "--model", "ward_duer").exit_code == 0
    assert run("fit", path, "--model", "ward_duer", "--strict").exit_code == 1
    assert run("fit", path, "--model", "lambert").exit_code == 1


def test_the_verdict_stands_at_the_top_in_the_document_and_in_short(tmp_path, run):
    samples = glossy(np.random.default_rng(1))
    path = saved(samples, tmp_path / "a.csv")
    shown = run("fit", path, "--model", "ward_duer").output.splitlines()
    assert shown[1].startswith("verdict: does not fit: typically off by ")
    document = json.loads(run("fit", path, "--model", "ward_duer", "--json").stdout)
    assert document["verdict"]["class"] == "does_not_fit"
    assert document["verdict"]["typical_misfit"] > 0.05
    result = fit(samples, "ward_duer")
    assert "does not fit" in repr(result)
    result.save(tmp_path / "fit.json")
    assert FitResult.load(tmp_path / "fit.json").verdict == result.verdict
    assert isinstance(result.verdict, Verdict)


def test_compare_says_which_fit_and_that_none_does():
    samples = glossy(np.random.default_rng(1))
    found = gonio.compare(samples, ["ward_isotropic", "phong"])
    assert found.entry("ward_isotropic").verdict.kind == "fits"
    assert found.conclusion.startswith("Of these models ward_isotropic fits. ")
    assert gonio.compare(samples, ["ward_duer", "phong"]).conclusion.startswith(
        "None of these models fits. "
    )


def test_a_joint_fit_has_one_verdict_over_its_parts():
    rng = np.random.default_rng(1)
    parts = {"a": glossy(rng), "b": glossy(rng, sd=0.02)}
    assert verdict(parts, share=["alpha"]).kind == "fits"
    assert verdict(parts, "phong", share=["n"]).kind == "does_not_fit"


@pytest.mark.parametrize("loss", ["log", "cube_root", "student_t"])
def test_every_loss_has_a_verdict(loss):
    samples = glossy(np.random.default_rng(1))
    assert verdict(samples, "phong", loss=loss).kind == "does_not_fit"
    assert verdict(samples, "ward_isotropic", loss=loss).kind in ("fits", "undecided")


def test_sign_and_per_cent_of_a_place_agree():
    result = fit(glossy(np.random.default_rng(1)), "phong")
    for groups in result.diagnostics["residuals"]["maps"].values():
        for group in groups:
            if group["relative"] is not None:
                assert group["z"] * group["relative"] >= 0


# ---------------------------------------------------------------- noise that follows the reading


def relative(rng, r, *, digits=17, of="reading", where=GRID):
    f = models.get("ward_isotropic")(where, **ISOTROPIC)
    value = f * (1 + r * rng.standard_normal(len(f)))
    u = r * np.abs(value if of == "reading" else f)
    return BRDFSamples(where, value, np.array([float(f"{x:.{digits - 1}e}") for x in u]))


@pytest.mark.parametrize(("r", "digits"), [(0.02, 17), (0.05, 2), (0.1, 2), (0.1, 3)])
def test_noise_of_the_reading_is_found_and_its_weights_are_not_biased(r, digits):
    values = []
    for k in range(20):
        result = fit(relative(np.random.default_rng(k), r, digits=digits), "ward_isotropic")
        law = result.diagnostics["noise_laws"][0]
        assert law is not None
        assert law["square"] == pytest.approx(r**2, rel=0.1)
        assert any("u_brdf was computed from the readings" in w for w in result.warnings)
        values.append([e.value / ISOTROPIC[n] - 1 for n, e in result.parameters.items()])
    mean, error = np.mean(values, axis=0), np.std(values, axis=0, ddof=1) / np.sqrt(20)
    assert np.all(np.abs(mean) < 4 * error + 0.002)


def test_noise_of_the_surface_keeps_the_weights_that_are_stated():
    for of, r in (("surface", 0.1), ("surface", 0.02)):
        result = fit(relative(np.random.default_rng(1), r, of=of), "ward_isotropic")
        assert result.diagnostics["noise_laws"] == [None]


def test_one_digit_is_enough_where_the_noise_is_larger_than_its_rounding():
    rng = np.random.default_rng(1)
    f = np.exp(rng.uniform(-4, 0, 500))
    for r in (0.1, 0.2):
        y = f * (1 + r * rng.standard_normal(500))
        u = np.array([float(f"{x:.0e}") for x in r * np.abs(y)])
        assert noise_law(y, u, f).square == pytest.approx(r**2, rel=0.15)
        u = np.array([float(f"{x:.0e}") for x in r * f])
        assert noise_law(y, u, f) is None


def test_a_law_with_a_floor_and_that_of_counts_are_found():
    rng = np.random.default_rng(1)
    f = np.exp(rng.uniform(-4, 0, 300))
    y = f * (1 + 0.1 * rng.standard_normal(300))
    floor = noise_law(y, np.hypot(0.1 * y, 0.01), f)
    assert floor.constant == pytest.approx(1e-4, rel=0.01)
    assert floor.square == pytest.approx(0.01, rel=0.01)
    counts = noise_law(y, 0.1 * np.sqrt(np.abs(y)), f)
    assert counts.linear == pytest.approx(0.01, rel=0.01)


def test_each_part_of_a_joint_fit_has_its_own_law():
    rng = np.random.default_rng(1)
    parts = {"a": relative(rng, 0.05), "b": relative(rng, 0.05, of="surface")}
    result = fit(parts, "ward_isotropic", share=["alpha"])
    first, second = result.diagnostics["noise_laws"]
    assert first is not None
    assert second is None


def test_residuals_of_a_true_model_have_no_structure_by_noise_of_the_reading():
    kinds = [
        fit(relative(np.random.default_rng(k), 0.1), "ward_isotropic").verdict.kind
        for k in range(20)
    ]
    assert kinds.count("fits") >= 18


# ---------------------------------------------------------------- shared errors that owners state


def test_a_stated_scale_widens_amplitudes_and_moves_nothing():
    samples = glossy(np.random.default_rng(1))
    plain, wide = fit(samples, "ward_isotropic"), fit(samples, "ward_isotropic", u_scale=0.05)
    assert wide.values() == plain.values()
    for name in ("rho_d", "rho_s"):
        estimate = wide.parameters[name]
        assert estimate.components["scale"] == pytest.approx(0.05 * estimate.value, rel=0.01)
    assert wide.parameters["alpha"].components["scale"] < 1e-3


def test_a_zero_error_of_the_incidence_fits_within_stated_angles(tmp_path, run):
    """Incidences that are off by 0.5 deg: within 0.5 deg that are stated, not within 0.05."""
    true = np.radians(0.5)
    where = grid((15, 30, 45, 60), 40, (0, 60, 120, 180))
    moved = Directions(where.theta_i + true, where.phi_i, where.theta_r, where.phi_r)
    f = models.get("ward_isotropic")(moved, rho_d=0.2, rho_s=0.1, alpha=0.12)
    rng = np.random.default_rng(1)
    samples = BRDFSamples(where, f * (1 + 0.01 * rng.standard_normal(len(f))), 0.01 * f)
    assert verdict(samples).kind == "does_not_fit"
    assert verdict(samples, u_angle=true).kind == "fits_within_shared"
    assert verdict(samples, u_angle=true / 20).kind == "does_not_fit"
    path = saved(samples, tmp_path / "a.csv")
    options = ("--model", "ward_isotropic", "--strict")
    assert run("fit", path, *options).exit_code == 1
    assert run("fit", path, *options, "--u-angle", "0.5", "--u-scale", "1%").exit_code == 0


def test_stated_errors_that_cannot_be_are_refused(run, tmp_path):
    samples = noisy(np.random.default_rng(1))
    with pytest.raises(ConfigurationError, match=r"u_angle is 0\.5; it is radians"):
        with_shared_errors(samples, u_angle=0.5)
    with pytest.raises(ConfigurationError, match="u_scale is -1; it is a fraction"):
        with_shared_errors(samples, u_scale=-1)
    path = saved(samples, tmp_path / "a.csv")
    failed = run("fit", path, "--model", "lambert", "--u-scale", "much")
    assert failed.exit_code == 2
    assert "give a fraction or a percentage" in failed.stderr


# ---------------------------------------------------------------- scores by other files


def test_a_fit_predicts_other_samples_of_its_surface():
    rng = np.random.default_rng(1)
    found = fit(glossy(rng), "ward_isotropic").score(glossy(rng))
    assert found.kind == "fits"
    assert found.chi2 / found.dof == pytest.approx(1, abs=0.3)
    assert abs(found.bias) < 0.01


def test_a_fit_of_another_surface_is_off_by_what_it_is_off():
    rng = np.random.default_rng(1)
    result = fit(noisy(rng), "lambert")
    found = result.score(noisy(rng, truth={"rho": 0.55}))
    assert found.kind == "does_not_fit"
    assert found.typical_error == pytest.approx(0.1, abs=0.01)
    assert found.interval[0] < found.typical_error < found.interval[1] < 0.11
    assert found.bias == pytest.approx(0.1, abs=0.01)
    scaled = with_shared_errors(noisy(rng, truth={"rho": 0.55}), u_scale=0.1)
    assert result.score(scaled).kind == "fits_within_shared"


def test_chi2_of_a_prediction_counts_the_uncertainty_of_the_fit():
    """A fit to few samples predicts many: by their noise alone its error would be a misfit."""
    few = grid((30,), 12, (0,))
    kinds, p = [], []
    for k in range(30):
        rng = np.random.default_rng(k)
        result = fit(noisy(rng, sd=0.05, where=few), "lambert")
        found = result.score(noisy(rng, sd=0.01))
        p.append(found.p)
        kinds.append(found.kind)
    assert stats.kstest(p, "uniform").pvalue > 0.001


def test_a_score_counts_the_blur_of_a_stated_source_cone():
    """Readings through a cone, averaged over drawn directions, are within a cone that is stated."""
    rng = np.random.default_rng(1)
    where = grid((15, 30, 45, 60), 40, (0, 60, 120, 180))
    surface = {"rho_d": 0.2, "rho_s": 0.1, "alpha": 0.12}
    model = models.get("ward_isotropic")

    def read(f):
        return BRDFSamples(where, f * (1 + 0.01 * rng.standard_normal(len(f))), 0.01 * f)

    result = fit(read(model(where, **surface)), "ward_isotropic")
    w_i, w_r = (
        np.ascontiguousarray(np.broadcast_to(w, (len(where.theta_r), 3))) for w in where.vectors()
    )
    blurred = np.zeros(len(w_r))
    for _ in range(400):
        step = rng.normal(0, 0.04, w_r.shape)
        end = w_r + step - np.sum(step * w_r, axis=1, keepdims=True) * w_r
        end /= np.linalg.norm(end, axis=1, keepdims=True)
        blurred += model.evaluate(w_i, end, model.vector(surface)) / 400
    other = read(blurred)
    assert result.score(other).kind == "does_not_fit"
    cone = SharedTerm("source cone", 0.0, blur=0.04)
    assert result.score(replace(other, shared=(cone,))).kind == "fits_within_shared"


def test_samples_without_noise_are_scored_by_the_residuals_of_the_fit():
    rng = np.random.default_rng(1)
    result = fit(glossy(rng), "ward_isotropic")
    assert result.score(glossy(rng, sd=0.03, stated=False)).kind in ("undecided", "does_not_fit")
    assert result.score(glossy(rng, sd=0.003, stated=False)).kind == "fits"


def test_the_command_scores_a_fit_by_a_file(tmp_path, run):
    rng = np.random.default_rng(1)
    first, other = (saved(glossy(rng), tmp_path / name) for name in ("a.csv", "b.csv"))
    out = str(tmp_path / "fit.json")
    assert run("fit", first, "--model", "ward_isotropic", "-o", out).exit_code == 0
    shown = run("fit", out, "--score", other)
    assert shown.exit_code == 0
    assert shown.output.startswith("prediction: fits: no error of the prediction beyond ")
    document = json.loads(run("fit", out, "--score", other, "--json").stdout)
    assert document["schema"] == "gonio.score/1"
    assert document["class"] == "fits"
    both = json.loads(run("fit", first, "--model", "phong", "--score", other, "--json").stdout)
    assert both["diagnostics"]["score"]["class"] == "does_not_fit"
    refused = run("fit", first)
    assert refused.exit_code == 2
    assert "a fit needs --model MODEL" in refused.stderr


# ---------------------------------------------------------------- small inputs of others


@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
def test_noise_in_per_cent_of_the_reading_is_no_misfit():
    result = fit(gonio.formats.read(CASES / "noise_percent_of_reading.csv"), "ward_isotropic")
    assert result.verdict.kind == "fits"
    assert not any("model, not the noise" in w for w in result.warnings)


@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
@pytest.mark.parametrize("loss", ["chi2", "log", "student_t"])
def test_a_steep_metal_is_not_said_to_fit(loss):
    samples = gonio.formats.read(CASES / "steep_metal_six_decades.csv")
    assert verdict(samples, loss=loss).kind in ("does_not_fit", "undecided")
