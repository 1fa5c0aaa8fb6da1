"""Sessions on disk: what is acknowledged is kept, what is damaged is named."""

import errno
import json
import os
import shutil

import numpy as np
import pytest
from pydantic import ValidationError

from gonio.certificate import Certificate
from gonio.errors import ConfigurationError, DataError
from gonio.metadata import (
    Camera,
    Geometry,
    LampRecord,
    LensCalibration,
    Metadata,
    Plan,
)
from gonio.session import Session, open_truth_images, read_truth

SHAPE = (20, 24)
PLAN = Plan(theta_i_deg=(0.0, 30.0), rotations_deg=(0.0, 90.0), exposures_s=(0.01, 0.04), repeats=1)


def metadata(**changed):
    parts = {
        "schema": "gonio.session/1",
        "instrument": "bench",
        "sample": "tile",
        "geometry": Geometry(shape="ellipsoid", R=150, D=15, usable_theta_r_deg=80),
        "lens": LensCalibration(projection="equidistant", focal_length_mm=1.8),
        "camera": Camera(
            rows=SHAPE[0], columns=SHAPE[1], pitch_mm=(0.2, 0.2), gain_dn_per_e=0.4, black_dn=64,
            saturation_dn=4095, full_well_e=1e4, noise_dn=1.0, dark_e_per_s=2.0,
        ),
        "standard": Certificate(reflectance=0.99, uncertainty=0.005),
        "lamp": LampRecord(half_angle_deg=0.5, drift=0.003),
        "plan": PLAN,
        "fingerprint": "one",
    }  # fmt: skip
    return Metadata(**{**parts, **changed})


def picture(number):
    return np.random.default_rng(number).integers(0, 4096, SHAPE).astype(np.uint16)


def all_frames(plan=PLAN):
    return [(*image, k) for image in plan.images() for k in range(len(plan.exposures_s))]


def fill(session):
    for number, key in enumerate(all_frames()):
        session.write(*key, picture(number))


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    path = tmp_path_factory.mktemp("sessions") / "tile.gonio"
    fill(Session.create(path, metadata()))
    return path


@pytest.fixture
def full(original, tmp_path):
    """A complete session that a test may damage."""
    return shutil.copytree(original, tmp_path / "tile.gonio")


def chunk(path, role, take, incidence, exposure):
    return path / f"frames.zarr/{role}/c/{take}/{incidence}/{exposure}/0/0"


class TestRoundTrip:
    def test_frames_come_back_as_they_were(self, full):
        session = Session.open(full)
        assert session.complete
        assert session.n_done == PLAN.n_frames == 2 * 2 * (1 + 1 + 2)
        session.require_complete()
        for number, key in enumerate(all_frames()):
            np.testing.assert_array_equal(session.frame(*key), picture(number))
        assert session.metadata == metadata()

    def test_a_bracket_holds_all_exposures(self, full):
        bracket = Session.open(full).bracket("sample", 1, 1)
        assert bracket.shape == (2, *SHAPE)
        assert bracket.dtype == np.uint16
        np.testing.assert_array_equal(bracket[1], picture(PLAN.n_frames - 1))

    def test_a_frame_of_zeros_is_kept(self, tmp_path):
        session = Session.create(tmp_path / "dark", metadata())
        session.write("background", 0, 0, 0, np.zeros(SHAPE, np.uint16))
        again = Session.open(tmp_path / "dark")
        assert np.all(again.frame("background", 0, 0, 0) == 0)

    def test_continues_where_it_stopped(self, tmp_path):
        session = Session.create(tmp_path / "part", metadata())
        session.write("background", 0, 0, 0, picture(0))
        again = Session.create(tmp_path / "part", metadata())
        assert again.n_done == 1
        assert again.has("background", 0, 0, 0)
        assert not again.has("background", 0, 0, 1)
        with pytest.raises(DataError, match="1 of 16 frames are there; run the same 'gonio sim"):
            again.require_complete()
        with pytest.raises(DataError, match="frame background/0/0/1 is missing"):
            again.frame("background", 0, 0, 1)

    def test_a_frame_of_another_shape_or_type_is_refused(self, tmp_path):
        session = Session.create(tmp_path / "s", metadata())
        with pytest.raises(DataError, match=r"background/0/0/0 is uint16 of shape \(3, 3\), not"):
            session.write("background", 0, 0, 0, np.zeros((3, 3), np.uint16))
        with pytest.raises(DataError, match=r"is float64 of shape .* not uint16 of \(20, 24\)"):
            session.write("background", 0, 0, 0, np.zeros(SHAPE))
        assert session.n_done == 0

    def test_the_plan_counts_its_frames(self):
        plan = PLAN.model_copy(update={"repeats": 3})
        assert plan.n_frames == 2 * 2 * (3 + 3 + 2) == len(all_frames(plan))


class TestChannels:
    PLAN = Plan(
        **PLAN.model_dump(exclude={"channels"}),
        channels=[{"name": "red", "wavelength_nm": 620}, {"name": "green"}, {"name": "blue"}],
    )

    @staticmethod
    def frames(plan):
        return [(*key, c) for key in all_frames(plan) for c in range(len(plan.channels))]

    def test_frames_come_back_as_they_were(self, tmp_path):
        session = Session.create(tmp_path / "s", metadata(plan=self.PLAN))
        for number, (*key, channel) in enumerate(self.frames(self.PLAN)):
            session.write(*key, picture(number), channel=channel)
        again = Session.open(tmp_path / "s")
        assert again.complete
        assert again.n_done == self.PLAN.n_frames == 3 * PLAN.n_frames
        for number, (*key, channel) in enumerate(self.frames(self.PLAN)):
            np.testing.assert_array_equal(again.frame(*key, channel=channel), picture(number))
        bracket = again.bracket("sample", 1, 1, channel=2)
        np.testing.assert_array_equal(bracket[1], picture(self.PLAN.n_frames - 1))
        # Who does not ask for a channel sees the first.
        np.testing.assert_array_equal(
            again.frame("standard", 0, 1, 1), again.frame("standard", 0, 1, 1, channel=0)
        )

    def test_the_arrays_say_what_their_axes_are(self, tmp_path, full):
        import zarr

        several = Session.create(tmp_path / "s", metadata(plan=self.PLAN))
        one, many = (
            zarr.open_array(path / "frames.zarr" / "sample") for path in (full, several.path)
        )
        assert one.metadata.dimension_names == ("take", "incidence", "exposure", "row", "column")
        assert many.metadata.dimension_names == ("channel", *one.metadata.dimension_names)
        assert many.shape == (3, *one.shape)
        assert many.chunks == (1, 1, 1, 1, *SHAPE)

    def test_a_frame_of_one_channel_is_not_that_of_another(self, tmp_path):
        session = Session.create(tmp_path / "s", metadata(plan=self.PLAN))
        session.write("sample", 0, 0, 0, picture(1), channel=2)
        assert session.has("sample", 0, 0, 0, channel=2)
        assert not session.has("sample", 0, 0, 0)
        assert not session.complete
        with pytest.raises(DataError, match="frame sample/0/0/0/c1 is missing"):
            Session.open(tmp_path / "s").frame("sample", 0, 0, 0, channel=1)
        line = json.loads((tmp_path / "s" / "manifest.jsonl").read_text())
        assert line["frame"] == "sample/0/0/0/c2"

    def test_a_channel_that_was_not_planned(self, full):
        with (full / "manifest.jsonl").open("a") as file:
            file.write('{"frame": "sample/0/0/0/c1", "crc32": 1}\n')
        with pytest.raises(DataError, match="frame 'sample/0/0/0/c1' is not of the plan"):
            Session.open(full)


class TestStandardOnce:
    PLAN = PLAN.model_copy(update={"standard_theta_i_deg": 45.0})

    def test_the_plan_counts_its_images(self):
        plan = self.PLAN
        assert plan.incidences("sample") == (0, 30)
        assert plan.incidences("standard") == (45,)
        # One for each of the sample's incidences, and the standard's own.
        assert plan.incidences("background") == (0, 30, 45)
        assert plan.n_images == len(list(plan.images())) == 3 + 1 + 2 * 2
        assert plan.n_frames == 2 * plan.n_images

    def test_frames_come_back_as_they_were(self, tmp_path):
        session = Session.create(tmp_path / "s", metadata(plan=self.PLAN))
        for number, key in enumerate(all_frames(self.PLAN)):
            session.write(*key, picture(number))
        again = Session.open(tmp_path / "s")
        assert again.complete
        np.testing.assert_array_equal(again.frame("background", 0, 2, 1), picture(5))
        np.testing.assert_array_equal(again.frame("standard", 0, 0, 0), picture(6))
        with pytest.raises(DataError, match="frame standard/0/1/0 is missing"):
            again.frame("standard", 0, 1, 0)


class TestDamage:
    def test_a_flipped_byte_in_a_chunk(self, full):
        file = chunk(full, "sample", 1, 0, 1)
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 0x40
        file.write_bytes(content)
        session = Session.open(full)
        with pytest.raises(DataError, match=r"frame sample/1/0/1 .*it is damaged, take it again"):
            session.frame("sample", 1, 0, 1)
        np.testing.assert_array_equal(session.frame("sample", 1, 0, 0), picture(12))

    def test_another_frame_in_its_place(self, full):
        shutil.copy(chunk(full, "sample", 0, 0, 0), chunk(full, "sample", 1, 0, 1))
        with pytest.raises(DataError, match="frame sample/1/0/1 fails its crc32 check; it is dam"):
            Session.open(full).frame("sample", 1, 0, 1)

    def test_a_truncated_chunk(self, full):
        os.truncate(chunk(full, "standard", 0, 1, 0), 30)
        with pytest.raises(DataError, match=r"frame standard/0/1/0 .*it is damaged, take it again"):
            Session.open(full).frame("standard", 0, 1, 0)

    def test_a_lost_chunk(self, full):
        chunk(full, "standard", 0, 1, 0).unlink()
        with pytest.raises(DataError, match="frame standard/0/1/0 fails its crc32 check"):
            Session.open(full).frame("standard", 0, 1, 0)

    def test_a_missing_manifest(self, full):
        (full / "manifest.jsonl").unlink()
        with pytest.raises(DataError, match=r"manifest.jsonl: the manifest is missing"):
            Session.open(full)

    def test_a_torn_last_line_is_cut_off(self, full):
        file = full / "manifest.jsonl"
        whole = file.read_bytes()
        file.write_bytes(whole[:-9])
        session = Session.open(full)
        assert session.n_done == PLAN.n_frames - 1
        session.write(*all_frames()[-1], picture(PLAN.n_frames - 1))
        assert file.read_bytes() == whole

    def test_a_line_that_is_no_frame(self, full):
        with (full / "manifest.jsonl").open("a") as file:
            file.write("hello\n")
        with pytest.raises(DataError, match=r"manifest.jsonl: line 17 is not a frame's line"):
            Session.open(full)

    def test_a_frame_that_was_not_planned(self, full):
        with (full / "manifest.jsonl").open("a") as file:
            file.write('{"frame": "sample/9/0/0", "crc32": 1}\n')
        with pytest.raises(DataError, match="line 17: frame 'sample/9/0/0' is not of the plan"):
            Session.open(full)


class TestRefusals:
    def test_nothing_there(self, tmp_path):
        with pytest.raises(DataError, match="no such session; give a folder that 'gonio simulate'"):
            Session.open(tmp_path / "none")

    def test_a_folder_that_is_no_session(self, tmp_path):
        with pytest.raises(DataError, match=r"not a session, session.json is missing"):
            Session.open(tmp_path)

    def test_a_foreign_folder_is_left_alone(self, tmp_path):
        (tmp_path / "thesis.txt").write_text("mine")
        with pytest.raises(ConfigurationError, match="exists and is not a session; give another"):
            Session.create(tmp_path, metadata())
        assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]

    @pytest.mark.parametrize("manifest", [None, '{"frame": "sample/0/0/0", "crc32": 1}\n'])
    def test_frames_without_their_metadata_are_left_alone(self, full, manifest):
        (full / "session.json").unlink()
        (full / "manifest.jsonl").unlink()
        if manifest:
            (full / "manifest.jsonl").write_text(manifest)
        with pytest.raises(ConfigurationError, match="exists and is not a session"):
            Session.create(full, metadata())
        assert chunk(full, "sample", 0, 0, 0).exists()

    def test_a_file_is_left_alone(self, tmp_path):
        (tmp_path / "file").write_text("mine")
        with pytest.raises(ConfigurationError, match="exists and is not a session"):
            Session.create(tmp_path / "file", metadata())

    def test_a_session_made_with_other_settings(self, full):
        with pytest.raises(
            ConfigurationError,
            match=r"holds a session of tile on bench made with other settings .*asked for, "
            r"brass on rig; give another folder or delete it",
        ):
            Session.create(full, metadata(sample="brass", instrument="rig", fingerprint="two"))
        assert Session.open(full).complete

    @staticmethod
    def rewrite(path, *keys, value):
        file = path / "session.json"
        content = json.loads(file.read_text())
        part = content
        for key in keys[:-1]:
            part = part[key]
        part[keys[-1]] = value
        file.write_text(json.dumps(content))

    def test_huge_declared_frames_are_refused(self, full):
        self.rewrite(full, "camera", "rows", value=10**9)
        with pytest.raises(DataError, match="frames of more than 268435456 pixels are refused"):
            Session.open(full)

    def test_a_huge_declared_plan_is_refused(self, full):
        self.rewrite(full, "plan", "repeats", value=10**12)
        with pytest.raises(DataError, match="more than 16777216 frames are refused"):
            Session.open(full)

    def test_another_schema(self, full):
        self.rewrite(full, "schema", value="gonio.session/99")
        with pytest.raises(DataError, match=r"schema 'gonio.session/99' is not 'gonio.session/1'"):
            Session.open(full)

    def test_an_unknown_key(self, full):
        self.rewrite(full, "camera", "colour", value="red")
        with pytest.raises(DataError, match=r"session.json: camera.colour: Extra inputs are not"):
            Session.open(full)

    def test_a_value_out_of_range(self, full):
        self.rewrite(full, "geometry", "R", value=-3)
        with pytest.raises(DataError, match=r"session.json: geometry.R: Input should be greater"):
            Session.open(full)

    def test_metadata_that_is_not_json(self, full):
        (full / "session.json").write_text("{")
        with pytest.raises(DataError, match=r"session.json: content: Invalid JSON"):
            Session.open(full)

    def test_the_schema_allows_no_unknown_keys(self):
        schema = Metadata.model_json_schema()
        assert schema["additionalProperties"] is False
        assert all(part["additionalProperties"] is False for part in schema["$defs"].values())
        with pytest.raises(ValidationError, match="Extra inputs are not permitted"):
            metadata(truth={})


class TestDiskFull:
    def test_acknowledged_frames_are_kept_and_the_rest_can_follow(self, tmp_path, monkeypatch):
        path = tmp_path / "s"
        session = Session.create(path, metadata())
        frames = all_frames()
        for number, key in enumerate(frames[:5]):
            session.write(*key, picture(number))

        def refuse(_):
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", refuse)
            with pytest.raises(
                DataError,
                match=r"cannot be written \(No space left on device\); free space and run the "
                "same command again, frames already acknowledged are kept",
            ):
                session.write(*frames[5], picture(5))
        assert session.n_done == 5
        again = Session.open(path)
        assert again.n_done == 5
        for number, key in enumerate(frames):
            if not again.has(*key):
                again.write(*key, picture(number))
        complete = Session.open(path)
        assert complete.complete
        for number, key in enumerate(frames):
            np.testing.assert_array_equal(complete.frame(*key), picture(number))

    def test_a_refused_line_of_the_manifest_is_not_an_acknowledgement(self, tmp_path, monkeypatch):
        session = Session.create(tmp_path / "s", metadata())
        sync, calls = os.fsync, []

        def third_fails(descriptor):
            calls.append(descriptor)
            if len(calls) == 3:  # chunk, its folder, manifest
                raise OSError(errno.ENOSPC, "No space left on device")
            sync(descriptor)

        monkeypatch.setattr(os, "fsync", third_fails)
        with pytest.raises(DataError, match="No space left on device"):
            session.write("background", 0, 0, 0, picture(0))
        assert not session.has("background", 0, 0, 0)

    def test_no_place_for_a_new_session(self, tmp_path, monkeypatch):
        def refuse(_):
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(os, "fsync", refuse)
        with pytest.raises(DataError, match=r"cannot be written \(No space left on device\)"):
            Session.create(tmp_path / "s", metadata())
        monkeypatch.undo()
        assert Session.create(tmp_path / "s", metadata()).n_done == 0


class TestTruth:
    def test_a_real_session_has_none(self, full):
        assert read_truth(full) is None
        assert open_truth_images(full) is None

    def test_a_damaged_one_is_named(self, full):
        (full / "truth").mkdir()
        (full / "truth" / "truth.json").write_text("{")
        with pytest.raises(DataError, match=r"truth.json: not readable"):
            read_truth(full)
