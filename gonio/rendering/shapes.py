"""Shapes whose intersection with a ray is a formula: quadrics of revolution, boxes, plates.

Every shape gives the point where a ray meets it, the outward normal there, and the direction in
which it is brushed: the x axis of the sample's frame in which a model is evaluated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gonio.geometry import FloatArray

NEAR = 1e-7  # distance along a ray up to which a hit is on the surface where it starts
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # z of the shape is up, y


@dataclass(frozen=True, kw_only=True)
class Shape(ABC):
    """A shape in a frame of its own.

    Parameters
    ----------
    centre : ndarray, shape (3,)
        Where the origin of its frame lies in the scene.
    axes : ndarray, shape (3, 3)
        Columns are its x, y and z axes in the scene.
    """

    centre: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes: FloatArray = field(default_factory=lambda: np.eye(3))

    def meet(self, origin: FloatArray, along: FloatArray) -> FloatArray:
        """Distance (n,) at which rays from `origin` (n, 3) first meet it; inf where they do not."""
        t = self._meet((origin - self.centre) @ self.axes, along @ self.axes)
        return np.asarray(np.where(t > NEAR, t, np.inf))

    def frame(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Outward normal and brushed direction, unit vectors (n, 3), at points of its surface."""
        normal, brushed = self._frame((point - self.centre) @ self.axes)
        return normal @ self.axes.T, brushed @ self.axes.T

    @abstractmethod
    def _meet(self, o: FloatArray, d: FloatArray) -> FloatArray:
        """`meet` in its own frame; distances up to NEAR are ignored."""

    @abstractmethod
    def _frame(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`frame` in its own frame."""


@dataclass(frozen=True)
class Piece:
    """Part of a surface of revolution, x^2 + y^2 = a + b z + c z^2 between two heights.

    A cylinder has b = c = 0, a cone c > 0, a sphere of radius a^(1/2) about 0 has c = -1.
    """

    low: float
    high: float
    a: float
    b: float = 0.0
    c: float = 0.0

    def meet(self, o: FloatArray, d: FloatArray) -> FloatArray:
        """First distance of rays at which they pass the surface between the heights."""
        # (o + t d) in x^2 + y^2 - a - b z - c z^2 = 0 is q t^2 + 2 p t + s = 0.
        q = d[:, 0] ** 2 + d[:, 1] ** 2 - self.c * d[:, 2] ** 2
        p = o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1] - d[:, 2] * (self.b / 2 + self.c * o[:, 2])
        s = o[:, 0] ** 2 + o[:, 1] ** 2 - self.a - o[:, 2] * (self.b + self.c * o[:, 2])
        root = np.sqrt(np.maximum(p * p - q * s, 0))
        # First the root without cancellation, then the other from their product s/q.
        w = -p - np.copysign(root, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = np.stack([w / q, s / w])
        z = o[:, 2] + roots * d[:, 2]
        inside = (p * p >= q * s) & (roots > NEAR) & (z >= self.low) & (z <= self.high)
        return np.asarray(np.where(inside, roots, np.inf).min(axis=0))


@dataclass(frozen=True, kw_only=True)
class Revolution(Shape):
    """A surface of revolution about its z axis, brushed along its circles of latitude.

    Parameters
    ----------
    pieces : sequence of Piece
        From the bottom to the top. Where they end on a circle, a flat disc closes the shape.
    open_top : bool
        Leave the upper disc out, which shows the inside of a thin wall.
    """

    pieces: Sequence[Piece]
    open_top: bool = False

    def _caps(self) -> list[tuple[float, float, float]]:
        """Height, squared radius and direction (down or up) of the closing discs."""
        ends = [(self.pieces[0], self.pieces[0].low, -1.0)]
        if not self.open_top:
            ends += [(self.pieces[-1], self.pieces[-1].high, 1.0)]
        caps = [(z, k.a + k.b * z + k.c * z * z, up) for k, z, up in ends]
        return [cap for cap in caps if cap[1] > 1e-12]

    def _meet(self, o: FloatArray, d: FloatArray) -> FloatArray:
        t = np.min([piece.meet(o, d) for piece in self.pieces], axis=0)
        for z, r2, _ in self._caps():
            with np.errstate(divide="ignore", invalid="ignore"):
                s = (z - o[:, 2]) / d[:, 2]
                on = (o[:, 0] + s * d[:, 0]) ** 2 + (o[:, 1] + s * d[:, 1]) ** 2 <= r2
            t = np.where(on & (s > NEAR) & (s < t), s, t)
        return np.asarray(t)

    def _frame(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y, z = point.T
        normal = np.zeros_like(point)
        smallest = np.full(len(point), np.inf)
        for piece in self.pieces:
            # Of the pieces that reach this height, the one on whose surface the point lies.
            deviation = np.abs(x * x + y * y - piece.a - z * (piece.b + piece.c * z))
            deviation = np.where(
                (z < piece.low - 1e-9) | (z > piece.high + 1e-9), np.inf, deviation
            )
            slope = np.broadcast_to(-(piece.b / 2 + piece.c * z), x.shape)
            normal[deviation < smallest] = np.stack([x, y, slope], axis=1)[deviation < smallest]
            smallest = np.minimum(deviation, smallest)
        for height, _, up in self._caps():
            flat = (np.abs(z - height) < 1e-9) & (smallest > 1e-9)
            normal[flat] = [0.0, 0.0, up]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        return normal, _around_z(x, y)


def _around_z(x: FloatArray, y: FloatArray) -> FloatArray:
    """Unit vectors along the circles of latitude; along x on the axis itself."""
    r = np.hypot(x, y)
    on_axis = r < 1e-12
    r = np.where(on_axis, 1.0, r)
    around = np.stack([-y / r, x / r, np.zeros_like(x)], axis=1)
    around[on_axis] = [1.0, 0.0, 0.0]
    return around


@dataclass(frozen=True, kw_only=True)
class Box(Shape):
    """A box with its middle at the origin; its upright faces are brushed horizontally.

    Parameters
    ----------
    half : ndarray, shape (3,)
        Half its edges. The z axis is the upright one.
    """

    half: FloatArray

    def _meet(self, o: FloatArray, d: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = (-self.half - o) / d, (self.half - o) / d
        # A ray in a face's own plane gives 0/0: it does not pass that pair of faces.
        enter = np.nan_to_num(np.minimum(low, high), nan=-np.inf, neginf=-np.inf, posinf=np.inf)
        leave = np.nan_to_num(np.maximum(low, high), nan=np.inf, neginf=-np.inf, posinf=np.inf)
        first, last = enter.max(axis=1), leave.min(axis=1)
        t = np.where(first > NEAR, first, last)
        return np.asarray(np.where((first <= last) & (t > NEAR), t, np.inf))

    def _frame(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        face = np.argmin(np.abs(np.abs(point) - self.half), axis=1)
        row = np.arange(len(point))
        normal = np.zeros_like(point)
        normal[row, face] = np.sign(point[row, face])
        # Horizontal in each face: along y on the x faces, along x on the others.
        brushed = np.where((face == 0)[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
        return normal, brushed


@dataclass(frozen=True, kw_only=True)
class Plate(Shape):
    """A flat rectangle about the origin, visible from both sides, brushed along its x axis.

    Parameters
    ----------
    half_x, half_y : float
        Half its edges; infinite ones are allowed.
    """

    half_x: float = np.inf
    half_y: float = np.inf

    def _meet(self, o: FloatArray, d: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -o[:, 2] / d[:, 2]
            x, y = o[:, 0] + t * d[:, 0], o[:, 1] + t * d[:, 1]
            on = (t > NEAR) & (np.abs(x) <= self.half_x) & (np.abs(y) <= self.half_y)
        return np.asarray(np.where(on & np.isfinite(t), t, np.inf))

    def _frame(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (
            np.broadcast_to([0.0, 0.0, 1.0], point.shape),
            np.broadcast_to([1.0, 0.0, 0.0], point.shape),
        )


@dataclass(frozen=True)
class Hits:
    """Where n rays meet a scene.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        inf where a ray meets nothing; the other fields are then undefined.
    point : ndarray, shape (n, 3)
    frame : ndarray, shape (n, 3, 3)
        Columns are the x, y and z axes of the sample: brushed direction, across it, normal. The
        normal is on the side from which the ray comes.
    """

    distance: FloatArray
    point: FloatArray
    frame: FloatArray

    @property
    def met(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """True where a ray meets something."""
        return np.asarray(np.isfinite(self.distance))


def trace(shapes: Sequence[Shape], origin: FloatArray, along: FloatArray, turn: float) -> Hits:
    """The first shape that each ray meets; the brushed direction is turned by `turn` radians."""
    t = np.array([shape.meet(origin, along) for shape in shapes])
    nearest, distance = np.argmin(t, axis=0), t.min(axis=0)
    point = origin + np.where(np.isfinite(distance), distance, 0.0)[:, None] * along
    normal, brushed = np.zeros_like(point), np.zeros_like(point)
    normal[:, 2], brushed[:, 0] = 1.0, 1.0
    for k, shape in enumerate(shapes):
        on_shape = (nearest == k) & np.isfinite(distance)
        normal[on_shape], brushed[on_shape] = shape.frame(point[on_shape])
    facing = np.sum(normal * along, axis=1) <= 0
    return Hits(distance, point, _axes(np.where(facing[:, None], normal, -normal), brushed, turn))


def hidden(
    shapes: Sequence[Shape], origin: FloatArray, along: FloatArray, distance: FloatArray
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether something lies on each ray before this distance."""
    return np.asarray(np.any([shape.meet(origin, along) < distance for shape in shapes], axis=0))


def _axes(normal: FloatArray, brushed: FloatArray, turn: float) -> FloatArray:
    """Orthonormal axes (n, 3, 3) from normals and directions across them."""
    x = brushed - np.sum(brushed * normal, axis=1, keepdims=True) * normal
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(normal, x)
    turned = np.cos(turn) * x + np.sin(turn) * y
    return np.stack([turned, np.cross(normal, turned), normal], axis=2)
