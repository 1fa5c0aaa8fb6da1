"""Ward's Fig. 7: an anisotropic plate under a lamp, beside a wall, three ways.

Eq. (6) of Ward 1992 adds a sum over lamps in closed form to one sampled ray for the rest:

L(r) = I rho_d/pi + L_s rho_s + sum_i L_i omega_i cos(theta_i) rho_bd(i; r)

I is the irradiance by everything but the lamps, L_s the radiance along a ray drawn by eq. (7). A
ray that meets a lamp is not counted, because the sum has it. In print the rays are "uniformly
weighted"; to agree with eq. (5) each must carry f cos(theta)/density, whose mean falls about as
cos(theta_r) (docs/errata.md), and eq. (7a) its arctangent.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

import gonio.models as models
from gonio.errors import ConfigurationError, unknown_name
from gonio.geometry import FloatArray, unit_vectors
from gonio.models import Model

Method = Literal["deterministic", "monte_carlo", "hybrid", "double_counted"]
METHODS: tuple[Method, ...] = get_args(Method)
Weights = Literal["corrected", "printed"]


@dataclass(frozen=True)
class Room:
    """A plate in the plane z = 0, a wall behind it and a lamp between, facing down.

    Parameters
    ----------
    half_plate : float
        Half the edge of the plate, which lies about the origin.
    wall_y, wall_height, wall_half_width : float
        The wall stands upright at y = wall_y.
    wall_reflectance : float
        It is Lambertian and lit by the lamp alone.
    lamp : tuple of float
        x, y, z of the lamp's middle.
    lamp_half : tuple of float
        Half its edges along x and y.
    lamp_radiance : float
    theta_r : float
        The viewer is far away at this angle from the normal, at phi = -90 deg, radians.
    """

    half_plate: float = 1.0
    wall_y: float = 1.3
    wall_height: float = 1.5
    wall_half_width: float = 2.0
    wall_reflectance: float = 0.8
    lamp: tuple[float, float, float] = (0.0, 0.9, 1.2)
    lamp_half: tuple[float, float] = (0.15, 0.06)
    lamp_radiance: float = 30.0
    theta_r: float = float(np.radians(50.0))

    def lamp_elements(self, n: int) -> tuple[FloatArray, float]:
        """Middles (n * n, 3) of equal parts of the lamp, and the area of each."""
        step = (np.arange(n) + 0.5) / n * 2 - 1
        x, y = np.meshgrid(step * self.lamp_half[0], step * self.lamp_half[1])
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
        return self.lamp + flat, 4 * self.lamp_half[0] * self.lamp_half[1] / n**2

    def wall_elements(self, n: int) -> tuple[FloatArray, float]:
        """Middles (4 n * n, 3) of equal parts of the wall, and the area of each."""
        x = ((np.arange(4 * n) + 0.5) / (4 * n) * 2 - 1) * self.wall_half_width
        z = (np.arange(n) + 0.5) / n * self.wall_height
        grid_x, grid_z = np.meshgrid(x, z)
        position = np.stack([grid_x.ravel(), np.full(grid_x.size, self.wall_y), grid_z.ravel()], 1)
        return position, 2 * self.wall_half_width * self.wall_height / (4 * n * n)

    def wall_radiance(self, position: FloatArray) -> FloatArray:
        """Radiance at positions (..., 3) of the wall: rho/pi times their irradiance by the lamp."""
        total = np.zeros(position.shape[:-1])
        parts, area = self.lamp_elements(3)
        for part in parts:
            way = part - position
            r2 = np.sum(way * way, axis=-1)
            down, onto = np.maximum(way[..., 2], 0), np.maximum(-way[..., 1], 0)
            total += self.lamp_radiance * area * down * onto / r2**2
        return self.wall_reflectance / np.pi * total

    def meets_lamp(self, point: FloatArray, along: FloatArray) -> np.ndarray:
        """Whether rays from the plate meet the lamp."""
        x, y = self._at(point, along, (self.lamp[2] - point[..., 2]) / _positive(along[..., 2]))
        inside = np.abs(x - self.lamp[0]) <= self.lamp_half[0]
        return np.asarray(inside & (np.abs(y - self.lamp[1]) <= self.lamp_half[1]))

    @staticmethod
    def _at(point: FloatArray, along: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        return point[..., 0] + t * along[..., 0], point[..., 1] + t * along[..., 1]

    def incoming(self, point: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radiance of the lamp and of the wall along rays from the plate; the lamp is in front."""
        lamp = self.meets_lamp(point, along)
        t = (self.wall_y - point[..., 1]) / _positive(along[..., 1])
        position = point + t[..., None] * along
        wall = (np.abs(position[..., 0]) <= self.wall_half_width) & (along[..., 1] > 0)
        wall &= (position[..., 2] <= self.wall_height) & (along[..., 2] > 0) & ~lamp
        radiance = np.zeros(wall.shape)
        radiance[wall] = self.wall_radiance(position[wall])
        return np.where(lamp, self.lamp_radiance, 0.0), radiance


def _positive(z: FloatArray) -> FloatArray:
    return np.where(z > 0, z, 1e-300)


@dataclass(frozen=True)
class PlatePicture:
    """The plate by one method.

    Parameters
    ----------
    radiance : ndarray, shape (rows, columns)
        Top row farthest from the viewer.
    variance : ndarray, shape (rows, columns), or None
        Estimated variance of each value; None where nothing was drawn.
    rays : int
        Rays for each pixel, those to parts of the lamp included.
    seconds : float
        Time that the picture took on this machine.
    """

    radiance: FloatArray
    variance: FloatArray | None
    rays: int
    seconds: float


def plate(
    method: Method,
    model: Model | str = "ward",
    p: Mapping[str, float] | None = None,
    *,
    room: Room | None = None,
    size: int = 48,
    n: int = 16,
    lamp_parts: int = 2,
    weights: Weights = "corrected",
    seed: int = 0,
) -> PlatePicture:
    """Radiance of the plate by one of Ward's methods.

    Parameters
    ----------
    method : {"deterministic", "monte_carlo", "hybrid", "double_counted"}
        Eq. (6) without its sampled term; every ray drawn as the surface reflects; eq. (6); and
        eq. (6) with the rays that meet the lamp counted too.
    model : Model or str
        One with rho_d and a lobe of amplitude rho_s.
    p : mapping, optional
        Parameters by name.
    room : Room, optional
    size : int
        Rows and columns.
    n : int
        Rays drawn for each pixel.
    lamp_parts : int
        The lamp is this many parts along each edge, each a lamp of eq. (6).
    weights : {"corrected", "printed"}
        Weights of the rays that stand for the lobe: f cos(theta)/density, or rho_s for all.
    seed : int

    Returns
    -------
    PlatePicture

    Raises
    ------
    ConfigurationError
        For an unknown method, or a model without rho_d and rho_s.

    References
    ----------
    Ward 1992, section 5, eqs (6) and (7), Fig. 7.

    Examples
    --------
    >>> sharp = {"rho_d": 0.1, "rho_s": 0.33, "alpha_x": 0.05, "alpha_y": 0.16}
    >>> hybrid = plate("hybrid", "ward", sharp, size=8)
    >>> plate("deterministic", "ward", sharp, size=8).rays, hybrid.rays
    (4, 20)
    """
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    if weights not in get_args(Weights):
        raise unknown_name("kind of weights", weights, get_args(Weights))
    model, vector = _lobed(model, p)
    _check_numbers(size, n, lamp_parts)
    room, start = room or Room(), time.perf_counter()
    point, back = _pixel_positions(room, size)
    if method == "monte_carlo":
        terms = _drawn(room, model, vector, point, back, n, np.random.default_rng(seed))
        value, rays = terms.mean(axis=0), n
    else:
        value = _lamps(room, model, vector, point, back, lamp_parts)
        value += _irradiance(room, point) * vector[model.names.index("rho_d")] / np.pi
        terms, rays = np.zeros((0, 0)), lamp_parts**2
        if method != "deterministic":
            rng = np.random.default_rng(seed)
            terms = _lobe_rays(room, model, vector, point, back, n, weights, rng,
                               with_lamp=method == "double_counted")  # fmt: skip
            value, rays = value + terms.mean(axis=0), rays + n
    variance = terms.var(axis=0, ddof=1).reshape(size, size) / n if len(terms) > 1 else None
    seconds = time.perf_counter() - start
    return PlatePicture(value.reshape(size, size), variance, rays, seconds)


def plate_reference(
    model: Model | str = "ward",
    p: Mapping[str, float] | None = None,
    *,
    room: Room | None = None,
    size: int = 48,
    lamp_parts: int = 12,
    wall_parts: int = 24,
) -> FloatArray:
    """The plate by quadrature over lamp and wall, as a reference for the methods.

    Parameters
    ----------
    model, p, room, size
        As in `plate`.
    lamp_parts, wall_parts : int
        Parts along the lamp's edges and up the wall.

    Returns
    -------
    ndarray, shape (size, size)
        Radiance, free of noise.
    """
    model, vector = _lobed(model, p)
    room = room or Room()
    point, back = _pixel_positions(room, size)
    value = _lamps(room, model, vector, point, back, lamp_parts)
    positions, area = room.wall_elements(wall_parts)
    radiance = room.wall_radiance(positions)
    for position, emitted in zip(positions, radiance, strict=True):
        along, solid_angle = _towards(point, position, area, np.array([0.0, -1.0, 0.0]))
        f = model.evaluate(along, back, vector)
        open_ = ~room.meets_lamp(point, along)
        value += emitted * open_ * f * along[:, 2] * solid_angle
    return value.reshape(size, size)


def _lobed(model: Model | str, p: Mapping[str, float] | None) -> tuple[Model, FloatArray]:
    model = models.get(model)
    missing = {"rho_d", "rho_s"} - set(model.names)
    if missing or not model.claims.reciprocal:
        raise ConfigurationError(
            f"{model.name} cannot be split as eq. (6) does: it takes a reciprocal model with "
            "rho_d and rho_s, such as ward or ward_gmd.",
            value=model.name,
        )
    return model, model.vector(p or {})


def _check_numbers(size: int, n: int, lamp_parts: int) -> None:
    for name, value in (("size", size), ("n", n), ("lamp_parts", lamp_parts)):
        if value < 1:
            raise ConfigurationError(f"{name} = {value}; it must be 1 or more.", value=value)


def _pixel_positions(room: Room, size: int) -> tuple[FloatArray, FloatArray]:
    """Middles (n, 3) of the pixels on the plate, far row first, and the viewer's direction."""
    step = ((np.arange(size) + 0.5) / size * 2 - 1) * room.half_plate
    x, y = np.meshgrid(step, step[::-1])
    point = np.stack([x.ravel(), y.ravel(), np.zeros(size * size)], axis=1)
    return point, np.broadcast_to(unit_vectors(room.theta_r, -np.pi / 2), point.shape)


def _towards(
    point: FloatArray, position: FloatArray, area: float, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Directions (n, 3) from points to one part of lamp or wall, and the solid angle it fills."""
    way = position - point
    r2 = np.sum(way * way, axis=1)
    along = way / np.sqrt(r2)[:, None]
    return along, np.maximum(-(along @ normal), 0) * area / r2


def _lamps(
    room: Room, model: Model, p: FloatArray, point: FloatArray, back: FloatArray, parts: int
) -> FloatArray:
    """sum_i L_i omega_i cos(theta_i) rho_bd of eq. (6)."""
    positions, area = room.lamp_elements(parts)
    total = np.zeros(len(point))
    for position in positions:
        along, solid_angle = _towards(point, position, area, np.array([0.0, 0.0, -1.0]))
        f = model.evaluate(along, back, p)
        total += room.lamp_radiance * solid_angle * along[:, 2] * f
    return total


def _irradiance(room: Room, point: FloatArray) -> FloatArray:
    """I of eq. (6), by the wall alone."""
    positions, area = room.wall_elements(12)
    total = np.zeros(len(point))
    for position, emitted in zip(positions, room.wall_radiance(positions), strict=True):
        along, solid_angle = _towards(point, position, area, np.array([0.0, -1.0, 0.0]))
        total += emitted * ~room.meets_lamp(point, along) * along[:, 2] * solid_angle
    return total


def _drawn(
    room: Room,
    model: Model,
    p: FloatArray,
    point: FloatArray,
    back: FloatArray,
    n: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Radiance (n, pixels) along rays drawn as the whole surface reflects, times their weights."""
    draws = model.sample(np.broadcast_to(back, (n, *back.shape)), p, rng)
    lamp, wall = room.incoming(np.broadcast_to(point, draws.w_r.shape), draws.w_r)
    return draws.weight * (lamp + wall)


def _lobe_rays(
    room: Room,
    model: Model,
    p: FloatArray,
    point: FloatArray,
    back: FloatArray,
    n: int,
    weights: Weights,
    rng: np.random.Generator,
    *,
    with_lamp: bool,
) -> FloatArray:
    """L_s rho_s of eq. (6) for each ray, (n, pixels): the lobe without the diffuse part."""
    lobe = p.copy()
    lobe[model.names.index("rho_d")] = 0.0
    draws = model.sample(np.broadcast_to(back, (n, *back.shape)), lobe, rng)
    lamp, wall = room.incoming(np.broadcast_to(point, draws.w_r.shape), draws.w_r)
    weight = draws.weight
    if weights == "printed":
        weight = np.where(draws.w_r[..., 2] > 0, lobe[model.names.index("rho_s")], 0.0)
    return np.asarray(weight * (wall + lamp if with_lamp else wall))
