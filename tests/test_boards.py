"""Boards, photographs of them, and finding their corners."""

from __future__ import annotations

import json
import re
import struct

import cv2
import numpy as np
import pytest

from gonio import instrument
from gonio.board import Board, dictionaries
from gonio.calibration.lens import boards
from gonio.calibration.lens.board_poses import Pose
from gonio.calibration.lens.corner_template import Ink, refine
from gonio.calibration.lens.fisheye import Fisheye
from gonio.calibration.lens.image_circle import fit_image_circle
from gonio.calibration.lens.rotations import rotation_vector
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import angles, unit_vectors
from gonio.instrument import board_photos, board_poses
from gonio.instrument.board_camera import BoardCamera
from gonio.instrument.board_files import save_photos
from gonio.instrument.board_photos import Photographer
from gonio.instrument.board_poses import draw_poses
from gonio.plotting.board import rectangles, save_board

RIG = instrument.preset("modern12")
PLAIN = Board("chessboard", 9, 6, 20.0)
CHARUCO = Board("charuco", 9, 6, 20.0, 15.0, "4x4_50")


def camera(binning=2, *, field_deg=180.0, psf_px=0.5, offset=(6.0, -4.0)):
    """modern12's camera; blur and offset of the axis in unbinned pixels."""
    return BoardCamera.of(
        RIG, binning=binning, centre_offset_px=offset, psf_px=psf_px * binning, field_deg=field_deg
    )


def fisheye(view):
    """The same lens in the pixels of the calibration, from the instrument's figures."""
    f = view.lens.focal_length_mm / view.pitch_mm[0]
    return Fisheye(f, view.lens.k, tuple(view.centre_px), view.pitch_mm[0] / view.pitch_mm[1])


def facing(board, theta_deg, phi_deg, distance, turn_deg=0.0):
    """A board whose middle lies in a direction, facing the camera."""
    rotation = board_poses._towards(np.radians(theta_deg), np.radians(phi_deg))
    rotation = rotation @ board_poses._tilted(0, 0, np.radians(turn_deg))
    middle = np.array([*board.size_mm, 0.0]) / 2
    direction = unit_vectors(np.radians(theta_deg), np.radians(phi_deg))
    return board_poses.Pose(rotation, distance * direction - rotation @ middle)


def shown(view, board, pose):
    return view.project(pose.to_camera(board.corners_mm()))


@pytest.fixture(scope="module")
def tilted():
    """A charuco board half-way to the rim: camera, pose, photograph, corners as they are."""
    view = camera()
    pose = facing(CHARUCO, 50, 70, 130, turn_deg=25)
    photo = Photographer(CHARUCO, view).take(pose, seed=3, number=0)
    return view, pose, photo, shown(view, CHARUCO, pose)


# ---------------------------------------------------------------- the board


@pytest.mark.parametrize("size", [(12, 9), (7, 10), (5, 5)])
def test_corners_are_counted_as_opencv_does(size):
    board = Board("charuco", *size, 20.0, 14.0, "5x5_100")
    np.testing.assert_allclose(
        board.corners_mm(), board.charuco().getChessboardCorners(), atol=1e-6
    )
    assert board.n_corners == len(board.corners_mm())


@pytest.mark.parametrize(("size", "marker"), [((12, 9), 15.0), ((5, 8), 10.0)])
def test_the_drawn_board_is_opencv_s(size, marker):
    board = Board("charuco", *size, 20.0, marker, "4x4_100")
    # 24 dots a square: both marker sizes are whole numbers of dots for six cells.
    ours = np.full((24 * size[1], 24 * size[0]), 255, np.uint8)
    for rectangle in rectangles(board):
        x, y, w, h = (round(1.2 * v) for v in rectangle)
        ours[y : y + h, x : x + w] = 0
    theirs = board.charuco().generateImage((24 * size[0], 24 * size[1]))
    assert np.mean(ours != theirs) < 0.02  # OpenCV rounds its cells
    # And it is read as the same board.
    larger = np.pad(np.kron(ours, np.ones((2, 2), np.uint8)), 40, constant_values=255)
    found = boards.find_corners(larger, board)
    assert len(found) == board.n_corners


def test_a_plain_board_is_half_ink():
    assert sum(w * h for *_, w, h in rectangles(PLAIN)) == pytest.approx(9 * 6 * 400 / 2)


def test_printed_svg_has_its_size_in_mm(tmp_path):
    save_board(CHARUCO, tmp_path / "b.svg")
    text = (tmp_path / "b.svg").read_text()
    assert 'width="220mm" height="160mm" viewBox="-20 -20 220 160"' in text
    drawn = re.findall(r'<rect x="([^"]+)" y="([^"]+)" width="([^"]+)" height="([^"]+)"/>', text)
    np.testing.assert_allclose(np.array(drawn, float), rectangles(CHARUCO), atol=1e-4)
    assert "print at 100 %" in text


def test_printed_png_has_its_size_and_is_found(tmp_path):
    save_board(CHARUCO, tmp_path / "b.png", dpi=150)
    data = (tmp_path / "b.png").read_bytes()
    at = data.index(b"pHYs") + 4
    per_metre, _, unit = struct.unpack(">IIB", data[at : at + 9])
    image = cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_GRAYSCALE)
    assert unit == 1
    assert image.shape[1] / per_metre == pytest.approx(0.220, rel=1e-3)
    found = boards.find_corners(image, CHARUCO)
    assert len(found) == CHARUCO.n_corners
    # Dots are 0.17 mm; the first corner stands a margin and a square from the edge.
    np.testing.assert_allclose(found.pixels[0] / per_metre, 0.040, atol=2e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "chess"}, "unknown kind of board 'chess': did you mean 'chessboard'?"),
        ({"columns": 3}, "a board of 3 x 9 squares is too small; allowed are 4 or more each way."),
        ({"square_mm": 0.0}, "squares of 0 mm; the side must be positive."),
        ({"marker_mm": 20.0}, "markers of 20 mm do not fit in squares of 20 mm; they must be"),
        ({"dictionary": "4x4_10"}, "unknown dictionary '4x4_10': did you mean '4x4_100'?"),
        (
            {"dictionary": "4x4_50"},
            "the board has 54 markers and the dictionary 4x4_50 only 50; choose a larger one or",
        ),
    ],
)
def test_boards_that_cannot_be(change, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        Board(**change)


def test_pictures_of_boards_that_cannot_be(tmp_path):
    with pytest.raises(ConfigurationError, match=r"b.pdf: a board is written as .svg or .png"):
        save_board(CHARUCO, tmp_path / "b.pdf")
    with pytest.raises(ConfigurationError, match=r"10 dots an inch leave 0.98 dots for the small"):
        save_board(CHARUCO, tmp_path / "b.png", dpi=10)
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- the photograph


def test_axes_are_those_of_the_frame():
    # Column grows with x and row with y, no flip; the axis stands 3 and -2 binned pixels off.
    view = camera()
    column, row = view.project(np.array([[0, 0, 1.0], [1, 0, 1], [0, 1, 1]])).T
    assert (column[0], row[0]) == (415.5 + 3, 415.5 - 2)
    assert column[1] > column[0] + 100
    assert row[1] == row[0]
    assert row[2] > row[0] + 100
    assert column[2] == pytest.approx(column[0])
    # A board in the direction of +x, held upright, has its first corner up and to the left.
    at = shown(view, CHARUCO, facing(CHARUCO, 40, 0, 150))
    assert at[:, 0].min() > column[0]
    assert at[0, 1] < at[-1, 1]
    assert at[0, 0] < at[7, 0]


def test_projection_is_opencv_s():
    view = camera()
    rng = np.random.default_rng(1)
    points = unit_vectors(rng.uniform(0, np.radians(89.5), 200), rng.uniform(-np.pi, np.pi, 200))
    f = view.lens.focal_length_mm / view.pitch_mm
    matrix = np.array([[f[0], 0, view.centre_px[0]], [0, f[1], view.centre_px[1]], [0, 0, 1]])
    zero = np.zeros((1, 3))
    theirs, _ = cv2.fisheye.projectPoints(points[None], zero, zero, matrix, np.array(view.lens.k))
    np.testing.assert_allclose(view.project(points), theirs[0], atol=1e-8)
    np.testing.assert_allclose(fisheye(view).project(points), theirs[0], atol=1e-8)


def test_corners_stand_where_the_projection_says(tilted):
    _, _, photo, at = tilted
    found = boards.find_corners(boards.stretched(photo), CHARUCO)
    assert len(found) == CHARUCO.n_corners
    off = found.pixels - at[found.numbers]
    assert np.sqrt(np.mean(off**2)) < 0.1
    assert np.abs(off.mean(axis=0)).max() < 0.05


def test_light_and_darkness(tilted):
    view, _, photo, at = tilted
    rows, columns = np.indices(photo.shape)
    x = np.hypot(columns - view.centre_px[0], rows - view.centre_px[1]) * view.pitch_mm[0]
    outside = photo[x > view.lens.radius(np.pi / 2) + 5 * view.pitch_mm[0]]
    # No light is the black level: mean of some 1e5 pixels of 5 counts noise.
    assert outside.mean() == pytest.approx(view.sensor.binned_black_dn, abs=0.2)
    # White paper beside ink, in the shares of their reflectances.
    near = photo[
        int(at[:, 1].min()) : int(at[:, 1].max()), int(at[:, 0].min()) : int(at[:, 0].max())
    ]
    dark, bright = np.percentile(near, [2, 98]) - view.sensor.binned_black_dn
    assert dark / bright == pytest.approx(board_photos.BLACK / board_photos.WHITE, abs=0.02)


def test_a_pixel_averages_its_rays():
    # The share of ink over the board is that of its pattern, whatever the pixels cut.
    view = camera(8, psf_px=0.0)
    pose = facing(CHARUCO, 0, 0, 150, turn_deg=7)
    image = Photographer(CHARUCO, view).irradiance(pose)
    theta = angles(np.stack(np.broadcast_arrays(*_directions(view)), -1))[0]
    flat = image / np.where(theta < 1.5, view.lens.relative_illumination(theta), np.inf)
    flat /= view.lens.solid_angle(np.minimum(theta, 1.5))
    solid = view.lens.solid_angle(np.minimum(theta, 1.5))
    inside = _on_board(view, pose, CHARUCO)
    # Pixels in equal directions of the board's plane: dA = d^2 dOmega / cos^3.
    area = np.where(inside, solid / np.cos(np.minimum(theta, 1.4)) ** 3, 0)
    mean = (flat * area).sum() / area.sum()
    ink = sum(w * h for *_, w, h in rectangles(CHARUCO)) / (180 * 120)
    expected = board_photos.BLACK * ink + board_photos.WHITE * (1 - ink)
    assert mean == pytest.approx(expected, abs=0.01)  # the outline cuts pixels


def _directions(view):
    x, y = np.meshgrid(*view.sensor.positions_mm())
    radius = np.hypot(x, y)
    theta = np.nan_to_num(view.lens.polar_angle(radius), nan=3.0)
    return np.moveaxis(unit_vectors(theta, np.arctan2(y, x)), -1, 0)


def _on_board(view, pose, board):
    w = np.stack(_directions(view), -1) @ pose.rotation
    eye = -pose.rotation.T @ pose.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        at = eye + (-eye[2] / w[..., 2])[..., None] * w
    width, height = board.size_mm
    inside = (at[..., 0] > 0) & (at[..., 0] < width) & (at[..., 1] > 0) & (at[..., 1] < height)
    return inside & (w[..., 2] > 0)


def test_a_board_is_not_seen_from_behind():
    view, pose = camera(8), facing(CHARUCO, 0, 0, 150)
    turned = board_poses.Pose(pose.rotation @ np.diag([1.0, -1.0, -1.0]), pose.translation)
    behind = Photographer(CHARUCO, view).irradiance(turned)
    away = Photographer(CHARUCO, view).irradiance(
        board_poses.Pose(pose.rotation, pose.translation + np.array([0, 0, 1e9]))
    )
    np.testing.assert_allclose(behind, away)


def test_one_seed_one_photograph():
    view, pose = camera(8), facing(CHARUCO, 30, 0, 150)
    one = Photographer(CHARUCO, view, threads=1).take(pose, seed=5, number=1)
    two = Photographer(CHARUCO, view, threads=2).take(pose, seed=5, number=1)
    np.testing.assert_array_equal(one, two)
    assert np.any(one != Photographer(CHARUCO, view).take(pose, seed=5, number=2))
    assert np.any(one != Photographer(CHARUCO, view).take(pose, seed=6, number=1))


@pytest.mark.parametrize(("field", "least", "most"), [(180.0, 85.0, 90.0), (200.0, 95.0, 100.0)])
def test_charuco_poses_reach_the_edge(field, least, most):
    view = camera(field_deg=field)
    points = np.vstack(
        [p.to_camera(CHARUCO.corners_mm()) for p in draw_poses(CHARUCO, view, 20, _rng(2))]
    )
    theta = np.degrees(angles(points[np.isfinite(view.project(points)[:, 0])])[0])
    assert least < theta.max() <= most
    assert theta.min() < 10
    # All around: each sixth of the circle has corners beyond 70 deg.
    phi = angles(points)[1][np.degrees(angles(points)[0]) > 70]
    assert len(np.unique(np.floor(phi / np.radians(60)))) == 6


def test_chessboards_are_seen_whole():
    view = camera()
    for pose in draw_poses(PLAIN, view, 12, _rng(4)):
        assert np.isfinite(shown(view, PLAIN, pose)).all()


def _rng(seed):
    return np.random.default_rng(seed)


def test_a_lens_that_folds_its_image_is_refused():
    folding = RIG.lens.model_copy(update={"k": (-0.3, 0.0, 0.0, 0.0)})
    with pytest.raises(ConfigurationError, match="stops growing before its edge at 90 deg"):
        BoardCamera(folding, RIG.sensor)


def test_photographs_and_what_they_show_are_written(tmp_path):
    view = camera(8)
    folder = tmp_path / "shots"
    seen = []
    paths = save_photos(
        folder, CHARUCO, view, n=3, seed=1, bits=16, progress=lambda *each: seen.append(each)
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert [path.name for path in paths] == ["photo_00.png", "photo_01.png", "photo_02.png"]
    known = json.loads((folder / "truth" / "truth.json").read_text())
    assert known["schema"] == "gonio.boards/1"
    assert known["centre_px"] == view.centre_px.tolist()
    for path, photo in zip(paths, known["photos"], strict=True):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image.dtype == np.uint16
        assert image.shape == (208, 208)
        # White is exposed to 0.7 of the range.
        assert image.max() > 20000
        rotation = np.array(photo["rotation"])
        assert np.linalg.det(rotation) == pytest.approx(1)
        pose = board_poses.Pose(rotation, np.array(photo["translation_mm"]))
        number, *at = photo["corners"][0]
        np.testing.assert_allclose(shown(view, CHARUCO, pose)[number], at)
    with pytest.raises(ConfigurationError, match=r"shots: is there already; give the name of a"):
        save_photos(folder, CHARUCO, view, n=3, seed=1)
    with pytest.raises(ConfigurationError, match="0 photographs; give 1 or more"):
        save_photos(tmp_path / "none", CHARUCO, view, n=0, seed=1)


# ---------------------------------------------------------------- finding corners


def test_photographs_are_read_as_the_sensor_has_them(tmp_path):
    image = np.arange(20 * 30, dtype=np.uint16).reshape(20, 30) * 100
    cv2.imwrite(str(tmp_path / "a.png"), image)
    np.testing.assert_array_equal(boards.read_photo(tmp_path / "a.png"), image)
    colour = np.stack([image >> 8] * 3, -1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "b.tif"), colour)
    np.testing.assert_array_equal(boards.read_photo(tmp_path / "b.tif"), colour[..., 0])


def test_photographs_that_cannot_be_read(tmp_path):
    with pytest.raises(DataError, match=r"no.png: cannot be read \(No such file or directory\)"):
        boards.read_photo(tmp_path / "no.png")
    for content in (b"", b"this is no picture"):
        (tmp_path / "bad.png").write_bytes(content)
        with pytest.raises(DataError, match=r"bad.png: not a readable picture of 8 or 16 bits"):
            boards.read_photo(tmp_path / "bad.png")


def test_a_mirrored_photograph_shows_no_board_and_is_noticed(tilted):
    image = boards.stretched(tilted[2])
    flipped = image[::-1].copy()
    assert len(boards.find_corners(flipped, CHARUCO)) == 0
    assert boards.is_mirrored(flipped, CHARUCO)
    assert not boards.is_mirrored(image, CHARUCO)


def test_markers_of_another_dictionary_are_named():
    view = camera(4)
    photo = Photographer(CHARUCO, view).take(facing(CHARUCO, 0, 0, 80), seed=1, number=0)
    image = boards.stretched(photo)
    other = Board("charuco", 9, 6, 20.0, 15.0, "5x5_100")
    assert len(boards.find_corners(image, other)) == 0
    assert boards.other_dictionary(image, other) == "4x4_50"
    assert boards.other_dictionary(image, CHARUCO) is None
    assert "4x4_50" in dictionaries()


def test_an_empty_photograph_shows_no_board():
    image = np.full((200, 200), 80, np.uint8)
    for board in (CHARUCO, PLAIN):
        assert len(boards.find_corners(image, board)) == 0
    assert len(boards.find_in_views(image, CHARUCO, Fisheye(60.0, centre=(99.5, 99.5)))) == 0
    assert boards.other_dictionary(image, CHARUCO) is None


def test_coarse_photographs_are_searched_in_magnified_views():
    # 3 pixels a cell of a marker: few for a detector that sees the photograph.
    view = camera(4, psf_px=0.3)
    pose = facing(CHARUCO, 60, 200, 130)
    image = boards.stretched(Photographer(CHARUCO, view).take(pose, seed=1, number=0))
    guess = Fisheye(fisheye(view).radius(np.pi / 2) / (np.pi / 2), centre=tuple(view.centre_px))
    direct = boards.find_corners(image, CHARUCO)
    found = boards.find_in_views(image, CHARUCO, guess)
    assert len(found) > len(direct)
    assert len(found) >= 12
    off = found.pixels - shown(view, CHARUCO, pose)[found.numbers]
    assert np.sqrt(np.mean(off**2)) < 0.25


def test_a_plain_board_is_found_whole_from_either_end():
    view = camera(4)
    pose = facing(PLAIN, 40, -100, 150, turn_deg=100)
    image = boards.stretched(Photographer(PLAIN, view).take(pose, seed=1, number=0))
    found = boards.find_corners(image, PLAIN)
    at = shown(view, PLAIN, pose)
    if np.abs(found.pixels - at).max() > 2:
        at = at[::-1]
    assert np.sqrt(np.mean((found.pixels - at) ** 2)) < 0.15


# ---------------------------------------------------------------- the image circle


def disc(centre, radius, shape=(300, 400), ratio=1.0):
    rows, columns = np.indices(shape)
    away = np.hypot(columns - centre[0], (rows - centre[1]) / ratio)
    return 20 + 100 * np.clip(radius - away + 0.5, 0, 1) * (1 - 0.4 * (away / radius) ** 2)


@pytest.mark.parametrize(
    ("centre", "radius", "ratio"), [((203.3, 148.6), 120, 1.0), ((203.3, 148.6), 90, 1.3)]
)
def test_image_circle(centre, radius, ratio):
    found = fit_image_circle(disc(centre, radius, ratio=ratio), ratio)
    np.testing.assert_allclose(found.centre, centre, atol=0.3)
    # The edge is where the light is a quarter of the middle's, smoothed: about a pixel outside.
    assert found.radius == pytest.approx(radius, abs=1.5)


def test_an_image_circle_that_the_sensor_cuts():
    found = fit_image_circle(disc((203.3, 148.6), 185))
    np.testing.assert_allclose(found.centre, (203.3, 148.6), atol=1)
    assert found.radius == pytest.approx(185, abs=2)


@pytest.mark.parametrize("image", [np.full((300, 400), 90.0), disc((200, 150), 400)])
def test_without_an_edge_there_is_no_circle(image):
    assert fit_image_circle(image) is None


# ---------------------------------------------------------------- corners by the pattern


def as_pose(pose):
    return Pose(rotation_vector(pose.rotation), pose.translation)


@pytest.mark.parametrize("board", [CHARUCO, PLAIN], ids=["charuco", "plain"])
def test_corners_by_the_pattern_to_hundredths_of_a_pixel(board):
    view = camera()
    pose = facing(board, 62, 70, 120, turn_deg=25)
    photo = Photographer(board, view).take(pose, seed=3, number=0)
    at = shown(view, board, pose)
    field = np.isfinite(at[:, 0])
    # A lens of 0.3 % another focal length, a centre 0.4 pixels off: as after a first fit.
    true = fisheye(view)
    guess = Fisheye(true.f * 1.003, true.k, (true.centre[0] + 0.3, true.centre[1] - 0.3))
    numbers, pixels = refine(photo, Ink.of(board), guess, as_pose(pose))
    assert field.sum() * 0.9 <= len(numbers) <= field.sum()
    off = pixels - at[numbers]
    assert np.sqrt(np.mean(off**2)) < 0.04
    again, pixels = refine(photo, Ink.of(board), true, as_pose(pose))
    off = pixels - at[again]
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert np.abs(off.mean(axis=0)).max() < 0.01


def test_hidden_corners_are_left_out(tilted):
    view, pose, photo, at = tilted
    covered = photo.copy()
    column = int(np.median(at[:, 0]))
    covered[:, column:] = 3000  # a hand in the picture
    numbers, _ = refine(covered, Ink.of(CHARUCO), fisheye(view), as_pose(pose))
    assert set(numbers) <= set(np.flatnonzero(at[:, 0] < column + 1))
    assert len(numbers) >= 0.8 * np.sum(at[:, 0] < column - 10)


def test_nothing_is_found_where_the_board_is_not(tilted):
    view, pose, photo, _ = tilted
    aside = pose.translation + pose.rotation @ [10.0, 10.0, 0.0]  # half a square each way
    wrong = Pose(rotation_vector(pose.rotation), aside)
    numbers, _ = refine(photo, Ink.of(CHARUCO), fisheye(view), wrong)
    assert len(numbers) == 0


def test_a_board_out_of_the_field_has_no_corners(tilted):
    view, _, photo, _ = tilted
    pose = as_pose(facing(CHARUCO, 150, 0, 130))
    numbers, pixels = refine(photo, Ink.of(CHARUCO), fisheye(view), pose)
    assert (len(numbers), pixels.shape) == (0, (0, 2))
