"""A session of several colour filters becomes samples of several channels."""

import numpy as np
import pytest
from virtual import small

import gonio
from gonio.instrument.filter import Filter
from gonio.metadata import Plan

RHO = (0.2, 0.6)
PLAN = Plan(theta_i_deg=(10.0, 50.0), rotations_deg=(0.0,), exposures_s=(1e-3, 8e-3, 64e-3))


@pytest.fixture(scope="module")
def reduced(tmp_path_factory):
    rig = small(lamp={"drift": 0.01}).model_copy(
        update={
            "channels": (
                Filter(name="red", wavelength_nm=620.0),
                Filter(name="blue", wavelength_nm=450.0, relative_rate=0.5),
            )
        }
    )
    session = gonio.simulate(
        model="lambert",
        parameters={"rho": RHO},
        output=tmp_path_factory.mktemp("channels") / "session",
        instrument=rig,
        plan=PLAN,
        seed=3,
    )
    return gonio.reduce(session)


def test_every_channel_is_there_with_its_wavelength(reduced):
    assert set(reduced.channel) == {"red", "blue"}
    for name, wavelength, rho in zip(("red", "blue"), (620.0, 450.0), RHO, strict=True):
        own = reduced.channel == name
        assert set(reduced.wavelength_nm[own]) == {wavelength}
        # A lamp that drifts by 1 % an image, two images against two standards.
        assert np.mean(reduced.value[own]) * np.pi == pytest.approx(rho, rel=0.04)


def test_the_lamp_drifts_in_every_channel_by_itself_and_the_dome_is_one(reduced):
    lamp = next(t for t in reduced.shared if t.name == "lamp, sample")
    assert len(np.unique(lamp.group)) == 2 * len(PLAN.theta_i_deg)
    red, blue = (set(lamp.group[reduced.channel == name]) for name in ("red", "blue"))
    assert not red & blue
    for term in reduced.shared:
        if term.name.startswith("dome"):
            red, blue = (set(term.group[reduced.channel == name]) for name in ("red", "blue"))
            assert red == blue


def test_a_session_of_one_unnamed_channel_names_none(tmp_path):
    session = gonio.simulate(
        model="lambert", output=tmp_path / "one", instrument=small(), plan=PLAN, seed=3
    )
    samples = gonio.reduce(session)
    assert samples.channel is None
    assert samples.wavelength_nm is None


def test_each_channel_can_be_fitted(reduced):
    for name, rho in zip(("red", "blue"), RHO, strict=True):
        own = reduced.select(reduced.channel == name, name)
        estimate = gonio.fit(own, model="lambert").parameters["rho"]
        assert estimate.value == pytest.approx(rho, abs=4 * estimate.stderr)
