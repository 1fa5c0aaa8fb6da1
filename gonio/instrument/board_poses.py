"""Random poses of a calibration board in front of the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gonio.board import Board
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument.board_camera import BoardCamera

# Directions of the boards' middles from the axis, as parts of the half field, and how often.
# The rim gets half of the photographs: there the lens is fitted or extrapolated.
_RINGS = ((0.0, 0.25, 0.2), (0.3, 0.55, 0.3), (0.65, 0.95, 0.5))
_TILT = np.radians(35)
_GOLDEN = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class Pose:
    """Pose of a board in front of the camera: X_camera = rotation X_board + translation (mm)."""

    rotation: FloatArray
    translation: FloatArray

    def to_camera(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) of the board in the frame of the camera, mm."""
        return points @ self.rotation.T + self.translation


def draw_poses(board: Board, camera: BoardCamera, n: int, rng: np.random.Generator) -> list[Pose]:
    """Poses for n photographs: in the middle, half-way and at the rim, at all azimuths, tilted.

    A plain chessboard is detected only if all of it is visible. It is moved towards the axis until
    its outer corners are in the field.
    """
    rings = _rings(n, rng)
    # Steps of the golden angle within a ring cover all azimuths, for few photographs and many.
    steps = [rings[:k].count(ring) for k, ring in enumerate(rings)]
    return [
        _draw_pose(board, camera, ring, step * _GOLDEN, rng)
        for ring, step in zip(rings, steps, strict=True)
    ]


def _rings(n: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """The ring of each photograph: rings in their shares, interleaved."""
    last = np.cumsum([share for _, _, share in _RINGS])
    chosen = np.searchsorted(last, (np.arange(n) + 0.5) / n)
    return [_RINGS[k][:2] for k in rng.permutation(np.minimum(chosen, len(_RINGS) - 1))]


def _draw_pose(
    board: Board,
    camera: BoardCamera,
    ring: tuple[float, float],
    azimuth: float,
    rng: np.random.Generator,
) -> Pose:
    width, height = board.size_mm
    theta = rng.uniform(*ring) * camera.half_field
    phi = azimuth + rng.uniform(-0.3, 0.3)
    distance = rng.uniform(0.55, 0.85) * math.hypot(width, height)
    turn, lean = rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    tilt = rng.uniform(0.25, 1) * _TILT
    middle = np.array([width / 2, height / 2, 0.0])
    square = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], float)
    for shrink in np.linspace(1, 0, 41):
        rotation = _towards(theta * shrink, phi) @ _tilted(tilt * shrink**0.25, lean)
        rotation = rotation @ _tilted(0, 0, turn)
        direction = unit_vectors(theta * shrink, phi)
        pose = Pose(rotation, distance * direction - rotation @ middle)
        if board.kind == "charuco" or np.isfinite(camera.project(pose.to_camera(square))).all():
            return pose
    raise ConfigurationError(
        f"the {board} does not fit in the field of {camera.lens.field_deg:g} deg; "
        "use a charuco board, which is found in parts."
    )


def _towards(theta: float, phi: float) -> FloatArray:
    """Rotation that turns the axis to a direction, about a line across both."""
    return _tilted(theta, phi + np.pi / 2)


def _tilted(angle: float, about: float, turn: float = 0.0) -> FloatArray:
    """Rotation by `angle` about a line in the x-y plane at azimuth `about`, after one about z."""
    axis = np.array([math.cos(about), math.sin(about), 0.0])
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
    tilt = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    cos, sin = math.cos(turn), math.sin(turn)
    return np.asarray(tilt @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]))
