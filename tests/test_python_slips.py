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
