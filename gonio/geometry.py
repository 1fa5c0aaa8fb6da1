"""Directions over a surface, half vectors, hemisphere quadrature and the equal-area map.

Frame: z is the surface normal, phi counts from +x, counter-clockwise seen from outside. Both
directions of a pair point away from the surface. All angles are radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import DataError

FloatArray = NDArray[np.float64]

HORIZON = np.pi / 2


def unit_vectors(theta: ArrayLike, phi: ArrayLike) -> FloatArray:
    """Unit vectors of shape (..., 3) for polar angle `theta` and azimuth `phi` in radians.

    Examples
    --------
    >>> unit_vectors(0.0, 0.0).tolist()
    [0.0, 0.0, 1.0]
    """
    theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    sin_theta = np.sin(theta)
    # cos(pi/2) is 6e-17 in floating point; the horizon is exactly horizontal.
    z = np.where(theta == HORIZON, 0.0, np.cos(theta))
    # Each component is contiguous in memory, as the compiled loops like it.
    return np.moveaxis(np.stack([sin_theta * np.cos(phi), sin_theta * np.sin(phi), z]), 0, -1)


def angles(vectors: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Polar angle and azimuth, radians, of vectors of shape (..., 3); they need not be unit.

    theta = atan2(hypot(x, y), z) keeps all digits near the normal, where acos loses half.

    Examples
    --------
    >>> theta, phi = angles([0.0, 1.0, 1.0])
    >>> round(float(np.degrees(theta)), 12), round(float(np.degrees(phi)), 12)
    (45.0, 90.0)
    """
    v = np.asarray(vectors, float)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


@dataclass(frozen=True)
class Directions:
    """Pairs of directions, four angles in radians that broadcast against each other.

    Parameters
    ----------
    theta_i, phi_i : array_like
        Polar angle and azimuth of the direction towards the light, radians.
    theta_r, phi_r : array_like
        The same for the direction towards the viewer. Polar angles lie in [0, pi].

    Raises
    ------
    DataError
        If an angle is not finite, a polar angle is outside [0, pi] (degrees given where radians
        are wanted are caught here), or the shapes do not broadcast.

    Notes
    -----
    Polar angles beyond pi/2 are accepted: a reflectance model returns 0 there.

    Examples
    --------
    >>> d = Directions(0.5, 0.0, [0.1, 0.2], np.pi)
    >>> d.shape
    (2,)
    >>> float(d.swapped().theta_r)
    0.5
    """

    theta_i: FloatArray
    phi_i: FloatArray
    theta_r: FloatArray
    phi_r: FloatArray

    def __init__(
        self, theta_i: ArrayLike, phi_i: ArrayLike, theta_r: ArrayLike, phi_r: ArrayLike
    ) -> None:
        given = {"theta_i": theta_i, "phi_i": phi_i, "theta_r": theta_r, "phi_r": phi_r}
        for name, value in given.items():
            array = np.asarray(value, dtype=float)
            _check_angle(name, array)
            object.__setattr__(self, name, array)
        try:
            np.broadcast_shapes(*(getattr(self, name).shape for name in given))
        except ValueError:
            shapes = ", ".join(f"{name} {getattr(self, name).shape}" for name in given)
            raise DataError(
                f"the four angles have shapes that do not broadcast: {shapes}; "
                "give equal shapes or scalars."
            ) from None

    @property
    def shape(self) -> tuple[int, ...]:
        """Common shape of the four angles after broadcasting."""
        return np.broadcast_shapes(
            self.theta_i.shape, self.phi_i.shape, self.theta_r.shape, self.phi_r.shape
        )

    def swapped(self) -> Directions:
        """The same pairs with the two directions exchanged, for tests of reciprocity."""
        return Directions(self.theta_r, self.phi_r, self.theta_i, self.phi_i)

    def vectors(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors towards the light and towards the viewer, each of shape (..., 3)."""
        shape = (*self.shape, 3)
        w_i = np.broadcast_to(unit_vectors(self.theta_i, self.phi_i), shape)
        w_r = np.broadcast_to(unit_vectors(self.theta_r, self.phi_r), shape)
        return w_i, w_r

    def delta(self) -> FloatArray:
        """Angle between the surface normal and the half vector (Ward 1992, Fig. 5), radians."""
        w_i, w_r = self.vectors()
        return angles(w_i + w_r)[0]


def _check_angle(name: str, array: FloatArray) -> None:
    if not np.all(np.isfinite(array)):
        raise DataError(f"{name} holds a value that is not finite; remove it.", value=array)
    if name.startswith("theta") and array.size and (array.min() < 0 or array.max() > np.pi):
        bad = float(array.min() if array.min() < 0 else array.max())
        raise DataError(
            f"{name} = {bad:g} is outside [0, pi]; polar angles are radians from the normal "
            "and never negative.",
            value=bad,
        )


def hemisphere_quadrature(
    n_theta: int = 64, n_phi: int = 128, theta_max: float = HORIZON
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions and weights that integrate over a cap of the hemisphere.

    Gauss-Legendre in z = cos(theta) by a uniform rule in phi.

    Parameters
    ----------
    n_theta, n_phi : int
        Number of polar and azimuthal nodes.
    theta_max : float
        Edge of the cap, radians.

    Returns
    -------
    theta, phi, weights : ndarray, shape (n_theta * n_phi,)
        The weights are solid angles: they sum to 2 pi (1 - cos(theta_max)).

    Examples
    --------
    >>> theta, phi, w = hemisphere_quadrature(8, 8)
    >>> bool(abs(np.sum(w * np.cos(theta)) - np.pi) < 1e-12)
    True
    """
    nodes, weights = np.polynomial.legendre.leggauss(n_theta)
    z_min = np.cos(theta_max)
    z = z_min + (1 - z_min) * (nodes + 1) / 2
    w = weights * (1 - z_min) / 2
    phi = (np.arange(n_phi) + 0.5) * (2 * np.pi / n_phi)
    theta_grid, phi_grid = np.meshgrid(np.arccos(z), phi, indexing="ij")
    weight_grid = np.repeat(w, n_phi) * (2 * np.pi / n_phi)
    return theta_grid.ravel(), phi_grid.ravel(), weight_grid


def equal_area(vectors: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Lambert's equal-area map of unit vectors (..., 3) to a disc of radius 1 for a hemisphere.

    x = X / sqrt(1 + Z), y = Y / sqrt(1 + Z): equal solid angles have equal areas, and the
    horizon lies at radius 1.

    Examples
    --------
    >>> x, y = equal_area(unit_vectors(np.pi / 2, 0.0))
    >>> round(float(x), 12), float(y)
    (1.0, 0.0)
    """
    v = np.asarray(vectors, float)
    scale = 1 / np.sqrt(1 + v[..., 2])
    return v[..., 0] * scale, v[..., 1] * scale


def from_equal_area(x: ArrayLike, y: ArrayLike) -> FloatArray:
    """Inverse of `equal_area`: unit vectors of shape (..., 3) for points of the disc.

    Examples
    --------
    >>> np.round(from_equal_area(1.0, 0.0), 12).tolist()
    [1.0, 0.0, 0.0]
    """
    x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
    q = x * x + y * y
    scale = np.sqrt(np.maximum(2 - q, 0))
    return np.stack([x * scale, y * scale, 1 - q], axis=-1)


def golden_fractions(n: int) -> FloatArray:
    """n numbers that fill 0 to 1 evenly: multiples of the golden ratio, less whole numbers.

    Samples that are chosen by them are spread over all, without the period of a scan or a grid.

    Examples
    --------
    >>> golden_fractions(4).round(3).tolist()
    [0.0, 0.618, 0.236, 0.854]
    """
    return np.asarray((np.arange(n) * 0.6180339887498949) % 1.0)


def rotated(vectors: ArrayLike, psi: float | FloatArray) -> FloatArray:
    """Vectors (..., 3) seen from a frame turned by `psi` (...) about z: phi_new = phi - psi.

    Examples
    --------
    >>> np.round(rotated([0.0, 1.0, 0.0], np.pi / 2), 12).tolist()
    [1.0, 0.0, 0.0]
    """
    v = np.asarray(vectors, float)
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], -1)
