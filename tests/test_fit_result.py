"""The result of a fit: its JSON document, its units, its file."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.errors import ConfigurationError, DataError
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.samples import BRDFSamples


def samples_of(name, n=200, **truth):
    rng = np.random.default_rng(1)
    theta, phi = np.radians(rng.uniform(0, 70, (2, n))), rng.uniform(0, 2 * np.pi, (2, n))
    where = Directions(theta[0], phi[0], theta[1], phi[1])
    f = models.get(name)(where, **truth)
    sd = 0.01 * f.mean()
    return BRDFSamples(
        where, f + sd * rng.standard_normal(n), u_independent=np.full(n, sd), history=("made",)
    )


@pytest.fixture(scope="module")
def rough():
    return gonio.fit(
        samples_of("oren_nayar", rho=0.8, sigma=np.radians(25)), model="oren_nayar", seed=5,
        cuts={"max_theta_r_deg": 70.0},
    )  # fmt: skip


def test_the_document_has_the_keys_of_its_schema(rough):
    data = json.loads(rough.to_json())
    assert data["schema"] == "gonio.fit/1"
    assert set(data) >= {
        "schema", "model", "status", "parameters", "chi2", "dof", "n_samples", "seed",
        "posterior", "warnings",
    }  # fmt: skip
    for entry in data["parameters"].values():
        assert set(entry) == {
            "value", "stderr", "unit", "at_bound", "interval_68", "interval_95", "components",
            "dof", "established",
        }  # fmt: skip
    assert (data["model"], data["status"], data["posterior"]) == ("oren_nayar", "converged", None)
    assert (data["n_samples"], data["dof"], data["seed"]) == (200, 198, 5)
    assert (data["weights"], data["cuts"]) == ("sd", {"max_theta_r_deg": 70.0})
    assert data["diagnostics"]["history"] == ["made"]
    assert set(data["versions"]) == {
        "gonio", "python", "numpy", "scipy", "numba", "nlopt", "emcee",
    }  # fmt: skip
    assert re.fullmatch("[0-9a-f]{64}", data["source"]["data_sha256"])


def test_angles_are_in_radians(rough):
    sigma = rough.parameters["sigma"]
    assert sigma.unit == "rad"
    assert sigma.value == pytest.approx(np.radians(25), abs=5 * sigma.stderr)
    assert rough.values()["sigma"] == sigma.value
    assert sigma.interval_95[0] < sigma.value < sigma.interval_95[1]
    assert sigma.interval_95[1] - sigma.value == pytest.approx(1.96 * sigma.stderr, rel=1e-3)
    assert rough.parameters["rho"].unit == ""
    covariance = np.array(rough.covariance)
    stderr = [e.stderr for e in rough.parameters.values()]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), stderr, rtol=1e-12)


def test_the_document_holds_degrees(rough):
    data = json.loads(rough.to_json())
    shown, sigma = data["parameters"]["sigma"], rough.parameters["sigma"]
    assert shown["unit"] == "deg"
    assert shown["value"] == math.degrees(sigma.value)
    assert shown["stderr"] == math.degrees(sigma.stderr)
    assert shown["interval_95"] == [math.degrees(end) for end in sigma.interval_95]
    assert shown["components"] == {"independent": math.degrees(sigma.components["independent"])}
    u = [entry["stderr"] for entry in data["parameters"].values()]
    np.testing.assert_allclose(np.sqrt(np.diag(data["covariance"])), u, rtol=1e-12)
    assert data["parameters"]["rho"]["value"] == rough.parameters["rho"].value


def test_a_result_survives_its_file(rough, tmp_path):
    path = tmp_path / "fit.json"
    rough.save(path)
    again = FitResult.load(path)
    assert again.ok
    assert again.to_json() == path.read_text(encoding="utf-8")
    assert again.to_dict() == rough.to_dict()
    # Degrees of the file may stand for two neighbouring numbers of radians.
    assert again.values() == pytest.approx(rough.values(), rel=3e-16)
    np.testing.assert_allclose(again.covariance, rough.covariance, rtol=5e-16)


def test_a_posterior_survives_its_file(tmp_path):
    result = gonio.fit(samples_of("lambert", rho=0.4, n=50), model="lambert", posterior=True)
    path = tmp_path / "fit.json"
    result.save(path)
    assert FitResult.load(path) == result
    data = json.loads(path.read_text(encoding="utf-8"))
    assert set(data["posterior"]) >= {"ess", "r_hat", "draws"}
    assert data["posterior"]["draws"] is None
    assert data["diagnostics"]["priors"] == {"rho": [0.0, 1.0]}


def test_the_hash_tells_other_data(rough):
    a = samples_of("lambert", rho=0.4, n=50)
    b = BRDFSamples(a.directions, a.value * (1 + 1e-15), u_independent=a.u_independent)
    hashes = {gonio.fit(s, model="lambert").source["data_sha256"] for s in (a, a, b)}
    assert len(hashes) == 2


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("not json", "JSONDecodeError: Expecting value"),
        ("", "JSONDecodeError"),
        ("[1, 2]", "TypeError"),
        ("{}", "KeyError: 'schema'"),
        ('{"schema": "gonio.fit/2"}', "ValueError: the schema is not gonio.fit/1"),
        ('{"schema": "gonio.fit/1"}', "KeyError: 'parameters'"),
        ('{"schema": "gonio.fit/1", "parameters": {"rho": {}}}', "KeyError: 'interval_68'"),
        ('{"schema": "gonio.fit/1", "parameters": {}, "posterior": null, "warnings": [],'
         ' "surprise": 1}', "TypeError"),
    ],
)  # fmt: skip
def test_files_that_are_no_fit_are_refused(text, reason, tmp_path):
    path = tmp_path / "fit.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=re.escape(f"{path}: not a readable fit ({reason}")) as e:
        FitResult.load(path)
    assert e.value.value == path


def test_a_missing_file_is_named(tmp_path):
    path = tmp_path / "none.json"
    text = f"{path}: no such file; give a fit that 'gonio fit -o' wrote."
    with pytest.raises(DataError, match=re.escape(text)):
        FitResult.load(path)


def test_a_folder_is_no_fit(tmp_path):
    with pytest.raises(DataError, match=r"not a readable fit \(IsADirectoryError"):
        FitResult.load(tmp_path)


def test_bad_arguments_are_refused_by_name():
    samples = samples_of("lambert", rho=0.4, n=50)
    with pytest.raises(ConfigurationError, match="unknown model 'wrad': did you mean 'ward'"):
        gonio.fit(samples, model="wrad")
    with pytest.raises(ConfigurationError, match="unknown parameter 'rh' of lambert"):
        gonio.fit(samples, model="lambert", start={"rh": 0.1})
    with pytest.raises(ConfigurationError, match="rho = 2 is out of range; allowed is 0 to 1"):
        gonio.fit(samples, model="lambert", start={"rho": 2})


@pytest.mark.parametrize("weights", ["none", "cos", "coscos", "sd"])
def test_the_weights_are_in_the_result(weights):
    result = gonio.fit(samples_of("lambert", rho=0.4), model="lambert", weights=weights)
    assert result.weights == weights
    assert result.values()["rho"] == pytest.approx(0.4, rel=0.01)
