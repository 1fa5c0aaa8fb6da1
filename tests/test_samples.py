"""Samples on disk come back as they were, or an error says why not."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from gonio.errors import DataError
from gonio.geometry import Directions, unit_vectors
from gonio.samples import FLAG_ENTRY, FLAG_PARTIAL, BRDFSamples, Cells, SharedTerm

N = 6
PLAIN_FIELDS = (
    "value",
    "u_independent",
    "noise_slope",
    "u_reference",
    "solid_angle",
    "flags",
    "image",
    "wavelength_nm",
    "channel",
)


def full_samples() -> BRDFSamples:
    """Samples with every field set, cells of 1 to 3 members."""
    rng = np.random.default_rng(0)
    counts = np.array([1, 2, 3, 1, 2, 3])
    m = int(counts.sum())
    return BRDFSamples(
        directions=Directions(
            np.linspace(0, 1.2, N), 0.1, rng.uniform(0, 1.4, N), rng.uniform(-3, 3, N)
        ),
        value=rng.uniform(-0.01, 0.5, N),
        u_independent=rng.uniform(0.001, 0.01, N),
        noise_slope=rng.uniform(0, 1e-4, N),
        u_reference=rng.uniform(0, 1e-3, N),
        reference_sharing=3,
        shared=(
            SharedTerm("standard", "reflectance of the standard", relative=0.01),
            SharedTerm("lamp", "drift of the lamp", 0.002, group=np.arange(N) // 2),
            SharedTerm("tilt", "tilt of the sample", shift=rng.normal(0, 1e-3, (N, 3))),
            SharedTerm("shape", "shape of the standard", 0.1, profile=rng.uniform(0, 1, N)),
            SharedTerm("cone", "cone of the lamp", blur=0.004),
            SharedTerm("drift", "stray light", 0.01, offset=rng.normal(0, 1e-4, N)),
        ),
        solid_angle=rng.uniform(0.001, 0.01, N),
        flags=np.array([0, FLAG_PARTIAL, 0, FLAG_ENTRY, 3, 0], np.uint8),
        image=np.array([0, 0, 0, 1, 1, 1]),
        wavelength_nm=np.full(N, 550.0),
        channel=np.array(["red", "green", "blue"] * 2),
        cells=Cells(
            unit_vectors(rng.uniform(0, 1.4, m), rng.uniform(-3, 3, m)),
            np.repeat(1 / counts, counts),
            np.concatenate([[0], np.cumsum(counts)]),
        ),
        history=("simulated", "thinned: 6 cells"),
        metadata={"material": "clay_vase", "temperature_c": 21.5, "tags": ["a", "ü"]},
    )


def assert_same(a: BRDFSamples, b: BRDFSamples) -> None:
    for name in ("theta_i", "phi_i", "theta_r", "phi_r"):
        np.testing.assert_array_equal(
            np.broadcast_to(getattr(a.directions, name), len(a)), getattr(b.directions, name)
        )
    for name in PLAIN_FIELDS:
        x, y = getattr(a, name), getattr(b, name)
        if x is None:
            assert y is None, name
        else:
            assert x.dtype.kind == y.dtype.kind, name
            np.testing.assert_array_equal(x, y)
    assert a.reference_sharing == b.reference_sharing
    assert a.quantity == b.quantity
    assert a.history == b.history
    assert a.metadata == b.metadata
    assert (a.cells is None) == (b.cells is None)
    if a.cells is not None:
        for name in ("w_r", "weight", "offsets"):
            np.testing.assert_array_equal(getattr(a.cells, name), getattr(b.cells, name))
    assert len(a.shared) == len(b.shared)
    for s, t in zip(a.shared, b.shared, strict=True):
        assert (s.name, s.meaning, s.relative, s.blur) == (t.name, t.meaning, t.relative, t.blur)
        for name in ("group", "shift", "profile", "offset"):
            x, y = getattr(s, name), getattr(t, name)
            assert (x is None) == (y is None)
            if x is not None:
                np.testing.assert_array_equal(x, y)


def minimal() -> BRDFSamples:
    return BRDFSamples(Directions([0.1, 0.2], 0, [0.3, 0.4], 0), np.array([0.2, 0.3]))


class TestRoundTrip:
    @pytest.mark.parametrize("make", [full_samples, minimal])
    def test_every_field_comes_back(self, make, tmp_path):
        samples = make()
        samples.save(tmp_path / "samples.nc")
        assert_same(samples, BRDFSamples.load(tmp_path / "samples.nc"))
        assert [p.name for p in tmp_path.iterdir()] == ["samples.nc"]

    def test_the_file_states_quantity_convention_and_units(self, tmp_path):
        full_samples().save(tmp_path / "samples.nc")
        with xr.open_dataset(tmp_path / "samples.nc", engine="h5netcdf") as dataset:
            assert dataset.attrs["quantity"] == "BRDF in sr^-1, cosine not included"
            assert "counter-clockwise" in dataset.attrs["convention"]
            assert dataset["value"].attrs["units"] == "sr-1"
            assert dataset["theta_i"].attrs["units"] == "rad"

    def test_transmission_states_its_quantity_and_where_its_light_comes_from(self, tmp_path):
        samples = replace(full_samples(), quantity="BTDF")
        samples.save(tmp_path / "samples.nc")
        assert_same(samples, BRDFSamples.load(tmp_path / "samples.nc"))
        with xr.open_dataset(tmp_path / "samples.nc", engine="h5netcdf") as dataset:
            assert dataset.attrs["quantity"] == "BTDF in sr^-1, cosine not included"
            convention = dataset.attrs["convention"]
            assert "the incident direction, below the surface, is mirrored" in convention

    def test_a_second_save_replaces_the_first(self, tmp_path):
        path = tmp_path / "samples.nc"
        full_samples().save(path)
        minimal().save(path)
        assert_same(minimal(), BRDFSamples.load(path))


class TestBadFiles:
    def test_a_missing_file(self, tmp_path):
        with pytest.raises(DataError, match=r"none\.nc: no such file; give a samples file"):
            BRDFSamples.load(tmp_path / "none.nc")

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
    def test_a_truncated_file(self, share, tmp_path):
        path = tmp_path / "samples.nc"
        full_samples().save(path)
        whole = path.read_bytes()
        path.write_bytes(whole[: int(share * len(whole))])
        match = r"samples\.nc: not a readable samples file .*may be truncated, make it again with"
        with pytest.raises(DataError, match=match) as caught:
            BRDFSamples.load(path)
        assert caught.value.exit_code == 3

    def test_a_file_of_another_schema(self, tmp_path):
        path = tmp_path / "other.nc"
        xr.Dataset({"x": ("n", [1.0])}, attrs={"schema": "gonio.samples/9"}).to_netcdf(
            path, engine="h5netcdf"
        )
        match = r"the schema is 'gonio.samples/9', not 'gonio.samples/1'; this is not a samples"
        with pytest.raises(DataError, match=match):
            BRDFSamples.load(path)

    def test_another_quantity(self, tmp_path):
        path = tmp_path / "other.nc"
        minimal().save(path)
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            other = dataset.load().assign_attrs(quantity="BRDF, cosine included")
        other.to_netcdf(path, engine="h5netcdf")
        with pytest.raises(DataError, match="the quantity is 'BRDF, cosine included'"):
            BRDFSamples.load(path)

    def test_a_file_without_a_needed_column(self, tmp_path):
        path = tmp_path / "samples.nc"
        minimal().save(path)
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            less = dataset.load().drop_vars("value")
        less.to_netcdf(path, engine="h5netcdf")
        with pytest.raises(DataError, match=r"samples\.nc: not a readable samples file"):
            BRDFSamples.load(path)

    def test_cells_that_do_not_fit_their_members(self, tmp_path):
        path = tmp_path / "samples.nc"
        full_samples().save(path)
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            wrong = dataset.load()
        wrong["member_offset"] = wrong["member_offset"] + 1
        wrong.to_netcdf(path, engine="h5netcdf")
        with pytest.raises(DataError, match="member offsets are inconsistent"):
            BRDFSamples.load(path)


class TestWriting:
    def test_a_missing_folder(self, tmp_path):
        match = r"the folder .*nowhere does not exist; make it first"
        with pytest.raises(DataError, match=match):
            minimal().save(tmp_path / "nowhere" / "samples.nc")
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize("step", ["fsync", "replace"])
    def test_a_full_disk_leaves_nothing_behind(self, step, tmp_path, monkeypatch):
        def full(*arguments):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(*((os, "fsync") if step == "fsync" else (Path, "replace")), full)
        match = r"samples\.nc: cannot be written \(No space left on device\); nothing was left beh"
        with pytest.raises(DataError, match=match):
            minimal().save(tmp_path / "samples.nc")
        assert not list(tmp_path.iterdir())

    def test_a_full_disk_keeps_the_earlier_file(self, tmp_path, monkeypatch):
        path = tmp_path / "samples.nc"
        minimal().save(path)

        def full(descriptor):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(DataError, match="cannot be written"):
                full_samples().save(path)
        assert_same(minimal(), BRDFSamples.load(path))


class TestSharedTerm:
    def test_changes_a_value_by_a_fraction_and_an_offset(self):
        value, half = np.array([1.0, 2.0]), np.array([1.0, 0.5])
        plain = SharedTerm("a", "b", 0.1)
        assert plain.change(value).tolist() == [0.1, 0.2]
        assert SharedTerm("a", "b", 0.1, profile=half).change(value).tolist() == [0.1, 0.1]
        both = SharedTerm("a", "b", 0.1, profile=half, offset=np.array([0.0, 3.0]))
        assert both.change(value).tolist() == [0.1, 3.1]
        assert SharedTerm("a", "b", offset=np.array([0.5, 3.0])).change(value).tolist() == [0.5, 3]
        assert not both.moves_directions

    def test_of_directions_changes_no_value_of_itself(self):
        value = np.ones(2)
        for term in (SharedTerm("a", "b", shift=np.ones((2, 3))), SharedTerm("a", "b", blur=0.1)):
            assert term.moves_directions
            assert term.change(value).tolist() == [0, 0]


class TestSelect:
    def test_a_mask_takes_cells_and_shared_terms_along(self):
        samples = full_samples()
        keep = np.array([False, True, False, True, False, True])
        part = samples.select(keep, "odd ones")
        assert len(part) == 3
        assert part.history[-1] == "odd ones: 3 of 6 samples kept"
        np.testing.assert_array_equal(part.value, samples.value[keep])
        np.testing.assert_array_equal(part.directions.theta_r, samples.directions.theta_r[keep])
        np.testing.assert_array_equal(part.directions.phi_i, np.full(3, 0.1))
        np.testing.assert_array_equal(part.channel, samples.channel[keep])
        np.testing.assert_array_equal(part.shared[1].group, samples.shared[1].group[keep])
        np.testing.assert_array_equal(part.shared[2].shift, samples.shared[2].shift[keep])
        np.testing.assert_array_equal(part.shared[5].offset, samples.shared[5].offset[keep])

    @pytest.mark.parametrize("index", [[5, 0, 2], [1], []])
    def test_cells_follow_in_the_order_asked_for(self, index):
        samples = full_samples()
        part = samples.select(np.array(index, np.int64), "picked")
        assert part.cells.offsets[0] == 0
        for new, old in enumerate(index):
            a, b = part.cells.offsets[new : new + 2]
            c, d = samples.cells.offsets[old : old + 2]
            np.testing.assert_array_equal(part.cells.w_r[a:b], samples.cells.w_r[c:d])
            np.testing.assert_array_equal(part.cells.weight[a:b], samples.cells.weight[c:d])

    def test_limits_keep_what_lies_on_them(self):
        samples = full_samples()
        limit = float(samples.directions.theta_i[3])
        part = samples.limited(max_theta_i=limit)
        assert len(part) == 4
        assert part.history[-1] == f"theta_i <= {np.degrees(limit):.6g} deg: 4 of 6 samples kept"
        assert samples.limited() is samples

    def test_limits_that_leave_no_sample(self):
        match = r"no sample has theta_r <= 5 deg; the smallest is 17\.1887 deg"
        with pytest.raises(DataError, match=match):
            minimal().limited(max_theta_r=np.radians(5))


class TestChecks:
    def test_directions_and_values_must_match(self):
        match = r"got directions of shape \(2,\) and values of shape \(3,\)"
        with pytest.raises(DataError, match=match):
            BRDFSamples(Directions([0.1, 0.2], 0, 0, 0), np.zeros(3))

    def test_a_value_that_is_not_finite(self):
        with pytest.raises(DataError, match="a BRDF value is not finite; remove the sample"):
            BRDFSamples(Directions([0.1, 0.2], 0, 0, 0), np.array([0.1, np.nan]))

    def test_a_direction_beyond_the_horizon(self):
        with pytest.raises(DataError, match=r"theta_r = 100 deg is beyond the horizon"):
            BRDFSamples(Directions(0.1, 0, np.radians([20, 100]), 0), np.zeros(2))

    def test_a_column_of_another_length(self):
        with pytest.raises(DataError, match=r"solid_angle has shape \(3,\), not \(2,\)"):
            BRDFSamples(Directions([0.1, 0.2], 0, 0, 0), np.zeros(2), solid_angle=np.ones(3))

    @pytest.mark.parametrize("u", [0.0, -0.1, np.nan])
    def test_an_uncertainty_that_is_not_positive(self, u):
        with pytest.raises(DataError, match=r"^the uncertainty \(u_independent.*must be positive"):
            BRDFSamples(
                Directions([0.1, 0.2], 0, 0, 0), np.zeros(2), u_independent=np.array([0.1, u])
            )

    def test_negative_values_are_kept_and_counted(self):
        samples = BRDFSamples(Directions([0.1, 0.2], 0, 0, 0), np.array([-0.001, 0.1]))
        assert samples.n_negative == 1
        assert samples.value[0] == -0.001
