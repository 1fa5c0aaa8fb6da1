"""Results, samples and sessions that gonio 0.1 wrote still read, angles in radians in Python."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import gonio
from gonio import models
from gonio.fitting.result import FitResult
from gonio.samples import BRDFSamples
from gonio.session import Session, read_truth

FILES = Path(__file__).parent / "data_0_1"


def with_keys_of_today(written):
    """The document as 0.2 writes it: one key has another name; what is new says unknown."""
    identifiability = written["diagnostics"]["identifiability"]
    identifiability["suggested_measurement"] = identifiability.pop("mending")
    for entry in written["parameters"].values():
        entry |= {"dof": None, "established": None}
    if written["posterior"] is not None:
        written["posterior"]["allowance"] = ""
    if written.get("sharing") is not None:
        written["sharing"] |= {"distance": None, "distance_dof": None, "change": None}
    return written | {"model_source": None, "polish": "gauss_newton", "verdict": None}


def u_of(result, name):
    return result.parameters[name].stderr


def test_a_fit_of_0_1_comes_back_in_radians():
    result = FitResult.load(FILES / "fit.json")
    written = json.loads((FILES / "fit.json").read_text(encoding="utf-8"))
    assert result.ok
    sigma, entry = result.parameters["sigma"], written["parameters"]["sigma"]
    assert (entry["unit"], sigma.unit) == ("deg", "rad")
    assert sigma.value == pytest.approx(np.radians(entry["value"]), rel=3e-16)
    assert sigma.stderr == pytest.approx(np.radians(entry["stderr"]), rel=3e-16)
    assert sigma.interval_95 == pytest.approx(np.radians(entry["interval_95"]), rel=3e-16)
    u = [estimate.stderr for estimate in result.parameters.values()]
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), u, rtol=1e-12)
    assert result.to_dict() == with_keys_of_today(written)


def test_a_joint_fit_of_0_1_comes_back():
    result = FitResult.load(FILES / "joint.json")
    written = json.loads((FILES / "joint.json").read_text(encoding="utf-8"))
    alone = written["parts"][0]["alone"]["sigma"]
    assert result.parts[0].alone["sigma"] == pytest.approx(np.radians(alone), rel=3e-16)
    assert set(result.part("red").values()) == {"rho", "sigma"}
    assert result.to_dict() == with_keys_of_today(written)


def test_samples_of_0_1_are_fitted_to_what_0_1_found():
    samples = BRDFSamples.load(FILES / "samples.nc")
    assert [term.name for term in samples.shared] == ["standard"]
    again = gonio.fit(samples, model="oren_nayar")
    result = FitResult.load(FILES / "fit.json")
    for name, value in again.values().items():  # to where chi2 was flat by its tolerance
        assert value == pytest.approx(result.values()[name], abs=1e-5 * u_of(result, name))
    f = models.get("oren_nayar")(samples.directions, **result.values())
    assert np.std((samples.value - f) / samples.u_independent) == pytest.approx(1, abs=0.25)


def test_a_session_of_0_1_opens_and_is_reduced():
    path = FILES / "session.gonio"
    session = Session.open(path)
    session.require_complete()
    assert read_truth(path)["parameters"]["sigma"] == pytest.approx(np.radians(25))
    samples = gonio.reduce(session)
    result = gonio.fit(samples, model="oren_nayar", start={"rho": 0.8, "sigma": np.radians(25)})
    assert result.values()["sigma"] == pytest.approx(np.radians(25), abs=np.radians(3))
