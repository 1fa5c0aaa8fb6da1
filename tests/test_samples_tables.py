"""Samples at a prompt, in a notebook, as tables and as CSV."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pandas as pd
import pytest

from gonio import formats
from gonio.errors import ConfigurationError, DataError, IncompleteFileWarning
from gonio.geometry import Directions, unit_vectors
from gonio.samples import BRDFSamples, Cells, SharedTerm

THETA_R = [0.1, 0.4, 0.8, 1.2]


def samples(**more) -> BRDFSamples:
    given = {"channel": ["red", "blue", "red", "blue"], "wavelength_nm": [650, 450, 650, 450]}
    return BRDFSamples(
        Directions(0.5, 0.0, THETA_R, 3.0), [0.2, 0.3, 0.25, -0.01], [0.01] * 4, **given | more
    )


def full() -> BRDFSamples:
    return samples(
        shared=(SharedTerm("standard", "reflectance", 0.01),),
        cells=Cells(unit_vectors(np.array(THETA_R), 3.0), np.ones(4), np.arange(5)),
        solid_angle=[0.01] * 4,
    )


# ---------------------------------------------------------------- what a person sees


def test_repr_is_one_line_however_many_samples():
    large = BRDFSamples(Directions(0.5, 0.0, np.linspace(0, 1, 100_000), 0.0), np.ones(100_000))
    for each in (full(), large):
        assert len(repr(each)) < 400
        assert "\n" not in repr(each)
    assert repr(full()) == (
        "<BRDFSamples BRDF: 4 values, -0.01 to 0.3 sr^-1; theta_i: 28.65 deg; theta_r: 5.73 to "
        "68.75 deg; u_brdf: 0.01 sr^-1; channels: blue, red; wavelengths: 450, 650 nm; cells: 4 "
        "members; shared errors: standard>"
    )
    assert "u_brdf: not stated" in repr(large)


def test_html_shows_the_first_samples_in_degrees():
    html = full()._repr_html_()
    assert html.count("<tr>") == 8 + 1 + 4
    assert "<td>68.7549</td>" in html
    assert "theta_i [deg]" in html
    assert (
        "and 1 more samples"
        in BRDFSamples(Directions(0.1, 0.0, [0.1] * 6, 0.0), [0.1] * 6)._repr_html_()
    )
    assert BRDFSamples(Directions([], [], [], []), np.array([]))._repr_html_()


# ---------------------------------------------------------------- selection


def test_lists_are_arrays():
    one = samples(flags=[0, 1, 0, 2], image=[0, 0, 1, 1])
    assert one.value.dtype == float
    assert (one.flags.dtype, one.image.dtype) == (np.uint8, np.int64)
    assert one.channel.dtype.kind == "U"
    with pytest.raises(
        DataError, match=r"^the uncertainty \(u_independent\) has shape \(2,\), not \(4,\)\.$"
    ):
        BRDFSamples(Directions(0.5, 0.0, THETA_R, 3.0), [0.1] * 4, [0.1, 0.1])


def test_a_mask_indices_and_a_slice_select():
    every = full()
    positive = every[every.value > 0]
    assert len(positive) == 3
    assert positive.history[-1] == "selected: 3 of 4 samples kept"
    assert len(positive.cells.offsets) == 4
    assert every[[2, 0]].value.tolist() == [0.25, 0.2]
    assert every[-1].value.tolist() == [-0.01]
    assert every[1:3].value.tolist() == [0.3, 0.25]
    assert len(every[[False] * 4]) == 0
    with pytest.raises(DataError, match=r"^a mask of shape \(2,\) does not fit 4 samples\.$"):
        every[[True, False]]
    with pytest.raises(DataError, match=r"^an index is beyond the 4 samples; the last is 3\.$"):
        every[4]


def test_a_channel_or_wavelength_is_selected_by_name():
    red = full().select(channel="red")
    assert red.value.tolist() == [0.2, 0.25]
    assert red.history[-1] == "channel = red: 2 of 4 samples kept"
    assert full().select(wavelength_nm=450).value.tolist() == [0.3, -0.01]
    with pytest.raises(ConfigurationError, match="no sample has channel 'gren'; known: blue, red"):
        full().select(channel="gren")
    with pytest.raises(ConfigurationError, match="wavelength_nm 500; known: they have none"):
        samples(wavelength_nm=None).select(wavelength_nm=500)


# ---------------------------------------------------------------- tables


def test_a_table_goes_there_and_back():
    frame = full().to_dataframe()
    assert list(frame.columns) == [
        "theta_i", "phi_i", "theta_r", "phi_r", "brdf", "u_brdf", "solid_angle", "wavelength_nm",
        "channel",
    ]  # fmt: skip
    again = BRDFSamples.from_dataframe(frame)
    np.testing.assert_array_equal(again.directions.theta_r, THETA_R)
    np.testing.assert_array_equal(again.value, full().value)
    np.testing.assert_array_equal(again.channel, full().channel)
    degrees = BRDFSamples.from_dataframe(full().to_dataframe(angles="deg"), angles="deg")
    np.testing.assert_allclose(degrees.directions.theta_r, THETA_R, rtol=1e-15)


def test_a_table_that_is_none_is_refused():
    frame = samples().to_dataframe(angles="deg")
    with pytest.raises(DataError, match="where its angles are degrees give angles='deg'"):
        BRDFSamples.from_dataframe(frame)
    with pytest.raises(DataError, match="unknown column 'u_brfd': did you mean 'u_brdf'"):
        BRDFSamples.from_dataframe(frame.rename(columns={"u_brdf": "u_brfd"}), angles="deg")
    with pytest.raises(DataError, match=r"^the table has no column brdf; wanted are theta_i, "):
        BRDFSamples.from_dataframe(frame.drop(columns="brdf"), angles="deg")
    with pytest.raises(ConfigurationError, match="angles = 'grad'; allowed are 'rad' and 'deg'"):
        BRDFSamples.from_dataframe(pd.DataFrame(), angles="grad")


def test_xarray_holds_everything_in_radians():
    dataset = full().to_xarray()
    assert dataset["theta_r"].attrs["units"] == "rad"
    assert dataset["theta_r"].values.tolist() == THETA_R
    assert "standard" in dataset.attrs["shared"]


# ---------------------------------------------------------------- files


def test_a_csv_is_a_csv_and_says_what_it_leaves_out(tmp_path):
    path = tmp_path / "x.csv"
    text = (
        f"{path}: a CSV cannot hold 1 shared error, the cells over which a fit integrates, solid "
        "angles of these samples; a fit to it knows less. Save as .nc to keep them."
    )
    with pytest.warns(IncompleteFileWarning, match=f"^{re.escape(text)}$"):
        full().save(path)
    assert path.read_text(encoding="utf-8").startswith("theta_i,phi_i,theta_r,phi_r,brdf,u_brdf")
    again = formats.read(path)
    np.testing.assert_array_equal(again.value, full().value)
    np.testing.assert_array_equal(again.directions.theta_r, THETA_R)


def test_a_csv_that_holds_all_says_nothing(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        samples().save(tmp_path / "x.CSV")


def test_another_suffix_is_refused(tmp_path):
    for name in ("x", "x.h5", "x.json"):
        with pytest.raises(
            ConfigurationError,
            match=r"samples are saved as netCDF \(\.nc\), with all that they hold, or as CSV "
            r"\(\.csv\), directions and values alone; give a name that ends in one of these\.$",
        ):
            samples().save(tmp_path / name)
        assert not (tmp_path / name).exists()
