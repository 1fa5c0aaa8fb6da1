"""The same corners through OpenCV's two wide-angle calibrations, as a check of one's own.

Known of OpenCV 5.0: `fisheye.calibrate` fails without a guess of the lens and takes no points at 90
deg and beyond, where its projection mirrors them (opencv/opencv 19433 and 22620);
`omnidir.calibrate` takes them and may leave out views. Its model (Mei & Rives, ICRA 2007, with two
radial terms) is another one, so that it agrees less well, most of all beyond the corners.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gonio.calibration.lens.board_poses import View
from gonio.calibration.lens.bundle_adjustment import LEAST_CORNERS, LensFit
from gonio.geometry import FloatArray, angles, unit_vectors

LIMITS_DEG = (60.0, 75.0, 85.0)
_BELOW_HORIZON = np.radians(89.0)
_Projection = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class CrossCheck:
    """Another calibration beside a fit.

    Parameters
    ----------
    name : str
        Of the function.
    rms_px : float or None
        Its root mean square distance; None where it failed.
    difference_deg : dict
        Largest difference of the polar angles that a pixel stands for, up to each of
        `LIMITS_DEG`, all around.
    n_corners : int
        Given to it.
    failure : str
        Why it gave no result; empty where it did.
    """

    name: str
    rms_px: float | None
    difference_deg: dict[float, float]
    n_corners: int
    failure: str = ""


def cross_check(fit: LensFit, shape: tuple[int, int]) -> list[CrossCheck]:
    """Both of OpenCV's calibrations on the corners of a fit.

    Parameters
    ----------
    fit : LensFit
        Its corners are used, its lens is the guess that OpenCV needs.
    shape : tuple of int
        Rows and columns of the photographs.
    """
    below = [
        view.subset(angles(pose.to_camera(view.board))[0] < _BELOW_HORIZON)
        for view, pose in zip(fit.views, fit.poses, strict=True)
    ]
    return [
        _checked("cv2.fisheye.calibrate", _fisheye, fit, below, shape),
        _checked("cv2.omnidir.calibrate", _omnidir, fit, fit.views, shape),
    ]


def _checked(
    name: str,
    calibrate: Callable[[LensFit, Sequence[View], tuple[int, int]], tuple[float, _Projection]],
    fit: LensFit,
    views: Sequence[View],
    shape: tuple[int, int],
) -> CrossCheck:
    import cv2

    views = [view for view in views if len(view.pixels) >= LEAST_CORNERS]
    n = sum(len(view.pixels) for view in views)
    try:
        rms, project = calibrate(fit, views, shape)
    except cv2.error as error:
        return CrossCheck(name, None, {}, n, _reason(error))
    if not np.isfinite(rms):
        return CrossCheck(name, None, {}, n, "it returned no finite result")
    differences = {limit: _difference(fit, project, limit) for limit in LIMITS_DEG}
    return CrossCheck(name, float(rms), differences, n)


def _reason(error: Exception) -> str:
    """OpenCV's message without its version, file and line."""
    text = " ".join(str(error).split())
    return text.partition("error: ")[2] or text


def _difference(fit: LensFit, project: _Projection, limit_deg: float) -> float:
    theta, phi = np.meshgrid(
        np.radians(np.linspace(1, limit_deg, 60)), np.linspace(-np.pi, np.pi, 24, endpoint=False)
    )
    ours = angles(fit.lens.directions(project(unit_vectors(theta.ravel(), phi.ravel()))))[0]
    return float(np.degrees(np.abs(ours - theta.ravel()).max()))


def _lists(views: Sequence[View]) -> tuple[list[FloatArray], list[FloatArray]]:
    """Points of the boards and of the pictures in the one layout that OpenCV takes: (1, n, k)."""
    return [view.board[None] for view in views], [view.pixels[None] for view in views]


def _guess(fit: LensFit) -> FloatArray:
    f, (cx, cy) = fit.lens.f, fit.lens.centre
    return np.array([[f, 0, cx], [0, f * fit.lens.ratio, cy], [0, 0, 1]])


def _fisheye(
    fit: LensFit, views: Sequence[View], shape: tuple[int, int]
) -> tuple[float, _Projection]:
    import cv2

    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    rms, matrix, k, _, _ = cv2.fisheye.calibrate(
        *_lists(views), shape[::-1], _guess(fit), np.zeros((4, 1)), flags=flags, criteria=_stop()
    )

    def project(w: FloatArray) -> FloatArray:
        zero = np.zeros((1, 3))
        pixels, _ = cv2.fisheye.projectPoints(w[None], zero, zero, matrix, k)
        return np.asarray(pixels[0])

    return rms, project


def _omnidir(
    fit: LensFit, views: Sequence[View], shape: tuple[int, int]
) -> tuple[float, _Projection]:
    import cv2

    rms, matrix, xi, d, _, _, _ = cv2.omnidir.calibrate(
        *_lists(views), shape[::-1], np.zeros((3, 3)), np.zeros((1, 1)), np.zeros((1, 4)),
        cv2.omnidir.CALIB_FIX_SKEW, _stop(),
    )  # fmt: skip

    def project(w: FloatArray) -> FloatArray:
        zero = np.zeros((1, 3))
        pixels, _ = cv2.omnidir.projectPoints(w[None], zero, zero, matrix, float(xi[0, 0]), d)
        return np.asarray(pixels[0])

    return rms, project


def _stop() -> tuple[int, int, float]:
    import cv2

    return cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-10
