"""Chances of ratios of quadratic forms in normal noise, and their combination."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gonio.geometry import FloatArray

NEGLIGIBLE = 1e-10  # eigenvalue of C^T C, columns of unit size, that is rounding
NEARLY_ONE = 0.99  # p-values above do not outweigh small ones in their combination
SETTLED = 1e-8  # step, in standard deviations, after which a saddlepoint is exact
STEPS = 200  # that halve an interval to rounding in any case
AT_MEAN = 1e-4  # |t| sqrt(K'') below which the saddlepoint is taken at the mean


def upper_tail(weights: FloatArray, multiplicity: FloatArray) -> float:
    """P(sum_k weights_k X_k > 0), X_k chi-squared with multiplicity_k degrees of freedom.

    Lugannani and Rice's saddlepoint approximation; weights may have both signs.

    Parameters
    ----------
    weights, multiplicity : ndarray, shape (K,)

    References
    ----------
    Kuonen 1999, Biometrika 86, 929.

    Examples
    --------
    F of 3 and 10 degrees of freedom, at its 5 % quantile; the approximation is good to 2 %:

    >>> from scipy import stats
    >>> f = stats.f.isf(0.05, 3, 10)
    >>> round(upper_tail(np.array([1 / 3, -f / 10]), np.array([3.0, 10.0])), 3)
    0.051
    """
    from scipy.special import ndtr

    size = float(np.max(np.abs(weights), initial=0.0))
    if size == 0:
        return 1.0
    w = weights / size
    if not (w.max() > 0 and w.min() < 0):
        return 1.0 if w.max() > 0 else 0.0
    low, high = 0.5 / w.min(), 0.5 / w.max()

    edge = 1 - 1e-12
    t = _saddlepoint(w, multiplicity, low * edge, high * edge)
    if t in (low * edge, high * edge):  # the slope has one sign by rounding
        return 0.0 if t > 0 else 1.0
    k = -0.5 * float(np.sum(multiplicity * np.log1p(-2 * t * w)))
    k2 = 2 * float(np.sum(multiplicity * (w / (1 - 2 * t * w)) ** 2))
    if abs(t) * np.sqrt(k2) < AT_MEAN:
        k3 = 8 * float(np.sum(multiplicity * w**3))
        return float(np.clip(0.5 - k3 / (6 * np.sqrt(2 * np.pi) * k2**1.5), 0, 1))
    r, u = np.sign(t) * np.sqrt(max(-2 * k, 0.0)), t * np.sqrt(k2)
    return float(np.clip(ndtr(-(r + np.log(u / r) / r)), 0.0, 1.0))


def _saddlepoint(w: FloatArray, multiplicity: FloatArray, low: float, high: float) -> float:
    """Where sum multiplicity w / (1 - 2 t w), which grows with t, is 0; else the end next to it.

    Newton's steps, and halves of the interval where these leave it.
    """
    weighted = multiplicity * w

    def slope(t: float) -> tuple[float, float]:
        ratio = 1 / (1 - 2 * t * w)
        part = weighted * ratio
        return float(part.sum()), 2 * float(part @ (w * ratio))

    if slope(high)[0] < 0:
        return high
    if slope(low)[0] > 0:
        return low
    t = 0.0
    for _ in range(STEPS):
        value, growth = slope(t)
        low, high = (t, high) if value < 0 else (low, t)
        step = -value / growth
        if not low < t + step < high:
            t = (low + high) / 2
            continue
        t += step
        # The next step would be about the square of this one, in units of the deviation of t.
        if abs(step) * math.sqrt(growth) <= SETTLED:
            break
    return t


def component_test(gram: FloatArray, score: float, square: float, dof: int) -> float | None:
    """p-value of no variance component: z ~ N(0, s^2 1 + t^2 C C^T) with t = 0.

    The score statistic T = |C^T z|^2 / |z|^2, with the fitted directions projected out of both, is
    a ratio of quadratic forms whose eigenvalues are those of C^T (1 - Q Q^T) C. It is exact for
    normal noise of any size s. None where nothing is left to test.

    Parameters
    ----------
    gram : ndarray, shape (C, C)
        C^T (1 - Q Q^T) C; eigenvalues below 1e-10 count as rounding, so that columns are of
        about unit length.
    score, square : float
        |C^T z|^2 and |z|^2.
    dof : int
        Degrees of freedom of |z|^2.
    """
    values = np.asarray(np.linalg.eigvalsh(gram), dtype=np.float64)
    return ratio_test(values, score, square, dof)


def ratio_test(values: FloatArray, score: float, square: float, dof: int) -> float | None:
    """`component_test` where the eigenvalues of the matrix are at hand."""
    values = values[values > NEGLIGIBLE]
    rest = dof - len(values)
    if len(values) == 0 or square <= 0 or rest < 0:
        return None
    ratio = score / square
    weights = np.concatenate([values - ratio, np.full(min(rest, 1), -ratio)])
    multiplicity = np.concatenate([np.ones(len(values)), np.full(min(rest, 1), float(rest))])
    return upper_tail(weights, multiplicity)


def combined(p_values: Sequence[float]) -> float:
    """One p-value of several dependent ones, by Cauchy's distribution; 1 of none.

    References
    ----------
    Liu & Xie 2020, J. Am. Stat. Assoc. 115, 393.

    Examples
    --------
    >>> round(combined([0.2, 0.2, 0.2]), 6)
    0.2
    >>> combined([])
    1.0
    """
    if not len(p_values):
        return 1.0
    p = np.clip(np.asarray(p_values, float), 1e-300, NEARLY_ONE)
    small = p < 1e-15
    t = np.where(small, 1 / (p * np.pi), np.tan((0.5 - np.where(small, 0.5, p)) * np.pi))
    mean = float(np.mean(t))
    return float(1 / (mean * np.pi)) if mean > 1e15 else float(0.5 - np.arctan(mean) / np.pi)
