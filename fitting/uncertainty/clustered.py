"""What leaving out one group of samples after the other does to the parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.uncertainty.degrees_of_freedom import Spread, of_quadratic_form
from gonio.fitting.uncertainty.informed import Informed
from gonio.geometry import FloatArray

LONE = 1e-6  # rest of a direction's information below which one group alone has it


def by_groups(
    informed: Informed, group: NDArray[np.int64], where: NDArray[np.bool_] | None = None
) -> tuple[Spread, FloatArray]:
    """Covariance by leaving out each group of samples once (CR3).

    Parameters
    ----------
    informed : Informed
    group : ndarray of int64, shape (N,)
        Samples whose errors may have anything to do with each other have one number.
    where : ndarray of bool, shape (N,), optional
        Samples that are left out; by default each.

    Returns
    -------
    Spread
        With Bell and McCaffrey's degrees of freedom, at most the number of groups less one.
    lone : ndarray, shape (P,)
        Share of each parameter's information in directions that one group alone informs. Such a
        group leaves no residuals along them, so that groups say nothing of them.

    Notes
    -----
    d_g = back (1 - Q_g^T Q_g)^-1 Q_g^T z_g and the covariance is sum_g d_g d_g^T. The curvature
    here is that of J^T W J also where the model fails: a Newton step with that of chi-squared
    explodes where one group has most of the information.

    References
    ----------
    Bell & McCaffrey 2002, Survey Methodology 28, 169. Pustejovsky & Tipton 2018, J. Bus. Econ.
    Stat. 36, 672.
    """
    back = informed.back
    n_p = len(back)
    some = np.arange(len(informed.z)) if where is None else np.flatnonzero(where)
    labels, number = np.unique(group[some], return_inverse=True)
    scores, own = np.zeros((len(labels), n_p)), np.zeros((len(labels), n_p))
    cross = np.zeros((len(labels), back.shape[1], n_p))
    lone = np.zeros(n_p)
    for g in range(len(labels)):
        rows = some[number == g]
        q = informed.q[rows]
        share = q.T @ q
        values, vectors = np.linalg.eigh(share)
        shared = 1 - values > LONE
        weight = (vectors[:, shared] / (1 - values[shared])) @ (vectors[:, shared].T @ back.T)
        scores[g] = (q.T @ informed.z[rows]) @ weight
        cross[g] = share @ weight
        own[g] = np.sum(weight * cross[g], axis=0)
        lone += np.sum((back @ vectors[:, ~shared]) ** 2, axis=1)
    trace, square = np.zeros(n_p), np.zeros(n_p)
    for j in np.flatnonzero(np.any(back != 0, axis=1)):
        matrix = np.diag(own[:, j]) - cross[:, :, j] @ cross[:, :, j].T
        size = max(float(np.max(np.abs(matrix), initial=0.0)), 1e-300)
        trace[j], square[j] = np.trace(matrix) / size, np.sum((matrix / size) ** 2)
    dof = np.minimum(of_quadratic_form(trace, square), len(labels) - 1)
    total = np.sum(back**2, axis=1)
    share_of = np.divide(lone, total, out=np.zeros(n_p), where=total > 0)
    return Spread(scores.T @ scores, dof), share_of
