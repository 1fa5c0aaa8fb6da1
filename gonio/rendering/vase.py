"""The cylindrical vase of Oren and Nayar's Fig. 13: brightness along its cross-section."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

import gonio.models as models
from gonio.errors import ConfigurationError
from gonio.geometry import HORIZON, FloatArray, unit_vectors
from gonio.models import Model
from gonio.rendering.lights import WHITE


def cross_section(
    model: Model | str,
    p: Mapping[str, float] | None = None,
    *,
    theta_i: float = 0.0,
    x: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Radiance across an upright cylinder seen from in front, by a distant lamp.

    Parameters
    ----------
    model : Model or str
    p : mapping, optional
        Parameters by name, angles in radians.
    theta_i : float
        Angle of the lamp to the right of the viewer, radians, in (-pi/2, pi/2).
    x : ndarray, optional
        Positions to the right of the axis in units of the radius, within (-1, 1); 401 where not
        given.

    Returns
    -------
    x, radiance : ndarray
        For the irradiance pi across the beam: a white Lambertian cylinder has cos(psi - theta_i),
        where x = sin(psi). f below 0 counts as 0.

    Raises
    ------
    ConfigurationError
        If theta_i or a position is out of range.

    Notes
    -----
    L(x) = E_0 f(psi - theta_i; psi) max[0, cos(psi - theta_i)], both directions in one plane. The
    grooves of an anisotropic model go round the cylinder.

    References
    ----------
    Oren & Nayar 1994, Fig. 13: rho = 0.7, sigma = 40 deg, theta_i = 0 and 20 deg.

    Examples
    --------
    >>> x, lambert = cross_section("lambert", {"rho": 1.0}, x=np.array([0.0, 0.6]))
    >>> lambert.round(12).tolist()
    [1.0, 0.8]
    """
    if not abs(theta_i) < HORIZON:
        raise ConfigurationError(
            f"theta_i = {math.degrees(theta_i):g} deg; the lamp stands within 90 deg of the "
            "viewer, to the right (positive) or the left.",
            value=theta_i,
        )
    model = models.get(model)
    x = np.sin(np.linspace(-HORIZON, HORIZON, 403)[1:-1]) if x is None else np.asarray(x, float)
    if not np.all(np.abs(x) < 1):
        raise ConfigurationError(
            "a position is not on the cylinder: x lies between -1 and 1, in units of its radius.",
            value=x,
        )
    psi = np.arcsin(x)
    # In the frame of the surface its x axis points to the right, along the grooves.
    w_r, w_i = unit_vectors(psi, math.pi), unit_vectors(theta_i - psi, 0.0)
    f = np.maximum(model.evaluate(w_i, w_r, model.vector(p or {})), 0.0)
    return x, WHITE * f * np.maximum(np.cos(psi - theta_i), 0.0)
