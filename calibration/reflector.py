"""From the camera's angles to the reflected angles: Ward's eq. (3) and the exact reflection.

Eq. (3) is the direction from the target T = (0, D, 0) to the point P of a sphere of radius R about
the dome's centre that the camera at C = (0, -D, 0) looks at. There is no law of reflection in it:
it is exact where P really sends T's light to C, which a sphere does only on the plane y = 0, and
an approximation "good as long as D is small in relation to R" (Ward 1992, section 3.2) elsewhere.

`reflected_directions` does both, for a pupil that need not sit at C: eq. (3), or the law of
reflection on the sphere or on the ellipsoid with foci C and T, with the derivatives that solid
angles are made of. A pupil off by e moves P by e and, on the dome that images it 1:1 onto the
sample, the landing point by -e: the direction turns by 2 e/R, and eq. (3), which starts at T
whatever the pupil does, sees half of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, angles, unit_vectors

Shape = Literal["sphere", "ellipsoid"]
Mapping = Literal["eq3", "exact"]


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


def reflected_directions(
    pupil: FloatArray,
    w_c: FloatArray,
    changes: Sequence[tuple[FloatArray, FloatArray]] = (),
    *,
    R: float,
    D: float,
    shape: Shape,
    mapping: Mapping,
) -> tuple[FloatArray, list[FloatArray]]:
    """Directions from the sample that chief rays see, and how they change with the rays.

    Parameters
    ----------
    pupil : ndarray, shape (..., 3)
        Where the chief rays start, mm.
    w_c : ndarray, shape (..., 3)
        Unit vectors of the chief rays.
    changes : sequence of (d_pupil, d_w_c)
        Changes of the rays, each pair of shape (..., 3), mm and radians.
    R, D : float
        As in `reflected_angles`.
    shape : {"sphere", "ellipsoid"}
        The ellipsoid has its foci in (0, -D, 0) and T = (0, D, 0).
    mapping : {"eq3", "exact"}
        eq3: from T to the point of the sphere of radius R that the ray meets, on either shape.
        exact: the ray is reflected and followed back from where it lands.

    Returns
    -------
    w_r : ndarray, shape (..., 3)
    d_w_r : list of ndarray, shape (..., 3)
        First-order changes of `w_r`, one for each of `changes`.

    Raises
    ------
    ConfigurationError
        If D is not in [0, R).

    Notes
    -----
    With n the unit normal at P = C + t w_c: w_r = 2 (w_c . n) n - w_c, the reflected ray reversed.
    A change moves P along the dome, n . dP = 0, which gives dt.

    Examples
    --------
    >>> nominal = {"R": 150.0, "D": 15.0, "shape": "ellipsoid", "mapping": "exact"}
    >>> w_r, _ = reflected_directions(np.array([0, -15.0, 0]), np.array([0, 0, 1.0]), **nominal)
    >>> [round(float(angle), 3) for angle in np.degrees(angles(w_r))]
    [11.365, -90.0]
    """
    _check(R, D)
    axes = _semi_axes(R, D, shape if mapping == "exact" else "sphere")
    along, gradient = _meet(pupil, w_c, axes)
    point = pupil + along[..., None] * w_c
    size = np.linalg.norm(gradient, axis=-1, keepdims=True)
    n = gradient / size
    moves = []
    for d_pupil, d_w in changes:
        free = d_pupil + along[..., None] * d_w
        moves.append(free - (_dot(n, free) / _dot(n, w_c))[..., None] * w_c)
    if mapping == "eq3":
        from_target = point - np.array([0.0, D, 0.0])
        length = np.linalg.norm(from_target, axis=-1, keepdims=True)
        w_r = from_target / length
        return w_r, [_across(w_r, d_point) / length for d_point in moves]
    cos = _dot(w_c, n)[..., None]
    w_r = 2 * cos * n - w_c
    turned = []
    for (_, d_w), d_point in zip(changes, moves, strict=True):
        d_n = _across(n, d_point / axes**2) / size
        d_cos = (_dot(d_w, n) + _dot(w_c, d_n))[..., None]
        turned.append(2 * (d_cos * n + cos * d_n) - d_w)
    return w_r, turned


def landing_points(
    pupil: FloatArray, w_c: FloatArray, *, R: float, D: float, shape: Shape
) -> FloatArray:
    """Where chief rays land on the plane of the sample, mm from the target, shape (..., 2).

    Parameters
    ----------
    pupil, w_c, R, D, shape
        As in `reflected_directions`.
    """
    w_r, _ = reflected_directions(pupil, w_c, R=R, D=D, shape=shape, mapping="exact")
    along, _ = _meet(pupil, w_c, _semi_axes(R, D, shape))
    point = pupil + along[..., None] * w_c
    down = point[..., 2:] / np.maximum(w_r[..., 2:], 1e-12)
    return np.asarray((point - down * w_r)[..., :2] - np.array([0.0, D]))


def _semi_axes(R: float, D: float, shape: Shape) -> FloatArray:
    return np.array([R, float(np.hypot(R, D)) if shape == "ellipsoid" else R, R])


def _meet(pupil: FloatArray, w: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance along rays from inside to the dome, and the gradient of its equation there."""
    q = 1 / axes**2
    a, b, c = _dot(w, q * w), _dot(w, q * pupil), 1 - _dot(pupil, q * pupil)
    along = (np.sqrt(b * b + a * c) - b) / a
    return along, q * (pupil + along[..., None] * w)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _across(w: FloatArray, v: FloatArray) -> FloatArray:
    """The part of v at right angles to the unit vector w."""
    return np.asarray(v - _dot(w, v)[..., None] * w)


def _range(s: FloatArray, R: float, D: float) -> FloatArray:
    """r_c of eq. (3), the distance from the camera to the sphere, for s = w_c . y."""
    return np.asarray(D * s + np.sqrt(D * D * s * s + R * R - D * D))


def _check(R: float, D: float) -> None:
    if not (np.isfinite(R) and 0 <= D < R):
        raise ConfigurationError(
            f"D = {D:g} mm with R = {R:g} mm: the camera must sit inside the dome, 0 <= D < R.",
            value=D,
        )
