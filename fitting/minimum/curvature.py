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


def marginal_root(
    h: FloatArray, among: NDArray[np.bool_], limited: tuple[int, ...] = ()
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which of these parameters are determined, and a root of the marginal covariance.

    Parameters
    ----------
    h : ndarray, shape (P, P)
        Curvature J^T W J.
    among : ndarray of bool, shape (P,)
        Parameters that are free.
    limited : tuple of int
        Reflectances whose sum is held at its limit: they can move along it, but not away from it.

    Returns
    -------
    determined : ndarray of bool, shape (P,)
    root : ndarray, shape (P, R)
        One column for each direction that the data inform. root @ root.T is the covariance of
        what is determined, for noise of unit size, and the generalised inverse of h that takes
        the data's score to the parameters. Rows of parameters that are not determined mean
        nothing.

    Notes
    -----
    Directions without information are left out, and not the parameters that take part in them.
    The others share some of the information with those: were those held, the others would seem
    better known than they are.
    """
    determined = np.asarray(among & (np.diag(h) > 0))
    index = np.flatnonzero(determined)
    root = np.zeros((len(h), 0))
    if len(index):
        scale = 1 / np.sqrt(np.diag(h)[index])
        along = within_sum(scale * np.isin(index, limited) if limited else np.zeros(len(index)))
        scaled = h[np.ix_(index, index)] * np.outer(scale, scale)
        values, vectors = np.linalg.eigh(along.T @ scaled @ along)
        informed = values >= UNDETERMINED
        vectors = along @ vectors
        determined[index] = ~np.any(np.abs(vectors[:, ~informed]) > TAKES_PART, axis=1)
        root = np.zeros((len(h), int(np.count_nonzero(informed))))
        root[index] = scale[:, None] * vectors[:, informed] / np.sqrt(values[informed])
    return determined, root


def marginal_inverse(
    h: FloatArray, among: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which of these parameters are determined, and their marginal covariance (P, P), else 0."""
    determined, root = marginal_root(h, among)
    return determined, where_determined(determined, root @ root.T)


def where_determined(determined: NDArray[np.bool_], matrix: FloatArray) -> FloatArray:
    """A covariance (P, P) with 0 in the rows and columns of what is not determined."""
    return np.asarray(np.where(determined[:, None] & determined[None], matrix, 0.0))


def inverse_curvature(optimum: Optimum) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which free parameters the data determine, and the generalised inverse curvature (P, P).

    See `marginal_root`; rows of what is not determined mean nothing.
    """
    determined, root = marginal_root(optimum.curvature, optimum.free, optimum.limited)
    determined[list(optimum.limited)] = False
    return determined, np.asarray(root @ root.T)


def within_sum(c: FloatArray) -> FloatArray:
    """Orthonormal directions (P, P - 1) along which a sum with coefficients c stays."""
    if not np.any(c):
        return np.eye(len(c))
    _, _, rows = np.linalg.svd(c[None])
    return np.asarray(rows[1:].T)
