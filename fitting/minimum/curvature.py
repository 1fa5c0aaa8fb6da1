"""Which parameters a curvature J^T W J determines, and its inverse over these.

Parameters differ in size and unit: everything is done on the curvature with a unit diagonal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.optimum import Optimum
from gonio.geometry import FloatArray
from gonio.kernels.boxed import UNDETERMINED

TAKES_PART = 1e-3  # component of a direction without information above which a parameter is in it


def axes(h: FloatArray, index: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eigenvalues, eigenvectors and scale of the curvature of these parameters.

    Parameters
    ----------
    h : ndarray, shape (P, P)
    index : ndarray of int64
        Parameters with a curvature above 0.

    Returns
    -------
    values, vectors, scale : ndarray
        Of h / (scale scale^T), growing, column by column; scale is the root of the diagonal.
    """
    scale = np.sqrt(np.diag(h)[index])
    values, vectors = np.linalg.eigh(h[np.ix_(index, index)] / np.outer(scale, scale))
    return values, vectors, scale


def determined(h: FloatArray, among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Parameters among these that take no part in a direction without information."""
    is_determined = np.asarray(among & (np.diag(h) > 0))
    index = np.flatnonzero(is_determined)
    values, vectors, _ = axes(h, index)
    for vector in vectors.T[values < UNDETERMINED]:
        is_determined[index[np.abs(vector) > TAKES_PART]] = False
    return is_determined


def inverse(h: FloatArray, index: NDArray[np.int64]) -> FloatArray:
    """Inverse of the curvature of these parameters, in the order of `index`."""
    scale = np.sqrt(np.diag(h)[index])
    return np.asarray(
        np.linalg.inv(h[np.ix_(index, index)] / np.outer(scale, scale)) / np.outer(scale, scale)
    )


def inverse_curvature(optimum: Optimum) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which free parameters the data determine, and the inverse curvature of these, (P, P)."""
    is_determined = determined(optimum.curvature, optimum.free)
    index = np.flatnonzero(is_determined)
    n_p = len(optimum.p)
    covariance = np.zeros((n_p, n_p))
    if len(index):
        scale = 1 / np.sqrt(np.diag(optimum.curvature)[index])
        scaled = optimum.curvature[np.ix_(index, index)] * np.outer(scale, scale)
        # Along a sum that is held at its limit the parameters can move, but not away from it.
        along = within_sum(scale * np.isin(index, optimum.limited))
        inside = along @ np.linalg.inv(along.T @ scaled @ along) @ along.T
        covariance[np.ix_(index, index)] = inside * np.outer(scale, scale)
    is_determined[list(optimum.limited)] = False
    return is_determined, covariance


def within_sum(c: FloatArray) -> FloatArray:
    """Orthonormal directions (P, P - 1) along which a sum with coefficients c stays."""
    if not np.any(c):
        return np.eye(len(c))
    _, _, rows = np.linalg.svd(c[None])
    return np.asarray(rows[1:].T)
