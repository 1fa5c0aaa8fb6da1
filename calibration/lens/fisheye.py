"""The fisheye lens in pixels: r = f theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

Kannala & Brandt, IEEE PAMI 28(8), 2006, eq. (6). The camera looks along +z with x to the right and
y down, columns and rows. Nothing here takes a tangent: 90 deg and more are angles like others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gonio.geometry import FloatArray, unit_vectors

NO_TERMS = (0.0, 0.0, 0.0, 0.0)
_ON_AXIS = 1e-9  # rad; nearer than that a direction has no azimuth
_TABLE = 4097


Terms = tuple[float, float, float, float]


def stretch(k: Terms, theta: FloatArray) -> FloatArray:
    """r/(f theta) of the polynomial."""
    k1, k2, k3, k4 = k
    q = theta * theta
    return np.asarray(1 + q * (k1 + q * (k2 + q * (k3 + q * k4))))


def slope(k: Terms, theta: FloatArray) -> FloatArray:
    """Derivative of r/f by theta of the polynomial."""
    k1, k2, k3, k4 = k
    q = theta * theta
    return np.asarray(1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4))))


@dataclass(frozen=True)
class Fisheye:
    """A lens before a sensor.

    Parameters
    ----------
    f : float
        Focal length, pixels of a row.
    k : tuple of float
        k1 to k4; all 0 is an equidistant lens.
    centre : tuple of float
        Column and row of the axis; whole numbers are pixels' centres.
    ratio : float
        Pitch of the pixels in x over that in y.

    Examples
    --------
    >>> lens = Fisheye(500.0, centre=(800.0, 600.0))
    >>> lens.project([1.0, 0.0, 0.0]).round(3).tolist()  # 90 deg to the right
    [1585.398, 600.0]
    """

    f: float
    k: Terms = NO_TERMS
    centre: tuple[float, float] = (0.0, 0.0)
    ratio: float = 1.0

    def radius(self, theta: ArrayLike) -> FloatArray:
        """Distance from the centre, pixels of a row, at polar angles in radians."""
        t = np.asarray(theta, float)
        return np.asarray(self.f * t * stretch(self.k, t))

    def slope(self, theta: ArrayLike) -> FloatArray:
        """Derivative of `radius` by theta."""
        return np.asarray(self.f * slope(self.k, np.asarray(theta, float)))

    def grows_to(self, limit: float = np.pi) -> float:
        """Polar angle, radians, at which the radius stops growing, or `limit` if it does not."""
        theta = np.linspace(0, limit, 4001)
        falls = np.flatnonzero(self.slope(theta) <= 0)
        return float(theta[falls[0]]) if len(falls) else limit

    def polar_angle(self, radius: ArrayLike) -> FloatArray:
        """Polar angle, radians, at distances from the centre; NaN beyond where it is unique.

        A table brackets the angle and Newton's method polishes it within two steps.
        """
        r = np.asarray(radius, float)
        theta = np.linspace(0, self.grows_to(), _TABLE)
        table = self.radius(theta)
        angle = np.interp(r, table, theta, right=np.nan)
        for _ in range(2):
            angle = angle - (self.radius(angle) - r) / self.slope(angle)
        return np.asarray(angle)

    def project(self, points: ArrayLike) -> FloatArray:
        """Column and row (..., 2) of points (..., 3) in the frame of the camera."""
        x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
        rho = np.hypot(x, y)
        theta = np.arctan2(rho, z)
        scale = self.radius(theta) / np.where(rho > 0, rho, 1)
        cx, cy = self.centre
        return np.stack([cx + scale * x, cy + self.ratio * scale * y], -1)

    def directions(self, pixels: ArrayLike) -> FloatArray:
        """Unit vectors (..., 3) seen at columns and rows (..., 2); NaN where there is none."""
        column, row = np.moveaxis(np.asarray(pixels, float), -1, 0)
        x, y = column - self.centre[0], (row - self.centre[1]) / self.ratio
        return unit_vectors(self.polar_angle(np.hypot(x, y)), np.arctan2(y, x))

    def derivatives(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels of points (n, 3) with derivatives by the lens and by the points.

        Returns
        -------
        pixels : ndarray, shape (n, 2)
        by_lens : ndarray, shape (n, 2, 8)
            By f, k1 to k4, column and row of the centre, ratio.
        by_point : ndarray, shape (n, 2, 3)
        """
        x, y, z = points.T
        rho = np.hypot(x, y)
        near = rho <= _ON_AXIS * np.abs(z)
        theta = np.arctan2(rho, z)
        safe = np.where(near, 1, rho)
        e = np.stack([np.where(near, 1, x / safe), np.where(near, 0, y / safe)], -1)
        r = self.radius(theta)
        unscaled = e * np.stack([r, self.ratio * r], -1)
        pixels = unscaled + np.array(self.centre)
        aspect = np.array([1.0, self.ratio])

        by_lens = np.zeros((len(points), 2, 8))
        odd = theta[:, None] ** np.array([3, 5, 7, 9])
        by_lens[..., 0] = unscaled / self.f
        by_lens[..., 1:5] = self.f * (e * aspect)[..., None] * odd[:, None, :]
        by_lens[:, 0, 5] = by_lens[:, 1, 6] = 1
        by_lens[:, 1, 7] = r * e[:, 1]

        # Along the radius r' dtheta, across it r dphi; on the axis both are f over the distance.
        square = rho**2 + z**2
        dtheta = np.stack([z * e[:, 0], z * e[:, 1], -rho], -1) / square[:, None]
        n = np.stack([-e[:, 1], e[:, 0]], -1)
        across = np.where(near, self.f / np.sqrt(square), r / safe)
        by_point = e[..., None] * (self.slope(theta)[:, None] * dtheta)[:, None, :]
        by_point[..., :2] += across[:, None, None] * n[:, :, None] * n[:, None, :]
        return pixels, by_lens, by_point * aspect[:, None]

    def vector(self) -> FloatArray:
        """The eight parameters in the order of `derivatives`."""
        return np.array([self.f, *self.k, *self.centre, self.ratio])

    def with_vector(self, values: FloatArray) -> Fisheye:
        """The lens with other parameters."""
        f, k1, k2, k3, k4, cx, cy, ratio = (float(each) for each in values)
        return replace(self, f=f, k=(k1, k2, k3, k4), centre=(cx, cy), ratio=ratio)
