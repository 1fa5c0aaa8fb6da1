"""What eq. (3) leaves out, in a closed form: a prediction that no code of the package makes."""

import numpy as np


def mapping_error(w_r, *, R, D, shape):
    """Size and direction of what eq. (3) leaves out, to leading order in D/R.

    Parameters
    ----------
    w_r : ndarray, shape (..., 3)
        Reflected directions by eq. (3).
    R, D : float
        Radius or semi-minor axis, half the separation of camera and target, mm.
    shape : {"sphere", "ellipsoid"}
        Shape of the dome.

    Returns
    -------
    ndarray, shape (..., 3)
        Tangent vectors, radians: (D/R)^2 sin(2 gamma) on a sphere, (D/R)^3 cos^2(gamma)
        sin(gamma) on the ellipsoid with foci in camera and target, gamma being the angle to the
        y axis; along the meridian through that axis.
    """
    epsilon = D / R
    # gamma belongs to the point P of the dome as seen from its centre; the direction from T
    # differs from it by D/R, which matters where the error passes through zero.
    y = w_r[..., 1:2]
    point = (np.sqrt(D * D * y * y + R * R - D * D) - D * y) * w_r + np.array([0.0, D, 0.0])
    s = point[..., 1:2] / np.linalg.norm(point, axis=-1, keepdims=True)
    tangent = np.array([0.0, 1.0, 0.0]) - w_r[..., 1:2] * w_r
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-12)
    amplitude = 2 * epsilon**2 * s if shape == "sphere" else epsilon**3 * s * s
    return np.asarray(amplitude * np.sqrt(1 - s * s) * tangent)
