"""Uncertainties of a joint solution, and what the other unknowns do to the material's parameters.

With the information H of all unknowns, parameters p and others x, and the marginal covariance C of
the others,

cov(p) = Hpp^-1 + B C B^T,     B = Hpp^-1 Hpx.

A fit whose other unknowns are held at their estimates has the covariance Hpp^-1. With M = B C B^T,
the P displacements V = C B^T M^(-1/2) of the others add B V V^T B^T = M exactly: each is one shared
error of the samples, of unit variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.dome_field.solve import Joint
from gonio.geometry import FloatArray


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of all unknowns of a joint solution.

    Parameters
    ----------
    covariance : ndarray, shape (U, U)
        0 for unknowns that are held.
    """

    covariance: FloatArray

    @classmethod
    def of(cls, information: FloatArray) -> Uncertainty:
        """Invert the information; unknowns with an infinite one are held."""
        from scipy.linalg import cho_factor, cho_solve

        free = np.isfinite(np.diag(information))
        inner = information[np.ix_(free, free)]
        scale = 1 / np.sqrt(np.diag(inner))
        factor = cho_factor(inner * np.outer(scale, scale), lower=True)
        inverse = cho_solve(factor, np.eye(len(inner))) * np.outer(scale, scale)
        covariance = np.zeros_like(information)
        covariance[np.ix_(free, free)] = (inverse + inverse.T) / 2
        return cls(covariance)


def modes(joint: Joint, uncertainty: Uncertainty, number: int) -> FloatArray:
    """Displacements V (U, m) of all unknowns by the modes of one session's parameters.

    Those of the session's own parameters are 0: the fit moves them.
    """
    own = joint.layout.of_session(number)
    own = own[np.isfinite(np.diag(joint.information)[own])]
    others = np.setdiff1d(np.arange(joint.layout.size), own)
    across = joint.information[np.ix_(own, others)]
    across = np.where(np.isfinite(across), across, 0.0)
    b = np.linalg.solve(joint.information[np.ix_(own, own)], across)
    c_bt = uncertainty.covariance[np.ix_(others, others)] @ b.T
    m = b @ c_bt
    scale = np.sqrt(np.maximum(np.diag(m), 1e-300))
    size, vectors = np.linalg.eigh(m / np.outer(scale, scale))
    kept = size > 1e-12
    # V = C B^T X with X X^T = M^-1: any such X gives the same covariance.
    x = (vectors[:, kept] / np.sqrt(size[kept])) / scale[:, None]
    v = np.zeros((joint.layout.size, int(np.count_nonzero(kept))))
    v[others] = c_bt @ x
    return v


def change_of_samples(joint: Joint, number: int, v: FloatArray) -> FloatArray:
    """Change (N, m) of a session's values by displacements (U, m) of the unknowns, sr^-1."""
    rows = joint.rows[number]
    change = np.zeros((len(rows.residual), v.shape[1]))
    for column in range(rows.index.shape[1]):
        change += rows.column[:, column, None] * v[rows.index[:, column]]
    return np.asarray(change / rows.root[:, None])
