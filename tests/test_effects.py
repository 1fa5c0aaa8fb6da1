"""Sources of error: one record each, from which lists, budgets, files and planning derive."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from gonio.calibration.effects import all_effects
from gonio.calibration.effects.base import value_at
from gonio.geometry import Directions
from gonio.instrument import preset
from gonio.instrument.records import metadata
from gonio.metadata import Plan
from gonio.samples import BRDFSamples
from gonio.shared_term import SharedTerm
from gonio.terms_of_0_1 import properties

EFFECTS = {effect.key: effect for effect in all_effects()}
PROPERTIES = ("evaluation", "averages", "constant", "belongs_to")
SINCE_0_1 = {"standard_shape", "nonlinearity"}  # effects that version 0.1 did not have
PLAN = Plan(theta_i_deg=(10.0, 50.0), rotations_deg=(0.0,), exposures_s=(1e-3,))


@pytest.mark.parametrize("key", EFFECTS)
class TestRecord:
    def test_it_is_named_as_its_file(self, key):
        assert EFFECTS[key].terms.__module__ == f"gonio.calibration.effects.{key}"

    def test_it_has_words(self, key):
        effect = EFFECTS[key]
        assert effect.title
        assert effect.text.endswith(".")
        assert all(record.meaning for record in effect.records)

    def test_its_keys_stand_in_the_metadata(self, key):
        known = metadata(preset("modern12"), PLAN, "sample", "")
        for each in (*EFFECTS[key].quantities, *EFFECTS[key].unknown):
            if each.key:
                value_at(known, each.key)  # an unknown key raises AttributeError

    def test_files_of_0_1_say_the_same_by_the_names_of_its_terms(self, key):
        for record in EFFECTS[key].records:
            expected = {name: getattr(record, name) for name in PROPERTIES} | {"effect": key}
            found = properties(record.name.replace("mode N", "mode 2"))
            assert found == ({} if key in SINCE_0_1 else expected)


def test_no_two_effects_have_one_place():
    assert len({effect.order for effect in all_effects()}) == len(EFFECTS)


def samples(*terms: SharedTerm) -> BRDFSamples:
    where = Directions(*np.full((4, 3), 0.1))
    return BRDFSamples(where, np.ones(3), shared=terms)


def test_what_a_term_is_comes_back_from_its_file(tmp_path):
    (record,) = EFFECTS["azimuth"].records
    terms = (
        record.shared(turn=0.02, name="another name"),
        SharedTerm("standard", "one's own", 0.01),
        SharedTerm("z", "", 0.01, effect="z", averages=True, constant=False, evaluation="A"),
    )
    samples(*terms).save(tmp_path / "samples.nc")
    assert BRDFSamples.load(tmp_path / "samples.nc").shared == terms
    # The name does not make it the standard of a reduction: the file is of today.
    assert BRDFSamples.load(tmp_path / "samples.nc").shared[1].effect is None


def test_a_term_of_a_file_of_0_1_is_known_by_its_name(tmp_path):
    path, old = tmp_path / "samples.nc", tmp_path / "old.nc"
    samples(
        SharedTerm("geometry, mode 12", "", shift=np.full((3, 3), 0.1)),
        SharedTerm("lamp, standard", "", 0.01, np.arange(3)),
        SharedTerm("tilt", "of my sample", 0.01),
    ).save(path)
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        made = dataset.load()
    kept = ("name", "meaning", "relative", "blur", "turn", "typical")
    terms = [{k: term[k] for k in kept} for term in json.loads(made.attrs["shared"])]
    made.attrs["shared"] = json.dumps(terms)
    made.to_netcdf(old, engine="h5netcdf")
    mode, lamp, tilt = BRDFSamples.load(old).shared
    assert (mode.effect, mode.evaluation, mode.of_rig) == ("calibrated_geometry", "A", True)
    assert (lamp.effect, lamp.averages, lamp.of_rig) == ("lamp_drift", True, False)
    assert [getattr(tilt, name) for name in ("effect", *PROPERTIES)] == [None] * 5
    np.testing.assert_array_equal(lamp.group, np.arange(3))


def test_whose_a_term_is_follows_from_what_it_does_where_nobody_says():
    group = np.arange(3)
    assert SharedTerm("a", "", 0.1).of_rig
    assert SharedTerm("a", "", shift=np.ones((3, 3)), group=group).of_rig
    assert not SharedTerm("a", "", 0.1, group).of_rig
    assert SharedTerm("a", "", 0.1, group, belongs_to="rig").of_rig
