"""Draws of a posterior spread to a covariance that allows for more than the noise.

The likelihood counts independent noise alone. Where the model does not fit, its posterior is as
much too narrow as the covariance by that noise; the draws keep their centre and, but for a linear
map, their shape.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.geometry import FloatArray

RIDGE = 1e-12  # of a variance: keeps a covariance of parameters that move as one invertible


def widened(
    problem: Problem,
    mode: FloatArray,
    draws: FloatArray,
    errors: Uncertainty,
    rng: np.random.Generator,
) -> FloatArray:
    """Draws (chains, steps, P) with the covariance of the uncertainties and tails of Student's t.

    Parameters
    ----------
    problem : Problem
    mode : ndarray, shape (P,)
        Where the uncertainties hold.
    draws : ndarray, shape (chains, steps, P)
    errors : Uncertainty
    rng : numpy.random.Generator

    Notes
    -----
    Over the parameters that are determined, in the logarithm of those that are so declared,
    x' = m + w L_u L_d^-1 (x - m), with m the mean of the draws, L L^T the covariance of the
    uncertainties and of the draws, and w^2 = nu / chi2(nu) with one probability for all parameters
    of a draw and nu the degrees of freedom of each. The other parameters keep their draws.
    """
    index = np.flatnonzero(errors.determined)
    log = np.array([problem.parameters[j].scale == "log" for j in index], np.bool_)
    x = draws[..., index].reshape(-1, len(index))
    x[:, log] = np.log(np.maximum(x[:, log], 1e-300))
    slope = np.where(log, 1 / np.where(log, mode[index], 1.0), 1.0)
    wanted = errors.without_propagated[np.ix_(index, index)] * np.outer(slope, slope)
    centre = x.mean(axis=0)
    away = (x - centre) @ (_root(wanted) @ np.linalg.inv(_root(np.cov(x, rowvar=False)))).T
    chance = rng.random(len(x))
    for k, j in enumerate(index.tolist()):
        dof = errors.dof_of(j)
        if dof is not None:
            nu = max(dof, 1.0)
            away[:, k] *= np.sqrt(nu / stats.chi2.ppf(chance, nu))
    # Tails of Student's t with few degrees of freedom leave every bound far behind.
    x = centre + away
    x[:, log] = np.exp(np.clip(x[:, log], -600, 600))
    result = draws.copy()
    result[..., index] = x.reshape(*draws.shape[:2], len(index))
    return result


def _root(covariance: FloatArray) -> FloatArray:
    covariance = np.atleast_2d(covariance)
    scale = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    return np.asarray(scale[:, None] * np.linalg.cholesky(scaled))
