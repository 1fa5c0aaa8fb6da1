"""Residuals as the loss of a fit sees them, in the unit of f."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray


@dataclass(frozen=True)
class OwnResiduals:
    """Residuals and derivatives of the least squares that are at their minimum where the loss is.

    Parameters
    ----------
    f : ndarray, shape (N,)
        Fitted values.
    residual : ndarray, shape (N,)
        y - f for chi-squared. For a transformed value [t(y) - t(f)]/t'(f), which is the same near
        f. For Student's t the part of y - f that its score counts: an outlier stays within sqrt(5)
        of its scale.
    jacobian : ndarray, shape (N, P)
        Derivatives of f, with the factor that `residual` has to y - f where it is one.
    """

    f: FloatArray
    residual: FloatArray
    jacobian: FloatArray


def own_residuals(problem: Problem, p: FloatArray) -> OwnResiduals:
    """Residuals at p in the way of the problem's loss.

    Notes
    -----
    With weights v the slope of the loss is -2 J^T v r, so that `jacobian` is orthogonal to
    `residual` at the minimum under the weights of the loss, as in least squares. Tests of least
    squares' residuals hold for these.
    """
    f, jacobian = problem.jacobian(p)
    y, law = problem.samples.value, problem.law
    if problem.quadratic:
        return OwnResiduals(f, y - f, jacobian)
    data = y, f, problem.inverse_variance, problem.cos_theta_r
    residual, _ = law.linearised(*data)
    share = np.sqrt(np.broadcast_to(law.shares(*data), f.shape))
    return OwnResiduals(f, residual * share, jacobian * share[:, None])
