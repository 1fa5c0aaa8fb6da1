"""From pixels to the camera's angles, with the lens calibration that the session carries."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gonio.geometry import FloatArray
from gonio.metadata import Camera, LensCalibration


def pixel_positions(
    camera: Camera, columns: ArrayLike, rows: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Position on the sensor, mm from the image's centre, of (fractional) columns and rows.

    Whole numbers are the pixels' centres; x grows with the column, y with the row.
    """
    x = (np.asarray(columns, float) - (camera.columns - 1) / 2) * camera.pitch_mm[0]
    y = (np.asarray(rows, float) - (camera.rows - 1) / 2) * camera.pitch_mm[1]
    return x, y


def camera_angles(
    lens: LensCalibration, x: ArrayLike, y: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Polar angle and azimuth at the camera, radians, of points of the sensor in mm.

    The polar angle is NaN outside the image circle. The Kannala-Brandt polynomial is inverted by
    a table and two Newton steps, which is safe where it is monotonic.

    Examples
    --------
    >>> lens = LensCalibration(projection="equidistant", focal_length_mm=2.0)
    >>> theta, phi = camera_angles(lens, 1.0, 0.0)
    >>> float(theta), float(phi)
    (0.5, 0.0)
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    radius = np.hypot(x, y) / lens.focal_length_mm
    edge = np.radians(lens.field_deg / 2)
    if lens.projection == "equisolid":
        theta = 2 * np.arcsin(np.clip(radius / 2, 0, 1))
    elif lens.projection == "equidistant":
        theta = radius
    else:
        theta = _invert(lens.k, radius, edge)
    return np.where(theta <= edge, theta, np.nan), np.arctan2(y, x)


def _invert(k: tuple[float, float, float, float], radius: FloatArray, edge: float) -> FloatArray:
    """theta with theta (1 + k1 theta^2 + ...) = radius, up to a little beyond the edge."""
    k1, k2, k3, k4 = k

    def forward(theta: FloatArray) -> FloatArray:
        q = theta * theta
        return theta * (1 + q * (k1 + q * (k2 + q * (k3 + q * k4))))

    def slope(theta: FloatArray) -> FloatArray:
        q = theta * theta
        return 1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * (9 * k4))))

    # A table brackets each radius; Newton polishes within the bracket's cell.
    grid = np.linspace(0, 1.02 * edge, 4097)
    table = forward(grid)
    theta = np.interp(radius, table, grid, right=np.inf)
    inside = np.isfinite(theta)
    for _ in range(2):
        t = theta[inside]
        theta[inside] = t - (forward(t) - radius[inside]) / slope(t)
    return np.asarray(theta)
