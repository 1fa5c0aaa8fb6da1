"""The fisheye model and the bundle adjustment, from corners without photographs."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gonio.board import Board
from gonio.calibration.lens import bundle_adjustment as lens_fit
from gonio.calibration.lens.board_poses import Pose, View, pose_of_board
from gonio.calibration.lens.bundle_adjustment import fit_lens
from gonio.calibration.lens.cross_check import cross_check
from gonio.calibration.lens.fisheye import Fisheye
from gonio.calibration.lens.from_photos import LensFromPhotos
from gonio.calibration.lens.image_circle import ImageCircle
from gonio.calibration.lens.rotations import left_jacobian, rotation, rotation_vector
from gonio.errors import DataError
from gonio.geometry import angles, unit_vectors

K = (-0.012, 0.004, -0.0015, 0.0002)
LENS = Fisheye(260.0, K, (418.5, 413.2))
GUESS = Fisheye(LENS.radius(np.pi / 2) / (np.pi / 2), centre=(416.0, 416.0))
BOARD = Board("chessboard", 8, 6, 25.0).corners_mm()
MIDDLE = BOARD.mean(axis=0)
SHAPE = (832, 832)


def towards(theta_deg, phi_deg, tilt=(0.0, 0.0, 0.0), distance=120.0):
    """A board whose middle lies in a direction and that faces the camera but for a tilt."""
    across = np.radians(phi_deg) + np.pi / 2
    facing = rotation(np.radians(theta_deg) * np.array([np.cos(across), np.sin(across), 0.0]))
    turned = facing @ rotation(np.asarray(tilt, float))
    pose_of_board = unit_vectors(np.radians(theta_deg), np.radians(phi_deg)) * distance
    return Pose(rotation_vector(turned), pose_of_board - turned @ MIDDLE)


def drawn_poses(n, rng, most_deg=75.0):
    polar = most_deg * np.sqrt((np.arange(n) + 0.5) / n)
    return [
        towards(theta, 137.5 * k, rng.normal(0, 0.3, 3), rng.uniform(90, 140))
        for k, theta in enumerate(polar)
    ]


def views_of(poses, rng=None, noise=0.0, lens=LENS, field_deg=180.0):
    """Corners of boards within the field, with normal noise."""
    found = []
    for k, pose in enumerate(poses):
        points = pose.to_camera(BOARD)
        seen = angles(points)[0] < np.radians(field_deg / 2)
        pixels = lens.project(points[seen])
        if rng is not None:
            pixels = pixels + noise * rng.standard_normal(pixels.shape)
        found.append(View(f"photo {k}", BOARD[seen], pixels))
    return found


def rng_of(seed):
    return np.random.default_rng(seed)


def theta_error_deg(fit, theta_deg, lens=LENS):
    """Largest angle, all around, between what a pixel sees and what the fit says."""
    w = unit_vectors(np.radians(theta_deg), np.linspace(-np.pi, np.pi, 24, endpoint=False))
    said = fit.lens.directions(lens.project(w))
    return np.degrees(np.linalg.norm(said - w, axis=1).max())


# ---------------------------------------------------------------- the lens


class TestFisheye:
    lens = Fisheye(300.0, K, (400.0, 310.0), 1.1)
    theta = np.radians([0.0, 1e-7, 5.0, 45.0, 89.9, 90.0, 90.1, 110.0])
    points = unit_vectors(theta, np.linspace(-3, 3, len(theta))) * 70.0

    def test_equidistant_by_hand(self):
        lens = Fisheye(200.0, centre=(10.0, 20.0), ratio=1.5)
        at = lens.project([[0, 0, 5], [3, 0, 0], [0, 4, 0], [-1, 0, -1]])
        quarter = 200 * np.pi / 2
        expected = [
            [10, 20],
            [10 + quarter, 20],
            [10, 20 + 1.5 * quarter],
            [10 - 1.5 * quarter, 20],
        ]
        np.testing.assert_allclose(at, expected, atol=1e-12)

    def test_below_the_horizon_it_is_opencv_s(self):
        w = unit_vectors(np.radians(np.linspace(0.1, 89.9, 50)), np.linspace(-3, 3, 50))
        matrix = np.array([[300.0, 0, 400], [0, 330, 310], [0, 0, 1]])
        zero = np.zeros((1, 3))
        theirs, _ = cv2.fisheye.projectPoints(w[None], zero, zero, matrix, np.array(K))
        np.testing.assert_allclose(self.lens.project(w), theirs[0], atol=1e-9)

    def test_beyond_the_horizon_the_image_goes_on(self):
        # OpenCV comes back on the other side there.
        w = unit_vectors(np.radians([88.0, 92.0, 100.0]), 0.4)
        assert np.all(np.diff(self.lens.project(w)[:, 0]) > 0)

    def test_directions_are_the_inverse(self):
        back = self.lens.directions(self.lens.project(self.points))
        np.testing.assert_allclose(back, self.points / 70.0, atol=1e-12)

    def test_no_direction_beyond_the_fold(self):
        folding = Fisheye(300.0, (-0.2, 0.0, 0.0, 0.0))
        # r' = 0 at theta^2 = 1 / (3 * 0.2)
        assert folding.grows_to() == pytest.approx(np.sqrt(1 / 0.6), abs=1e-3)
        assert np.isnan(folding.polar_angle(folding.radius(folding.grows_to()) + 1))
        assert Fisheye(300.0).grows_to(2.0) == 2.0

    def test_derivatives(self):
        pixels, by_lens, by_point = self.lens.derivatives(self.points)
        np.testing.assert_allclose(pixels, self.lens.project(self.points), atol=1e-9)
        x = self.lens.vector()
        for j, size in enumerate([1e-3, *[1e-6] * 4, 1e-3, 1e-3, 1e-6]):
            step = size * np.eye(8)[j]
            up, down = (self.lens.with_vector(x + s) for s in (step, -step))
            slope = (up.project(self.points) - down.project(self.points)) / (2 * size)
            np.testing.assert_allclose(by_lens[..., j], slope, rtol=1e-6, atol=1e-5)
        for j in range(3):
            step = 1e-4 * np.eye(3)[j]
            up, down = (self.lens.project(self.points + s) for s in (step, -step))
            # Near the axis theta is 1e-7: steps of 1e-4 mm are larger, but all is linear there.
            np.testing.assert_allclose(by_point[..., j], (up - down) / 2e-4, atol=2e-5)


class TestRotation:
    turns = np.array([[0, 0, 0], [1e-9, 0, 0], [0.3, -0.2, 0.5], [0, np.pi, 0], [2, 2, 1.0]])

    @pytest.mark.parametrize("turn", turns)
    def test_is_opencv_s(self, turn):
        np.testing.assert_allclose(rotation(turn), cv2.Rodrigues(turn)[0], atol=1e-12)

    @pytest.mark.parametrize("turn", turns)
    def test_jacobian(self, turn):
        h, v = 1e-6, np.array([0.2, -0.7, 0.4])
        for j, step in enumerate(h * np.eye(3)):
            slope = (rotation(turn + step) - rotation(turn - step)) @ v / (2 * h)
            about = left_jacobian(turn)[:, j]
            np.testing.assert_allclose(np.cross(about, rotation(turn) @ v), slope, atol=1e-9)

    def test_jacobian_of_the_bundle(self):
        poses = drawn_poses(3, rng_of(1))
        views = views_of(poses)
        names = lens_fit.QUANTITIES
        jacobian = lens_fit._jacobian(views, LENS, poses, names)
        h = 1e-5
        for k, pose in enumerate(poses):
            for j in range(6):
                ends = []
                for step in (h * np.eye(6)[j], -h * np.eye(6)[j]):
                    moved = list(poses)
                    moved[k] = Pose(pose.turn + step[:3], pose.shift + step[3:])
                    ends.append(np.vstack(lens_fit._residuals(views, LENS, moved)).ravel())
                column = jacobian[:, len(names) + 6 * k + j]
                np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * h), atol=1e-4)


# ---------------------------------------------------------------- poses


@pytest.mark.parametrize("theta_deg", [0, 40, 80, 95])
def test_a_pose_from_rays_at_any_angle(theta_deg):
    pose = towards(theta_deg, 200, (0.3, -0.2, 1.0))
    (view,) = views_of([pose], field_deg=360)
    found = pose_of_board(view, LENS)
    np.testing.assert_allclose(rotation(found.turn), rotation(pose.turn), atol=1e-9)
    np.testing.assert_allclose(found.shift, pose.shift, atol=1e-6)
    assert found.normal() @ found.shift > 0


def test_four_corners_are_a_pose():
    pose = towards(50, 20, (0.1, 0.4, -1.0))
    (view,) = views_of([pose])
    some = np.isin(np.arange(len(view.pixels)), [0, 6, 28, 34])
    found = pose_of_board(view.subset(some), LENS)
    np.testing.assert_allclose(found.shift, pose.shift, atol=1e-6)


# ---------------------------------------------------------------- the fit


@pytest.mark.parametrize("field_deg", [180.0, 210.0])
def test_without_noise_the_lens_is_exact(field_deg):
    poses = drawn_poses(8, rng_of(2), most_deg=field_deg / 2 - 10)
    fit = fit_lens(views_of(poses, field_deg=field_deg), GUESS)
    np.testing.assert_allclose(fit.lens.vector(), LENS.vector(), atol=2e-6)
    assert fit.rms_px < 1e-6
    assert not fit.outliers
    assert not fit.left_out
    if field_deg > 180:
        assert np.degrees(fit.theta().max()) > 97


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
@pytest.mark.parametrize(
    "k",
    [K, (-1 / 24, 1 / 1920, -1 / 322560, 0.0), (0.09, 0.0, 0.0, 0.0)],
    ids=["own", "sin", "wide"],
)
def test_the_start_may_be_a_third_off(factor, k):
    lens = replace(LENS, k=k)
    start = Fisheye(LENS.f * factor, centre=(440.0, 395.0))
    fit = fit_lens(views_of(drawn_poses(6, rng_of(3)), rng_of(4), 0.1, lens), start)
    assert theta_error_deg(fit, 85, lens) < 0.2
    assert 0.1 < fit.rms_px < 0.18  # 0.1 sqrt(2), of which the fit takes a little


def test_pixels_that_are_not_square():
    lens = replace(LENS, ratio=1.02)
    views = views_of(drawn_poses(8, rng_of(5)), rng_of(6), 0.05, lens)
    known = fit_lens(views, replace(GUESS, ratio=1.02))
    assert known.lens.ratio == 1.02
    assert known.free == lens_fit.QUANTITIES[:-1]
    found = fit_lens(views, GUESS, free_ratio=True)
    sd = np.sqrt(found.covariance[-1, -1])
    assert abs(found.lens.ratio - 1.02) < 4 * sd < 4e-4
    assert theta_error_deg(found, 85, lens) < 0.05
    # Taken for square they do not fit.
    assert fit_lens(views, GUESS).rms_px > 3 * known.rms_px


@pytest.fixture(scope="module")
def repeated():
    """Fits to 24 draws of the noise on the same boards, some of them beyond the horizon."""
    poses = drawn_poses(7, rng_of(7), most_deg=85)
    return [fit_lens(views_of(poses, rng_of(100 + k), 0.1, field_deg=200), LENS) for k in range(24)]


def test_errors_are_those_that_the_covariance_states(repeated):
    off = np.array([fit.lens.vector()[:7] - LENS.vector()[:7] for fit in repeated])
    chi2 = [d @ np.linalg.solve(fit.covariance, d) for d, fit in zip(off, repeated, strict=True)]
    # 24 numbers of chi2 with 7 degrees of freedom: their sum has 168 and a sd of sqrt(336) = 18.
    assert 168 - 4 * 18 < np.sum(chi2) < 168 + 4 * 18
    # And each figure alone: 24 normalised errors, mean 0 and mean square 1, sd .2 and .29.
    normal = off / [np.sqrt(np.diag(fit.covariance)) for fit in repeated]
    assert np.abs(normal.mean(axis=0)).max() < 4 * 0.2
    assert np.abs((normal**2).mean(axis=0) - 1).max() < 4 * 0.29


@pytest.mark.parametrize("theta_deg", [60.0, 75.0, 85.0, 90.0, 95.0])
def test_the_uncertainty_of_theta_is_that_of_pixels(repeated, theta_deg):
    phi = np.linspace(-np.pi, np.pi, 8, endpoint=False)
    pixels = LENS.project(unit_vectors(np.radians(theta_deg), phi))
    said = np.array([angles(fit.lens.directions(pixels))[0] for fit in repeated])
    mean_square = np.mean((said - np.radians(theta_deg)) ** 2)
    stated = np.mean([fit.theta_sd(np.radians([theta_deg]))[0] ** 2 for fit in repeated])
    # f and k are shared by the azimuths: 24 independent squares or more, of which 3 sd is 87 %.
    assert 0.3 < mean_square / stated < 1.87


def test_noise_is_estimated_from_the_residuals(repeated):
    # rms of the distances is 0.1 sqrt(2) times sqrt(1 - figures / coordinates).
    fit = repeated[0]
    used = 1 - (7 + 6 * len(fit.views)) / (2 * fit.n_corners)
    rms = np.array([each.rms_px for each in repeated])
    assert rms.mean() == pytest.approx(0.1 * np.sqrt(2 * used), rel=0.02)


def test_it_is_opencv_s_optimum_below_the_horizon():
    views = views_of(drawn_poses(10, rng_of(8), 70), rng_of(9), 0.1, field_deg=176)
    fit = fit_lens(views, GUESS)
    fisheye, omnidir = cross_check(fit, SHAPE)
    assert fisheye.failure == omnidir.failure == ""
    # The same sum of squares: the same minimum, to where OpenCV stops.
    assert fisheye.rms_px == pytest.approx(fit.rms_px, rel=1e-4)
    assert max(fisheye.difference_deg.values()) < 1e-3
    # Mei's model has two radial terms, and bends other ways.
    assert fit.rms_px < omnidir.rms_px < 1.1 * fit.rms_px
    assert max(omnidir.difference_deg.values()) < 0.2
    assert list(fisheye.difference_deg) == [60, 75, 85]


def test_opencv_s_failures_are_reported(monkeypatch):
    fit = fit_lens(views_of(drawn_poses(5, rng_of(8)), rng_of(9), 0.1), GUESS)

    def fails(*_args, **_flags):
        raise cv2.error(
            "OpenCV(5.0.0) calib.cpp:12: error: (-215) fabs(norm_u1) > 0 in function 'f'"
        )

    monkeypatch.setattr(cv2.fisheye, "calibrate", fails)
    check = cross_check(fit, SHAPE)[0]
    assert check.failure == "(-215) fabs(norm_u1) > 0 in function 'f'"
    assert check.rms_px is None
    assert check.difference_deg == {}


# ---------------------------------------------------------------- the record


def found_from(fit, field_deg=180.0, circle=None):
    return LensFromPhotos(fit, Board(), SHAPE, len(fit.views), (0.0069, 0.0069), field_deg, circle)


def test_the_record_is_in_mm_and_pixels_of_the_frames(repeated):
    fit = repeated[0]
    one, four = (found_from(fit).record(n) for n in (1, 4))
    assert one.focal_length_mm == four.focal_length_mm == pytest.approx(fit.lens.f * 0.0069)
    assert one.centre_px == pytest.approx(fit.lens.centre)
    # The middle of the first block of 4 x 4 is its pixel 1.5 and the frames' pixel 0.
    assert four.centre_px == pytest.approx([(c - 1.5) / 4 for c in fit.lens.centre])
    sd = np.sqrt(np.diag(four.uncertain.covariance))
    scale = [0.0069, 1, 1, 1, 1, 1 / 4, 1 / 4]
    np.testing.assert_allclose(sd, np.sqrt(np.diag(fit.covariance)) * scale)


def test_the_record_ends_where_the_image_stops_growing(repeated):
    fit = repeated[0]
    assert found_from(fit, 200.0).record().field_deg == 180
    assert found_from(fit, 170.0).record().field_deg == 170
    folding = found_from(replace(fit, lens=replace(LENS, k=(-0.2, 0.0, 0.0, 0.0))))
    # r' = 0 at 73.97 deg
    assert 140 < folding.record().field_deg < 2 * 73.97
    assert any("stops growing at theta = 74.0 deg" in each for each in folding.warnings())


def test_an_image_circle_that_ends_elsewhere_is_a_warning(repeated):
    fit = repeated[0]
    for theta_deg, n in ((89.0, 0), (80.0, 1), (95.0, 1)):
        circle = ImageCircle(LENS.centre, float(LENS.radius(np.radians(theta_deg))), 0.5)
        said = [each for each in found_from(fit, 180.0, circle).warnings() if "circle" in each]
        assert len(said) == n
        if n:
            assert said[0].startswith(f"the image circle ends at theta = {theta_deg:.1f} deg and")


# ---------------------------------------------------------------- wrong corners, wrong photographs


def test_wrong_corners_are_dropped_and_counted():
    views = views_of(drawn_poses(8, rng_of(10)), rng_of(11), 0.1)
    clean = fit_lens(views, GUESS)
    wrong = rng_of(12)
    spoilt, n = [], 0
    for view in views:
        bad = wrong.random(len(view.pixels)) < 0.1
        away = (
            wrong.uniform(2, 40, (len(bad), 1)) * unit_vectors(np.pi / 2, wrong.uniform(-3, 3))[:2]
        )
        spoilt.append(replace(view, pixels=view.pixels + bad[:, None] * away))
        n += int(bad.sum())
    fit = fit_lens(spoilt, GUESS)
    assert sum(fit.outliers.values()) == n
    assert fit.n_corners == clean.n_corners - n
    assert fit.rms_px == pytest.approx(clean.rms_px, rel=0.05)
    assert theta_error_deg(fit, 85) < 5 * np.degrees(clean.theta_sd(np.radians([85.0]))[0])


def test_a_photograph_of_another_board_is_left_out():
    views = views_of(drawn_poses(8, rng_of(10)), rng_of(11), 0.1)
    views[2] = replace(views[2], board=views[2].board * [1.0, 1.1, 1.0])
    fit = fit_lens(views, GUESS)
    assert "photo 2" not in [view.name for view in fit.views]
    n = len(views[2].pixels)
    reason = rf"\d+ of its {n} corners do not fit the other photographs"
    assert re.fullmatch(reason, fit.left_out["photo 2"])
    assert theta_error_deg(fit, 85) < 0.2


def test_photographs_that_cannot_be_used_are_left_out():
    views = views_of(drawn_poses(7, rng_of(10)), rng_of(11), 0.1)
    few = np.arange(len(views[1].pixels)) < 5
    views[1] = views[1].subset(few)
    line = views[2].board[:, 0] == views[2].board[-1, 0]
    views.append(views[2].subset(line))
    middle = views[3]
    mirrored = replace(
        middle, name="mirror", board=middle.board * [-1.0, 1, 1] + [2 * MIDDLE[0], 0, 0]
    )
    views.append(mirrored)
    views[2] = replace(views[2], name="whole")
    long = replace(
        views[4], board=np.repeat(views[4].board[:1], 9, axis=0), pixels=views[4].pixels[:9]
    )
    views[4] = long
    fit = fit_lens(views, GUESS)
    assert fit.left_out == {
        "photo 1": "5 corners, fewer than 8",
        "photo 2": "5 corners, fewer than 8",
        "photo 4": "its corners lie on one line",
        "mirror": "its board is seen from behind: it is mirrored",
    }
    assert len(fit.views) == 5


def test_mirrored_photographs_are_refused():
    views = [
        replace(view, pixels=view.pixels * [1, -1] + [0, SHAPE[0] - 1])
        for view in views_of(drawn_poses(6, rng_of(10)), rng_of(11), 0.1)
    ]
    with pytest.raises(DataError, match="seen from behind: the photographs are mirrored"):
        fit_lens(views, GUESS)


@pytest.mark.parametrize("n", [0, 2])
def test_too_few_photographs(n):
    views = views_of(drawn_poses(6, rng_of(10)), rng_of(11), 0.1)[:n]
    with pytest.raises(DataError, match=rf"{n} of {n} photographs show 8 or more corners of the b"):
        fit_lens(views, GUESS)


def test_parallel_boards_do_not_tell_the_lens():
    tilts = rng_of(13).normal(0, np.radians(0.7), (10, 3)) * [1, 1, 30]
    shifts = rng_of(14).uniform([-180, -150, 70], [20, 30, 160], (10, 3))
    poses = [Pose(tilt, shift) for tilt, shift in zip(tilts, shifts, strict=True)]
    with pytest.raises(DataError, match=r"all boards are parallel within \d\.\d deg, so that"):
        fit_lens(views_of(poses, rng_of(15), 0.05), GUESS)


def test_boards_in_the_middle_alone_do_not_tell_the_lens():
    poses = [towards(4 * k, 90 * k, (0.15, 0.05 * k, k), 400) for k in range(4)]
    with pytest.raises(DataError, match=r"do not determine the lens \(sd .* deg at theta = \d+ d"):
        fit_lens(views_of(poses, rng_of(15), 0.5), GUESS)
