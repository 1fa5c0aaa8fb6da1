"""Boards before a camera: corners in a photograph, and the pose of the board."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.lens.fisheye import Fisheye
from gonio.calibration.lens.rotations import rotation, rotation_vector
from gonio.geometry import FloatArray


@dataclass(frozen=True)
class View:
    """Corners of one photograph.

    Parameters
    ----------
    name : str
        Of the photograph, for messages.
    board : ndarray, shape (n, 3)
        The corners in the frame of the board, mm, z = 0.
    pixels : ndarray, shape (n, 2)
        Column and row; whole numbers are pixels' centres.
    """

    name: str
    board: FloatArray
    pixels: FloatArray

    def subset(self, keep: NDArray[np.bool_]) -> View:
        """The view with some of its corners."""
        return replace(self, board=self.board[keep], pixels=self.pixels[keep])


@dataclass(frozen=True)
class Pose:
    """Position of a board: X_camera = exp(turn) X_board + shift; `turn` a rotation vector, mm."""

    turn: FloatArray
    shift: FloatArray

    def to_camera(self, board: FloatArray) -> FloatArray:
        """Points (n, 3) of the board in the frame of the camera."""
        return np.asarray(board @ rotation(self.turn).T + self.shift)

    def normal(self) -> FloatArray:
        """Unit vector across the board, away from its viewer."""
        return rotation(self.turn)[:, 2]


def pose_of_board(view: View, lens: Fisheye) -> Pose:
    """Pose of a board before a known lens, from four corners or more.

    The direct linear transformation of rays, for any angle from the axis:

    w x (H (X, Y, 1)) = 0 with H = (r1, r2, t): a homography of directions, not of points on an
    image plane, so that nothing is special at 90 deg.
    """
    w = lens.directions(view.pixels)
    w = np.where(np.isfinite(w), w, [0.0, 0.0, -1.0])
    middle, scale = view.board[:, :2].mean(axis=0), view.board[:, :2].std()
    p = np.column_stack([(view.board[:, :2] - middle) / scale, np.ones(len(w))])
    cross = np.zeros((len(w), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    rows = np.einsum("nij,nk->nijk", cross, p).reshape(-1, 9)
    h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    if np.sum(np.einsum("ni,ij,nj->n", w, h, p)) < 0:
        h = -h
    size = (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1])) / 2
    h = h / size
    u, _, vt = np.linalg.svd(np.column_stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])]))
    turned = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    shift = h[:, 2] * scale - turned @ np.array([*middle, 0.0])
    return Pose(rotation_vector(turned), shift)
