"""Photographs of calibration boards as the camera of a virtual instrument takes them.

There is no dome and no lamp arm: a board is held in front of the lens in a lit room. Every pixel
averages a grid of rays through the lens onto the board. Then follow the blur of the lens, its
fall-off towards the rim, and the noise of the sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.board import Board
from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument.board_camera import BoardCamera
from gonio.instrument.board_poses import Pose
from gonio.instrument.noise import expose
from gonio.kernels.threads import map_blocks

WHITE, BLACK = 0.9, 0.05  # reflectance of paper and ink of the board
ROOM = 0.35  # mean reflectance of the background behind the board
EXPOSED = 0.7  # of the sensor's range, for white on the axis
GRID, FINE_GRID = 4, 12  # rays along the side of a pixel, and of one that an edge crosses
_OUTSIDE = -1.0


@dataclass(frozen=True)
class _Pixels:
    """The pixels inside the image circle: directions, and change of direction across them."""

    index: NDArray[np.int64]  # (n,) flat
    direction: FloatArray  # (n, 3)
    by_column: FloatArray  # (n, 3), change of direction over one column
    by_row: FloatArray
    throughput: FloatArray  # (n,), 1 on the axis


class Photographer:
    """A virtual photographer of one board with one camera."""

    def __init__(self, board: Board, camera: BoardCamera, *, threads: int | None = None) -> None:
        self.board, self.camera, self.threads = board, camera, threads
        self._content, self._markers = board.pattern()
        self._pixels = _pixels(camera)

    def take(self, pose: Pose, *, seed: int, number: int) -> NDArray[np.uint16]:
        """Raw counts (rows, columns) of one photograph.

        Parameters
        ----------
        pose : Pose
        seed, number : int
            Of the noise; the camera's fixed pattern and the room follow from the seed alone.
        """
        sensor = self.camera.sensor
        range_e = (sensor.saturation_dn - sensor.binned_black_dn) / sensor.binned_gain_dn_per_e
        white_e = EXPOSED * min(sensor.binned_full_well_e, range_e)
        signal = self.irradiance(pose, seed=seed) * (white_e / WHITE) * self._response(seed)
        return expose(
            signal, 1.0, seed=seed, frame=number, threads=self.threads, **sensor.readout()
        )

    def _response(self, seed: int) -> FloatArray:
        """Relative response of every pixel: PRNU alone, bad pixels left out."""
        sensor = self.camera.sensor
        rng = np.random.default_rng([seed, 11])
        return np.asarray(1 + sensor.prnu / sensor.binning * rng.standard_normal(sensor.shape))

    def irradiance(self, pose: Pose, *, seed: int = 0) -> FloatArray:
        """Irradiance of every pixel (rows, columns) without noise, 1 for a white of 1 on axis."""
        from scipy.ndimage import gaussian_filter

        pixels, camera, board = self._pixels, self.camera, self.board
        room = _room(pixels.direction, seed)
        # The board's plane in its own frame: ray = eye + s direction, z = 0.
        to_board = pose.rotation.T
        eye = -to_board @ pose.translation
        rays = [
            np.ascontiguousarray(v @ to_board.T)
            for v in (pixels.direction, pixels.by_column, pixels.by_row)
        ]
        out = np.empty(len(pixels.index))
        size = np.array([*board.size_mm, board.margin_mm, board.square_mm, board.marker_side])

        def work(a: int, b: int) -> None:
            _average(
                *(ray[a:b] for ray in rays), eye, size, self._content, self._markers, room[a:b],
                out[a:b],
            )  # fmt: skip

        map_blocks(work, len(out), threads=self.threads, block=1 << 14)
        image = np.zeros(camera.sensor.shape)
        image.ravel()[pixels.index] = out * pixels.throughput
        blur = camera.lens.psf_px / camera.sensor.binning
        return np.asarray(gaussian_filter(image, blur) if blur else image)


def _pixels(camera: BoardCamera) -> _Pixels:
    """Table of the lens: the rays of a pixel follow from its central ray to first order.

    The neglected term is 1/(24 f^2) in angle, f in pixels: less than 1e-3 of a pixel for a fisheye
    image of more than 100 pixels across.
    """
    lens, pitch = camera.lens, camera.pitch_mm
    x, y = (grid.ravel() for grid in np.meshgrid(*camera.sensor.positions_mm()))
    theta = lens.polar_angle(np.hypot(x, y))
    index = np.flatnonzero(np.isfinite(theta))
    theta, phi = theta[index], np.arctan2(y, x)[index]
    # d(direction) = e_theta dtheta + e_phi sin(theta) dphi with dtheta = dr/r', dphi = ds/r.
    flat = np.zeros_like(phi)
    e_theta = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])
    e_phi = np.stack([-np.sin(phi), np.cos(phi), flat])
    radius = lens.radius(theta)
    on_axis = radius == 0
    across = np.where(on_axis, 1 / lens.slope(0.0), np.sin(theta) / np.where(on_axis, 1, radius))
    radial, around = e_theta / lens.slope(theta), e_phi * across
    return _Pixels(
        index,
        unit_vectors(theta, phi),
        ((radial * np.cos(phi) - around * np.sin(phi)) * pitch[0]).T,
        ((radial * np.sin(phi) + around * np.cos(phi)) * pitch[1]).T,
        lens.relative_illumination(theta) * lens.solid_angle(theta),
    )


def _room(direction: FloatArray, seed: int) -> FloatArray:
    """Radiance of the room behind the board, brighter to one side."""
    rng = np.random.default_rng([seed, 7])
    light = unit_vectors(rng.uniform(0.5, 1.5), rng.uniform(-np.pi, np.pi))
    return np.asarray(ROOM * (1 + 0.4 * direction @ light))


@njit(cache=True, nogil=True)
def _average(w, by_column, by_row, eye, size, content, markers, room, out):  # type: ignore[no-untyped-def]
    """Mean reflectance over the rays of each pixel, more of them where an edge crosses it."""
    for k in range(out.shape[0]):
        mean, mixed = _mean_of(
            GRID, w[k], by_column[k], by_row[k], eye, size, content, markers, room[k]
        )
        if mixed:
            mean, _ = _mean_of(
                FINE_GRID, w[k], by_column[k], by_row[k], eye, size, content, markers, room[k]
            )
        out[k] = mean


@njit(cache=True, nogil=True)
def _mean_of(n, w, by_column, by_row, eye, size, content, markers, room):  # type: ignore[no-untyped-def]
    """Mean reflectance over n x n rays of a pixel, and whether they differ."""
    total, first, mixed = 0.0, 0.0, False
    for i in range(n):
        u = (i + 0.5) / n - 0.5
        for j in range(n):
            v = (j + 0.5) / n - 0.5
            z = w[2] + u * by_column[2] + v * by_row[2]
            value = _OUTSIDE
            # The eye is at negative z, before the face; a ray must go towards it.
            if z > 0.0 and eye[2] < 0.0:
                s = -eye[2] / z
                x = eye[0] + s * (w[0] + u * by_column[0] + v * by_row[0])
                y = eye[1] + s * (w[1] + u * by_column[1] + v * by_row[1])
                value = _reflectance(x, y, size, content, markers)
            value = room if value == _OUTSIDE else value
            if i == 0 and j == 0:
                first = value
            mixed = mixed or value != first
            total += value
    return total / (n * n), mixed


@njit(cache=True, nogil=True)
def _reflectance(x, y, size, content, markers):  # type: ignore[no-untyped-def]
    """Reflectance at a point of the board's plane, or _OUTSIDE."""
    width, height, margin, square, marker = size
    if not (-margin <= x <= width + margin and -margin <= y <= height + margin):
        return _OUTSIDE
    if not (0.0 <= x < width and 0.0 <= y < height):
        return WHITE
    column = min(int(x / square), content.shape[1] - 1)
    row = min(int(y / square), content.shape[0] - 1)
    what = content[row, column]
    if what == -1:
        return BLACK
    if what == -2:
        return WHITE
    cells = markers.shape[1]
    edge = (square - marker) / 2
    i = math.floor((x - column * square - edge) / marker * cells)
    j = math.floor((y - row * square - edge) / marker * cells)
    if 0 <= i < cells and 0 <= j < cells and not markers[what, j, i]:
        return BLACK
    return WHITE
