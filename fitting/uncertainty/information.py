"""Errors that many samples share, as columns beside the derivatives: what they take away.

A shared error of unit variance moves the samples by a column u of U; the covariance of the samples
is then C = s^2 W^-1 + U U^T, with W the weights and s the factor on the independent errors. Every
number here follows from small products of columns with W, by Woodbury's identity

C^-1 = W/s^2 - W U (s^2 I + U^T W U)^-1 U^T W / s^2.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio.fitting.problem.problem import Problem
from gonio.fitting.uncertainty.covariance import shared_change
from gonio.geometry import FloatArray


def shared_columns(problem: Problem, p: FloatArray, f: FloatArray) -> Any:
    """Change of every sample for one standard deviation of every draw of every shared error.

    Parameters
    ----------
    problem : Problem
    p : ndarray, shape (P,)
    f : ndarray, shape (N,)
        Model values at p.

    Returns
    -------
    scipy.sparse.csr_array, shape (N, draws)
    """
    from scipy.sparse import csr_array, hstack

    rows = np.arange(problem.n)
    parts = [csr_array((problem.n, 0))]
    for term in problem.samples.shared:
        change = shared_change(problem, term, p, f)
        group = np.zeros(problem.n, dtype=np.int64)
        if term.group is not None:
            group = np.unique(term.group, return_inverse=True)[1].astype(np.int64)
        shape = (problem.n, int(group.max(initial=0)) + 1)
        parts.append(csr_array((change, (rows, group)), shape=shape))
    return csr_array(hstack(parts))


def thinned(problem: Problem, most: int) -> Problem:
    """At most so many samples, spread evenly over all, with their cells and weights."""
    if problem.n <= most:
        return problem
    # Multiples of the golden ratio: spread evenly, without the period of a scan.
    index = (np.arange(most) * 0.6180339887498949) % 1.0 * problem.n
    return problem.at(np.unique(index.astype(np.int64)))


def information(
    problem: Problem, p: FloatArray, noise_scale: float, *, shared: bool = True
) -> FloatArray:
    """Fisher information (P, P) of the parameters; shared errors are marginalised.

    Parameters
    ----------
    problem : Problem
    p : ndarray, shape (P,)
    noise_scale : float
        Factor on the independent uncertainties, positive.
    shared : bool
        False: of the independent errors alone.
    """
    f, jacobian = problem.jacobian(p)
    weighted = problem.weighted(jacobian)
    found = weighted.T @ jacobian / noise_scale**2
    if not (shared and problem.samples.shared):
        return np.asarray(found)
    u = shared_columns(problem, p, f)
    cross = np.asarray(u.T @ weighted) / noise_scale**2
    inner = np.eye(u.shape[1]) + weighted_square(u, problem.inverse_variance) / noise_scale**2
    found = found - cross.T @ np.linalg.solve(inner, cross)
    return np.asarray((found + found.T) / 2)


def weighted_square(u: Any, weight: FloatArray) -> FloatArray:
    """U^T W U (draws, draws) of sparse columns."""
    from scipy.sparse import diags_array

    return np.asarray((u.T @ diags_array(weight) @ u).toarray())
