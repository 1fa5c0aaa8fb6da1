"""From the camera's angles to the reflected angles: Ward's eq. (3), its inverse and its Jacobian.

Eq. (3) is the direction from the target T = (0, D, 0) to the point P of a sphere of radius R about
the dome's centre that the camera at C = (0, -D, 0) looks at. There is no law of reflection in it:
it is exact where P really sends T's light to C, which a sphere does only on the plane y = 0, and
an approximation "good as long as D is small in relation to R" (Ward 1992, section 3.2) elsewhere.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, angles, unit_vectors


def reflected_angles(
    theta_c: ArrayLike, phi_c: ArrayLike, *, R: float, D: float
) -> tuple[FloatArray, FloatArray]:
    """Reflected angles by Ward's eq. (3).

    Parameters
    ----------
    theta_c, phi_c : array_like
        Polar angle and azimuth of the camera ray, radians.
    R : float
        Radius of the sphere, or semi-minor axis of the ellipsoid, mm.
    D : float
        Half the separation of camera and target, mm; 0 <= D < R.

    Returns
    -------
    theta_r, phi_r : ndarray
        Radians, in the frame of the laboratory.

    Raises
    ------
    ConfigurationError
        If D is not in [0, R).

    Notes
    -----
    r_c = D sin(theta_c) sin(phi_c) + sqrt(D^2 sin^2 sin^2 + R^2 - D^2), then the direction of
    r_c w_c - (0, 2 D, 0). theta_r is taken by atan2, which keeps digits where acos loses them.

    References
    ----------
    Ward 1992, "Measuring and Modeling Anisotropic Reflection", Computer Graphics 26(2),
    pp. 265-272, eq. (3), section 3.2.

    Examples
    --------
    >>> theta_r, phi_r = reflected_angles(0.0, 0.0, R=150.0, D=15.0)
    >>> round(float(np.degrees(theta_r)), 4), round(float(np.degrees(phi_r)), 4)
    (11.3654, -90.0)
    """
    _check(R, D)
    w_c = unit_vectors(theta_c, phi_c)
    x, y, z = np.moveaxis(_range(w_c[..., 1], R, D)[..., None] * w_c, -1, 0)
    return angles(np.stack([x, y - 2 * D, z], axis=-1))


def camera_angles(
    theta_r: ArrayLike, phi_r: ArrayLike, *, R: float, D: float
) -> tuple[FloatArray, FloatArray]:
    """Inverse of eq. (3): the same formula with D -> -D, which exchanges camera and target.

    Examples
    --------
    >>> back = camera_angles(*reflected_angles(0.7, 0.3, R=150.0, D=15.0), R=150.0, D=15.0)
    >>> [round(float(angle), 12) for angle in back]
    [0.7, 0.3]
    """
    _check(R, D)
    w_r = unit_vectors(theta_r, phi_r)
    x, y, z = np.moveaxis(_range(w_r[..., 1], R, -D)[..., None] * w_r, -1, 0)
    return angles(np.stack([x, y + 2 * D, z], axis=-1))


def solid_angle_ratio(theta_c: ArrayLike, phi_c: ArrayLike, *, R: float, D: float) -> FloatArray:
    """Jacobian of eq. (3): dOmega_r/dOmega_c = (R^2 - D P_y)/(R^2 + D P_y) (r_c/r_t)^3.

    Examples
    --------
    >>> round(float(solid_angle_ratio(0.0, 0.0, R=150.0, D=15.0)), 6)
    0.961354
    """
    _check(R, D)
    s = unit_vectors(theta_c, phi_c)[..., 1]
    r_c = _range(s, R, D)
    p_y = r_c * s - D
    r_t = np.sqrt(R * R + D * D - 2 * D * p_y)
    return np.asarray((R * R - D * p_y) / (R * R + D * p_y) * (r_c / r_t) ** 3)


def mapping_error(
    w_r: FloatArray, *, R: float, D: float, shape: Literal["sphere", "ellipsoid"]
) -> FloatArray:
    """Size and direction of what eq. (3) leaves out, to leading order in D/R.

    Parameters
    ----------
    w_r : ndarray, shape (..., 3)
        Reflected directions by eq. (3).
    R, D : float
        As in `reflected_angles`.
    shape : {"sphere", "ellipsoid"}
        Shape of the dome.

    Returns
    -------
    ndarray, shape (..., 3)
        Tangent vectors, radians: (D/R)^2 sin(2 gamma) on a sphere, (D/R)^3 cos^2(gamma)
        sin(gamma) on the ellipsoid with foci in camera and target, gamma being the angle to the
        y axis; along the meridian through that axis.

    Notes
    -----
    The reduction does not correct by it: it is carried as the uncertainty of the mapping.
    """
    epsilon = D / R
    # gamma belongs to the point P of the dome as seen from its centre; the direction from T
    # differs from it by D/R, which matters where the error passes through zero.
    point = _range(w_r[..., 1:2], R, -D) * w_r + np.array([0.0, D, 0.0])
    s = point[..., 1:2] / np.linalg.norm(point, axis=-1, keepdims=True)
    tangent = np.array([0.0, 1.0, 0.0]) - w_r[..., 1:2] * w_r
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-12)
    amplitude = 2 * epsilon**2 * s if shape == "sphere" else epsilon**3 * s * s
    return np.asarray(amplitude * np.sqrt(1 - s * s) * tangent)


def _range(s: FloatArray, R: float, D: float) -> FloatArray:
    """r_c of eq. (3), the distance from the camera to the sphere, for s = w_c . y."""
    return np.asarray(D * s + np.sqrt(D * D * s * s + R * R - D * D))


def _check(R: float, D: float) -> None:
    if not (np.isfinite(R) and 0 <= D < R):
        raise ConfigurationError(
            f"D = {D:g} mm with R = {R:g} mm: the camera must sit inside the dome, 0 <= D < R.",
            value=D,
        )
