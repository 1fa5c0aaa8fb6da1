"""Interval of what a chi-squared holds beyond its expectation."""

from __future__ import annotations

Z_95 = 1.959964  # 97.5 % quantile of the normal law


def noncentrality(chi2: float, dof: float) -> tuple[float, float]:
    """95 % interval of the noncentrality of a chi-squared.

    Solutions of (chi2 - dof - x)^2 = c^2 2 (dof + 2 x), the mean and the variance being those of
    the noncentral law.

    Examples
    --------
    >>> [round(x, 1) for x in noncentrality(100.0, 100.0)]
    [0.0, 36.4]
    """
    a, c2 = chi2 - dof, Z_95**2
    half = max(4 * a * c2 + 4 * c2**2 + 2 * c2 * dof, 0.0) ** 0.5
    return max(a + 2 * c2 - half, 0.0), max(a + 2 * c2 + half, 0.0)
