"""What a person sees of a fit's result: text, HTML, tables, predictions, residuals, draws."""

from __future__ import annotations

import re
import sys
import warnings

import numpy as np
import pytest
import xarray as xr
from arviz_versions import group_names

import gonio
from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.posterior import inference_data
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.samples import BRDFSamples, SharedTerm

U_STANDARD = 0.02
SURFACE = {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.15}
N = 400


def measured(name="ward_isotropic", values=SURFACE, *, shared=True, seed=1, **columns):
    """Samples with 1 % noise and a standard that may be wrong by 2 %."""
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, 65, (2, N)))
    where = Directions(theta[0], np.zeros(N), theta[1], rng.uniform(0, 2 * np.pi, N))
    f = models.get(name)(where, **values)
    terms = (SharedTerm("standard", "certified reflectance", U_STANDARD),) if shared else ()
    noise = 1 + 0.01 * rng.standard_normal(N)
    return BRDFSamples(where, f * noise, 0.01 * f, shared=terms, **columns)


@pytest.fixture(scope="module")
def ward():
    return gonio.fit(measured(), "ward_isotropic")


@pytest.fixture(scope="module")
def rough():
    values = {"rho": 0.8, "sigma": 0.4}
    return gonio.fit(measured("oren_nayar", values), "oren_nayar", posterior=True, seed=3)


@pytest.fixture(scope="module")
def joint():
    channel = np.repeat(["red", "blue"], N // 2)
    return gonio.fit(measured(channel=channel), "ward_isotropic", share="alpha")


# ---------------------------------------------------------------- text


def test_repr_is_one_short_line(ward, joint, rough):
    for result in (ward, joint, rough):
        assert len(repr(result)) < 500
        assert "\n" not in repr(result)
    assert re.match(
        r"<FitResult ward_isotropic: rho_d = 0\.\d+ ± 0\.\d+, .*; fits, converged, 400 samples",
        repr(ward),
    )
    assert re.search(r"sigma = 0\.40\d+ ± 0\.0\d+ rad", repr(rough))


def test_print_is_the_command_s_table(rough):
    text = str(rough)
    assert len(text) < 2000
    assert text.startswith("Oren-Nayar, functional approximation (Oren & Nayar 1994")
    assert re.search(r"sigma \[deg\] +22\.\d+ +0\.\d+ +22\.\d+ \.\. 23\.\d+", text)
    assert "posterior: converged" in text
    assert "Correlation" not in text


def test_the_command_prints_the_same(rough, tmp_path, capsys):
    from gonio.cli import main

    path = tmp_path / "samples.nc"
    measured("oren_nayar", {"rho": 0.8, "sigma": 0.4}).save(path)
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["fit", str(path), "--model", "oren_nayar", "--posterior", "--seed", "3"])
    shown = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert [line for line in shown if line] == [line for line in str(rough).splitlines() if line]


def test_the_summary_explains(ward):
    text = ward.summary()
    assert text.startswith(str(ward))
    for heading in ("Correlation of all errors", "What the data say", "Largest mean residuals"):
        assert heading in text


def test_html_escapes_and_shows_degrees(rough):
    html = rough._repr_html_()
    assert "Oren &amp; Nayar" in html
    assert "sigma [deg]" in html
    assert html.count("<tr>") == 3
    assert html.count("<") == html.count(">")
    odd = rough.__class__(**{**vars(rough), "warnings": ("a < b",)})
    assert "a &lt; b" in odd._repr_html_()


def test_a_joint_fit_is_printed_by_part(joint):
    text = str(joint)
    assert re.search(r"alpha +0\.1\d+", text)
    assert "sharing: the data allow it" in text
    assert joint._repr_html_().count("<tr>") == 1 + len(joint.parameters)


def test_a_result_of_an_unknown_model_still_prints(ward):
    from dataclasses import replace

    stranger = replace(ward, model="of_another_package", memory=None)
    assert str(stranger).startswith("of_another_package\nverdict: fits: ")


# ---------------------------------------------------------------- correlation


def test_the_standard_correlates_reflectances_that_noise_leaves_alone(ward):
    names = list(ward.parameters)
    a, b = names.index("rho_d"), names.index("rho_s")
    own = ward.diagnostics["identifiability"]["correlation"][a][b]
    total = ward.correlation_frame().loc["rho_d", "rho_s"]
    assert abs(own) < 0.5
    assert total > 0.7
    # The standard moves both by the same share of their values, whatever the noise does.
    u = {name: e.components["standard"] for name, e in ward.parameters.items()}
    c = ward.covariance_frame()
    independent = own * np.prod([ward.parameters[n].components["independent"] for n in
                                 ("rho_d", "rho_s")])  # fmt: skip
    assert c.loc["rho_d", "rho_s"] == pytest.approx(u["rho_d"] * u["rho_s"] + independent, rel=1e-3)
    assert f"{total:+.3f}" in ward.summary()


def test_without_a_covariance_the_frames_say_why():
    samples = measured("lambert", {"rho": 0.4}, shared=False)
    result = gonio.fit(samples, "ward_isotropic")
    assert result.covariance is None
    with pytest.raises(DataError, match=r"^this fit has no covariance: a parameter is at a"):
        result.covariance_frame()
    with pytest.raises(DataError, match="has no covariance"):
        result.correlation_frame()
    assert result.predict(samples.directions).u is None


# ---------------------------------------------------------------- numbers


def test_the_frame_holds_every_parameter_in_radians(rough):
    frame = rough.to_dataframe()
    assert list(frame.index) == ["rho", "sigma"]
    assert frame.loc["sigma", "unit"] == "rad"
    assert frame["value"].to_dict() == rough.values()
    assert frame.loc["sigma", "low_95"] == rough.parameters["sigma"].interval_95[0]


def test_a_prediction_is_uncertain_as_the_parameters_are(ward):
    where = Directions([0.2, 0.6, 1.0], 0.0, [0.2, 0.5, 0.1], [np.pi, 3.0, 0.3])
    found = ward.predict(where)
    model = models.get("ward_isotropic")
    np.testing.assert_allclose(found.value, model(where, **ward.values()), rtol=1e-12)
    rng = np.random.default_rng(1)
    p = rng.multivariate_normal(list(ward.values().values()), ward.covariance, size=4000)
    drawn = np.array([model(where, **dict(zip(model.names, row, strict=True))) for row in p])
    np.testing.assert_allclose(found.u, drawn.std(axis=0), rtol=0.05)
    # Nothing can be known better than the standard.
    assert np.all(found.u / found.value > 0.99 * U_STANDARD)


def test_a_joint_fit_predicts_by_part(joint):
    where = Directions(0.2, 0.0, 0.3, 1.0)
    with pytest.raises(ConfigurationError, match=r"as with result\.part\('red'\)\.predict"):
        joint.predict(where)
    red = joint.part("red")
    assert red.predict(where).value > 0
    assert len(red.residuals) == N // 2


def test_residuals_are_measured_less_fitted(ward, tmp_path):
    samples = measured()
    f = models.get("ward_isotropic")(samples.directions, **ward.values())
    np.testing.assert_allclose(ward.residuals, samples.value - f, atol=1e-12)
    assert np.std(ward.residuals / samples.u_independent) == pytest.approx(1, abs=0.1)
    ward.save(tmp_path / "fit.json")
    again = FitResult.load(tmp_path / "fit.json")
    text = (
        "this result does not hold its samples: it was read from a file, which holds the "
        "parameters only; fit again, or take samples.value - "
        "result.predict(samples.directions).value."
    )
    with pytest.raises(DataError, match=f"^{re.escape(text)}$"):
        again.residuals  # noqa: B018
    assert again.predict(samples.directions).value == pytest.approx(f, rel=1e-12)
    with pytest.raises(DataError, match="does not hold its draws"):
        again.inference_data()


# ---------------------------------------------------------------- draws


def test_arviz_takes_the_draws_in_radians(rough):
    data = rough.inference_data()
    sigma = data.posterior["sigma"]
    assert sigma.attrs["units"] == "rad"
    assert float(sigma.mean()) == pytest.approx(rough.values()["sigma"], rel=1e-2)
    assert "log_likelihood" not in group_names(data)


def test_without_arviz_the_draws_are_what_its_later_versions_take(rough, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    data = rough.inference_data()
    assert isinstance(data, xr.DataTree)
    assert "posterior" in data.children
    assert data["posterior/sigma"].attrs["units"] == "rad"


def test_loo_counts_the_parameters(rough):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz

        score = arviz.loo(rough.inference_data(log_likelihood=True))
    # Two parameters are fitted; the moves by the standard, of 2 %, are no misfit.
    assert float(score.p_loo) == pytest.approx(2, abs=0.6)
    assert float(np.max(score.pareto_k)) < 0.7 if hasattr(score, "pareto_k") else True


def test_a_large_log_likelihood_is_thinned_and_says_so(rough, monkeypatch):
    monkeypatch.setattr(inference_data, "MAX_BYTES", 8 * 40 * 4000)
    with pytest.warns(UserWarning, match=r"^the log-likelihood is thinned to \d+ of \d+ draws and"):
        data = rough.inference_data(log_likelihood=True)
    group = data.log_likelihood
    assert group["brdf"].size <= 40 * 4000
    assert group.attrs["samples"].endswith(f"of {N}")
    assert "shared errors held" in group.attrs["of"]
    assert data.posterior.sizes["draw"] == group.sizes["draw"]


def test_what_has_no_likelihood_of_single_samples_says_so(ward):
    with pytest.raises(ConfigurationError, match=r"no posterior .*; fit with posterior=True"):
        ward.inference_data()


# ---------------------------------------------------------------- arguments


def test_an_array_is_no_samples():
    with pytest.raises(
        ConfigurationError,
        match=r"^a fit takes BRDF samples, which are values with their directions, not ndarray; "
        r"make them with BRDFSamples\(Directions\(theta_i, phi_i, theta_r, phi_r\), values, u\), "
        r"angles in radians, with gonio\.reduce\(session\), gonio\.formats\.read\(file\) or "
        r"BRDFSamples\.from_dataframe\(table\)\.$",
    ):
        gonio.fit(np.ones(10), "lambert")
    with pytest.raises(ConfigurationError, match="not list; make them"):
        gonio.fit([0.1, 0.2], "lambert")
