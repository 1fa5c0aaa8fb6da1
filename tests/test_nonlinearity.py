"""A nonlinearity that is left in the counts: simulated, corrected, and its bias as predicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from virtual import Drawn, images, small

import gonio
from gonio.calibration.budget import budget
from gonio.calibration.frames.exposure import straightened
from gonio.instrument.noise import expose
from gonio.instrument.records import metadata
from gonio.metadata import Camera, Plan

BEND = 0.005
PLAN = Plan(
    theta_i_deg=(0.0, 20.0, 40.0, 60.0), rotations_deg=(0.0,),
    exposures_s=(0.25e-3, 1e-3, 4e-3, 16e-3, 64e-3, 256e-3), repeats=4,
)  # fmt: skip
# Rolled aluminum, painted cardboard and ivory plastic nearly: a metal, a satin and a plastic.
SURFACES = (
    {"rho_d": 0.1, "rho_s": 0.21, "alpha_x": 0.08, "alpha_y": 0.08},
    {"rho_d": 0.19, "rho_s": 0.043, "alpha_x": 0.08, "alpha_y": 0.08},
    {"rho_d": 0.33, "rho_s": 0.05, "alpha_x": 0.13, "alpha_y": 0.13},
)
CAMERA = Camera(
    rows=1, columns=1, pitch_mm=(0.01, 0.01), gain_dn_per_e=0.38, black_dn=64, saturation_dn=4095,
    full_well_e=10700, noise_dn=1, dark_e_per_s=0, nonlinearity_per_decade=BEND,
)  # fmt: skip


def reduced(surface, sensor, plan=PLAN, **known):
    """Samples of a session whose camera states `known`."""
    scene = images(small(n=52, sensor=sensor), plan, "ward", **surface)
    stated = metadata(scene.instrument, plan, "ward", "")
    camera = stated.camera.model_copy(update=known)
    return gonio.reduce(Drawn(scene, known=stated.model_copy(update={"camera": camera})))


def test_counts_follow_the_law_and_end_at_the_full_well():
    readout = small(sensor={"nonlinearity_per_decade": BEND, "read_noise_e": 0.0}).sensor.readout()
    well, gain, black = (readout[k] for k in ("full_well_e", "gain_dn_per_e", "black_dn"))
    for decades in (0.5, 1.5, 2.5):
        mean = well * 10**-decades
        frame = expose(np.full((400, 400), mean), 1.0, seed=1, frame=0, **readout)
        seen = (frame.mean() - black) / (gain * mean)
        noise = 1 / np.sqrt(mean * frame.size)
        assert seen == pytest.approx(1 - decades * BEND, abs=5 * noise)


def test_none_left_changes_no_count():
    readout = small().sensor.readout()
    rate = np.geomspace(1, 1e5, 4096).reshape(64, 64)
    straight = {k: v for k, v in readout.items() if k != "nonlinearity_per_decade"}
    np.testing.assert_array_equal(
        expose(rate, 1.0, seed=1, frame=0, **readout),
        expose(rate, 1.0, seed=1, frame=0, **straight),
    )


def test_the_inverse_of_the_response_is_exact():
    electrons = np.array([-300.0, -0.5, 0.0, 0.5, 1.0, 30.0, 10700.0])
    law = 1 + BEND * np.log10(np.maximum(abs(electrons), 1) / CAMERA.full_well_e)
    np.testing.assert_allclose(straightened(electrons * law, CAMERA), electrons, rtol=1e-13)


def bias(surface, plan):
    """Change of a fit to raw frames in per cent by .5 % a decade, and the prediction of it.

    Four times as much is simulated, since rounding of the counts differs from session to session.
    """
    strong = 4 * BEND
    sensor = {"nonlinearity_per_decade": strong}
    straight = reduced(surface, {}, plan, u_nonlinearity_per_decade=strong)
    bent = reduced(surface, sensor, plan, u_nonlinearity_per_decade=strong)
    (term,) = (t for t in straight.shared if t.effect == "nonlinearity")
    # One standard uncertainty is the whole of it here.
    moved = replace(straight, value=straight.value + term.change(straight.value))
    before, after, foretold = (gonio.fit(s, model="ward").values() for s in (straight, bent, moved))
    found = {k: 25 * (after[k] - before[k]) / v for k, v in surface.items()}
    return found, {k: 25 * (foretold[k] - before[k]) / v for k, v in surface.items()}


@pytest.mark.parametrize("surface", SURFACES)
def test_its_bias_is_the_predicted_one(surface):
    one_exposure = PLAN.model_copy(update={"exposures_s": (4e-3,)})
    found, predicted = bias(surface, one_exposure)
    for name in found:
        assert found[name] == pytest.approx(predicted[name], rel=0.1, abs=0.005)
    assert -0.6 < found["rho_d"] < -0.1
    assert 0.05 < found["rho_s"] < 0.6
    assert -0.2 < found["alpha_x"] < 0


def test_a_bracket_of_exposures_keeps_every_signal_near_the_full_well():
    """The terms of first order nearly cancel; a hundredth of a per cent of second order is left."""
    found, predicted = bias(SURFACES[0], PLAN)
    for name in found:
        assert found[name] == pytest.approx(predicted[name], rel=0.1, abs=0.01)
        assert abs(found[name]) < 0.15


def test_what_is_known_is_corrected():
    surface = SURFACES[0]
    sensor = {"nonlinearity_per_decade": BEND}
    known = reduced(surface, sensor, nonlinearity_per_decade=BEND, u_nonlinearity_per_decade=1e-4)
    straight = gonio.fit(reduced(surface, {}), model="ward").values()
    fitted = gonio.fit(known, model="ward").values()
    for name, value in surface.items():
        assert fitted[name] == pytest.approx(straight[name], abs=3e-4 * value)
    assert "nonlinearity of 0.5 % per decade corrected, +- 0.01 %" in known.history
    assert "nonlinearity" in [source.name for source in budget(known).sources]


def test_one_that_nobody_stated_is_unknown_and_not_0():
    samples = reduced(SURFACES[0], {"nonlinearity_per_decade": BEND})
    words = "nonlinearity of the camera (camera.u_nonlinearity_per_decade)"
    assert words in budget(samples).unknown
    assert words not in budget(reduced(SURFACES[0], {})).unknown
