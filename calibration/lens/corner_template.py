"""Corners of a board to a few hundredths of a pixel, and corners that no detector has found.

If the lens and the board's pose are known to a fraction of a square, the picture around each corner
is known except for a shift, its contrast and its blur. The shift is found by least squares on the
pixels as they are: nothing is resampled, and neither the curvature of the squares' edges, nor
foreshortening, nor a marker close by moves the result. Lucas & Kanade, IJCAI 1981, with the board
as the template.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.board import Board
from gonio.calibration.lens.board_poses import Pose
from gonio.calibration.lens.fisheye import Fisheye
from gonio.calibration.lens.rotations import rotation
from gonio.geometry import FloatArray

BLUR_PX = 0.7  # of the template; a wrong one costs contrast and moves nothing
WINDOW_SHARE = 0.5  # half-width of a window over the shorter side of a square in the picture
LEAST_HALF_PX, LARGEST_HALF_PX = 3.0, 9.0
LEAST_CORRELATION = 0.9
LARGEST_SHIFT = 0.3  # of that side
_LONGEST_STEP_PX = 1.0
_GRID, _FINE_GRID = 4, 12  # points along a pixel, and along one that an edge crosses
_ROUNDS = 3
_PAD = 2  # pixels around a window for blur and slopes


@dataclass(frozen=True)
class Ink:
    """The board as a picture: 1 paper, 0 ink."""

    board: Board
    content: NDArray[np.int64]
    markers: NDArray[np.bool_]

    @classmethod
    def of(cls, board: Board) -> Ink:
        """The picture of a board."""
        return cls(board, *board.pattern())


def refine(
    image: NDArray[Any], ink: Ink, lens: Fisheye, pose: Pose
) -> tuple[NDArray[np.int64], FloatArray]:
    """Corners of a board in a photograph whose lens and pose are known nearly.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Counts, in any unit.
    ink : Ink
    lens, pose : Fisheye, Pose
        From a first fit, good to a quarter of a square.

    Returns
    -------
    numbers : ndarray of int, shape (n,)
        Of the corners that look as the board does there; the others are hidden, out of the field
        or not sharp enough.
    pixels : ndarray, shape (n, 2)
        Column and row.
    """
    points = pose.to_camera(ink.board.corners_mm())
    start = lens.project(points)
    half = _half_widths(lens, pose, points, ink.board.square_mm)
    span = np.arange(-int(half.max()) - _PAD, int(half.max()) + _PAD + 1)
    nearest = np.round(np.where(np.isfinite(start), start, -1e6)).astype(int)
    inside = np.all((nearest + span[0] >= 0) & (nearest + span[-1] < image.shape[::-1]), axis=1)
    numbers = np.flatnonzero(inside)
    if not len(numbers):
        return numbers, np.empty((0, 2))
    start, nearest, half = start[numbers], nearest[numbers], half[numbers]

    column = nearest[:, 0, None, None] + span[None, None, :] + 0 * span[None, :, None]
    row = nearest[:, 1, None, None] + span[None, :, None] + 0 * span[None, None, :]
    on_board = _on_board(lens, pose, column, row)
    offset = np.stack([column, row], -1) - start[:, None, None, :]
    weight = (np.hypot(*np.moveaxis(offset, -1, 0)) <= half[:, None, None]).astype(float)
    counts = image[row, column].astype(float)
    shift, correlation = _match(counts, weight, offset, on_board, ink)
    side = half / WINDOW_SHARE
    good = (correlation >= LEAST_CORRELATION) & (np.hypot(*shift.T) <= LARGEST_SHIFT * side)
    return numbers[good], (start + shift)[good]


def _half_widths(lens: Fisheye, pose: Pose, points: FloatArray, square: float) -> FloatArray:
    """Half-width of each corner's window: half the shorter side of a square, in pixels."""
    by_board = lens.derivatives(points)[2] @ rotation(pose.turn)[:, :2]
    side = square * np.linalg.norm(by_board, axis=1).min(axis=1)
    return np.asarray(np.clip(WINDOW_SHARE * side, LEAST_HALF_PX, LARGEST_HALF_PX))


def _on_board(
    lens: Fisheye, pose: Pose, column: NDArray[np.int64], row: NDArray[np.int64]
) -> FloatArray:
    """Points of the board that pixels see, mm (..., 2); NaN where they miss its plane."""
    w = lens.directions(np.stack([column, row], -1)) @ rotation(pose.turn)
    eye = -pose.shift @ rotation(pose.turn)
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.where(w[..., 2] > 0, -eye[2] / w[..., 2], np.nan)
    return np.asarray(eye[:2] + distance[..., None] * w[..., :2])


def _match(
    counts: FloatArray, weight: FloatArray, offset: FloatArray, on_board: FloatArray, ink: Ink
) -> tuple[FloatArray, FloatArray]:
    """Shift (n, 2) in pixels and correlation (n,) of each window (n, m, m) with the template."""
    # Change of the point on the board by a pixel along the columns and along the rows.
    by_column, by_row = np.gradient(on_board, axis=2), np.gradient(on_board, axis=1)
    bad = ~np.isfinite(on_board).all(axis=(1, 2, 3))
    on_board, by_column, by_row = (np.nan_to_num(a) for a in (on_board, by_column, by_row))
    shift = np.zeros((len(counts), 2))
    correlation = np.zeros(len(counts))
    background = [np.ones_like(counts), offset[..., 0], offset[..., 1]]
    _, level = _least_squares(counts, weight, background)
    for _ in range(_ROUNDS):
        template = _template(on_board, by_column, by_row, shift, ink)
        slopes = np.gradient(template, axis=2), np.gradient(template, axis=1)
        fitted, rest = _least_squares(counts, weight, [*background, template, *slopes])
        contrast = fitted[:, 3]
        # A chessboard without markers that is turned by 180 deg may show paper for ink.
        usable = ~bad & (contrast != 0 if ink.board.kind == "chessboard" else contrast > 0)
        explained = 1 - rest / np.where(level > 0, level, 1)
        correlation = np.where(usable, np.sqrt(np.clip(explained, 0, 1)), 0)
        step = -fitted[:, 4:] / np.where(usable, contrast, np.inf)[:, None]
        shift += np.clip(step, -_LONGEST_STEP_PX, _LONGEST_STEP_PX)
    return shift, correlation


def _template(
    on_board: FloatArray, by_column: FloatArray, by_row: FloatArray, shift: FloatArray, ink: Ink
) -> FloatArray:
    """The board as a blurred lens would show it, moved by `shift` pixels."""
    from scipy.ndimage import gaussian_filter

    board = ink.board
    size = np.array([board.square_mm, board.marker_side])
    out = np.empty(on_board.shape[:3])
    _paper(on_board, by_column, by_row, shift, size, ink.content, ink.markers, out)
    return np.asarray(gaussian_filter(out, (0, BLUR_PX, BLUR_PX), truncate=_PAD / BLUR_PX))


@njit(cache=True, nogil=True)
def _paper(on_board, by_column, by_row, shift, size, content, markers, out):  # type: ignore[no-untyped-def]
    """Share of paper in every pixel (n, m, m) of the windows."""
    for k in range(out.shape[0]):
        for row in range(out.shape[1]):
            for column in range(out.shape[2]):
                point = on_board[k, row, column]
                right, down = by_column[k, row, column], by_row[k, row, column]
                share = _share(_GRID, point, right, down, shift[k], size, content, markers)
                if 0.0 < share < 1.0:
                    share = _share(_FINE_GRID, point, right, down, shift[k], size, content, markers)
                out[k, row, column] = share


@njit(cache=True, nogil=True)
def _share(n, point, right, down, shift, size, content, markers):  # type: ignore[no-untyped-def]
    """Share of paper among n x n points of a pixel."""
    count = 0
    for i in range(n):
        du = (i + 0.5) / n - 0.5 - shift[0]
        for j in range(n):
            dv = (j + 0.5) / n - 0.5 - shift[1]
            count += _is_paper(
                point[0] + du * right[0] + dv * down[0],
                point[1] + du * right[1] + dv * down[1],
                size,
                content,
                markers,
            )
    return count / n**2


@njit(cache=True, nogil=True, inline="always")
def _is_paper(x, y, size, content, markers):  # type: ignore[no-untyped-def]
    """Paper (True) or ink at a point of the board, mm; paper beyond its squares."""
    square, marker = size
    column, row = math.floor(x / square), math.floor(y / square)
    if not (0 <= column < content.shape[1] and 0 <= row < content.shape[0]):
        return True
    what = content[row, column]
    if what < 0:
        return what == -2
    cells = markers.shape[1]
    edge = (square - marker) / 2
    i = math.floor((x - column * square - edge) / marker * cells)
    j = math.floor((y - row * square - edge) / marker * cells)
    return not (0 <= i < cells and 0 <= j < cells) or markers[what, j, i]


def _least_squares(
    counts: FloatArray, weight: FloatArray, columns: list[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (n, columns) and weighted sum of squares (n,) for each window."""
    a = np.stack(columns, -1)
    normal = np.einsum("nijk,nij,nijl->nkl", a, weight, a)
    right = np.einsum("nijk,nij,nij->nk", a, weight, counts)
    size = np.sqrt(np.einsum("nkk->nk", normal)) + 1e-12
    scaled = normal / size[:, :, None] / size[:, None, :] + 1e-12 * np.eye(a.shape[-1])
    coefficients = np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size
    left = counts - np.einsum("nijk,nk->nij", a, coefficients)
    return coefficients, np.einsum("nij,nij,nij->n", left, weight, left)
