"""What the import reads and refuses: headers, decoding, floats, EXR, raw files."""

from __future__ import annotations

import struct
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rig_files
from rig_files import change, small_rig

from gonio import rig
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.errors import ConfigurationError, DataError
from gonio.rig import headers, raw
from gonio.rig.headers import Header, read_header
from gonio.rig.pictures import Sampling
from gonio.rig.raw import RawHeader
from gonio.rig.tables import FramesTable


@pytest.fixture
def folder(tmp_path):
    return small_rig(tmp_path / "rig")


def refused(folder, error, message):
    with pytest.raises(error, match=message):
        rig.check_frames(folder)


# ---------------------------------------------------------------- headers


@pytest.mark.parametrize("ending", [".png", ".tif"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_headers_say_what_opencv_wrote(tmp_path, ending, kind):
    path = tmp_path / f"a{ending}"
    rig_files.write(path, np.zeros((5, 7), kind))
    header = read_header(path, "a")
    assert (header.rows, header.columns, header.bits) == (5, 7, np.dtype(kind).itemsize * 8)
    assert not header.is_float


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_headers_of_float_tiff(tmp_path, kind):
    rig_files.write(tmp_path / "a.tif", np.zeros((5, 7), kind))
    bits = np.dtype(kind).itemsize * 8
    assert read_header(tmp_path / "a.tif", "a") == Header("TIFF", 5, 7, bits, is_float=True)


def page(**other):
    return rig_files.tiff([rig_files.grey(**other)])


# A page of a BigTIFF: 16 bits, 6 x 4 pixels; each entry is tag, kind, number and value.
BIG_TIFF = b"II" + struct.pack("<HHHQ", 43, 8, 0, 16) + struct.pack("<Q", 3)
BIG_TIFF += b"".join(struct.pack("<HHQQ", t, 3, 1, v) for t, v in ((256, 6), (257, 4), (258, 16)))
BIG_TIFF += bytes(8)


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("a.tif", page(), Header("TIFF", 4, 6, 16)),
        ("a.TIF", rig_files.tiff([rig_files.grey()], order=">"), Header("TIFF", 4, 6, 16)),
        ("a.tif", BIG_TIFF, Header("TIFF", 4, 6, 16)),
        (
            "a.tiff",
            rig_files.tiff([rig_files.grey(), rig_files.grey(2, 3, t254=("I", [1]))]),
            Header("TIFF", 4, 6, 16),  # the second page is a small copy
        ),
        ("a.exr", rig_files.exr_header({"Y": 2}), Header("EXR", 4, 6, 32, is_float=True)),
        ("a.exr", rig_files.exr_header({"R": 1}), Header("EXR", 4, 6, 16, is_float=True)),
        ("a.png", rig_files.png_header(6, 4, 16, 0), Header("PNG", 4, 6, 16)),
    ],
)
def test_headers_byte_by_byte(tmp_path, name, data, expected):
    (tmp_path / name).write_bytes(data)
    assert read_header(tmp_path / name, name) == expected


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.png", b"", r"a\.png: the file is empty\."),
        ("a.png", page(), r"a\.png: is not a PNG file, whatever its name says\."),
        ("a.tif", b"\x89PNG\r\n\x1a\n", r"is not a TIFF file, whatever its name says\."),
        ("a.tif", b"II\x2b\x01" + bytes(9), r"is not a TIFF file"),
        ("a.exr", b"II*\0\0\0\0\0", r"is not a EXR file"),
        ("a.tif", page()[:40], r"the TIFF header cannot be understood; the file is truncated or "),
        ("a.tif", b"II*\0\x08\0\0\0\xff\xff", r"the TIFF header cannot be understood"),
        (
            "a.tif", b"II*\0" + struct.pack("<IHI", 8, 0, 8),
            r"the TIFF header cannot be understood",  # a page that is its own successor
        ),
        ("a.exr", rig_files.exr_header({"Y": 2})[:30], r"the EXR header cannot be understood"),
        ("a.exr", rig_files.exr_header({})[:8] + b"\0", r"the EXR header cannot be understood"),
        ("a.png", rig_files.png_header(6, 4, 8, 2), r"a\.png: has 3 channels and should be grey, "
         r"one raw count a pixel: write frames without colour and alpha, or hand over the camera's "
         r"raw files\."),
        ("a.png", rig_files.png_header(6, 4, 8, 6), r"has 4 channels and should be grey"),
        ("a.png", rig_files.png_header(6, 4, 16, 4), r"has 2 channels and should be grey"),
        ("a.png", rig_files.png_header(6, 4, 8, 3), r"holds colours of a palette and should be"),
        ("a.png", rig_files.png_header(6, 4, 4, 0), r"holds integers of 4 bits; write frames with "
         r"8 or 16 bits a pixel\."),
        ("a.tif", page(t277=("H", [3]), t262=("H", [2]), t258=("H", [16, 16, 16])),
         r"is an RGB picture and should be grey"),
        ("a.tif", page(t277=("H", [2]), t258=("H", [16, 16])), r"has 2 channels and should be"),
        ("a.tif", page(t262=("H", [3])), r"holds colours of a palette and should be grey"),
        ("a.tif", page(t262=("H", [32803])), r"holds the colour mosaic of a raw file; name it "
         r"\.dng, so that it is read as one, and choose frames\.plane\."),
        ("a.tif", page(t262=("H", [0])), r"is stored as a negative \(white is 0\); write counts "),
        ("a.tif", page(t274=("H", [3])), r"is marked as turned or mirrored \(TIFF orientation 3\)"),
        ("a.tif", page(t339=("H", [2])), r"holds signed integers of 16 bits; write frames as uns"),
        ("a.tif", page(t339=("H", [3])), r"holds floats of 16 bits; write frames as unsigned"),
        ("a.tif", page(t258=("H", [12])), r"holds integers of 12 bits; write frames with 8 or 16"),
        ("a.tif", rig_files.tiff([rig_files.grey(), rig_files.grey()]), r"holds 2 pages; write one "
         r"frame to a file\."),
        ("a.exr", rig_files.exr_header({"B": 2, "G": 2, "R": 2}), r"has 3 channels \(B, G, R\) and "
         r"should be grey"),
        ("a.exr", rig_files.exr_header({"Y": 0}), r"holds integers of 32 bits; write EXR frames "),
        ("a.exr", rig_files.exr_header({"Y": 2}, flags=0x10), r"holds several parts or deep pixel"),
        ("a.png", rig_files.png_header(1 << 15, 1 << 14, 16, 0), r"32768 x 16384 pixels; frames of "
         r"1 to 268435456 pixels are allowed\."),
        ("a.exr", rig_files.exr_header({"Y": 2}, columns=-5), r"a\.exr: -5 x 4 pixels; frames of"),
    ],
)  # fmt: skip
def test_headers_that_are_refused(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(DataError, match=message):
        read_header(tmp_path / name, name)


def test_a_file_that_is_far_too_large_is_not_read(folder, monkeypatch):
    monkeypatch.setattr(headers, "_SLACK_BYTES", 1000)
    path = folder / "white/0_4_1.png"
    path.write_bytes(path.read_bytes() + bytes(40_000))
    message = r"white/0_4_1\.png: the file has \d{5} bytes, far more than 96 x 96 pixels need; it"
    refused(folder, DataError, message)


# ---------------------------------------------------------------- frames that differ, damage


def test_a_frame_of_another_size(folder):
    for name in ("sample/30_0_4.png", "sample/30_0_32.png", "white/0_4_1.png"):
        rig_files.write(folder / name, np.zeros((64, 96), np.uint16))
    refused(
        folder, DataError,
        r"white/0_4_1\.png: has 96 x 64 pixels and most of the others do not: has 96 x 96 pixels "
        r"\(so are 2 more\); frames of a session have one size, that of the camera's window\.",
    )  # fmt: skip


def test_8_bits_among_16(folder):
    rig_files.write(folder / "sample/30_0_4.png", np.zeros((96, 96), np.uint8))
    refused(
        folder, DataError,
        r"sample/30_0_4\.png: holds 8-bit integer counts and most of the others do not: holds "
        r"16-bit integer counts; one gain, black level and saturation hold for all frames: write "
        r"all with the same bits\.",
    )  # fmt: skip


@pytest.mark.parametrize("ending", [".png", ".tif"])
def test_a_truncated_picture(folder, ending):
    rig_files.convert(folder, ending)
    path = folder / f"white/30_32_1{ending}"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    # A TIFF may have its header behind the pixels.
    what = "cannot be decoded" if ending == ".png" else "the TIFF header cannot be understood"
    refused(folder, DataError, rf"white/30_32_1\{ending}: {what}; the file is truncated or damaged")


def test_pixels_that_are_not_as_the_header_says(folder, monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", lambda data, flags: np.zeros((96, 96, 3), np.uint16))
    refused(
        folder, DataError,
        r"dark/0_4_1\.png: decodes to uint16 of shape \(96, 96, 3\), and its header says 16-bit "
        r"integer of shape \(96, 96\); the file is damaged\.",
    )  # fmt: skip


def test_opencv_that_raises(folder, monkeypatch):
    def fail(data, flags):
        raise cv2.error("no")

    monkeypatch.setattr(cv2, "imdecode", fail)
    refused(folder, DataError, r"dark/0_4_1\.png: cannot be decoded; ")


# ---------------------------------------------------------------- floats


def frames_of(folder, tmp_path, name):
    session = rig.import_rig(folder, tmp_path / name).session
    return [session.bracket(*image) for image in session.metadata.plan.images()]


@pytest.mark.parametrize(("unit", "kind"), [(1, np.float32), (65535, np.float32), (4095, float)])
def test_floats_stand_for_counts(folder, tmp_path, unit, kind):
    plain = frames_of(folder, tmp_path, "a")
    rig_files.convert(folder, ".tif", lambda image: (image / unit).astype(kind))
    change(folder, ("[frames]\n", f"[frames]\ncounts_per_unit = {unit}\n"))
    np.testing.assert_array_equal(frames_of(folder, tmp_path, "b"), plain)
    assert f"1.0 is {unit} counts" in rig.check_frames(folder).done[0]


def test_floats_without_a_scale(folder):
    rig_files.convert(folder, ".tif", lambda image: image.astype(np.float32))
    refused(
        folder, ConfigurationError,
        r"dark/0_4_1\.tif: holds floats; say in frames\.counts_per_unit how many counts 1\.0 "
        r"stands for: 1 where they are counts, 65535 where 16 bits were scaled to 0 to 1\.",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.nan, r"white/0_4_1\.tif: 1 of 9216 pixels are NaN or infinite; take the frame again"),
        (np.inf, r"white/0_4_1\.tif: 1 of 9216 pixels are NaN or infinite"),
        (-3.0, r"1 of 9216 pixels are below 0; give raw counts, not frames from which something"),
        (70.5, r"1 of 9216 pixels are not whole counts; give raw frames, not processed ones\."),
        (7e4, r"counts reach 70000 with frames\.counts_per_unit = 1, and a frame holds 65535 at"),
    ],
)
def test_floats_that_are_no_counts(folder, value, message):
    rig_files.convert(folder, ".tif", lambda image: image.astype(np.float32))
    change(folder, ("[frames]\n", "[frames]\ncounts_per_unit = 1\n"))
    image = rig_files.pixels(folder / "white/0_4_1.tif")
    image[50, 50] = value
    rig_files.write(folder / "white/0_4_1.tif", image)
    refused(folder, DataError, message)


def test_a_scale_is_for_floats(folder):
    change(folder, ("[frames]\n", "[frames]\ncounts_per_unit = 65535\n"))
    refused(
        folder, ConfigurationError,
        r"frames\.counts_per_unit is for frames of floats and dark/0_4_1\.png holds 16-bit integer "
        r"counts; leave it out\.",
    )  # fmt: skip


# ---------------------------------------------------------------- EXR


def write_exr(path, image):
    exr = pytest.importorskip("OpenEXR", reason="the extra 'exr' is not installed")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File(header, {"Y": image}).write(str(path))


def as_exr(folder):
    change(folder, (".png", ".exr"), ("[frames]\n", "[frames]\ncounts_per_unit = 1\n"))
    for path in sorted(folder.rglob("*.png")):
        write_exr(path.with_suffix(".exr"), rig_files.pixels(path).astype(np.float32))
        path.unlink()


def test_exr_frames(folder, tmp_path):
    plain = frames_of(folder, tmp_path, "a")
    as_exr(folder)
    np.testing.assert_array_equal(frames_of(folder, tmp_path, "b"), plain)


def test_a_truncated_exr(folder):
    as_exr(folder)
    path = folder / "white/30_32_1.exr"
    path.write_bytes(path.read_bytes()[:-500])
    refused(folder, DataError, r"white/30_32_1\.exr: cannot be decoded \(.*\); the file is trunc")


def test_exr_without_its_library(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    change(folder, (".png", ".exr"), ("[frames]\n", "[frames]\ncounts_per_unit = 1\n"))
    for path in sorted(folder.rglob("*.png")):
        path.with_suffix(".exr").write_bytes(rig_files.exr_header({"Y": 2}, 96, 96))
    refused(
        folder, ConfigurationError,
        r"dark/0_4_1\.exr: EXR files are read by OpenEXR, which is not installed; run 'python -m "
        r"pip install OpenEXR', or write the frames as TIFF of 32-bit floats\.",
    )  # fmt: skip


# ---------------------------------------------------------------- raw files

MOSAIC = RawHeader("raw", 8, 12, 16, pattern="RGGB", black=(60, 62, 64, 66), white=4095)


def sampling(plane, header=MOSAIC, **other):
    return Sampling.of(header, FramesTable(pattern="x", plane=plane, **other), "a.dng")


@pytest.mark.parametrize(
    ("plane", "places", "black"),
    [
        ("red", {(0, 0)}, 60),
        ("green", {(0, 1), (1, 0)}, 63),
        ("green1", {(0, 1)}, 62),
        ("green2", {(1, 0)}, 64),
        ("blue", {(1, 1)}, 66),
    ],
)
def test_planes_of_a_mosaic(plane, places, black):
    found = sampling(plane)
    assert set(found.positions) == places
    assert MOSAIC.black_of(found.positions) == black
    assert found.shape == (4, 6)
    assert (found.step, found.n_summed) == (2, len(places))
    # The middle of the pixels that are used is where the session's pixel lies.
    row, column = np.mean(list(places), axis=0)
    assert found.moved((column + 2 * 5, row + 2 * 3)) == (5, 3)


def test_a_plane_with_region_and_binning():
    found = sampling("green", region_px=(2, 0, 4, 4), binning=2)
    assert (found.shape, found.step, found.n_summed) == ((2, 2), 4, 8)
    image = np.arange(8 * 12).reshape(8, 12)
    camera = SimpleNamespace(
        black_dn=0.0, saturation_dn=8 * 1000, gain_dn_per_e=1.0, full_well_e=1e9
    )
    cells = image[0::2, 1::2] + image[1::2, 0::2]
    expected = cells[:, 2:6].reshape(2, 2, 2, 2).sum(axis=(1, 3))
    np.testing.assert_array_equal(found.sampled(image, camera), expected)
    # Sensor column 8.5 is the middle of cell 4, the border of two blocks of two from cell 2 on.
    assert found.moved((8.5, 2.5)) == (0.75, 0.25)


def test_planes_that_are_refused():
    with pytest.raises(ConfigurationError, match=r"say in frames\.plane which are used: green \("):
        sampling(None)
    with pytest.raises(
        ConfigurationError,
        match=r"a\.dng: the sensor has filters RGGB and frames\.plane is 'mono'; allowed is red, ",
    ):
        sampling("mono")
    plain = RawHeader("raw", 8, 12, 16)
    assert sampling("mono", plain).shape == (8, 12)
    with pytest.raises(ConfigurationError, match=r"no colour filters and .* allowed is mono\."):
        sampling("red", plain)
    other = RawHeader("raw", 8, 12, 16, pattern="CYGM", black=(0, 0, 0, 0))
    with pytest.raises(ConfigurationError, match=r"are CYGM and none of them is red\."):
        sampling("red", other)


def stub(**figures):
    """What rawpy knows of a file."""
    sizes = SimpleNamespace(height=8, width=12, top_margin=1, left_margin=3)
    known = {
        "sizes": sizes, "raw_type": SimpleNamespace(name="Flat"), "num_colors": 3,
        "black_level_per_channel": [1, 2, 3, 4], "white_level": 1023, "color_desc": b"RGBG",
        "raw_color": lambda row, column: ((0, 1), (3, 2))[(row + 1) % 2][(column + 1) % 2],
    }  # fmt: skip

    class File(SimpleNamespace):
        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

    return SimpleNamespace(imread=lambda path: File(**(known | figures)))


def test_what_a_raw_file_says(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rawpy", stub())
    assert raw.read_raw_header(tmp_path, "a.dng") == RawHeader(
        "raw", 8, 12, 16, pattern="RGGB", black=(1, 2, 4, 3), white=1023
    )
    monkeypatch.setitem(sys.modules, "rawpy", stub(num_colors=1))
    assert raw.read_raw_header(tmp_path, "a.dng").pattern == ""


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"raw_type": SimpleNamespace(name="Stack")}, r"a\.raf: its pixels hold several colours"),
        (
            {"raw_color": lambda row, column: (row + column) % 3},
            r"a\.raf: its colour filters do not repeat every 2 x 2 pixels; such sensors are not "
            r"read, write the frames as TIFF\.",
        ),
        ({"sizes": SimpleNamespace(height=1 << 15, width=1 << 15)}, r"a\.raf: 32768 x 32768 pixel"),
    ],
)
def test_sensors_that_are_not_read(monkeypatch, tmp_path, figures, message):
    monkeypatch.setitem(sys.modules, "rawpy", stub(**figures))
    with pytest.raises(DataError, match=message):
        raw.read_raw_header(tmp_path, "a.raf")


def mosaic_of(image):
    """A mosaic whose green pixels hold an image twice, the others something else."""
    rows, columns = image.shape
    full = np.full((2 * rows, 2 * columns), 500, np.uint16)
    full[0::2, 1::2] = image
    full[1::2, 0::2] = image
    return full


def as_dng(folder):
    change(
        folder,
        (".png", ".dng"),
        ("[frames]\n", '[frames]\nplane = "green"\n'),
        ("pitch_um = [59.8, 59.8]", "pitch_um = [29.9, 29.9]"),
    )
    for path in sorted(folder.rglob("*.png")):
        path.with_suffix(".dng").write_bytes(rig_files.dng(mosaic_of(rig_files.pixels(path))))
        path.unlink()


def test_raw_files_give_the_sum_of_both_greens(folder, tmp_path):
    pytest.importorskip("rawpy", reason="the extra 'raw' is not installed")
    plain = frames_of(folder, tmp_path, "a")
    before = rig.check_frames(folder).metadata
    as_dng(folder)
    # Both pixels are saturated, or neither: from 98 % of the full well, at 4064 counts, on.
    full = np.array(plain) >= 64 + 0.98 * (4064 - 64)
    expected = np.where(full, 2 * 4095, 2 * np.array(plain))
    np.testing.assert_array_equal(frames_of(folder, tmp_path, "b"), expected)
    found = rig.check_frames(folder)
    assert found.done[0] == (
        "raw frames of 192 x 192 pixels, 16-bit integer; green of the filters RGGB, the sum of "
        "both greens of every 2 x 2: 96 x 96 in the session"
    )
    camera = found.metadata.camera
    assert (camera.black_dn, camera.saturation_dn, camera.full_well_e) == (128, 8190, 80_000)
    # The pixels of the session look where they did.
    columns, rows = np.meshgrid(np.arange(96), np.arange(96))
    old, new = (PixelMap.of(m).directions(columns, rows) for m in (before, found.metadata))
    np.testing.assert_allclose(new, old, atol=1e-12)


def test_raw_files_know_black_level_and_saturation(folder):
    pytest.importorskip("rawpy", reason="the extra 'raw' is not installed")
    as_dng(folder)
    change(folder, ("black_dn = 64.0", "# "), ("saturation_dn = 4095", "# "))
    found = rig.check_frames(folder)
    assert "camera: black_dn = 64 and saturation_dn = 4095, as the raw files say" in found.done
    assert found.metadata.camera.black_dn == 128


def test_damaged_and_foreign_raw_files(folder):
    pytest.importorskip("rawpy", reason="the extra 'raw' is not installed")
    as_dng(folder)
    path = folder / "white/30_32_1.dng"
    whole = path.read_bytes()
    path.write_bytes(b"no raw file")
    refused(folder, DataError, r"white/30_32_1\.dng: LibRaw cannot read it \(.*\)\.$")
    path.write_bytes(whole[:-1000])
    refused(folder, DataError, r"white/30_32_1\.dng: LibRaw cannot read it \(Input/output error\)")
    mosaic = mosaic_of(rig_files.pixels(rig_files.DEMO / "white/30_32_1.png"))
    path.write_bytes(rig_files.dng(mosaic, black=60))
    refused(
        folder, DataError,
        r"white/30_32_1\.dng: has the filters RGGB, black levels \(60\.0, .*; raw frames of a "
        r"session come from one camera with one setting\.",
    )  # fmt: skip


def test_raw_among_other_frames(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", stub())
    change(folder, ('{take}.png"\npattern_of_standard', '{take}.dng"\npattern_of_standard'))
    for path in sorted((folder / "dark").iterdir()):
        path.rename(path.with_suffix(".dng"))
    refused(folder, DataError, r"dark/0_4_1\.dng: is a raw file and most of the others do not: is ")


def test_raw_files_without_rawpy(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    change(folder, (".png", ".nef"))
    for path in sorted(folder.rglob("*.png")):
        path.rename(path.with_suffix(".nef"))
    refused(
        folder, ConfigurationError,
        r"dark/0_4_1\.nef: raw files are read by rawpy, which is not installed; run 'python -m pip "
        r"install rawpy', or write the frames as TIFF\.",
    )  # fmt: skip
