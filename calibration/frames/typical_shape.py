"""How f of a white standard may depart from a certificate that does not state its shape.

The logarithm of f is a sum of smooth functions of the directions, with random coefficients. Each
function is the same when the directions are exchanged, as reciprocity demands, and 0 at the normal.
The coefficients are scaled so that f at 75 deg, against f at the normal, has a standard deviation
of 1; `Certificate.u_shape` multiplies it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from gonio.certificate import SHAPE_AT_DEG
from gonio.geometry import FloatArray

# Standard deviations of the coefficients, in the order of `functions`; the smoother, the larger.
# The first three exist at normal incidence: their squares add up to 1. Those of cos(dphi) do so at
# 75 deg in both angles, where light that goes forwards is as uncertain as the fall to the rim.
SD = np.array([0.6**0.5, 0.25**0.5, 0.15**0.5, 0.5, 0.75**0.5, 0.25**0.5, 0.25])
_NEGLIGIBLE = 1e-3  # share of the variance that modes left out may have together
# Directions over which modes are uncorrelated, degrees. They are fixed, so that two sessions with
# one standard have the same modes.
_THETA_I, _THETA_R, _DPHI = np.arange(0, 76, 15), np.arange(5, 81, 5), np.arange(0, 181, 45)


def functions(theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike) -> FloatArray:
    """The functions, shape (7, ...), of angles in radians that are broadcast.

    Examples
    --------
    >>> at_75 = functions(0.0, np.radians(75), 0.0)
    >>> round(float(np.sum((SD * at_75) ** 2)), 12)
    1.0
    """
    end = np.radians(SHAPE_AT_DEG)
    theta_i, theta_r, dphi = np.broadcast_arrays(
        *(np.asarray(angle, float) for angle in (theta_i, theta_r, dphi))
    )
    x_i, x_r = ((1 - np.cos(t)) / (1 - np.cos(end)) for t in (theta_i, theta_r))
    # The functions with an azimuth vanish at the normal, where no azimuth exists.
    around = np.sin(theta_i) * np.sin(theta_r) / np.sin(end) ** 2
    return np.stack(
        [
            x_i + x_r,
            x_i**2 + x_r**2,
            x_i**3 + x_r**3,
            x_i * x_r,
            around * np.cos(dphi),
            around * np.cos(dphi) * (x_i + x_r) / 2,
            around**2 * np.cos(2 * dphi),
        ]
    )


def with_one(theta_i: ArrayLike, theta_r: ArrayLike, dphi: ArrayLike) -> FloatArray:
    """The constant 1 and the functions, shape (8, ...)."""
    values = functions(theta_i, theta_r, dphi)
    return np.concatenate([np.ones((1, *values.shape[1:])), values])


@cache
def _grid() -> FloatArray:
    """Constant and functions at fixed directions, weighted by projected solid angle, (8, n)."""
    angles = np.radians(np.meshgrid(_THETA_I, _THETA_R, _DPHI, indexing="ij"))
    weight = np.sin(angles[1]) * np.cos(angles[1])
    return np.asarray((with_one(*angles) * np.sqrt(weight / weight.sum())).reshape(len(SD) + 1, -1))


def principal(covariance: FloatArray) -> FloatArray:
    """Coefficients of independent modes, the largest first.

    Parameters
    ----------
    covariance : ndarray, shape (8, 8)
        Of the coefficients of the constant and of the functions.

    Returns
    -------
    ndarray, shape (modes, 8)
        Coefficients of one standard deviation of each mode. Modes that together have less than a
        thousandth of the variance over the hemisphere are left out.
    """
    value, vector = np.linalg.eigh(covariance)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    _, size, turned = np.linalg.svd(_grid().T @ root, full_matrices=False)
    variance = size**2
    if variance.sum() == 0:
        return np.empty((0, len(covariance)))
    rest = variance.sum() - np.cumsum(variance)
    n = int(np.argmax(rest <= _NEGLIGIBLE * variance.sum())) + 1
    modes = (root @ turned.T).T[:n]
    # The sign is free: positive where f is uncertain most, so that it does not depend on a library.
    peak = np.argmax(np.abs(modes), axis=1)
    return np.asarray(modes * np.sign(modes[np.arange(n), peak])[:, None])
