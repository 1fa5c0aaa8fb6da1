"""Degrees of freedom of estimated variances, and the intervals that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.geometry import FloatArray


@dataclass(frozen=True)
class Spread:
    """A covariance with the degrees of freedom of its diagonal.

    Parameters
    ----------
    covariance : ndarray, shape (P, P)
    dof : ndarray, shape (P,)
        Of each variance as an estimate, by Satterthwaite; infinity where it is known, NaN where
        it is 0.
    """

    covariance: FloatArray
    dof: FloatArray

    @classmethod
    def known(cls, covariance: FloatArray) -> Spread:
        """A covariance that is no estimate."""
        dof = np.where(np.diag(covariance) > 0, np.inf, np.nan)
        return cls(covariance, dof)

    def __add__(self, other: Spread) -> Spread:
        """The covariance of a sum of independent errors."""
        dof = [
            satterthwaite(variances, freedoms)
            for variances, freedoms in zip(
                np.column_stack([np.diag(self.covariance), np.diag(other.covariance)]),
                np.column_stack([self.dof, other.dof]),
                strict=True,
            )
        ]
        return Spread(self.covariance + other.covariance, np.array(dof))


def satterthwaite(variances: FloatArray, dof: FloatArray) -> float:
    """Degrees of freedom of a sum of independent estimates of variances.

    Notes
    -----
    A variance estimate v with nu degrees of freedom has the variance 2 v^2 / nu (Satterthwaite
    1946, Biometrics Bull. 2, 110).

    Examples
    --------
    >>> satterthwaite(np.array([1.0, 1.0]), np.array([10.0, 10.0]))
    20.0
    >>> satterthwaite(np.array([1.0, 1.0]), np.array([10.0, np.inf]))
    40.0
    """
    some = variances > 0
    if not some.any():
        return float("nan")
    share = variances[some] / np.max(variances)
    part = float(np.sum(share**2 / dof[some]))
    return float(np.sum(share)) ** 2 / part if part > 0 else float("inf")


def of_quadratic_form(trace: FloatArray, square: FloatArray) -> FloatArray:
    """Degrees of freedom tr(L)^2 / tr(L^2) of z^T L z for white noise z; NaN where L is 0.

    References
    ----------
    Bell & McCaffrey 2002, Survey Methodology 28, 169.
    """
    out = np.full(len(trace), np.nan)
    np.divide(trace**2, square, out=out, where=square > 0)
    return out


def quantile(probability: float, dof: float | None) -> float:
    """Quantile of Student's t; of the normal distribution where the variance is known (None).

    Fewer than one degree of freedom count as one.

    Examples
    --------
    >>> round(quantile(0.975, None), 3), round(quantile(0.975, 4.0), 3)
    (1.96, 2.776)
    """
    from scipy.special import ndtri, stdtrit

    if dof is None or not np.isfinite(dof):
        return float(ndtri(probability))
    return float(stdtrit(max(dof, 1.0), probability))
