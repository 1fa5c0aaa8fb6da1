"""Rotation vectors, their matrices and derivatives."""

from __future__ import annotations

import numpy as np

from gonio.geometry import FloatArray


def rotation(turn: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector, radians (Rodrigues).

    Examples
    --------
    >>> rotation(np.array([0.0, 0.0, np.pi / 2])).round(12).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    cross = _cross(turn)
    angle = float(np.linalg.norm(turn))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + _versine(angle) * cross @ cross)


def rotation_vector(matrix: FloatArray) -> FloatArray:
    """Rotation vector of a rotation matrix, of a length up to pi."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())


def left_jacobian(turn: FloatArray) -> FloatArray:
    """J with exp(turn + d) = exp(J d) exp(turn) to first order."""
    angle = float(np.linalg.norm(turn))
    cross = _cross(turn)
    if angle < 1e-4:
        third = 1 / 6 - angle**2 / 120
    else:
        third = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + _versine(angle) * cross + third * cross @ cross)


def _versine(angle: float) -> float:
    """(1 - cos angle) / angle^2."""
    return float(np.sinc(angle / (2 * np.pi)) ** 2 / 2)


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
