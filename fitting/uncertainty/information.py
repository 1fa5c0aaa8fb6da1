"""Errors that many samples share, as columns beside the derivatives: what they take away.

A shared error of unit variance moves the samples by a column u of U; the covariance of the samples
is then C = s^2 W^-1 + U U^T, with W the weights and s the factor on the independent errors. Every
number here follows from small products of columns with W, by Woodbury's identity

C^-1 = W/s^2 - W U (s^2 I + U^T W U)^-1 U^T W / s^2.
"""

from __future__ import annotations

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_columns import shared_columns, weighted_square
from gonio.geometry import FloatArray


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
    matrix = weighted.T @ jacobian / noise_scale**2
    if not (shared and problem.samples.shared):
        return np.asarray(matrix)
    u = shared_columns(problem, p, f)
    cross = np.asarray(u.T @ weighted) / noise_scale**2
    inner = np.eye(u.shape[1]) + weighted_square(u, problem.inverse_variance) / noise_scale**2
    matrix = matrix - cross.T @ np.linalg.solve(inner, cross)
    return np.asarray((matrix + matrix.T) / 2)
