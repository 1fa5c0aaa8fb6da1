"""A Gaussian of one or two variables inside a box: how much of it lies there, and exact draws.

The probability of the box in two variables is an integral over the first,

    P = int phi(x) [Phi((u_2 - m(x))/w) - Phi((l_2 - m(x))/w)] dx,

with m(x) and w the mean and standard deviation of the second given the first. It is taken by
Gauss-Legendre quadrature in panels about the largest density in the box and about the two places
where the inner probability falls, so that it also holds where the box lies far in a tail or the
two variables are nearly one.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

from gonio.geometry import FloatArray

NODES = 24
LEGENDRE = np.polynomial.legendre.leggauss(NODES)
REACH = 9.0  # standard deviations about the largest density in the box that are integrated over
EDGE = 40.0  # fall of the log-density beyond which nothing is left
AWAY = 8.5  # standard deviations at which a bound no longer matters (1e-17 beyond)
BATCH = 1024
ROUNDS = 30
GRID = 4001  # places of the distribution that is inverted where rejection would not end


def log_probability(
    mean: FloatArray, covariance: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """Log of the probability of a box.

    Parameters
    ----------
    mean : ndarray, shape (B, d)
        d is 0, 1 or 2.
    covariance : ndarray, shape (B, d, d)
    lower, upper : ndarray, shape (d,)

    Returns
    -------
    ndarray, shape (B,)

    Examples
    --------
    >>> mean, covariance = np.zeros((1, 2)), np.array([[[1.0, 0.5], [0.5, 1.0]]])
    >>> quadrant = log_probability(mean, covariance, np.zeros(2), np.full(2, np.inf))
    >>> bool(np.isclose(np.exp(quadrant[0]), 1 / 4 + np.arcsin(0.5) / (2 * np.pi)))
    True
    """
    low, high, rho = _standardised(mean, covariance, lower, upper)
    result = np.zeros(len(mean))
    near = (low > -AWAY) | (high < AWAY)
    for axis in range(mean.shape[1]):
        alone = near[:, axis] & (near.sum(axis=1) == 1)
        result[alone] = _log_between(low[alone, axis], high[alone, axis])
    both = near.sum(axis=1) == 2
    for start in range(0, int(both.sum()), BATCH):
        some = np.flatnonzero(both)[start : start + BATCH]
        nodes, log_weight = _nodes(low[some], high[some], rho[some])
        terms = log_weight + _log_inner(nodes, low[some], high[some], rho[some])
        top = terms.max(axis=1)
        result[some] = top + np.log(np.sum(np.exp(terms - top[:, None]), axis=1))
    return result


def draw(
    mean: FloatArray,
    covariance: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """One draw from each of B Gaussians inside a box, shape (B, d); arguments as above."""
    d = mean.shape[1]
    if d == 0:
        return np.empty_like(mean)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    low, high, rho = _standardised(mean, covariance, lower, upper)
    if d == 1:
        z = _between(low[:, 0], high[:, 0], rng)[:, None]
    else:
        z = _draw_two(low, high, rho, rng)
    return np.asarray(np.clip(mean + sd * z, lower, upper))


def _standardised(
    mean: FloatArray, covariance: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bounds in standard deviations (B, d), and the correlation (B,) of two variables."""
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    rho = np.zeros(len(mean))
    if mean.shape[1] == 2:
        rho = covariance[:, 0, 1] / (sd[:, 0] * sd[:, 1])
        rho = np.clip(rho, -1 + 1e-12, 1 - 1e-12)
    return (lower - mean) / sd, (upper - mean) / sd, rho


def _log_between(low: FloatArray, high: FloatArray) -> FloatArray:
    """log(Phi(high) - Phi(low)), by the tail in which both lie."""
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    log_b, log_a = log_ndtr(b), log_ndtr(a)
    with np.errstate(divide="ignore"):
        far = log_b + np.log(-np.expm1(np.minimum(log_a - log_b, 0.0)))
    return np.asarray(far)


def _between(low: FloatArray, high: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draws of a standard normal between low and high."""
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    u = rng.random(low.shape)
    # Phi(z) = Phi(b) - u (Phi(b) - Phi(a)); far in the lower tail only its logarithm is known.
    log_b = log_ndtr(b)
    part = -u * np.expm1(np.minimum(log_ndtr(a) - log_b, 0))
    direct = ndtri(ndtr(b) - u * (ndtr(b) - ndtr(a)))
    z = np.clip(np.where(b > -4, direct, ndtri_exp(log_b + np.log1p(-part))), a, b)
    return np.asarray(np.where(flip, -z, z))


def _log_inner(x: FloatArray, low: FloatArray, high: FloatArray, rho: FloatArray) -> FloatArray:
    """Log of the probability of the second variable's range where the first is x, (B, nodes)."""
    width = np.sqrt(1 - rho**2)[:, None]
    middle = rho[:, None] * x
    return _log_between((low[:, 1:] - middle) / width, (high[:, 1:] - middle) / width)


def _largest(low: FloatArray, high: FloatArray, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where in the box the density is largest, and its fall along the first variable there."""
    best = np.clip(0.0, low, high)
    inside = np.all((low <= 0) & (high >= 0), axis=1)
    energy = np.where(inside, -1.0, np.inf)
    for axis in range(2):
        other = 1 - axis
        for bound in (low[:, axis], high[:, axis]):
            corner = np.empty_like(low)
            corner[:, axis] = bound
            corner[:, other] = np.clip(rho * bound, low[:, other], high[:, other])
            with np.errstate(invalid="ignore", over="ignore"):
                value = (
                    corner[:, 0] ** 2 - 2 * rho * corner[:, 0] * corner[:, 1] + corner[:, 1] ** 2
                )
                value = np.where(np.isfinite(value), value, np.inf)
            better = value < energy
            best[better] = corner[better]
            energy = np.minimum(energy, value)
    fall = np.abs(best[:, 0] - rho * best[:, 1]) / (1 - rho**2)
    return best[:, 0], np.where(inside, 0.0, fall)


def _nodes(low: FloatArray, high: FloatArray, rho: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values of the first variable (B, nodes), and the log of weight times density there."""
    centre, fall = _largest(low, high, rho)
    width = np.sqrt(1 - rho**2) / np.maximum(np.abs(rho), 1e-9)
    sign = np.where(rho < 0, -1.0, 1.0)
    start = np.maximum(low[:, 0], centre - REACH)
    stop = np.minimum(high[:, 0], centre + REACH)
    breaks = [start, stop]
    # Where x sits on its own bound and falls fast, what counts is near it.
    near = np.minimum(REACH, EDGE / np.maximum(fall, 1e-9))
    breaks += [centre - near, centre, centre + near]
    for bound in (low[:, 1], high[:, 1]):
        turn = bound * sign / np.maximum(np.abs(rho), 1e-9)
        breaks += [turn - 7 * width, turn, turn + 7 * width]
    edges = np.sort(np.clip(np.stack(breaks, axis=1), start[:, None], stop[:, None]), axis=1)
    x, w = LEGENDRE
    half = np.diff(edges, axis=1)[:, :, None] / 2
    nodes = (edges[:, :-1, None] + half) + half * x
    with np.errstate(divide="ignore"):
        log_weight = np.log(half * w) - nodes**2 / 2 - np.log(2 * np.pi) / 2
    shape = (len(low), -1)
    return nodes.reshape(shape), log_weight.reshape(shape)


def _draw_two(
    low: FloatArray, high: FloatArray, rho: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draws of two correlated standard normals in boxes: rejection, then the inverse."""
    z = np.empty_like(low)
    left = np.arange(len(low))
    for k in range(ROUNDS):
        if len(left) == 0:
            return z
        # One variable from its own range; it is kept as often as the other then is in its range.
        # The two take turns as the first: where one order hardly ever succeeds the other may.
        first, second = (0, 1) if k % 2 == 0 else (1, 0)
        a = _between(low[left, first], high[left, first], rng)
        middle, width = rho[left] * a, np.sqrt(1 - rho[left] ** 2)
        b = middle + width * rng.standard_normal(len(left))
        good = (b >= low[left, second]) & (b <= high[left, second])
        z[left[good], first], z[left[good], second] = a[good], b[good]
        left = left[~good]
    for row in left:
        one = slice(row, row + 1)
        z[row] = _inverted(low[one], high[one], rho[one], rng)
    return z


def _inverted(
    low: FloatArray, high: FloatArray, rho: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """One draw by the distribution of the first variable on a fine grid."""
    nodes, log_weight = _nodes(low, high, rho)
    terms = (log_weight + _log_inner(nodes, low, high, rho))[0]
    kept = terms > terms.max() - EDGE
    first, last = nodes[0][kept].min(), nodes[0][kept].max()
    beyond = 0.01 * (last - first)  # nodes stop short of the bounds
    x = np.linspace(max(first - beyond, low[0, 0]), min(last + beyond, high[0, 0]), GRID)
    density = -(x**2) / 2 + _log_inner(x[None, :], low, high, rho)[0]
    density = np.exp(density - density.max())
    mass = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    a = np.interp(rng.random() * mass[-1], mass, x)
    width = np.sqrt(1 - rho[0] ** 2)
    below, above = ((np.array([e[0, 1]]) - rho[0] * a) / width for e in (low, high))
    return np.array([a, rho[0] * a + width * _between(below, above, rng)[0]])
