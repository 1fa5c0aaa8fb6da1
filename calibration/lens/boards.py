"""Photographs of calibration boards: reading them, and finding the board's corners.

OpenCV's detectors look at the photograph as it is, which a fisheye hardly bends over a few squares.
Where they find little (small squares, the rim), they look again at perspective views computed with
a first guess of the lens, magnified where the photograph is coarse.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.board import Board, aruco_dictionary, dictionaries
from gonio.calibration.lens.fisheye import Fisheye
from gonio.errors import DataError
from gonio.geometry import FloatArray, angles, unit_vectors

Image = NDArray[np.uint8] | NDArray[np.uint16]

_BLACK_PERCENTILE, _WHITE_PERCENTILE = 1.0, 99.7
# Perspective views: angle of their axes from the lens's, and how many around it.
_VIEWS = ((0, 1), (45, 6), (75, 10))
_VIEW_HALF_DEG = {"charuco": 40.0, "chessboard": 55.0}  # a chessboard must be in it whole
_VIEW_LEAST_F = 320.0  # focal length of a view, pixels; coarser photographs are magnified
_VIEW_SIZE = 1600  # largest side
_LEAST_MARKERS = 4  # fewer may be chance


@dataclass(frozen=True)
class Corners:
    """Corners found in a photograph.

    Parameters
    ----------
    numbers : ndarray of int, shape (n,)
        Of the corners, as `Board.corners_mm` counts them.
    pixels : ndarray, shape (n, 2)
        Column and row; whole numbers are pixels' centres.
    """

    numbers: NDArray[np.int64]
    pixels: FloatArray

    def __len__(self) -> int:
        return len(self.numbers)


NONE = Corners(np.empty(0, int), np.empty((0, 2)))


def read_photo(path: str | Path) -> Image:
    """A photograph in grey, 8 or 16 bits, its rows and columns as the sensor has them.

    Raises
    ------
    DataError
        If the file is missing, empty or no picture that OpenCV reads.

    Notes
    -----
    An orientation that a camera notes in the file is not applied: it would turn the axes against
    those of raw frames. Colours are weighted as OpenCV does.
    """
    import cv2

    path = Path(path)
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}).", value=path) from None
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image: Any = cv2.imdecode(data, flags) if len(data) else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise DataError(
            f"{path}: not a readable picture of 8 or 16 bits; give photographs as PNG, "
            "TIFF, JPEG or BMP.",
            value=path,
        )
    return np.asarray(image)


def stretched(image: Image) -> NDArray[np.uint8]:
    """The photograph in 8 bits with its dark and bright ends at 0 and 255, for the detectors."""
    low, high = np.percentile(image, [_BLACK_PERCENTILE, _WHITE_PERCENTILE])
    scaled = (image.astype(np.float32) - low) * (255 / max(high - low, 1))
    return np.asarray(np.clip(scaled + 0.5, 0, 255), np.uint8)


def find_corners(image: NDArray[np.uint8], board: Board, *, thorough: bool = True) -> Corners:
    """Corners that OpenCV's detectors find in a picture; none where it shows no board.

    A chessboard without markers is found whole or not at all. Which of its ends comes first is a
    matter of chance, and a mirrored picture of it is not recognised. A `thorough` search takes
    seconds if there is no board.
    """
    if board.kind == "charuco":
        return _find_charuco(image, board)
    return _find_chessboard(image, board, thorough)


def _find_charuco(image: NDArray[np.uint8], board: Board) -> Corners:
    import cv2

    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(image)
    if numbers is None or not len(numbers):
        return NONE
    return Corners(np.ravel(numbers).astype(int), np.reshape(corners, (-1, 2)).astype(float))


def _find_chessboard(image: NDArray[np.uint8], board: Board, thorough: bool) -> Corners:
    import cv2

    shape = (board.columns - 1, board.rows - 1)
    exhaustive = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    for flags in (0, exhaustive) if thorough else (0,):
        success, corners = cv2.findChessboardCornersSB(image, shape, flags=flags)
        if success:
            pixels = np.reshape(corners, (-1, 2)).astype(float)
            return Corners(np.arange(board.n_corners), pixels)
    return NONE


def find_in_views(image: NDArray[np.uint8], board: Board, lens: Fisheye) -> Corners:
    """Corners found in perspective views all around, by a first guess of the lens.

    A corner that several views show is taken from the one in whose middle it stands.
    """
    best: dict[int, tuple[float, FloatArray]] = {}
    for polar_deg, around in _VIEWS:
        for phi in np.arange(around) * (2 * np.pi / around):
            rotation = _looking(np.radians(polar_deg), phi)
            for number, away, pixel in _find_in_view(image, board, lens, rotation):
                if number not in best or away < best[number][0]:
                    best[number] = away, pixel
    if not best:
        return NONE
    numbers = np.array(sorted(best))
    return Corners(numbers, np.array([best[int(n)][1] for n in numbers]))


def _find_in_view(
    image: NDArray[np.uint8], board: Board, lens: Fisheye, rotation: FloatArray
) -> list[tuple[int, float, FloatArray]]:
    """Number, angle from the view's axis and pixel in the photograph of each corner."""
    import cv2

    half = np.tan(np.radians(_VIEW_HALF_DEG[board.kind]))
    f = min(max(lens.f, _VIEW_LEAST_F), _VIEW_SIZE / 2 / half)
    n = int(f * half)
    x, y = np.meshgrid(np.arange(-n, n + 1) / f, np.arange(-n, n + 1) / f)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ rotation.T
    source = lens.project(rays).astype(np.float32)
    view = cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_CUBIC)
    corners = find_corners(np.asarray(view, np.uint8), board, thorough=False)
    if not len(corners):
        return []
    rays = np.column_stack([(corners.pixels - n) / f, np.ones(len(corners))])
    away = angles(rays)[0]
    pixels = lens.project(rays @ rotation.T)
    return list(zip(corners.numbers.tolist(), away.tolist(), pixels, strict=True))


def _looking(theta: float, phi: float) -> FloatArray:
    """Rotation whose third column is a direction: from the frame of a view to the camera's."""
    z = unit_vectors(theta, phi)
    x = unit_vectors(theta + np.pi / 2, phi)
    return np.column_stack([x, np.cross(z, x), z])


def other_dictionary(image: NDArray[np.uint8], board: Board) -> str | None:
    """Name of another dictionary whose markers a photograph shows, the smallest that may be."""
    import cv2

    families: dict[str, dict[int, str]] = {}
    for name in dictionaries():
        family = name.rpartition("_")[0] if "x" in name else name
        families.setdefault(family, {})[len(aruco_dictionary(name).bytesList)] = name
    for sizes in families.values():
        # The largest of a family holds the markers of all.
        detector = cv2.aruco.ArucoDetector(aruco_dictionary(sizes[max(sizes)]))
        ids = detector.detectMarkers(image)[1]
        if ids is None or len(np.unique(ids)) < _LEAST_MARKERS:
            continue
        least = max(int(np.max(ids)) + 1, board.n_markers)
        name = sizes[min((size for size in sizes if size >= least), default=max(sizes))]
        return None if name == board.dictionary else name
    return None


def is_mirrored(image: NDArray[np.uint8], board: Board) -> bool:
    """Whether a picture shows the board only when it is flipped; charuco boards alone can tell."""
    return board.kind == "charuco" and len(find_corners(image[::-1].copy(), board)) > 0
