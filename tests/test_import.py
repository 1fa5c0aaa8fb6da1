"""A lab's folder of pictures becomes a session: `gonio import` and `gonio.rig`."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import rig_files
from rig_files import change, small_rig

import gonio
from gonio import cli, materials, rig
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.errors import ConfigurationError, DataError
from gonio.metadata import LensCalibration, Uncertain
from gonio.rig import frame_files, session_file
from gonio.rig.frame_files import FrameIndex, formatted
from gonio.rig.tables import SessionTable
from gonio.session import Session

TEMPLATE = (resources.files("gonio.data") / "session_template.toml").read_text("utf-8")


@pytest.fixture
def folder(tmp_path):
    """A part of the demo that imports without a complaint."""
    return small_rig(tmp_path / "rig")


@pytest.fixture
def command(capsys):
    """Run the command line in this process: (exit code, stdout, stderr)."""

    def run(*words):
        with pytest.raises(SystemExit) as left:
            cli.main([str(word) for word in words])
        return (left.value.code or 0, *capsys.readouterr())

    return run


def refused(folder, error, message):
    with pytest.raises(error, match=message):
        rig.check_frames(folder)


def codes(found):
    return {finding.code: finding for finding in found.findings}


def all_frames(session):
    return {
        place: session.frame(*place[:4], channel=place.channel)
        for place in frame_files.frame_indices(session.metadata.plan)
    }


# ---------------------------------------------------------------- the demo, from files to a fit


def test_the_demo_gives_rolled_aluminum_within_its_stated_uncertainty(command, tmp_path):
    lab, session = tmp_path / "lab", tmp_path / "demo.gonio"
    assert command("import", "--demo", lab)[0] == 0
    code, out, err = command("import", lab, "-o", session)
    assert code == 0, err
    assert "- PNG frames of 96 x 96 pixels, 16-bit integer\n" in out
    assert f"{session}: 126 frames of 96 x 96 pixels.\n" in out
    assert "importing lab: 126 of 126 frames in" in err
    fit = gonio.fit(gonio.reduce(session), model="ward")
    assert fit.status == "converged"
    for name, true in materials.get("rolled_aluminum").parameters.items():
        found = fit.parameters[name]
        assert abs(found.value - true) < 3 * found.stderr, name
        assert found.stderr < 0.02 * true, name  # and that is not for want of knowing


def test_frames_are_the_files_count_for_count(folder, tmp_path):
    found = rig.import_rig(folder, tmp_path / "s")
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert found.n_new == 18
    assert found.findings == ()
    for theta_i, incidence in ((0, 0), (30, 1)):
        for k, ms in enumerate(rig_files.EXPOSURES_MS):
            for role, name in rig_files.ROLES.items():
                end = f"0_{ms}" if role == "sample" else f"{ms}_1"
                counts = rig_files.pixels(folder / f"{name}/{theta_i}_{end}.png")
                np.testing.assert_array_equal(session.frame(role, 0, incidence, k), counts)


def test_the_session_knows_what_the_rig_says(folder, tmp_path):
    metadata = rig.import_rig(folder, tmp_path / "s").metadata
    camera = metadata.camera
    assert (metadata.instrument, metadata.sample) == ("demo rig", "rolled_aluminum")
    assert camera.pitch_mm == pytest.approx((0.0598, 0.0598), rel=1e-12)
    # noise in counts: 0.1 counts/e- times 8 e-
    assert (camera.noise_dn, camera.gain_dn_per_e, camera.black_dn) == pytest.approx((0.8, 0.1, 64))
    assert (camera.saturation_dn, camera.full_well_e, camera.dark_e_per_s) == (4095, 40_000, 20)
    assert metadata.standard.rolloff == 0.1
    assert metadata.lamp.drift == 0.003
    assert metadata.limits.multibounce == 0.01
    assert metadata.limits.transmittance is None
    assert metadata.lens.centre_px is None
    assert Session.open(tmp_path / "s").metadata == metadata


def test_a_check_reads_everything_and_writes_nothing(folder):
    before = sorted(folder.rglob("*"))
    found = rig.check_frames(folder)
    assert found.session is None
    assert found.findings == ()
    assert sorted(folder.rglob("*")) == before


# ---------------------------------------------------------------- interruption, files replaced


class StopError(Exception):
    pass


def stopping_after(n):
    def progress(done, total):
        if done == n:
            raise StopError

    return progress


def test_an_interrupted_import_continues(folder, tmp_path):
    whole = rig.import_rig(folder, tmp_path / "whole").session
    with pytest.raises(StopError):
        rig.import_rig(folder, tmp_path / "s", threads=1, progress=stopping_after(7))
    kept = Session.open(tmp_path / "s").n_done
    assert 7 <= kept < 18
    found = rig.import_rig(folder, tmp_path / "s")
    assert found.n_new == 18 - kept
    assert found.session.complete
    frames = all_frames(found.session)
    for place, frame in all_frames(whole).items():
        np.testing.assert_array_equal(frames[place], frame)
    assert rig.import_rig(folder, tmp_path / "s").n_new == 0


def test_a_frame_whose_source_was_not_noted_is_read_again(folder, tmp_path):
    rig.import_rig(folder, tmp_path / "s")
    notes = tmp_path / "s" / "sources.jsonl"
    lines = notes.read_text(encoding="utf-8").splitlines(keepends=True)
    notes.write_text("".join(lines[:-2]) + lines[-2][:40], encoding="utf-8")
    assert rig.import_rig(folder, tmp_path / "s").n_new == 2
    assert rig.import_rig(folder, tmp_path / "s").n_new == 0


def test_only_a_file_that_was_replaced_is_read_again(folder, tmp_path):
    rig.import_rig(folder, tmp_path / "s")
    file = folder / "sample/30_0_32.png"
    counts = rig_files.pixels(file)
    counts[40, 40] += 1
    rig_files.write(file, counts)
    found = rig.import_rig(folder, tmp_path / "s")
    assert found.n_new == 1
    np.testing.assert_array_equal(Session.open(tmp_path / "s").frame("sample", 0, 1, 1), counts)


def test_sources_are_noted(folder, tmp_path):
    rig.import_rig(folder, tmp_path / "s")
    lines = (tmp_path / "s" / "sources.jsonl").read_text(encoding="utf-8").splitlines()
    records = [json.loads(line) for line in lines]
    (one,) = [r for r in records if r["file"] == "white/30_32_1.png"]
    counts = rig_files.pixels(folder / "white/30_32_1.png")
    place = ("standard", 0, 1, 1, 0)
    assert tuple(one[name] for name in FrameIndex._fields) == place
    assert (one["low"], one["high"]) == (counts.min(), counts.max())
    assert len(records) == 18
    assert (tmp_path / "s" / "session.toml").read_bytes() == (folder / "session.toml").read_bytes()


def test_other_settings_need_another_session(folder, tmp_path):
    rig.import_rig(folder, tmp_path / "s")
    change(folder, ("black_dn = 64.0", "black_dn = 63.5"))
    with pytest.raises(ConfigurationError, match="made with other settings"):
        rig.import_rig(folder, tmp_path / "s")


def test_the_session_does_not_depend_on_the_threads(folder, tmp_path):
    one, four = (rig.import_rig(folder, tmp_path / f"s{n}", threads=n) for n in (1, 4))
    for path in sorted((tmp_path / "s1").rglob("*")):
        if path.is_file():
            other = tmp_path / "s4" / path.relative_to(tmp_path / "s1")
            assert path.read_bytes() == other.read_bytes()
    assert one.done == four.done


# ---------------------------------------------------------------- session.toml


def test_the_template_parses_and_names_every_key():
    table = SessionTable.model_validate(tomllib.loads(TEMPLATE))
    assert table.camera.gain_dn_per_e == 0.38
    named = set(re.findall(r"^(?:# )?(?:\[+)?([\w.]+?)(?: =|\]+$| *\]+ )", TEMPLATE, re.MULTILINE))
    named |= {name.rpartition(".")[2] for name in named}  # brdf.u_brdf

    def keys(record):
        for name, field in record.model_fields.items():
            inner = session_file._record_in(field.annotation)
            yield from keys(inner) if inner else [name]

    assert set(keys(SessionTable)) - named == set()


def test_what_the_template_leaves_out_may_be_put_in():
    """Each optional line is valid as it stands, but for those that exclude others."""
    exclusive = {"file", "model", "parameters", "csv", "plane", "counts_per_unit", "wedge_deg"}
    exclusive |= {"pattern_of_background", "pattern_of_standard", "rolloff", "rolloff_uncertainty"}
    text = re.sub(
        r"^# (?=\[|(\w+) = )",
        lambda m: m[0] if m[1] in exclusive else "",
        TEMPLATE,
        flags=re.MULTILINE,
    )
    table = SessionTable.model_validate(tomllib.loads(text))
    assert table.lens.uncertain is not None
    assert table.standard.table is not None
    assert table.plan.channels[0].wavelength_nm == 650
    assert table.frames.region_px == (0, 0, 1024, 1024)


def test_the_template_is_not_taken_for_a_rig(tmp_path):
    (tmp_path / "session.toml").write_text(TEMPLATE, encoding="utf-8")
    refused(
        tmp_path, ConfigurationError,
        r"instrument\.name is still 'FILL IN: name of the rig'; go through the template line by "
        r"line, every figure in it is an example\.",
    )  # fmt: skip


def test_a_folder_without_session_toml(tmp_path):
    refused(tmp_path / "none", ConfigurationError, r"none: no such folder; give the one that holds")
    refused(tmp_path, ConfigurationError, r"session\.toml: no such file; 'gonio import --template")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[camera]", "[camera", r"session\.toml: not valid TOML: "),
        (
            "gain_dn_per_e = 0.1", "gain_dn_pre_e = 0.1",
            r"camera\.gain_dn_pre_e: unknown key 'gain_dn_pre_e': did you mean 'gain_dn_per_e'\? "
            r"Choose from black_dn, ",
        ),
        (
            "[lamp]", "[lampp]",
            r"lampp: unknown table or key 'lampp': did you mean 'lamp'\? Choose from camera, ",
        ),
        (
            "[limits]", '[[plan.channels]]\nnme = "red"\n[limits]',
            r"plan\.channels\.0\.nme: unknown key 'nme': did you mean 'name'\? "
            r"Choose from name, wavelength_nm\.",
        ),
        (
            "gain_dn_per_e = 0.1", "",
            r"camera\.gain_dn_per_e is missing \(counts for an electron\); take two frames of the "
            r"white standard .* the gain is var\(A - B\) / \(2 \(M - black_dn\)\)\.",
        ),
        (
            "read_noise_e = 8.0", "",
            r"camera\.read_noise_e is missing \(sd of the read noise, e-\); take two frames with "
            r"the lens covered .* over 1\.414 and over gain_dn_per_e\.",
        ),
        (
            "dark_e_per_s = 20.0", "",
            r"camera\.dark_e_per_s is missing \(dark current, e-/s\); take frames with the lens "
            r"covered at two exposures; ",
        ),
        (
            "full_well_e = 40000.0", "",
            r"camera\.full_well_e is missing \(electrons at which a pixel is full\); it is "
            r"\(saturation_dn - black_dn\) / gain_dn_per_e where ",
        ),
        (
            "pitch_um = [59.8, 59.8]", "",
            r"camera\.pitch_um is missing .* in the camera's data sheet, in x and y\.",
        ),
        (
            "black_dn = 64.0", "",
            r"camera\.black_dn is missing \(count without light\); it is the mean count of a frame "
            r"taken with the lens covered",
        ),
        (
            "saturation_dn = 4095", "",
            r"camera\.saturation_dn is missing \(largest count\); it is the largest count of an "
            r"overexposed frame, 4095 for a camera of 12 bits\.",
        ),
        (
            "reflectance = 0.99", "",
            r"standard\.reflectance is missing; it stands in the certificate of the standard, or "
            r"give a model of it\.",
        ),
        (
            "uncertainty = 0.005", "",
            r"standard\.uncertainty is missing .* over its coverage factor: 0\.01 with k = 2 is "
            r"0\.005\.",
        ),
        ("R = 150.0", "", r"geometry\.R is missing .*'gonio calibrate alignment' finds it"),
        ("D = 15.0", "", r"geometry\.D is missing .*half the distance from the lens's pupil"),
        (
            "focal_length_mm = 1.8", "",
            r"lens\.focal_length_mm is missing; 'gonio calibrate lens' finds it from photographs",
        ),
        ('sample = "rolled_aluminum"', "", r"instrument\.sample is missing \(name of the sample\)"),
        ("R = 150.0", "R = -1", r"geometry\.R: Input should be greater than 0 \(given: -1\)\."),
        ("black_dn = 64.0", "black_dn = 5000.0", "black_dn = 5000 must lie below saturation_dn"),
        ("[59.8, 59.8]", "[59.8, 0]", r"camera: pitch_um must be positive"),
        (
            "[0.004, 0.032, 0.256]", "[0.032, 0.004, 0.256]",
            r"session\.toml: plan\.exposures_s must be positive and grow\.",
        ),
        ("rotations_deg = [0.0]", "rotations_deg = [0.0, 0.0]", "plan.rotations_deg holds a value"),
        ("[0.0, 30.0]", "[0.0, 95.0]", r"plan: theta_i = 95 deg must lie in 0 to 90 deg"),
        (
            "rolloff = 0.1", 'rolloff = 0.1\nmodel = "lambert"\nparameters = { rho = 0.9 }',
            r"standard: rolloff and model exclude each other; give one of them",
        ),
        ("rolloff = 0.1", "parameters = { rho = 0.9 }", "parameters belong to a model; give model"),
        (
            "rolloff = 0.1", 'model = "lambert"\nparameters = { rho = 0.9 }',
            r"a model states the reflectance by its parameters; leave it out",
        ),
        ("pattern = ", '# ', r"frames: give either pattern or csv; neither was given"),
        ("pattern = ", 'csv = "a.csv"\npattern = ', r"give either pattern or csv; both was given"),
        (
            "[frames]\npattern =", '[frames]\ncsv = "a.csv"\n# ',
            r"pattern_of_background and pattern_of_standard belong to a pattern",
        ),
        ("[frames]", "[frames]\nregion_px = [-1, 0, 9, 9]", "region_px must be first column"),
        ("[frames]", '[frames]\nplane = "gren"', r"frames\.plane: Input should be 'red', 'green'"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_session_toml_is_said(folder, old, new, message):
    change(folder, (old, new))
    refused(folder, ConfigurationError, message)


def test_a_missing_table(folder):
    text = (folder / "session.toml").read_text(encoding="utf-8")
    text = re.sub(r"\[camera\]\n.*?\n\n", "", text, flags=re.DOTALL)
    (folder / "session.toml").write_text(text, encoding="utf-8")
    refused(folder, ConfigurationError, r"the table \[camera\] is missing; 'gonio import --templ")


def test_session_toml_that_is_no_text(folder, monkeypatch):
    (folder / "session.toml").write_bytes(b"\xff\xfe\x00")
    refused(folder, ConfigurationError, "cannot be read as text")
    monkeypatch.setattr(session_file, "_LARGEST_BYTES", 2)
    refused(folder, ConfigurationError, r"is larger than 0 MiB; it is not a session\.toml\.")


# ---------------------------------------------------------------- the lens


LENS = """schema = "gonio.lens/1"

[lens]
projection = "equidistant"
focal_length_mm = 1.75
centre_px = [48.0, 47.0]

[frame]
rows = {rows}
columns = {columns}
"""


def with_lens_file(folder, rows=96, columns=96, name="lens.toml"):
    text = (folder / "session.toml").read_text(encoding="utf-8")
    text = re.sub(r"\[lens\]\n.*?\n\n", f'[lens]\nfile = "{name}"\n\n', text, flags=re.DOTALL)
    (folder / "session.toml").write_text(text, encoding="utf-8")
    (folder / "lens.toml").write_text(LENS.format(rows=rows, columns=columns), encoding="utf-8")
    return folder


def test_the_lens_may_stand_in_its_own_file(folder):
    found = rig.check_frames(with_lens_file(folder))
    assert found.metadata.lens == LensCalibration(
        projection="equidistant", focal_length_mm=1.75, centre_px=(48.0, 47.0)
    )
    assert "lens: as lens.toml says" in found.done


def test_a_lens_of_binned_frames_stays_as_it_is(folder):
    change(with_lens_file(folder, 48, 48), ("[frames]\n", "[frames]\nbinning = 2\n"))
    assert rig.check_frames(folder).metadata.lens.centre_px == (48.0, 47.0)


def test_a_lens_of_other_frames_is_refused(folder):
    with_lens_file(folder, 100, 96)
    refused(
        folder, DataError,
        r"the lens of lens\.toml was calibrated with frames of 96 x 100 pixels, and "
        r"dark/0_4_1\.png has 96 x 96; calibrate with frames of the same window, or give "
        r"'gonio calibrate lens' the right --frame-binning\.",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("none.toml", DataError, r"lens\.file = 'none\.toml': no such file beside it; 'gonio cali"),
        ("../lens.toml", ConfigurationError, r"lens\.file: '\.\./lens\.toml' leads out of"),
        ("session.toml", DataError, r"not a calibrated lens \(schema 'gonio\.lens/1'\)"),
    ],
)
def test_files_that_hold_no_lens(folder, name, error, message):
    refused(with_lens_file(folder, name=name), error, message)


def test_a_lens_file_stands_alone(folder):
    change(folder, ("[lens]", '[lens]\nfile = "lens.toml"'))
    refused(
        folder, ConfigurationError,
        r"lens\.file says all about the lens; leave focal_length_mm, k, projection out, or leave "
        r"file out\.",
    )  # fmt: skip
    change(with_lens_file(folder), ('file = "lens.toml"', "file = 3"))
    refused(folder, ConfigurationError, r"lens\.file must be the name of a file \(given: 3\)\.")


# ---------------------------------------------------------------- region, binning


def summed(image, n):
    rows, columns = image.shape
    return image.reshape(rows // n, n, columns // n, n).sum(axis=(1, 3))


def test_region_and_binning_sum_the_counts(folder, tmp_path):
    change(folder, ("[frames]\n", "[frames]\nregion_px = [8, 4, 80, 88]\nbinning = 4\n"))
    found = rig.import_rig(folder, tmp_path / "s")
    assert found.done[0] == (
        "PNG frames of 96 x 96 pixels, 16-bit integer; region of 80 x 88 from column 8, row 4; "
        "4 x 4 pixels summed: 20 x 22 in the session"
    )
    whole = rig_files.pixels(folder / "sample/30_0_4.png")
    frame = found.session.frame("sample", 0, 1, 0)
    np.testing.assert_array_equal(frame, summed(whole[4:92, 8:88].astype(int), 4))
    camera = found.metadata.camera
    assert (camera.rows, camera.columns) == (22, 20)
    assert (camera.black_dn, camera.saturation_dn) == (16 * 64, 16 * 4095)
    assert (camera.full_well_e, camera.dark_e_per_s) == (16 * 40_000, 16 * 20)
    # sixteen read noises of 0.8 counts and fifteen of sixteen roundings
    assert camera.noise_dn == pytest.approx(np.sqrt(16 * 0.8**2 + 15 / 12), rel=1e-12)


def test_a_block_with_a_saturated_pixel_is_saturated(folder, tmp_path):
    change(folder, ("[frames]\n", "[frames]\nbinning = 4\n"))
    file = folder / "sample/30_0_256.png"
    counts = rig_files.pixels(file)
    counts[40:48, 40:48] = 1000
    counts[41, 42] = 4095
    rig_files.write(file, counts)
    frame = rig.import_rig(folder, tmp_path / "s").session.frame("sample", 0, 1, 2)
    assert frame[10, 10] == 16 * 4095
    assert frame[11, 11] == 16 * 1000


@pytest.mark.parametrize("centre", ["", "centre_px = [50.25, 46.5]\n"])
def test_binned_pixels_look_where_their_middle_looked(folder, centre):
    change(folder, ("[lens]\n", f"[lens]\n{centre}"))
    whole = PixelMap.of(rig.check_frames(folder).metadata)
    change(folder, ("[frames]\n", "[frames]\nregion_px = [20, 10, 60, 72]\nbinning = 3\n"))
    part = PixelMap.of(rig.check_frames(folder).metadata)
    columns, rows = np.meshgrid(np.arange(20), np.arange(24))
    # The middle of three pixels is the second of them.
    expected = whole.directions(20 + 3 * columns + 1, 10 + 3 * rows + 1)
    np.testing.assert_allclose(part.directions(columns, rows), expected, atol=1e-12)


def test_the_covariance_of_the_centre_is_that_of_binned_pixels(folder):
    change(
        folder,
        ("[camera]", "[lens.uncertain]\nnames = ['focal_length', 'centre_x']\n"
         "covariance = [[1e-8, 2e-6], [2e-6, 9e-4]]\n\n[camera]"),
        ("[frames]\n", "[frames]\nbinning = 3\n"),
        ("[lens]\n", "[lens]\ncentre_px = [47.5, 47.5]\n"),
    )  # fmt: skip
    uncertain = rig.check_frames(folder).metadata.lens.uncertain
    assert isinstance(uncertain, Uncertain)
    expected = [[1e-8, 2e-6 / 3], [2e-6 / 3, 1e-4]]
    np.testing.assert_allclose(uncertain.covariance, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            "region_px = [20, 0, 80, 96]",
            r"frames\.region_px = \[20, 0, 80, 96\] \(first column, first row, columns, rows\) "
            r"reaches beyond the 96 x 96 pixels of dark/0_4_1\.png\.",
        ),
        (
            "binning = 5",
            r"96 x 96 pixels are not made of whole blocks of 5 x 5; choose 95 x 95 of them with "
            r"frames\.region_px\.",
        ),
        (
            "binning = 6",
            r"sums of 36 pixels of up to 4095 counts do not fit into 16 bits \(147420 > 65535\); "
            r"choose a smaller frames\.binning, or one plane in place of green\.",
        ),
        ('plane = "green"', r"frames\.plane = 'green' is for raw files and dark/0_4_1\.png is a P"),
    ],
)
def test_regions_and_blocks_that_cannot_be(folder, lines, message):
    change(folder, ("[frames]\n", f"[frames]\n{lines}\n"))
    refused(folder, ConfigurationError, message)


def test_counts_of_a_curved_response_are_not_summed(folder):
    change(folder, ("[frames]\n", "[frames]\nbinning = 2\n"), ("[camera]", "[camera]\ngamma = 0.5"))
    refused(
        folder, ConfigurationError,
        r"with camera\.gamma = 0\.5 counts are not in proportion to the light and their sums mean "
        r"nothing; leave frames\.binning at 1",
    )  # fmt: skip


# ---------------------------------------------------------------- names by a pattern

VALUES = {
    "role": "white", "theta_i": 7.5, "rotation": 90.0, "take": 2, "exposure_s": 0.00025,
    "exposure_ms": 0.25, "exposure_us": 250.0, "channel": "red",
}  # fmt: skip


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("{role}/{theta_i:g}_{exposure_ms:g}.tif", "white/7.5_0.25.tif"),
        ("{theta_i}_{rotation}.png", "7.5_90.png"),
        ("{rotation:03d}_{take:02d}_{exposure_us:05.0f}.dng", "090_02_00250.dng"),
        ("{channel}_{theta_i:+06.1f}_{exposure_s:.5f}.exr", "red_+007.5_0.00025.exr"),
        ("{{x}}_{take}.png", "{x}_2.png"),
    ],
)
def test_a_pattern_gives_names(pattern, name):
    assert formatted(pattern, VALUES) == name


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        (
            "{thta_i:g}.png",
            r"unknown field 'thta_i': did you mean 'theta_i'\? Choose from chann",
        ),
        ("{role.__class__}.png", r"unknown field 'role\.__class__'; choose from channel, exposure"),
        ("{role", r"the pattern '\{role' cannot be read \(expected '\}' before end of string\)"),
        ("{theta_i:d}.png", r"theta_i = 7\.5 is no whole number and cannot be written with d; "),
        ("{theta_i:x}.png", r"the format 'x' of \{theta_i\} is not allowed; allowed is width, "),
        ("{theta_i:999999999g}.png", r"the format '999999999g' of \{theta_i\} is not allowed"),
        ("{role!r}.png", r"the format 'r' of \{role\} is not allowed; allowed is none\."),
        ("{role:9}.png", r"the format '9' of \{role\} is not allowed; allowed is none\."),
    ],
)
def test_patterns_that_are_refused(pattern, message):
    with pytest.raises(ConfigurationError, match=message):
        formatted(pattern, VALUES)


def new_pattern(folder, pattern, plan=()):
    text = (folder / "session.toml").read_text(encoding="utf-8")
    text = re.sub(r"^pattern.*\n", "", text, flags=re.MULTILINE)
    text = text.replace("[frames]\n", f'[frames]\npattern = "{pattern}"\n')
    (folder / "session.toml").write_text(text, encoding="utf-8")
    change(folder, *plan)


TWO_ROTATIONS = ("rotations_deg = [0.0]", "rotations_deg = [0.0, 90.0]")
TWO_TAKES = ("rotations_deg = [0.0]", "rotations_deg = [0.0]\nrepeats = 2")
COLOURS = ("[frames]", '[[plan.channels]]\nname = "a"\n[[plan.channels]]\nname = "b"\n[frames]')
STANDARD_AT_30 = ("rotations_deg = [0.0]", "rotations_deg = [0.0]\nstandard_theta_i_deg = 30")


@pytest.mark.parametrize(
    ("pattern", "plan", "message"),
    [
        ("{theta_i}_{exposure_ms}.png", (), r"two frames, background at 0 deg, 4 ms and standard "
         r"at 0 deg, 4 ms; put \{role\} into it\."),
        ("{role}_{exposure_ms}.png", (), r"'dark_4\.png' to two frames, background at 0 deg, 4 ms "
         r"and background at 30 deg, 4 ms; put \{theta_i:g\} into it, with enough digits\."),
        ("{role}_{theta_i}.png", (), r"put \{exposure_ms:g\} into it, with enough digits\."),
        ("{role}_{theta_i}_{exposure_ms}.png", [TWO_ROTATIONS], r"put \{rotation:g\} into it"),
        ("{role}_{theta_i}_{exposure_ms}.png", [TWO_TAKES], r"background at 0 deg, take 1, 4 ms "
         r"and background at 0 deg, take 2, 4 ms; put \{take\} into it\."),
        ("{role}_{theta_i}_{exposure_ms}.png", [COLOURS], r"4 ms, channel a and background at 0 "
         r"deg, 4 ms, channel b; put \{channel\} into it\."),
        ("{role}_{theta_i}_{exposure_ms}.png", [STANDARD_AT_30], r"the standard needs a background "
         r"of its own: name it by frames\.roles\.background_of_standard\."),
    ],
)  # fmt: skip
def test_a_pattern_that_does_not_tell_frames_apart(folder, pattern, plan, message):
    new_pattern(folder, pattern, plan)
    refused(folder, ConfigurationError, message)


def test_the_background_of_the_standard_may_have_its_own_name(folder):
    change(folder, STANDARD_AT_30, ('sample = "sample"', 'sample = "sample"\n'
           'background_of_standard = "dark30"'))  # fmt: skip
    for ms in rig_files.EXPOSURES_MS:
        (folder / "dark30").mkdir(exist_ok=True)
        # Another take at the same place: the demo has two.
        shutil.copy(rig_files.DEMO / f"dark/30_{ms}_2.png", folder / f"dark30/30_{ms}_1.png")
    found = rig.check_frames(folder)
    assert found.metadata.plan.standard_theta_i_deg == 30
    assert found.warnings == (
        "white/0_256_1.png and 2 more: are not of the plan and are left out.",
    )


def test_every_frame_of_every_channel_is_imported(folder, tmp_path):
    change(folder, COLOURS)
    text = (folder / "session.toml").read_text(encoding="utf-8")
    text = re.sub(r'\.png"', '_{channel}.png"', text)
    (folder / "session.toml").write_text(text, encoding="utf-8")
    for path in sorted(folder.rglob("*.png")):
        counts = rig_files.pixels(path)
        rig_files.write(path.with_name(f"{path.stem}_a.png"), counts)
        rig_files.write(path.with_name(f"{path.stem}_b.png"), counts[::-1])
        path.unlink()
    session = rig.import_rig(folder, tmp_path / "s").session
    assert session.complete
    a, b = (session.frame("sample", 0, 1, 0, channel=c) for c in (0, 1))
    np.testing.assert_array_equal(a, b[::-1])


def test_missing_frames_are_listed(folder):
    for ms in rig_files.EXPOSURES_MS:
        (folder / f"white/30_{ms}_1.png").unlink()
    refused(
        folder, DataError,
        r"rig: 3 of 18 frames are missing: white/30_4_1\.png, white/30_32_1\.png, "
        r"white/30_256_1\.png\.$",
    )  # fmt: skip
    shutil.rmtree(folder / "dark")
    refused(folder, DataError, r"9 of 18 frames are missing: (dark/\S+, ){4}dark/\S+ and 4 more\.$")


def test_frames_of_other_names_are_a_hint(folder):
    for path in sorted((folder / "white").iterdir()):
        path.rename(path.with_stem(f"w{path.stem}"))
    refused(
        folder, DataError,
        r"and 1 more\. 6 pictures in the folder are not of the plan, such as white/w0_256_1\.png: "
        r"check plan and frames of session\.toml\.",
    )  # fmt: skip


def test_a_picture_that_is_not_of_the_plan_is_named(folder):
    rig_files.copy(folder, "sample/45_0_4.png")
    found = rig.check_frames(folder)
    assert found.warnings == ("sample/45_0_4.png: is not of the plan and is left out.",)


@pytest.mark.parametrize(
    "pattern", ["../{role}/{theta_i}_{exposure_ms}.png", "/{role}/{theta_i}_{exposure_ms}.png"]
)
def test_no_name_leads_out_of_the_folder(folder, pattern):
    new_pattern(folder, pattern)
    refused(
        folder, ConfigurationError,
        r"frames: '\S+/dark/0_4\.png' leads out of \S+rig; put every file of the rig below its"
        if pattern[0] == "." else r"frames: '/dark/0_4\.png' leads out of \S+rig; ",
    )  # fmt: skip


def test_no_link_leads_out_of_the_folder(folder, tmp_path):
    (folder / "white").rename(tmp_path / "elsewhere")
    (folder / "white").symlink_to(tmp_path / "elsewhere")
    refused(folder, ConfigurationError, r"'white/0_4_1\.png' leads out of .*no link that leads els")


def test_a_link_within_the_folder_is_followed(folder):
    (folder / "white").rename(folder / "ptfe")
    (folder / "white").symlink_to(folder / "ptfe")
    assert rig.check_frames(folder).findings == ()


def test_a_circle_of_links_leads_nowhere(folder):
    (folder / "white/0_4_1.png").unlink()
    (folder / "white/0_4_1.png").symlink_to(folder / "white/0_4_1.png")
    refused(folder, ConfigurationError, "leads out of")


def test_another_ending(folder):
    change(folder, ("{take}.png", "{take}.bmp"))
    refused(
        folder, ConfigurationError,
        r"'dark/0_4_1\.bmp' ends in '\.bmp'; frames are read from \.tif, \.tiff, \.png, \.exr and "
        r"cameras' raw files such as \.dng, \.cr3, \.nef or \.arw\.",
    )  # fmt: skip


def test_a_plan_beyond_all_measure(folder, monkeypatch):
    monkeypatch.setattr(frame_files, "MAX_FRAMES", 17)
    refused(folder, ConfigurationError, "the plan has 18 frames; at most 17 are allowed")


# ---------------------------------------------------------------- names by a table


def rows_of(folder):
    """The small rig as a table: header and rows."""
    rows = [["file", "role", "theta_i_deg", "rotation_deg", "exposure_s", "channel", "take"]]
    for theta_i in rig_files.THETA_I:
        for ms in rig_files.EXPOSURES_MS:
            s = str(ms / 1000)
            for role, name in rig_files.ROLES.items():
                end = f"0_{ms}" if role == "sample" else f"{ms}_1"
                rows.append([f"{name}/{theta_i}_{end}.png", role, str(theta_i), "", s, "", ""])
    return rows


def with_table(folder, rows):
    text = (folder / "session.toml").read_text(encoding="utf-8")
    text = re.sub(r"^pattern.*\n", "", text, flags=re.MULTILINE)
    text = text.replace("[frames]\n", '[frames]\ncsv = "frames.csv"\n')
    (folder / "session.toml").write_text(text, encoding="utf-8")
    lines = "\n".join(",".join(row) for row in rows)
    (folder / "frames.csv").write_text(lines, encoding="utf-8")
    return folder


def test_a_table_says_the_same_as_a_pattern(folder, tmp_path):
    by_pattern = rig.import_rig(folder, tmp_path / "a").session
    rows = rows_of(folder)
    with_table(folder, [rows[0], *rows[:0:-1], [""]])  # in any order, with an empty line
    by_table = rig.import_rig(folder, tmp_path / "b").session
    assert by_table.metadata == by_pattern.metadata
    frames = all_frames(by_table)
    for place, frame in all_frames(by_pattern).items():
        np.testing.assert_array_equal(frames[place], frame)


def test_takes_rotations_and_channels_of_a_table(folder):
    with_table(folder, rows_of(folder))
    change(folder, ("rotations_deg = [0.0]", "rotations_deg = [0.0, 90.0]\nrepeats = 2"), COLOURS)
    plan = session_file.read(folder).table.plan
    row = {"theta_i_deg": "30", "exposure_s": "0.032", "channel": "b"}
    sample = row | {"role": "sample", "rotation_deg": "90"}
    assert frame_files._index_of_row(plan, sample, "") == FrameIndex("sample", 1, 1, 1, 1)
    white = row | {"role": "standard", "take": "2"}
    assert frame_files._index_of_row(plan, white, "") == FrameIndex("standard", 1, 1, 1, 1)
    with pytest.raises(DataError, match="rotation_deg = '' is not a number"):
        frame_files._index_of_row(plan, sample | {"rotation_deg": ""}, "line 3")
    with pytest.raises(
        DataError, match=r"take = 3 is not of the plan; 1 to plan\.repeats holds 1, 2"
    ):
        frame_files._index_of_row(plan, white | {"take": "3"}, "line 3")
    with pytest.raises(DataError, match="unknown channel ''"):
        frame_files._index_of_row(plan, white | {"channel": ""}, "line 3")


def test_the_table_names_the_background_of_the_standard(folder):
    with_table(folder, rows_of(folder))
    change(folder, STANDARD_AT_30)
    plan = session_file.read(folder).table.plan
    row = {"theta_i_deg": "30", "exposure_s": "0.004", "role": "background_of_standard"}
    assert frame_files._index_of_row(plan, row, "") == FrameIndex("background", 0, 2, 0, 0)
    assert frame_files._index_of_row(plan, row | {"role": "background"}, "").incidence == 1


def edited(column, value, row=1):
    def edit(rows):
        rows[row][column] = value
        return rows

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (edited(0, "fle", row=0), r"frames\.csv: unknown column 'fle': did you mean 'file'\?"),
        (lambda rows: [row[:4] for row in rows], r"the column exposure_s is missing; the first "
         r"line must name the columns: file, role, theta_i_deg, rotation_deg, exposure_s, "),
        (lambda rows: [], r"the column file is missing"),
        (edited(6, "channel", row=0), r"frames\.csv: a column is named twice\."),
        (lambda rows: [*rows, ["a.png", "sample"]], r"frames\.csv, line 20: has 2 fields and the "
         r"first line names 7\."),
        (edited(1, "bakground"), r"line 2: unknown role 'bakground': did you mean 'background'\? "
         r"Choose from background, sample, standard\."),
        (edited(2, "35"), r"line 2: theta_i_deg = 35 is not of the plan; plan\.theta_i_deg holds "
         r"0, 30\."),
        (edited(4, "4"), r"line 2: exposure_s = 4 is not of the plan; plan\.exposures_s holds "
         r"0\.004, 0\.032, 0\.256\."),
        (edited(3, "45", row=3), r"line 4: rotation_deg = 45 is not of the plan; "
         r"plan\.rotations_deg holds 0\."),
        (edited(6, "2"), r"line 2: take = 2 is not of the plan; 1 to plan\.repeats holds 1\."),
        (edited(5, "red"), r"line 2: unknown channel 'red'"),
        (edited(2, "x"), r"line 2: theta_i_deg = 'x' is not a number\."),
        (edited(4, "0.032"), r"line 5: background at 0 deg, 32 ms is 'dark/0_32_1\.png', and was "
         r"'dark/0_4_1\.png' above; a frame has one file\."),
        (edited(0, "dark/0_32_1.png"), r"line 5: 'dark/0_32_1\.png' is the file of another frame "
         r"in line 2; each frame has a file of its own\."),
        (lambda rows: rows[:-7], r"7 of 18 frames of the plan have no row: .*(; .*){4} and 2 more"),
        (edited(0, "../dark.png"), r"frames: '\.\./dark\.png' leads out of"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_the_table_is_said(folder, edit, message):
    with_table(folder, edit(rows_of(folder)))
    refused(folder, (DataError, ConfigurationError), message)


def test_a_table_that_is_not_there(folder):
    with_table(folder, [])
    (folder / "frames.csv").unlink()
    refused(folder, DataError, r"frames\.csv: cannot be read as a CSV")
    change(folder, ("frames.csv", "../frames.csv"))
    refused(folder, ConfigurationError, r"frames\.csv: '\.\./frames\.csv' leads out of")


# ---------------------------------------------------------------- the standard as a model


def with_model(folder, lines):
    change(folder, ("reflectance = 0.99", "# "), ("rolloff = 0.1", f"{lines}\n# "))


def test_a_standard_by_a_model_is_tabulated(folder):
    from gonio import models
    from gonio.calibration.frames.standard import standard_brdf
    from gonio.geometry import Directions

    with_model(folder, 'model = "oren_nayar"\nparameters = { sigma = 20, rho = 0.98 }')
    found = rig.check_frames(folder)
    certificate = found.metadata.standard
    rng = np.random.default_rng(1)
    theta_r, dphi = np.radians(80) * rng.random(500), 2 * np.pi * rng.random(500)
    for theta_deg in (0, 30):
        theta_i = float(np.radians(theta_deg))
        f = models.get("oren_nayar")(
            Directions(theta_i, 0, theta_r, dphi), sigma=np.radians(20), rho=0.98
        )
        np.testing.assert_allclose(standard_brdf(certificate, theta_i, theta_r, dphi), f, rtol=1e-3)
    assert 0.9 < certificate.reflectance < 1
    assert certificate.uncertainty == 0.005
    told = r"standard: f of oren_nayar \(sigma = 20, rho = 0\.98\), tabulated within \S+ of its "
    assert any(re.match(told, line) for line in found.done)


PI_F0 = 'kind = "pi_f0"'
NO_SHAPE = (("rolloff = 0.1", "# rolloff"), ("reciprocal = false", "#"))


def test_the_kind_of_a_certificate_comes_into_the_session(folder):
    change(folder, (PI_F0, 'kind = "total"'), *NO_SHAPE, ("# rolloff", "u_shape = 0.04 #"))
    certificate = rig.check_frames(folder).metadata.standard
    assert (certificate.kind, certificate.reflectance) == ("total", 0.99)
    assert (certificate.rolloff, certificate.u_shape) == (None, 0.04)


def test_a_certified_list_of_f_comes_into_the_session(folder):
    lines = """brdf.theta_i_deg = [0.0, 0.0]
brdf.theta_r_deg = [15.0, 45.0]
brdf.dphi_deg = [0.0, 0.0]
brdf.brdf = [0.317, 0.314]
brdf.u_brdf = [0.001, 0.001]"""
    change(folder, (PI_F0, 'kind = "brdf_table"'), *NO_SHAPE, ("reflectance = 0.99", f"{lines} #"))
    assert rig.check_frames(folder).metadata.standard.brdf.brdf == (0.317, 0.314)
    change(folder, ("brdf.u_brdf = [0.001, 0.001]", "brdf.u_brdf = [0.001]"))
    refused(folder, ConfigurationError, r"the lists must have one value for each geometry")


def test_a_certificate_that_contradicts_itself_is_refused(folder):
    change(folder, (PI_F0, 'kind = "brdf_table"'))
    refused(folder, ConfigurationError, r"standard: kind brdf_table needs the list brdf")


def test_a_lambertian_standard_is_a_table_of_one(folder):
    with_model(folder, 'model = "lambert"\nparameters = { rho = 0.97 }')
    certificate = rig.check_frames(folder).metadata.standard
    assert certificate.reflectance == pytest.approx(0.97, rel=1e-6)
    assert np.ravel(certificate.table.factor) == pytest.approx([1, 1], rel=1e-6)  # two incidences


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            'model = "lmbert"\nparameters = { rho = 0.9 }',
            "unknown model 'lmbert': did you mean 'la",
        ),
        (
            'model = "ward"\nparameters = { rho_d = 0.9, rho_s = 0.01, alpha_x = 0.2, '
            "alpha_y = 0.2 }",
            r"standard\.model: a white standard looks alike from all sides and ward is not "
            r"isotropic; choose an isotropic model, such as oren_nayar\.",
        ),
        (
            'model = "oren_nayar"\nparameters = { rho = 0.9 }',
            r"standard\.parameters: sigma of oren_nayar is missing; give all of rho, sigma\.",
        ),
        (
            'model = "oren_nayar"\nparameters = { rho = 0.9, sigma = 200 }',
            r"standard\.parameters: sigma = 200 deg is out of range; allowed is 0 to 60 deg\.",
        ),
        (
            'model = "oren_nayar"\nparameters = { rho = 0.9, sgma = 2 }',
            "unknown parameter 'sgma' of oren_nayar: did you mean 'sigma'",
        ),
        (
            'model = "ward_isotropic"\nparameters = { rho_d = 0.7, rho_s = 0.1, alpha = 0.02 }',
            r"standard\.model: f of ward_isotropic with these parameters changes too fast to be "
            r"tabulated \(error \S+ with steps of 0\.5 deg\); a white standard is nearly matt\.",
        ),
        (
            'model = "lambert"\nparameters = { rho = 0 }',
            r"lambert with these parameters reflects 0 of the light at 8 deg; a standard reflects "
            r"more than 0 and at most 1\.",
        ),
    ],
)
def test_models_that_no_standard_follows(folder, lines, message):
    with_model(folder, lines)
    refused(folder, ConfigurationError, message)


# ---------------------------------------------------------------- faults of the frames


def test_exchanged_exposures_are_reported_with_their_files(folder):
    a, b = folder / "white/30_32_1.png", folder / "white/30_256_1.png"
    a.rename(folder / "x.png")
    b.rename(a)
    (folder / "x.png").rename(b)
    found = codes(rig.check_frames(folder))
    assert "white/30_256_1.png" in found["exposure_order"].text
    assert found["exposure_order"].severity == "error"


def test_a_file_copied_over_another(folder):
    shutil.copy(folder / "white/30_32_1.png", folder / "white/0_32_1.png")
    found = codes(rig.check_frames(folder))
    assert "same_frame" not in found  # which says the same
    finding = found["same_file"]
    assert finding.text == (
        "white/30_32_1.png: is white/0_32_1.png, byte for byte; noise never comes twice. One of "
        "the two was copied over the other: take it again."
    )


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("sample/30_0_256.png", "sample at 30 deg, 256 ms"),
        ("white/0_32_1.png", "standard at 0 deg"),
    ],
)
def test_an_empty_frame(folder, name, what):
    rig_files.write(folder / name, np.full((96, 96), 64, np.uint16))
    finding = codes(rig.check_frames(folder))["empty_frame"]
    assert finding.severity == "error"
    assert finding.text.startswith(f"{name}: {what}")
    assert finding.text.endswith(
        "every count is 64; no light reached the camera or the file is empty. Take the frame again."
    )


def test_a_dark_short_exposure_may_have_one_count_only(folder):
    rig_files.write(folder / "dark/0_4_1.png", np.full((96, 96), 64, np.uint16))
    assert "empty_frame" not in codes(rig.check_frames(folder))


def test_a_frame_that_is_saturated_everywhere(folder):
    for ms in rig_files.EXPOSURES_MS:
        rig_files.write(folder / f"white/30_{ms}_1.png", np.full((96, 96), 4095, np.uint16))
    found = codes(rig.check_frames(folder))
    assert found["saturated_frame"].text == (
        "white/30_4_1.png: standard at 30 deg, 4 ms: every pixel is saturated in the shortest "
        "exposure; take a shorter one."
    )
    assert "empty_frame" not in found


def test_8_bits_in_a_container_of_16(folder):
    rig_files.convert(folder, ".png", lambda image: image >> 4)
    finding = codes(rig.check_frames(folder))["fewer_bits"]
    assert finding.severity == "error"
    assert re.match(
        r"\w+/\d+_\w+\.png: \d+ pixels have 254 counts and none of any frame has more; that is "
        r"what 8 bits hold, and "
        r"camera\.saturation_dn is 4095: saturated pixels would pass for good ones\. ",
        finding.text,
    )


def test_8_bits_cannot_hold_the_saturation_of_12(folder):
    rig_files.convert(folder, ".png", lambda image: (image >> 4).astype(np.uint8))
    refused(
        folder, ConfigurationError,
        r"camera\.saturation_dn = 4095, and the frames hold 8 bits, 255 counts at most; correct "
        r"it, with black_dn and gain_dn_per_e, or write the frames with all bits of the camera\.",
    )  # fmt: skip


def test_frames_of_8_bits(folder, tmp_path):
    rig_files.convert(folder, ".png", lambda image: (image >> 4).astype(np.uint8))
    change(
        folder,
        ("saturation_dn = 4095", "saturation_dn = 255"),
        ("black_dn = 64.0", "black_dn = 3.5"),  # 64/16, and what cutting four bits off loses
        ("gain_dn_per_e = 0.1", "gain_dn_per_e = 0.00625"),
    )
    found = rig.import_rig(folder, tmp_path / "s")
    assert not [finding for finding in found.findings if finding.severity == "error"]
    frame = found.session.frame("standard", 0, 0, 1)
    assert frame.dtype == np.uint16
    counts = rig_files.pixels(rig_files.DEMO / "white/0_32_1.png")
    np.testing.assert_array_equal(frame, counts >> 4)


def test_counts_at_the_upper_end_of_16_bits_are_divided(folder, tmp_path):
    plain = all_frames(rig.import_rig(folder, tmp_path / "a").session)
    rig_files.convert(folder, ".png", lambda image: image << 4)
    change(folder, ("[frames]\n", "[frames]\ndivide_by = 16\n"))
    found = rig.import_rig(folder, tmp_path / "b")
    assert "counts divided by 16" in found.done[0]
    for place, frame in all_frames(found.session).items():
        np.testing.assert_array_equal(frame, plain[place])
    counts = rig_files.pixels(folder / "dark/0_32_1.png")
    counts[3, 3] += 1
    rig_files.write(folder / "dark/0_32_1.png", counts)
    refused(
        folder, DataError,
        r"dark/0_32_1\.png: 1 of 9216 counts are no multiples of frames\.divide_by = 16; dividing "
        r"them would round them off\.",
    )  # fmt: skip


# ---------------------------------------------------------------- the command


def test_the_template_is_printed_or_written_but_not_over_a_file(command, tmp_path):
    assert command("import", "--template")[:2] == (0, TEMPLATE)
    path = tmp_path / "session.toml"
    code, out, _ = command("import", "--template", "-o", path)
    assert code == 0
    assert out == f"{path}: fill it in, then run 'gonio import --check {tmp_path}'.\n"
    assert path.read_text(encoding="utf-8") == TEMPLATE
    code, _, err = command("import", "--template", "-o", path)
    assert (code, err) == (2, f"Error: {path}: exists and is not overwritten; give another name.\n")


def test_the_demo_is_not_written_over_files(command, tmp_path):
    (tmp_path / "a").touch()
    code, _, err = command("import", "--demo", tmp_path)
    assert code == 2
    assert err == f"Error: {tmp_path}: exists and is not an empty folder; give another name.\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["import"], "give a RIG_FOLDER; 'gonio import --template' writes the session.toml that "),
        (["import", "rig"], "give -o SESSION to import or --check to check; neither was given."),
        (["import", "rig", "--check", "-o", "s"], "to check; both were given."),
        (["import", "--template", "rig"], "--template stands alone; leave RIG_FOLDER out."),
        (["import", "--template", "--demo", "d"], "--template stands alone; leave --demo out."),
        (["import", "--demo", "d", "--check"], "--demo stands alone; leave --check out."),
        (["import", "--demo", "d", "-o", "s"], "--demo stands alone; leave -o out."),
    ],
)
def test_options_that_do_not_go_together(command, words, message):
    code, _, err = command(*words)
    assert code == 2
    assert message in err


def test_json_is_one_document(command, folder, tmp_path):
    code, out, err = command("import", folder, "-o", tmp_path / "s", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["schema"] == "gonio.import/1"
    assert (document["frames"], document["frames_added"]) == (18, 18)
    assert (document["rows"], document["columns"]) == (96, 96)
    assert document["session"] == str(tmp_path / "s")
    assert document["warnings"] == document["findings"] == []
    assert "importing rig: 18 of 18 frames" in err
    document = json.loads(command("import", folder, "--check", "--json")[1])
    assert document["session"] is None


def test_errors_of_frames_end_with_exit_code_3(command, folder, tmp_path):
    shutil.copy(folder / "white/30_32_1.png", folder / "white/0_32_1.png")
    code, out, err = command("import", folder, "--check")
    assert code == 3
    assert "error: white/30_32_1.png: is white/0_32_1.png, byte for byte" in out
    assert f"{folder}: 18 frames of 96 x 96 pixels, not in order.\n" in out
    assert re.search(r"Error: \S+rig: \d errors in the frames, said above\.\n$", err)
    code, out, err = command("import", folder, "-o", tmp_path / "s")
    assert code == 3
    assert f"The session is in {tmp_path / 's'}; after files are replaced the same command" in err
    rig_files.copy(folder, "white/0_32_1.png")
    code, out, err = command("import", folder, "-o", tmp_path / "s")
    assert (code, out.splitlines()[-1]) == (
        0, f"{tmp_path / 's'}: 18 frames of 96 x 96 pixels, 17 of them from before."
    )  # fmt: skip


def test_an_interruption_says_what_is_safe(command, folder, tmp_path, monkeypatch):
    from gonio.rig import importing

    def interrupted(*arguments, **named):
        yield from ()
        raise KeyboardInterrupt

    rig.import_rig(folder, tmp_path / "s")
    monkeypatch.setattr(importing, "_read_all", interrupted)
    code, _, err = command("import", folder, "-o", tmp_path / "s")
    assert code == 4
    assert err.endswith(
        "interrupted; run the same command again to continue. 18 of 18 frames are safe in "
        f"{tmp_path / 's'}.\n"
    )


def test_a_faulty_frame_is_said_without_opencv_talking(folder, capfd):
    file = folder / "sample/0_0_4.png"
    file.write_bytes(file.read_bytes()[:-300])
    refused(folder, DataError, r"sample/0_0_4\.png: cannot be decoded")
    assert "WARN" not in capfd.readouterr().err


def test_a_mirror_is_imported_for_the_alignment(folder, tmp_path):
    change(
        folder,
        ("rotations_deg = [0.0]", 'rotations_deg = [0.0]\nmode = "mirror"'),
        ("[0.0, 30.0]", "[-30.0, 0.0, 30.0]"),
    )
    for name in ("dark/{}_{}_1.png", "sample/{}_0_{}.png"):
        for ms in rig_files.EXPOSURES_MS:
            counts = rig_files.pixels(folder / name.format(30, ms))
            rig_files.write(folder / name.format(-30, ms), counts[:, ::-1])
    session = rig.import_rig(folder, tmp_path / "s").session
    assert session.complete
    assert session.metadata.plan.theta_i_deg == (-30, 0, 30)


def test_demo_folder_is_small():
    files = [path for path in Path(rig_files.DEMO).rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 1.5e6
