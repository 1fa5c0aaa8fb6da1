"""`gonio boards`, `gonio calibrate lens`: from rendered photographs to the record of the lens."""

from __future__ import annotations

import json
import re
import shutil
import tomllib

import cv2
import numpy as np
import pytest

from gonio import cli, instrument
from gonio.board import Board
from gonio.calibration.lens import lens_file
from gonio.calibration.lens import projection as lens
from gonio.calibration.lens.from_photos import calibrate_lens
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import unit_vectors
from gonio.instrument.board_camera import BoardCamera
from gonio.metadata import Camera, LensCalibration

PITCH_UM = 6.9  # modern12 binned 2 x 2
OFFSET = ("--centre-offset-px", "5,-3")
BOARD = Board()
RIG = instrument.preset("modern12")
CAMERA = BoardCamera.of(RIG, binning=2, centre_offset_px=(5, -3), psf_px=0.8)


def run(capsys, *words):
    """Exit code, stdout and stderr of a command in this process."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as left:
        cli.main([str(word) for word in words])
    return left.value.code, *capsys.readouterr()


@pytest.fixture
def gonio(capsys):
    return lambda *words: run(capsys, *words)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """A dozen photographs of a charuco board, 8 bits, 832 x 832."""
    folder = tmp_path_factory.mktemp("boards") / "photos"
    words = ["boards", "-o", folder, "--count", 12, "--binning", 2, "--psf-px", 0.8, "--seed", 4]
    with pytest.raises(SystemExit) as left:
        cli.main([*map(str, words), *OFFSET])
    assert left.value.code == 0
    return folder


@pytest.fixture(scope="module")
def calibrated(photos, tmp_path_factory):
    """Folder with what `gonio calibrate lens` made of them."""
    out = tmp_path_factory.mktemp("calibrated")
    words = ["calibrate", "lens", photos, "-o", out / "lens.json", "--pitch-um", PITCH_UM]
    words += ["--frame-binning", 2, "--map", out / "map.png"]
    with pytest.raises(SystemExit) as left:
        cli.main([str(word) for word in words])
    assert left.value.code == 0
    return out


@pytest.fixture
def document(calibrated):
    return json.loads((calibrated / "lens.json").read_text())


def frames_of(columns=416, rows=416, pitch_mm=4 * 3.45e-3):
    return Camera(
        rows=rows, columns=columns, pitch_mm=(pitch_mm, pitch_mm), gain_dn_per_e=1, black_dn=0,
        saturation_dn=4095, full_well_e=1e4, noise_dn=1, dark_e_per_s=0,
    )  # fmt: skip


def said_directions(record, camera, columns, rows):
    """Where the reduction says that pixels of a session's frames look."""
    theta, phi = lens.camera_angles(record, *lens.pixel_positions(camera, columns, rows, record))
    return unit_vectors(theta, phi)


# ---------------------------------------------------------------- the photographs


def test_photographs_and_their_report(photos, gonio, tmp_path):
    assert sorted(path.name for path in photos.iterdir())[-2:] == ["photo_11.png", "truth"]
    code, out, err = gonio("boards", "-o", tmp_path / "b", "--count", 2, "--binning", 8, "--json")
    assert code == 0
    said = json.loads(out)
    assert len(said["photos"]) == 2
    assert said["pitch_um"] == pytest.approx([27.6, 27.6])
    assert "2 of 2 photographs" in err


def test_a_board_to_print(gonio, tmp_path):
    code, out, err = gonio("boards", "--print", tmp_path / "b.svg", "--squares", "8x6")
    assert (code, out) == (0, "")
    assert "8 x 6 squares of 20 mm" in err
    assert "200 x 160 mm, to be printed at 100 %" in err
    assert (tmp_path / "b.svg").read_text().startswith("<svg")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "give -o FOLDER for photographs or --print BOARD.svg for a board."),
        ("-o OUT --squares 12", "--squares '12' is not COLUMNSxROWS such as 12x9."),
        ("-o OUT --squares 3x9", "a board of 3 x 9 squares is too small;"),
        ("-o OUT --dictionary 4x4", "unknown dictionary '4x4': did you mean '4x4_"),
        ("-o OUT --binning 5", "binning 5 does not divide the 1664 x 1664 pixels of modern12."),
        ("-o OUT --centre-offset-px 3", "--centre-offset-px '3' is not two numbers such as 3.5,-2"),
        ("-o OUT --psf-px -1", "psf_px = -1 is out of range; allowed is 0 to 50."),
        ("-o OUT --field-deg 400", "field_deg = 400 is out of range; allowed is 0 to 300."),
        ("-o OUT --instrument modern", "unknown instrument 'modern': did you mean 'modern1"),
        ("--print OUT.jpg", "a board is written as .svg or .png; give a name that ends so."),
    ],
)
def test_boards_refuses(gonio, tmp_path, words, message):
    code, _, err = gonio("boards", *words.replace("OUT", str(tmp_path / "out")).split())
    assert code == 2
    assert message in err
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- the lens


def test_corners_fit_to_a_fraction_of_a_pixel(document):
    fit = document["fit"]
    assert fit["rms_px"] < 0.15
    assert (fit["n_photos"], fit["n_used"]) == (12, 12)
    # The detectors alone stop a square before the rim.
    assert fit["theta_reached_deg"] > 87
    shown = json.loads((_truth_of(document)).read_text())
    visible = sum(len(photo["corners"]) for photo in shown["photos"])
    assert fit["n_corners"] > 0.95 * visible
    assert sum(photo["corners"] for photo in fit["photos"]) == fit["n_corners"]
    assert fit["warnings"] == []


def _truth_of(document):
    from pathlib import Path

    return Path(document["fit"]["photos"][0]["name"]).parent / "truth" / "truth.json"


@pytest.mark.parametrize(
    ("theta_deg", "limit_deg"),
    [(0.1, 0.02), (30, 0.02), (60, 0.02), (75, 0.02), (85, 0.02), (89.9, 0.05)],
)
def test_a_pixel_of_a_frame_looks_where_the_instrument_says(document, theta_deg, limit_deg):
    # Photographs binned 2 x 2, frames 4 x 4 of the same window: direction -> frame -> direction.
    record = LensCalibration.model_validate(document["lens"])
    frames = BoardCamera.of(RIG, binning=4, centre_offset_px=(5, -3))
    w = unit_vectors(np.radians(theta_deg), np.linspace(-np.pi, np.pi, 36, endpoint=False))
    columns, rows = frames.project(w).T
    said = said_directions(record, frames_of(), columns, rows)
    off = np.degrees(np.linalg.norm(said - w, axis=1))
    assert off.max() < limit_deg


def test_the_centre_is_column_and_row_of_the_frames(document):
    # Window of 1664: middle 207.5 of 416 pixels, the axis 5 and -3 unbinned pixels from there.
    np.testing.assert_allclose(
        document["lens"]["centre_px"], [207.5 + 5 / 4, 207.5 - 3 / 4], atol=0.02
    )
    assert document["frame"] == {"rows": 416, "columns": 416}
    np.testing.assert_allclose(
        CAMERA.centre_px, [4 * (c + 0.5) / 2 - 0.5 for c in (208.75, 206.75)]
    )


def test_errors_are_within_the_stated_uncertainty(document):
    stated = document["lens"]["uncertain"]
    found = [
        document["lens"]["focal_length_mm"], *document["lens"]["k"], *document["lens"]["centre_px"],
    ]  # fmt: skip
    off = np.array(found) - [1.8, *RIG.lens.k, 208.75, 206.75]
    assert stated["names"] == ["focal_length", "k1", "k2", "k3", "k4", "centre_x", "centre_y"]
    # chi2 of 7: 99.99 % lie below 30. Corners of a photograph may err together: a factor of 2.
    assert off @ np.linalg.solve(np.array(stated["covariance"]), off) < 2 * 30
    assert max(document["fit"]["theta_sd_deg"]) < 0.01


def test_opencv_agrees(document):
    fisheye, omnidir = document["fit"]["cross_check"]
    assert (fisheye["name"], omnidir["name"]) == ("cv2.fisheye.calibrate", "cv2.omnidir.calibrate")
    assert max(fisheye["theta_difference_deg"]) < 0.01
    assert max(omnidir["theta_difference_deg"]) < 0.1
    assert fisheye["theta_to_deg"] == [60, 75, 85]


def test_the_residual_map_is_drawn(calibrated):
    image = cv2.imread(str(calibrated / "map.png"))
    assert min(image.shape[:2]) > 600
    # Arrows in blue, circles in orange, on white.
    for colour in ((178, 114, 0), (0, 159, 230)):
        assert np.sum(np.abs(image.astype(int) - colour).max(axis=-1) < 40) > 200


def test_what_is_printed(photos, gonio, tmp_path):
    some = [photos / f"photo_{k:02d}.png" for k in (1, 3, 4, 6)]
    out = tmp_path / "lens.toml"
    code, shown, err = gonio(
        "calibrate", "lens", *some, "-o", out, "--pitch-um", f"{PITCH_UM},{PITCH_UM}"
    )
    assert code == 0
    assert re.search(r"focal_length +│ 1\.\d+ +│ \S+ +│ mm", shown)
    assert "Standard uncertainty of theta at 60, 75, 85, 90 deg: " in shown
    assert "cv2.fisheye.calibrate: rms 0." in shown
    assert f"{out}: 4 of 4 photographs, " in shown
    assert "Warning: only 4 photographs were used; 15 to 30 are better." in err
    document = tomllib.loads(out.read_text())
    read = lens_file.read(out)
    assert read.lens == LensCalibration.model_validate(document["lens"])
    assert (read.rows, read.columns) == (832, 832)
    assert document["fit"]["n_used"] == 4
    # JSON on stdout is the same document.
    code, shown, _ = gonio(
        "calibrate", "lens", *some, "-o", tmp_path / "lens.json", "--pitch-um", PITCH_UM, "--json"
    )
    again = json.loads(shown)
    assert again["lens"] == document["lens"]
    assert again.pop("output") == str(tmp_path / "lens.json")
    assert json.loads((tmp_path / "lens.json").read_text()) == again
    assert lens_file.read(tmp_path / "lens.json") == read


def test_a_photograph_without_the_board_is_left_out(photos, tmp_path):
    paths = [photos / f"photo_{k:02d}.png" for k in (1, 3, 4)]
    image = cv2.imread(str(paths[0]), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "none.png"), image[:, ::-1] // 8)
    found = calibrate_lens([*paths, tmp_path / "none.png"], BOARD, pitch_mm=(0.0069, 0.0069))
    assert found.dropped == {str(tmp_path / "none.png"): "no corner of the board was found"}
    assert len(found.fit.views) == 3


def test_a_narrow_reach_is_a_warning(photos):
    shown = json.loads((photos / "truth" / "truth.json").read_text())["photos"]
    middle = [photos / photo["file"] for photo in shown if photo["theta_max_deg"] < 80]
    found = calibrate_lens(middle, BOARD, pitch_mm=(0.0069, 0.0069))
    (reach, few) = found.warnings()
    assert re.fullmatch(
        r"the corners reach theta = \d\d\.\d deg: beyond it the lens is extrapolated. Photograph "
        r"the board at the rim, to 85 deg and more.",
        reach,
    )
    assert few.startswith(f"only {len(middle)} photographs were used")
    sd = found.fit.theta_sd(np.radians([60.0, 90.0]))
    assert sd[1] > 2 * sd[0]
    with pytest.raises(ConfigurationError, match=r"frames binned 3 x 3 are not made of whole bloc"):
        found.record(3)


# ---------------------------------------------------------------- what is refused


def one_broken(photos, tmp_path, name, content):
    """Two good photographs and one that is not."""
    for k in (0, 1):
        shutil.copy(photos / f"photo_{k:02d}.png", tmp_path)
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        cv2.imwrite(str(path), content)
    return [*sorted(tmp_path.glob("photo_*.png")), path]


def test_a_broken_photograph_is_named(photos, tmp_path, gonio):
    half = (photos / "photo_02.png").read_bytes()[:30]
    paths = one_broken(photos, tmp_path, "shot.png", half)
    code, out, err = gonio(
        "calibrate", "lens", *paths, "-o", tmp_path / "lens.toml", "--pitch-um", PITCH_UM
    )
    assert (code, out) == (3, "")
    assert f"Error: {paths[-1]}: not a readable picture of 8 or 16 bits" in err
    assert not (tmp_path / "lens.toml").exists()


def test_photographs_of_two_sizes(photos, tmp_path):
    paths = one_broken(photos, tmp_path, "shot.png", np.zeros((600, 800), np.uint8))
    with pytest.raises(DataError, match=r"shot.png: has 800 x 600 pixels and .* has 832 x 832; gi"):
        calibrate_lens(paths, BOARD, pitch_mm=(1, 1))


def test_too_few_photographs_show_the_board(photos, tmp_path):
    paths = one_broken(photos, tmp_path, "shot.png", np.full((832, 832), 99, np.uint8))
    with pytest.raises(DataError, match=r"2 of 3 photographs show 8 or more corners"):
        calibrate_lens(paths, BOARD, pitch_mm=(1, 1))


def test_no_photograph_shows_the_board(tmp_path):
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((200, 200), 99, np.uint8))
    paths = sorted(tmp_path.glob("*.png"))
    with pytest.raises(
        DataError, match=r"a.png and 1 more: no board was found \(charuco, 12 x 9 .*; check the nu"
    ):
        calibrate_lens(paths, BOARD, pitch_mm=(1, 1))


def test_a_board_of_another_dictionary(photos):
    board = Board(dictionary="6x6_100")
    with pytest.raises(
        DataError, match=r"photo_00.png shows markers of the dictionary 4x4_100: give that one"
    ):
        calibrate_lens([photos / "photo_00.png"], board, pitch_mm=(1, 1))


def test_mirrored_photographs(photos, tmp_path):
    image = cv2.imread(str(photos / "photo_03.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "m.png"), image[::-1])
    with pytest.raises(
        DataError, match=r"m.png: no board .*; they are mirrored: give them as the "
    ):
        calibrate_lens([tmp_path / "m.png"], BOARD, pitch_mm=(1, 1))


def test_no_photograph_and_one_given_twice(photos):
    with pytest.raises(ConfigurationError, match="no photograph is given; give three or more"):
        calibrate_lens([], BOARD, pitch_mm=(1, 1))
    path = photos / "photo_00.png"
    with pytest.raises(ConfigurationError, match=r"photo_00.png is given twice; give each photogr"):
        calibrate_lens([path, path], BOARD, pitch_mm=(1, 1))


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("IN -o OUT.txt --pitch-um 1", 2, "a lens is written as TOML or JSON; give a name that en"),
        ("IN -o OUT/no.toml --pitch-um 1", 3, "does not exist; make it first."),
        ("IN -o OUT.toml --pitch-um 0", 2, "--pitch-um '0' is not a pitch in micrometres such as"),
        ("IN -o OUT.toml --pitch-um 1,2,3", 2, "--pitch-um '1,2,3' is not a pitch in micrometres"),
        ("IN -o OUT.toml --pitch-um a", 2, "--pitch-um 'a' is not a pitch in micrometres such as"),
        ("IN -o OUT.toml --pitch-um 1 --map OUT.bmp", 2, "pictures are written as .png, .pdf, .sv"),
        ("EMPTY -o OUT.toml --pitch-um 1", 3, "empty: the folder holds no pictures."),
        ("-o OUT.toml --pitch-um 1", 2, "Missing argument 'PHOTO...'."),
    ],
)
def test_lens_refuses(gonio, tmp_path, photos, words, code, message):
    (tmp_path / "empty").mkdir()
    places = {"IN": str(photos), "EMPTY": str(tmp_path / "empty")}
    given = [places.get(word, word.replace("OUT", str(tmp_path / "out"))) for word in words.split()]
    got, out, err = gonio("calibrate", "lens", *given)
    assert (got, out) == (code, "")
    assert message in err


def test_an_unknown_calibration(gonio):
    code, _, err = gonio("calibrate", "lense")
    assert code == 2
    assert "unknown calibration 'lense': did you mean 'lens'?" in err


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("schema = 1\n", r"not a calibrated lens \(schema 'gonio.lens/1'\); give a file that"),
        ("schema = ", r"not valid TOML: "),
        ('schema = "gonio.lens/1"\n[frame]\nrows = 1\n', r"lens or frame is missing or wrong"),
        (
            'schema = "gonio.lens/1"\n[frame]\nrows = 1\ncolumns = 1\n[lens]\n'
            'projection = "equidistant"\nfocal_length_mm = -1\n',
            r"lens.focal_length_mm: Input should be greater than 0",
        ),
    ],
)
def test_files_that_are_no_lens(tmp_path, content, message):
    (tmp_path / "l.toml").write_text(content)
    with pytest.raises(DataError, match=rf"l.toml: {message}"):
        lens_file.read(tmp_path / "l.toml")


def test_a_lens_that_is_not_there(tmp_path):
    with pytest.raises(DataError, match=r"l.toml: cannot be read as text"):
        lens_file.read(tmp_path / "l.toml")
