"""From pixels to the camera's angles, with the lens calibration that the session carries."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gonio.calibration.lens.fisheye import NO_TERMS, Terms, slope, stretch
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray
from gonio.metadata import Camera, LensCalibration


def image_centre(camera: Camera, lens: LensCalibration | None = None) -> tuple[float, float]:
    """Column and row of the lens axis; the middle of the frame where it was not calibrated."""
    if lens is not None and lens.centre_px is not None:
        return lens.centre_px
    return (camera.columns - 1) / 2, (camera.rows - 1) / 2


def pixel_positions(
    camera: Camera, columns: ArrayLike, rows: ArrayLike, lens: LensCalibration | None = None
) -> tuple[FloatArray, FloatArray]:
    """Position on the sensor, mm from the image's centre, of (fractional) columns and rows.

    Whole numbers are the pixels' centres; x grows with the column, y with the row.

    Parameters
    ----------
    camera : Camera
    columns, rows : array_like
    lens : LensCalibration, optional
        Gives the image's centre; the middle of the frame without it.
    """
    centre = image_centre(camera, lens)
    x = (np.asarray(columns, float) - centre[0]) * camera.pitch_mm[0]
    y = (np.asarray(rows, float) - centre[1]) * camera.pitch_mm[1]
    return x, y


def camera_angles(
    lens: LensCalibration, x: ArrayLike, y: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Polar angle and azimuth at the camera, radians, of points of the sensor in mm.

    The polar angle is NaN outside the image circle. The Kannala-Brandt polynomial is inverted by
    a table and two Newton steps, which is safe where it is monotonic.

    Raises
    ------
    ConfigurationError
        If the polynomial is not monotonic over the field.

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


def sensor_radius(lens: LensCalibration, theta_c: ArrayLike) -> FloatArray:
    """Distance from the image's centre, mm, of rays at polar angles in radians: r = f(theta).

    Examples
    --------
    >>> lens = LensCalibration(projection="equidistant", focal_length_mm=2.0)
    >>> float(sensor_radius(lens, 0.5))
    1.0
    """
    theta = np.asarray(theta_c, float)
    if lens.projection == "equisolid":
        return np.asarray(2 * lens.focal_length_mm * np.sin(theta / 2))
    return np.asarray(lens.focal_length_mm * theta * stretch(_terms(lens), theta))


def solid_angle_per_area(lens: LensCalibration, theta_c: ArrayLike) -> FloatArray:
    """Solid angle that a small area of the image sees, sin(theta)/(r dr/dtheta), sr/mm^2.

    Parameters
    ----------
    lens : LensCalibration
    theta_c : array_like
        Polar angle at the camera, radians.

    Examples
    --------
    On the axis every projection sees 1/f^2:

    >>> lens = LensCalibration(projection="equidistant", focal_length_mm=2.0)
    >>> float(solid_angle_per_area(lens, 0.0))
    0.25
    """
    theta = np.asarray(theta_c, float)
    f = lens.focal_length_mm
    if lens.projection == "equisolid":
        # r = 2 f sin(theta/2): the same everywhere, which is the projection's name.
        return np.where(np.isfinite(theta), 1 / f**2, np.nan)
    k = _terms(lens)
    return np.asarray(np.sinc(theta / np.pi) / (stretch(k, theta) * slope(k, theta)) / f**2)


def _terms(lens: LensCalibration) -> Terms:
    return lens.k if lens.projection == "kannala_brandt" else NO_TERMS


def _invert(k: Terms, radius: FloatArray, edge: float) -> FloatArray:
    """theta with theta (1 + k1 theta^2 + ...) = radius, up to a little beyond the edge."""
    # A table brackets each radius; Newton polishes within the bracket's cell.
    grid = np.linspace(0, 1.02 * edge, 4097)
    table = grid * stretch(k, grid)
    if np.any(np.diff(table) <= 0):
        turns = np.degrees(grid[np.argmax(np.diff(table) <= 0)])
        raise ConfigurationError(
            f"k = {', '.join(f'{c:g}' for c in k)}: the lens polynomial stops growing at "
            f"{turns:.1f} deg, inside the field of {np.degrees(2 * edge):g} deg; calibrate with "
            "points nearer to the rim, or give a smaller field_deg.",
            value=k,
        )
    theta = np.asarray(np.interp(radius, table, grid, right=np.inf))
    inside = np.isfinite(theta)
    for _ in range(2):
        t = theta[inside]
        theta[inside] = t - (t * stretch(k, t) - radius[inside]) / slope(k, t)
    return theta
