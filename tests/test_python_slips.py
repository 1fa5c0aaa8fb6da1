"""Slips that a person makes in Python: each is answered by one sentence that says what to do."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import gonio
from gonio.errors import ConfigurationError, DataError


@pytest.fixture(scope="module")
def samples() -> gonio.BRDFSamples:
    theta = np.linspace(0.0, 1.2, 20)
    value = 0.1 + 0.001 * np.cos(40 * theta)
    return gonio.BRDFSamples(gonio.Directions(0.3, 0.0, theta, 0.0), value, 0.001 + 0 * theta)


@pytest.fixture(scope="module")
def result(samples: gonio.BRDFSamples) -> gonio.FitResult:
    return gonio.fit(samples, "lambert")


def test_a_prediction_takes_directions(result: gonio.FitResult, samples: gonio.BRDFSamples) -> None:
    with pytest.raises(ConfigurationError, match=r"not BRDFSamples; of samples give samples\.dir"):
        result.predict(samples)  # type: ignore[arg-type]
    assert np.all(result.predict(samples.directions).value > 0)


def test_a_plain_function_is_no_model(samples: gonio.BRDFSamples) -> None:
    with pytest.raises(ConfigurationError, match=r"not as function; a function of arrays becomes"):
        gonio.fit(samples, lambda directions, rho: rho)  # type: ignore[arg-type]


def test_starting_values_have_names(samples: gonio.BRDFSamples) -> None:
    with pytest.raises(ConfigurationError, match=r"such as \{'rho': 0.5\}, not list"):
        gonio.fit(samples, "lambert", start=[0.3])  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["fit.csv", "fit.nc", "fit.png"])
def test_a_fit_is_saved_as_json(result: gonio.FitResult, tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigurationError, match=r"a fit is saved as JSON; name a file \.json"):
        result.save(tmp_path / name)
    assert not (tmp_path / name).exists()


def test_a_fit_is_no_file_of_samples(result: gonio.FitResult, tmp_path: Path) -> None:
    result.save(tmp_path / "fit.json")
    with pytest.raises(DataError, match=r"a fit is read by gonio\.FitResult\.load"):
        gonio.load(tmp_path / "fit.json")


def test_a_fresh_fit_is_drawn_with_its_samples(result: gonio.FitResult) -> None:
    figure = gonio.plot(result, "residuals")
    assert figure.axes
    plt.close(figure)


def test_a_check_prints_the_page_of_the_command(samples: gonio.BRDFSamples) -> None:
    page = str(gonio.check("oren_nayar", {"sigma": 0.5}))
    assert page.startswith("oren_nayar: rho = 0.8, sigma = 28.6479 deg\n")
    assert "The model keeps what it claims." in page
    report = gonio.check(samples)
    assert str(report).startswith("20 samples, 0 of them negative.\n")
    assert "Quantity: undecided" in str(report)
    assert report._repr_html_().startswith("<pre>20 samples")


def test_a_budget_prints_the_table_of_the_command(samples: gonio.BRDFSamples) -> None:
    budget = gonio.budget(samples)
    assert str(budget).startswith("BRDF, 20 samples\n")
    assert "expanded, k = 2" in str(budget)
    assert "ndarray" not in str(budget)
    assert "<pre>BRDF, 20 samples" in budget._repr_html_()


@pytest.mark.parametrize(
    ("function", "parameters", "message"),
    [
        (lambda directions, k: k, {"q": (0.5, 0, 1)}, "takes no q and needs k; its arguments"),
        (lambda directions: 0.1, ["q"], "takes no q; its arguments after the directions are none"),
        (lambda directions, k, m: k, ["k"], "needs m; its arguments after the directions are k, m"),
    ],
)
def test_parameters_are_the_arguments_of_the_function(function, parameters, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        gonio.Model.from_function(function, parameters)


def test_a_function_may_take_any_parameter_or_have_defaults_of_its_own() -> None:
    def free(directions, **parameters):
        return parameters["rho"] / np.pi

    def partly(directions, rho, scale=1.0):
        return scale * rho / np.pi

    for function in (free, partly):
        assert gonio.Model.from_function(function, ["rho"]).names == ("rho",)


def test_what_a_function_raises_is_one_sentence() -> None:
    def broken(directions, rho):
        return rho * directions.theta

    message = r"^broken: the function raises AttributeError: .*'theta' \(line \d+ of .*slips\.py\)"
    with pytest.raises(DataError, match=message):
        gonio.Model.from_function(broken, ["rho"])


def test_one_uncertainty_holds_for_all_samples() -> None:
    where = gonio.Directions(0.3, 0.0, np.linspace(0, 1, 5), 0.0)
    assert np.all(gonio.BRDFSamples(where, np.ones(5), 0.1).u_independent == np.full(5, 0.1))
    with pytest.raises(DataError, match=r"^the uncertainty \(.*must be positive, and one is -0"):
        gonio.BRDFSamples(where, np.ones(5), -0.1)
    with pytest.raises(DataError, match=r"^the uncertainty \(u_independent\) has shape \(2,\)"):
        gonio.BRDFSamples(where, np.ones(5), [0.1, 0.2])


def test_a_report_is_written_where_its_name_is_given(
    result: gonio.FitResult, tmp_path: Path
) -> None:
    made = gonio.report(result, tmp_path / "r.html")
    assert (tmp_path / "r.html").read_text(encoding="utf-8") == made.html
    with pytest.raises(ConfigurationError, match=r"r\.pdf: a report is written as HTML"):
        gonio.report(result, tmp_path / "r.pdf")


def test_samples_of_a_fit_in_a_file_are_given_and_checked(
    result: gonio.FitResult, samples: gonio.BRDFSamples, tmp_path: Path
) -> None:
    result.save(tmp_path / "fit.json")
    samples.save(tmp_path / "own.nc")
    with pytest.raises(DataError, match=r"which samples it was made to\. Give them with --samples"):
        gonio.plot(tmp_path / "fit.json", "residuals")
    for given in (samples, tmp_path / "own.nc"):
        figure = gonio.plot(tmp_path / "fit.json", "residuals", samples=given)
        assert figure.axes
        plt.close(figure)
    other = gonio.BRDFSamples(samples.directions, 2 * samples.value, samples.u_independent)
    with pytest.raises(DataError, match=r"^the samples: not the samples that the fit was made to"):
        gonio.plot(tmp_path / "fit.json", "residuals", samples=other)
