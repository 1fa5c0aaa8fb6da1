"""Radians in Python, degrees in files: what a fit returns goes back where it came from."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import gonio
from gonio import models, plotting
from gonio.errors import ConfigurationError
from gonio.fitting.result import FitResult
from gonio.geometry import Directions
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.samples import BRDFSamples
from gonio.session import read_truth

ANGULAR = [name for name in models.names() if any(q.unit for q in models.get(name).parameters)]
DATA = Directions(
    *np.radians(
        [
            np.repeat([10.0, 30.0, 50.0, 65.0], 12),
            np.zeros(48),
            np.tile(np.linspace(5, 75, 12), 4),
            np.tile(np.linspace(0, 330, 12), 4),
        ]
    )
)


def truth(name: str) -> dict[str, float]:
    """Values inside the bounds that are nobody's starting values."""
    return {
        q.name: 0.37 if q.unit else min(1.07 * q.default, 0.5 * (q.default + q.upper))
        for q in models.get(name).parameters
    }


@pytest.fixture(scope="module", params=ANGULAR)
def exact(request):
    """A model's name, its exact data, and the fit to them."""
    model = models.get(request.param)
    value = model(DATA, **truth(request.param))
    samples = BRDFSamples(DATA, value, np.full(len(value), 1e-6))
    return request.param, samples, gonio.fit(samples, model=model, start=truth(request.param))


def test_models_with_angles_are_found():
    assert set(ANGULAR) >= {"oren_nayar", "torrance_sparrow", "oren_nayar_torrance_sparrow"}


def test_values_go_back_into_the_model(exact):
    name, samples, result = exact
    again = models.get(name)(DATA, **result.values())
    np.testing.assert_allclose(again, samples.value, rtol=1e-5, atol=1e-9)
    for q in models.get(name).parameters:
        assert result.parameters[q.name].unit == q.unit


def test_values_go_back_as_a_start_and_a_simulation(exact, tmp_path):
    name, samples, result = exact
    again = gonio.fit(samples, model=name, start=result.values())
    assert again.values() == pytest.approx(result.values(), rel=1e-4, abs=1e-6)
    rig = preset("ideal12")
    coarse = {
        "rows": rig.sensor.rows // 8,
        "columns": rig.sensor.columns // 8,
        "pitch_um": tuple(8 * p for p in rig.sensor.pitch_um),
    }
    rig = rig.model_copy(update={"sensor": rig.sensor.model_copy(update=coarse)})
    gonio.simulate(
        model=name, output=tmp_path / "session", parameters=result.values(), instrument=rig,
        plan=Plan(theta_i_deg=(30.0,), rotations_deg=(0.0,), exposures_s=(0.01,)),
    )  # fmt: skip
    assert read_truth(tmp_path / "session")["parameters"] == result.values()


def test_values_go_back_into_a_plot(exact):
    name, _, result = exact
    assert plotting.model_lobe(name, result.values())


def test_the_document_keeps_degrees_and_comes_back(exact, tmp_path):
    name, _, result = exact
    path = tmp_path / "fit.json"
    result.save(path)
    data = json.loads(path.read_text(encoding="utf-8"))
    for q in models.get(name).parameters:
        entry = data["parameters"][q.name]
        assert entry["unit"] == q.file_unit
        assert entry["value"] == q.to_file(result.values()[q.name])
    again = FitResult.load(path)
    assert again.values() == pytest.approx(result.values(), rel=3e-16)
    assert again.to_json() == path.read_text(encoding="utf-8")


def test_an_angle_that_looks_like_degrees_is_refused():
    text = (
        "sigma = 20 rad (1145.92 deg) is out of range; allowed is 0 rad (0 deg) to 1.0472 rad "
        "(60 deg). It looks like degrees; angles in Python are radians: write sigma=0.349066 for "
        "20 deg."
    )
    model = models.get("oren_nayar")
    with pytest.raises(ConfigurationError, match=f"^{re.escape(text)}$"):
        model(DATA, sigma=20)
    samples = BRDFSamples(DATA, model(DATA))
    with pytest.raises(ConfigurationError, match="It looks like degrees"):
        gonio.fit(samples, model="oren_nayar", start={"sigma": 20})
    with pytest.raises(ConfigurationError, match=r"out of range; allowed is .* deg\)\.$"):
        model(DATA, sigma=-1)  # no number of degrees either
    with pytest.raises(ConfigurationError, match=r"rho = 20 is out of range; allowed is 0 to 1\.$"):
        model(DATA, rho=20)


def test_priors_given_in_python_hold_radians():
    from gonio.fitting.posterior.priors import Prior, parse, resolve

    model = models.get("oren_nayar")
    sigma = model.parameter("sigma")
    given = resolve(model.parameters, {"sigma": "normal(0.35, 0.1)"})
    assert given[model.names.index("sigma")] == Prior("normal", 0.35, 0.1)
    assert parse(sigma, "normal(20, 5)") == Prior("normal", np.radians(20), np.radians(5))


def test_a_comparison_holds_radians_and_writes_degrees():
    from gonio.fitting.comparison.compare import compare

    model = models.get("oren_nayar")
    rng = np.random.default_rng(1)
    f = model(DATA, rho=0.8, sigma=0.4)
    samples = BRDFSamples(DATA, f * (1 + 0.01 * rng.standard_normal(len(f))), 0.01 * f)
    found = compare(samples, ["oren_nayar", "lambert"])
    entry = found.entry("oren_nayar")
    assert entry.values["sigma"] == pytest.approx(0.4, rel=0.2)
    assert entry.priors["sigma"] == (model.parameter("sigma").lower, model.parameter("sigma").upper)
    written = next(e for e in found.to_dict()["entries"] if e["model"] == "oren_nayar")
    assert written["values"]["sigma"] == np.degrees(entry.values["sigma"])
    assert "units" not in written
