"""chi-squared of the residuals with shared errors marginalised."""

from __future__ import annotations

import numpy as np

from gonio.fitting.problem.shared_columns import weighted_square
from gonio.fitting.residual_tests.whitened import (
    Base,
    pseudo_root,
)
from gonio.geometry import FloatArray

OUTSIDE = 0.0025  # one-sided probability of chi-squared beyond which its size is stated,
MATERIAL = 1.25  # and factor by which chi2/dof must miss 1: smaller misses change no decision


def chi_squared_test(base: Base) -> tuple[float, float, float, str]:
    """chi2, dof, one-sided probability and verdict, shared errors marginalised.

    Noise of a standard's frame that R images use is one draw, not R: with the share q of it in
    the variance, chi-squared varies as one with n / (1 + (R - 1) q^2) degrees of freedom.
    """
    from scipy.special import chdtr, chdtrc

    problem, u, jac = base.problem, base.shared, base.jacobian
    variance = problem.variance(base.f)
    weight = 1 / variance
    inner: FloatArray = np.zeros((0, 0))
    if u.shape[1]:
        inner = np.asarray(np.linalg.inv(np.eye(u.shape[1]) + weighted_square(u, weight)))

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        """a^T C^-1 b."""
        unprojected = np.asarray(a.T @ (weight[:, None] * b))
        if not u.shape[1]:
            return unprojected
        return np.asarray(
            unprojected - (u.T @ (weight[:, None] * a)).T @ inner @ (u.T @ (weight[:, None] * b))
        )

    r = base.residual[:, None]
    size = np.sqrt(np.maximum(np.sum(jac**2, axis=0), 1e-300))
    jac = jac / size
    cross = product(jac, r)
    root_inverse = pseudo_root(product(jac, jac))
    chi2 = float(product(r, r)[0, 0] - np.sum((root_inverse.T @ cross) ** 2))
    n = problem.n - root_inverse.shape[1]
    reference = problem.samples.u_reference
    counted = float(n)
    if reference is not None and problem.samples.reference_sharing > 1:
        q = np.minimum(reference**2 / variance, 1.0)
        counted = n / (1 + (problem.samples.reference_sharing - 1) * float(np.mean(q**2)))
    chi2 = max(chi2, 0.0)
    scaled = chi2 * counted / n
    above, below = chdtrc(counted, scaled), chdtr(counted, scaled)
    verdict = "as stated"
    if above < OUTSIDE and chi2 > MATERIAL * n:
        verdict = "larger"
    elif below < OUTSIDE and chi2 < n / MATERIAL:
        verdict = "smaller"
    return chi2, float(n), float(min(above, below)), verdict
