"""Lights of a scene: a distant lamp, a rectangle, an environment.

A light draws directions towards itself, with their density, and gives its radiance along any
direction. Multiple importance sampling needs both.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gonio.errors import ConfigurationError, DataError
from gonio.geometry import FloatArray, unit_vectors

WHITE = math.pi  # irradiance in which a perfect white surface has the radiance 1


class Towards(NamedTuple):
    """Directions towards a light, from n points.

    Parameters
    ----------
    along : ndarray, shape (n, 3)
        Unit vectors.
    distance : ndarray, shape (n,)
        inf for a distant light.
    radiance : ndarray, shape (n,)
        Incoming radiance; for a light of one direction, the irradiance across the beam.
    density : ndarray, shape (n,)
        Probability density of the direction, sr^-1; 0 where no light comes from it.
    """

    along: FloatArray
    distance: FloatArray
    radiance: FloatArray
    density: FloatArray


class Light(ABC):
    """A light that fills a solid angle."""

    @abstractmethod
    def draw(self, point: FloatArray, u: FloatArray) -> Towards:
        """One direction for each point (n, 3), from numbers u (2, n) uniform in [0, 1)."""

    @abstractmethod
    def incoming(self, point: FloatArray, along: FloatArray) -> Towards:
        """Radiance at points from given directions (n, 3), and their density in `draw`."""


@dataclass(frozen=True)
class Directional(Light):
    """A distant lamp, one direction.

    Parameters
    ----------
    theta_i, phi_i : float
        Direction towards it about the axis of the scene, radians.
    irradiance : float
        Across the beam; at pi, the default, a perfect white surface that faces it has radiance 1.
    """

    theta_i: float = 0.0
    phi_i: float = 0.0
    irradiance: float = WHITE

    def draw(self, point: FloatArray, u: FloatArray) -> Towards:
        n = len(point)
        along = np.broadcast_to(unit_vectors(self.theta_i, self.phi_i), (n, 3))
        return Towards(along, np.full(n, np.inf), np.full(n, self.irradiance), np.ones(n))

    def incoming(self, point: FloatArray, along: FloatArray) -> Towards:
        n = len(point)
        return Towards(along, np.full(n, np.inf), np.zeros(n), np.zeros(n))


@dataclass(frozen=True)
class Rectangle(Light):
    """A flat lamp that sends the same radiance everywhere on its front.

    Parameters
    ----------
    centre : ndarray, shape (3,)
        Its middle in the scene.
    edge_u, edge_v : ndarray, shape (3,)
        Its edges, at right angles; the front is on the side of edge_u x edge_v.
    radiance : float
    """

    centre: FloatArray
    edge_u: FloatArray
    edge_v: FloatArray
    radiance: float = 1.0

    @classmethod
    def facing(
        cls,
        theta_i: float,
        phi_i: float,
        *,
        distance: float,
        size: tuple[float, float],
        irradiance: float = WHITE,
    ) -> Rectangle:
        """A rectangle that faces the origin of the scene.

        Parameters
        ----------
        theta_i, phi_i : float
            Direction of its middle about the axis of the scene, radians.
        distance : float
            From the origin, in the unit of the scene.
        size : tuple of float
            Width and height.
        irradiance : float
            Irradiance of a surface at the origin that faces it.

        Raises
        ------
        ConfigurationError
            If distance or size is not positive.

        Examples
        --------
        >>> lamp = Rectangle.facing(0.0, 0.0, distance=2.0, size=(1.0, 1.0))
        >>> round(float(np.linalg.norm(lamp.centre)), 12)
        2.0
        """
        for name, value in (("distance", distance), ("width", size[0]), ("height", size[1])):
            if not (math.isfinite(value) and value > 0):
                raise ConfigurationError(
                    f"the light's {name} is {value:g}; it must be a positive length, in the unit "
                    "of the scene.",
                    value=value,
                )
        back = unit_vectors(theta_i, phi_i)
        u = np.array([back[2], 0.0, -back[0]])
        u = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(u) < 1e-9 else u / np.linalg.norm(u)
        v = np.cross(u, -back)  # u x v = -back: the front looks at the origin
        radiance = irradiance / _projected_solid_angle(distance, size)
        return cls(distance * back, size[0] * u, -size[1] * v, radiance)

    @property
    def _normal(self) -> FloatArray:
        n = np.cross(self.edge_u, self.edge_v)
        return np.asarray(n / np.linalg.norm(n))

    @property
    def area(self) -> float:
        """Its area."""
        return float(np.linalg.norm(np.cross(self.edge_u, self.edge_v)))

    def draw(self, point: FloatArray, u: FloatArray) -> Towards:
        position = (
            self.centre + np.outer(u[0] - 0.5, self.edge_u) + np.outer(u[1] - 0.5, self.edge_v)
        )
        way = position - point
        distance = np.linalg.norm(way, axis=1)
        return self._from(way / distance[:, None], distance)

    def incoming(self, point: FloatArray, along: FloatArray) -> Towards:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((self.centre - point) @ self._normal) / (along @ self._normal)
            off = point + t[:, None] * along - self.centre
            inside = np.isfinite(t) & (t > 0)
            for edge in (self.edge_u, self.edge_v):
                inside &= np.abs(off @ edge) <= 0.5 * (edge @ edge)
        return self._from(along, np.where(inside, t, np.inf))

    def _from(self, along: FloatArray, distance: FloatArray) -> Towards:
        """An area dA at this distance is a solid angle cos dA/distance^2.

        The back of the lamp is transparent: it does not hide the scene from the camera.
        """
        cos = -(along @ self._normal)
        lit = (cos > 0) & np.isfinite(distance)
        with np.errstate(invalid="ignore", divide="ignore"):
            density = np.where(lit, distance**2 / (cos * self.area), 0.0)
        return Towards(
            along, np.where(lit, distance, np.inf), np.where(lit, self.radiance, 0.0), density
        )


def _projected_solid_angle(distance: float, size: tuple[float, float]) -> float:
    """int cos dw of a rectangle that faces a surface, both square to the line between them.

    Four quarters, each (1/2)[A atan(b/sqrt(1 + a^2)) + B atan(a/sqrt(1 + b^2))] with a, b the
    half edges over the distance, A = a/sqrt(1 + a^2), B = b/sqrt(1 + b^2).

    Examples
    --------
    >>> round(_projected_solid_angle(1e-6, (1.0, 1.0)), 4)  # it fills the hemisphere
    3.1416
    """
    a, b = size[0] / 2 / distance, size[1] / 2 / distance
    c, d = math.hypot(1, a), math.hypot(1, b)
    return 2 * (a / c * math.atan(b / c) + b / d * math.atan(a / d))


class Environment(Light):
    """Light from all directions, far away: a map in latitude and longitude.

    Parameters
    ----------
    radiance : ndarray, shape (rows, columns)
        Not negative. Rows go from straight up (+y) to straight down in equal steps of the polar
        angle; the middle column lies in the direction -z, into which a camera in front looks, and
        columns go to the right. A single pixel is uniform light. Radiance is constant over a
        pixel.

    Raises
    ------
    DataError
        If a value is negative or not finite, or all are 0.

    Notes
    -----
    A pixel is drawn in proportion to its radiance times its solid angle; directions within it are
    uniform.

    Examples
    --------
    >>> sky = Environment(np.ones((1, 1)))
    >>> sky.radiance_along(np.array([[0.0, 1.0, 0.0]])).tolist()
    [1.0]
    """

    def __init__(self, radiance: FloatArray) -> None:
        values = np.array(radiance, float)
        if values.ndim != 2 or not values.size:
            raise DataError(
                f"an environment of shape {values.shape} was given; it is one grey map (rows, "
                "columns) in latitude and longitude.",
                value=values.shape,
            )
        if not np.all(np.isfinite(values)) or values.min() < 0:
            raise DataError(
                "the environment holds a radiance that is negative or not finite; correct the map.",
                value=float(np.nanmin(values)),
            )
        if values.max() <= 0:
            raise DataError("the environment is black: no pixel has light.", value=0.0)
        self.radiance = values
        rows, columns = values.shape
        edges = np.cos(np.linspace(0, np.pi, rows + 1))
        self._cos = edges
        self._solid_angle = -np.diff(edges) * (2 * np.pi / columns)
        flux = values * self._solid_angle[:, None]
        self._below = np.cumsum(flux.ravel()) / flux.sum()
        self._density = values / flux.sum()

    @classmethod
    def uniform(cls, radiance: float = 1.0) -> Environment:
        """The same radiance from everywhere."""
        return cls(np.array([[float(radiance)]]))

    @property
    def solid_angle(self) -> FloatArray:
        """Solid angle of a pixel of each row, sr, shape (rows,)."""
        return np.asarray(self._solid_angle)

    def directions(self) -> FloatArray:
        """Unit vectors (rows, columns, 3) of the middle of each pixel, by equal areas."""
        columns = self.radiance.shape[1]
        up = (self._cos[1:] + self._cos[:-1]) / 2
        azimuth = ((np.arange(columns) + 0.5) / columns - 0.5) * 2 * np.pi
        return _direction(up[:, None], azimuth[None, :])

    def _pixel(self, along: FloatArray) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = self.radiance.shape
        polar = np.arccos(np.clip(along[..., 1], -1, 1)) / np.pi
        azimuth = np.arctan2(along[..., 0], -along[..., 2]) / (2 * np.pi) + 0.5
        row = np.minimum((polar * rows).astype(int), rows - 1)
        return row, np.minimum((azimuth * columns).astype(int), columns - 1)

    def radiance_along(self, along: FloatArray) -> FloatArray:
        """Radiance from directions (..., 3)."""
        return np.asarray(self.radiance[self._pixel(along)])

    def draw(self, point: FloatArray, u: FloatArray) -> Towards:
        columns = self.radiance.shape[1]
        pixel = np.searchsorted(self._below, u[0], side="right")
        pixel = np.minimum(pixel, self._below.size - 1)
        row, column = np.divmod(pixel, columns)
        # The remainder of the first number is the position within the pixel.
        before = np.where(pixel > 0, self._below[pixel - 1], 0.0)
        within = np.clip((u[0] - before) / np.maximum(self._below[pixel] - before, 1e-300), 0, 1)
        up = self._cos[row] + within * (self._cos[row + 1] - self._cos[row])
        along = _direction(up, ((column + u[1]) / columns - 0.5) * 2 * np.pi)
        return Towards(
            along, np.full(len(along), np.inf), self.radiance[row, column],
            self._density[row, column],
        )  # fmt: skip

    def incoming(self, point: FloatArray, along: FloatArray) -> Towards:
        row, column = self._pixel(along)
        return Towards(
            along, np.full(len(along), np.inf), self.radiance[row, column],
            self._density[row, column],
        )  # fmt: skip


def _direction(up: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Unit vectors with y = up; azimuth 0 is -z and grows towards +x."""
    across = np.sqrt(np.maximum(1 - up * up, 0))
    parts = (across * np.sin(azimuth), np.broadcast_to(up, np.broadcast(up, azimuth).shape),
             -across * np.cos(azimuth))  # fmt: skip
    return np.stack(parts, axis=-1)


SKIES = ("uniform", "overcast", "clear")
GROUND = 0.2  # of the sky's irradiance over pi: the radiance below the horizon


def sky(
    name: str, theta_i: float = 0.0, phi_i: float = math.pi / 2, rows: int = 128
) -> Environment:
    """A sky by formula, scaled so that level ground receives the irradiance pi.

    Parameters
    ----------
    name : {"uniform", "overcast", "clear"}
        `uniform` is the same from everywhere, above and below. `overcast` is (1 + 2 sin gamma)/3
        of its zenith at the height gamma; `clear` is the CIE standard clear sky of clean air
        (type 12), without the sun's disc.
    theta_i, phi_i : float
        Of `clear`, the sun about the axis of the scene, radians.
    rows : int
        Rows of the map; it has twice as many columns.

    Raises
    ------
    ConfigurationError
        For another name, or a sun below the horizon.

    References
    ----------
    ISO 15469:2004 (CIE S 011), eqs (1)-(4) and table 1.
    """
    if name == "uniform":
        return Environment.uniform()
    if name not in SKIES:
        raise ConfigurationError(f"unknown sky {name!r}: known are {', '.join(SKIES)}.", value=name)
    blank = Environment(np.ones((rows, 2 * rows)))
    along = blank.directions()
    up = along[..., 1]
    if name == "overcast":
        radiance = (1 + 2 * np.maximum(up, 0)) / 3
    else:
        sun = unit_vectors(theta_i, phi_i)
        if sun[1] <= 0:
            raise ConfigurationError(
                f"the sun at theta_i = {math.degrees(theta_i):g}, phi_i = "
                f"{math.degrees(phi_i):g} deg is not above the horizon of the scene; choose phi_i "
                "between 0 and 180 deg and theta_i above 0.",
                value=theta_i,
            )
        radiance = _clear(np.maximum(up, 1e-3), along @ sun)
    weight = blank.solid_angle[:, None] * np.maximum(up, 0)
    radiance *= WHITE / np.sum(weight * radiance)
    return Environment(np.where(up > 0, radiance, GROUND))


def _clear(up: FloatArray, cos_sun: FloatArray) -> FloatArray:
    """phi(Z) f(chi): gradation and indicatrix of ISO 15469, type 12, not normalised."""
    a, b, c, d, e = -1.0, -0.32, 10.0, -3.0, 0.45
    chi = np.arccos(np.clip(cos_sun, -1, 1))
    gradation = 1 + a * np.exp(b / up)
    indicatrix = 1 + c * (np.exp(d * chi) - math.exp(d * math.pi / 2)) + e * cos_sun**2
    return np.asarray(gradation * indicatrix)
