"""Pareto-smoothed importance sampling (PSIS): steadier weights, and whether to rely on them.

Vehtari, Simpson, Gelman, Yao and Gabry 2024, JMLR 25 (72), 1-58. The largest weights are replaced
by the expected order statistics of a generalised Pareto distribution that is fitted to them after
Zhang and Stephens 2009, Technometrics 51, 316-325. The steps are those of arviz 0.23, so that the
numbers are the same whichever arviz is installed, and without any.
"""

from __future__ import annotations

import numpy as np

from gonio.geometry import FloatArray

_SMALLEST_TAIL = 5  # weights that tell a shape
_PRIOR_WEIGHTS, _PRIOR_SHAPE = 10, 0.5  # the fitted shape is drawn towards 0.5 as if by ten weights
_PRIOR_SCALE = 3


def pareto_smoothed(log_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smoothed normalised log weights, and the shape of the tail of each row.

    Parameters
    ----------
    log_weights : ndarray, shape (S,) or (N, S)
        Logarithms of S importance weights, up to a constant, in each of N rows.

    Returns
    -------
    smoothed : ndarray, shape of `log_weights`
        The weights of each row sum to 1.
    k_hat : ndarray, shape (1,) or (N,)
        Shape of the tail. Above 0.7 the weights are not to be relied on; infinite where too few
        weights are left to tell.

    Examples
    --------
    >>> smoothed, k_hat = pareto_smoothed(np.log(np.arange(1.0, 101.0)))
    >>> round(float(np.sum(np.exp(smoothed))), 12), bool(k_hat[0] < 0.7)
    (1.0, True)
    """
    smoothed = np.array(log_weights, dtype=float)
    with np.errstate(all="ignore"):
        shapes = [_smooth(row) for row in np.atleast_2d(smoothed)]
    return smoothed, np.array(shapes)


def _smooth(x: FloatArray) -> float:
    """Smooth and normalise one row of log weights in place; the shape of its tail."""
    n = len(x)
    n_tail = int(np.ceil(min(n / 5, 3 * n**0.5)))
    x -= np.max(x)
    cutoff = max(np.sort(x)[-n_tail - 1], np.log(np.finfo(float).tiny))
    (tail,) = np.where(x > cutoff)
    shape = np.inf
    if len(tail) >= _SMALLEST_TAIL:
        tail = tail[np.argsort(x[tail])]
        shape, scale = _pareto(np.exp(x[tail]) - np.exp(cutoff))
        if np.isfinite(shape):
            probability = np.arange(0.5, len(tail)) / len(tail)
            x[tail] = np.log(_quantile(probability, shape, scale) + np.exp(cutoff))
            x[x > 0] = 0  # no weight above the largest raw one
    x -= np.log(np.sum(np.exp(x - np.max(x)))) + np.max(x)
    return float(shape)


def _pareto(excess: FloatArray) -> tuple[float, float]:
    """Shape and scale of the generalised Pareto distribution of sorted values above 0.

    The posterior mean of Zhang and Stephens over a grid of b = shape / scale.
    """
    n = len(excess)
    m = 30 + int(n**0.5)
    b = 1 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))
    b /= _PRIOR_SCALE * excess[int(n / 4 + 0.5) - 1]
    b += 1 / excess[-1]
    k = np.log1p(-b[:, None] * excess).mean(axis=1)
    log_likelihood = n * (np.log(-(b / k)) - k - 1)
    weights = 1 / np.exp(log_likelihood - log_likelihood[:, None]).sum(axis=1)
    counts = weights >= 10 * np.finfo(float).eps
    b, weights = b[counts], weights[counts]
    weights /= weights.sum()
    mean_b = np.sum(b * weights)
    shape = np.log1p(-mean_b * excess).mean()
    scale = -shape / mean_b
    shape = (n * shape + _PRIOR_WEIGHTS * _PRIOR_SHAPE) / (n + _PRIOR_WEIGHTS)
    return float(shape), float(scale)


def _quantile(probability: FloatArray, shape: float, scale: float) -> FloatArray:
    """Quantiles of a generalised Pareto distribution; NaN where the scale is not above 0."""
    if scale <= 0:
        return np.full_like(probability, np.nan)
    if abs(shape) < np.finfo(float).eps:
        return -np.log1p(-probability) * scale
    return np.asarray(np.expm1(-shape * np.log1p(-probability)) / shape * scale)
