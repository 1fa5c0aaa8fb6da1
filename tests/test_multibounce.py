"""Light that goes round twice: what it does to eq. (2), and what is left when g is known."""

import numpy as np
import pytest
from virtual import Drawn, images, small

import gonio
from gonio.calibration.effects.multibounce import RECORD, image_albedo
from gonio.checks import directional_albedo
from gonio.instrument.records import metadata
from gonio.metadata import Plan
from gonio.models import get

G = 0.05
EXPOSURES = (0.25e-3, 1e-3, 4e-3, 16e-3, 64e-3, 256e-3)
PLAN = Plan(theta_i_deg=(10.0, 50.0), rotations_deg=(0.0,), exposures_s=EXPOSURES)


def rig(u, g=G):
    return small(surroundings={"multibounce": g, "multibounce_uncertainty": u})


def reduced(u, model="lambert", **parameters):
    return gonio.reduce(Drawn(images(rig(u), PLAN, model, **parameters)))


def term(samples):
    return next((t for t in samples.shared if t.name == RECORD.name), None)


@pytest.mark.parametrize("rho", [0.05, 0.5, 0.95])
def test_a_known_g_takes_the_bias_away(rho):
    rho_std = rig(0.0).standard.reflectance
    bias = (1 + G * rho) / (1 + G * rho_std) - 1
    ratio = [np.average(reduced(u, rho=rho).value) * np.pi / rho - 1 for u in (None, 0.0)]
    assert ratio[0] == pytest.approx(bias, abs=3e-4)
    assert ratio[1] == pytest.approx(0, abs=3e-4)


def test_what_is_left_is_the_uncertainty_of_g_times_the_difference_of_albedos():
    rho = 0.05
    left = term(reduced(0.3, rho=rho))
    assert left.meaning == "light that reaches the sample twice, after correction"
    size = left.relative * left.profile
    difference = rig(0.0).standard.reflectance - rho
    np.testing.assert_allclose(size, 0.3 * G * difference, rtol=0.02)
    whole = term(reduced(None, rho=rho))
    assert whole.profile is None
    assert whole.relative == pytest.approx(G * rig(0.0).standard.reflectance)


def test_the_history_says_what_was_corrected():
    assert "multi-bounce corrected with g = 0.05 +- 0.015" in reduced(0.3, rho=0.5).history
    assert not any("corrected" in line for line in reduced(None, rho=0.5).history)


def test_an_instrument_without_it_has_no_such_term():
    scene = images(rig(0.3, g=0.0), PLAN, "lambert", rho=0.5)
    assert term(gonio.reduce(Drawn(scene))) is None


def test_the_albedo_of_an_image_is_that_of_the_surface():
    from gonio.calibration.reduction import reduce as reduction

    seen = {}
    original = reduction.effects.corrected

    def kept(known, parts):
        seen["parts"] = parts
        return original(known, parts)

    ward = {"rho_d": 0.3, "rho_s": 0.1, "alpha_x": 0.1, "alpha_y": 0.2}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reduction.effects, "corrected", kept)
        reduced(None, "ward", **ward)
    for part in seen["parts"]:
        found, u = image_albedo([part])
        exact = directional_albedo(get("ward"), ward, part.theta_i).value
        # What is seen holds the light that goes round twice.
        rho_std = rig(0.0).standard.reflectance
        assert found == pytest.approx(exact * (1 + G * exact) / (1 + G * rho_std), abs=2 * u)
        assert u < 0.02


def test_the_true_g_is_drawn_about_the_stated_one(tmp_path):
    from gonio.session import read_truth

    scales = []
    for seed in range(4):
        path = tmp_path / str(seed)
        one = Plan(theta_i_deg=(10.0,), rotations_deg=(0.0,), exposures_s=(1e-3,))
        made = gonio.simulate(
            model="lambert", output=path, instrument=rig(0.3), plan=one, seed=seed
        )
        scales.append(read_truth(path)["multibounce_scale"])
        assert made.metadata.limits.multibounce == G
        assert made.metadata.limits.u_multibounce == pytest.approx(0.3 * G)
    assert len(set(scales)) == 4
    assert 0.02 < np.std(scales) < 1


def test_nothing_is_corrected_in_transmission():
    below = PLAN.model_copy(update={"mode": "transmission", "standard_theta_i_deg": 10.0})
    sheet = metadata(rig(0.3), below, "sheet", "")
    from gonio.calibration.effects.multibounce import is_corrected

    assert not is_corrected(sheet)
    assert is_corrected(metadata(rig(0.3), PLAN, "sheet", ""))
