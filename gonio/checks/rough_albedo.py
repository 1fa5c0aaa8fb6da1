"""A rough directional albedo from the sample nearest to each direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.checks.pairs import wrapped
from gonio.geometry import FloatArray, hemisphere_quadrature, unit_vectors


def rough_albedo(
    theta_i: FloatArray,
    theta_r: FloatArray,
    delta: FloatArray,
    f: FloatArray,
    group: NDArray[np.int64],
) -> float | None:
    """Largest directional albedo, from the sample nearest to each direction of the hemisphere.

    Parameters
    ----------
    theta_i, theta_r, delta : ndarray, shape (N,)
        Polar angles and abs(phi_r - phi_i), radians.
    f : ndarray, shape (N,)
        BRDF, sr^-1.
    group : ndarray of int64, shape (N,)
        Wavelength and channel.

    Returns
    -------
    float or None
        None if the data cover too little of the hemisphere.
    """
    from scipy.spatial import cKDTree

    theta, phi, weight = hemisphere_quadrature(16, 32)
    grid = unit_vectors(theta, np.abs(wrapped(phi)))
    largest = None
    incidence = np.round(np.degrees(theta_i)).astype(np.int64)
    keys = np.stack([group, incidence], axis=1)
    unique, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.ravel()
    counts = np.bincount(index, minlength=len(unique))
    for number in np.flatnonzero(counts >= 20):
        members = index == number
        points = unit_vectors(theta_r[members], delta[members])
        distance, nearest = cKDTree(points).query(grid)
        # Nine tenths of the projected hemisphere lie within 20 degrees of a sample.
        if np.sum((weight * np.cos(theta))[distance < 0.35]) > 0.9 * np.pi:
            albedo = float(np.sum(weight * np.cos(theta) * f[members][nearest]))
            largest = albedo if largest is None else max(largest, albedo)
    return largest
