"""Variance of the residuals beyond the stated noise, as an error of the model relative to f."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.standardised import decorrelated, orthonormal
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.result.noncentrality import noncentrality
from gonio.geometry import FloatArray

FARTHEST = 3.0  # standard deviations of a draw that its statement allows


@dataclass(frozen=True)
class Excess:
    """What the residuals have beyond the noise.

    Parameters
    ----------
    chi2 : float
        Sum of squares of the residuals in units of the noise, what parameters could do projected
        out.
    dof : float
        What it is expected to be.
    p : float
        Chance of a chi-squared as large under a true model.
    size : float
        Typical error of the model as a fraction of f: root of (chi2 - dof) / sum f^2/u^2, 0 where
        that is negative.
    interval : tuple of float
        95 % interval of `size`.
    z : ndarray, shape (N,)
        The residuals in units of the noise.
    """

    chi2: float
    dof: float
    p: float
    size: float
    interval: tuple[float, float]
    z: FloatArray


def stated_variance(problem: Problem, f: FloatArray) -> FloatArray:
    """Variance of independent errors as stated, (N,), whatever factor a joint fit put on it."""
    pieces = problem.independent.pieces()
    return np.concatenate([piece.variance(f[where]) for piece, where, _ in pieces])


def excess_of(base: Base, *, shared: bool = True) -> Excess:
    """Compare residuals with the stated noise; the samples must state it.

    Parameters
    ----------
    base : Base
    shared : bool
        With the errors that the samples share in the covariance of the residuals.

    Notes
    -----
    chi-squared is noncentral, with the squares of the model's errors in units of the noise as its
    noncentrality. Its interval is that of the normal law with its mean and variance.
    """
    from scipy.sparse import csr_array, diags_array
    from scipy.special import chdtrc

    problem, f, residual = base.problem, base.f, base.residual
    variance = stated_variance(problem, f)
    root = 1 / np.sqrt(variance)
    draws = csr_array((problem.n, 0))
    information = (root * f) ** 2
    if shared and base.shared.shape[1]:
        draws = csr_array(diags_array(root) @ base.shared)
        residual = residual + problem.profiled_change()
        inner = np.linalg.inv(np.eye(draws.shape[1]) + (draws.T @ draws).toarray())
        taken = np.asarray(draws.multiply(draws @ inner).sum(axis=1)).ravel()
        information = information * np.maximum(1 - taken, 0.0)
    columns = decorrelated(draws, root[:, None] * np.column_stack([base.jacobian, residual]))
    q = orthonormal(columns[:, :-1])
    z = columns[:, -1] - q @ (q.T @ columns[:, -1])
    chi2, dof = float(z @ z), float(problem.n - q.shape[1])
    counted = counted_dof(problem, variance, dof)
    p = float(chdtrc(max(counted, 1.0), chi2 * counted / max(dof, 1.0)))
    scale = dof / max(counted, 1.0)
    low, _ = noncentrality(chi2 / scale, counted)
    # Residuals smaller than their noise do not make it see more than it can.
    _, high = noncentrality(max(chi2 / scale, counted), counted)
    total = max(float(np.sum(information)) * dof / problem.n, 1e-300)
    beyond = _beyond_statement(draws, z, root * f) if draws.shape[1] else 0.0
    size, least, most = (
        float(np.hypot(np.sqrt(max(x, 0.0) / total), beyond))
        for x in (chi2 - dof, low * scale, high * scale)
    )
    return Excess(chi2, dof, p, size, (least, most), z)


def _beyond_statement(draws: Any, z: FloatArray, level: FloatArray) -> float:
    """Error, as a fraction of f, by draws of shared errors that lie beyond three of their sd.

    chi-squared charges a draw of k standard deviations with k^2, however much it moves the samples.
    """
    drawn = draws.T @ decorrelated(draws, z[:, None])[:, 0]
    excess = np.sign(drawn) * np.maximum(np.abs(drawn) - FARTHEST, 0.0)
    moved = draws @ excess
    return float(np.sqrt(float(moved @ moved) / max(float(level @ level), 1e-300)))


def counted_dof(problem: Problem, variance: FloatArray, dof: float) -> float:
    """Degrees of freedom by which chi-squared scatters.

    Noise of a standard's frame that R images use is one draw, not R: with the share q of it in the
    variance, chi-squared varies as one with n / (1 + (R - 1) q^2) degrees of freedom.
    """
    reference, sharing = problem.samples.u_reference, problem.samples.reference_sharing
    if reference is None or sharing <= 1:
        return dof
    q = np.minimum(reference**2 / variance, 1.0)
    return dof / (1 + (sharing - 1) * float(np.mean(q**2)))
