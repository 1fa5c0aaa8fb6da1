"""Several sessions on one virtual rig."""

from __future__ import annotations

import numpy as np
import pytest

import gonio
from gonio.errors import ConfigurationError
from gonio.instrument import preset
from gonio.instrument.realisation import Realisation
from gonio.metadata import Plan
from gonio.session import read_truth

PLAN = Plan(theta_i_deg=(0, 30), rotations_deg=(0,), exposures_s=(0.01, 0.1))


def drawn(seed, **seeds):
    return Realisation.from_seeds(seed, preset("modern12"), PLAN, **seeds)


def test_a_rig_keeps_its_dome_camera_and_standard_and_a_session_has_its_own_lamp():
    one, two = drawn(1, rig_seed=7), drawn(2, rig_seed=7)
    for name in ("dome_seed", "pattern_seed", "standard_scale", "multibounce_scale"):
        assert getattr(one, name) == getattr(two, name), name
    assert one.noise_seed != two.noise_seed
    assert not np.any(one.lamp == two.lamp)
    # A session whose own seed is 7 has the dome, the camera and the standard of rig 7.
    alone = drawn(7)
    assert (alone.dome_seed, alone.pattern_seed) == (one.dome_seed, one.pattern_seed)
    assert alone.standard_scale == one.standard_scale


def test_a_standard_may_have_its_own_seed():
    one, other = drawn(1, rig_seed=7, standard_seed=3), drawn(1, rig_seed=8, standard_seed=3)
    assert one.standard_scale == other.standard_scale == drawn(3).standard_scale
    assert one.dome_seed != other.dome_seed


def test_what_a_rig_draws_does_not_depend_on_the_plan():
    longer = PLAN.model_copy(update={"theta_i_deg": (0, 20, 40, 60)})
    for_longer = Realisation.from_seeds(1, preset("modern12"), longer, rig_seed=7)
    assert for_longer.multibounce_scale == drawn(1, rig_seed=7).multibounce_scale
    assert for_longer.standard_scale == drawn(1, rig_seed=7).standard_scale


def test_the_cone_of_the_lamp_is_drawn_for_a_rig_and_the_session_states_the_nominal_one(tmp_path):
    rig = preset("modern12").with_pixels(26)
    scales = [drawn(1, rig_seed=k).half_angle_scale for k in range(200)]
    # The standard uncertainty of modern12 is 10 %; the sd of 200 draws is known to 5 %.
    assert np.std(scales) == pytest.approx(0.1, rel=0.2)
    assert drawn(1, rig_seed=7).half_angle_scale == drawn(2, rig_seed=7).half_angle_scale
    session = gonio.simulate(
        "white_sand", output=tmp_path / "a", seed=1, rig_seed=7, instrument=rig, plan=PLAN
    )
    assert session.metadata.lamp.half_angle_deg == 0.5
    assert session.metadata.lamp.u_half_angle_deg == pytest.approx(0.05)
    truth = read_truth(session.path)
    assert truth["half_angle_scale"] == drawn(1, rig_seed=7).half_angle_scale != 1.0
    true = drawn(1, rig_seed=7).instrument(rig).lamp.half_angle_deg
    assert true == pytest.approx(0.5 * truth["half_angle_scale"])


def test_sessions_state_their_rig(tmp_path):
    small = preset("ideal12").with_pixels(26)
    words = {"instrument": small, "plan": PLAN}
    one = gonio.simulate("white_sand", output=tmp_path / "a", seed=1, rig_seed=7, **words)
    two = gonio.simulate("white_sand", output=tmp_path / "b", seed=2, rig_seed=7, **words)
    own = gonio.simulate("white_sand", output=tmp_path / "c", seed=7, **words)
    assert one.metadata.rig == two.metadata.rig == "ideal12 no. dfc29e9d"
    assert own.metadata.rig == "ideal12 no. dfc29e9d"


@pytest.mark.parametrize("name", ["rig_seed", "standard_seed"])
def test_seeds_have_a_range(tmp_path, name):
    with pytest.raises(ConfigurationError, match=rf"^{name} = -1 is out of range; allowed is 0 to"):
        gonio.simulate("white_sand", output=tmp_path / "a", **{name: -1})
