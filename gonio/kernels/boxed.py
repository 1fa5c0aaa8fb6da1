"""Small quadratic problems between bounds: the step of a fit, and amplitudes at a starting value.

Imported where a fit runs; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import numpy as np
from numba import njit

UNDETERMINED = 1e-10  # a pivot of the scaled matrix below this counts as no information
HELD = 1e-12  # share of the largest slope by which the slope at an active bound points outwards
ROUNDS = 200  # trials of the sum's multiplier
ROUNDING = 1e-14  # relative distance of the sum from its limit that counts as reached


@njit(nogil=True, cache=True, error_model="numpy")
def constrained_step(h, g, low, high, c, slack, damping):
    """The x that makes g.x - x.(H + damping diag H).x / 2 largest, between the bounds.

    Parameters
    ----------
    h : ndarray, shape (P, P)
        H, positive semi-definite.
    g : ndarray, shape (P,)
    low, high : ndarray, shape (P,)
        Bounds of x, low <= 0 <= high.
    c : ndarray, shape (P,)
        Coefficients of a sum c.x that stays at most `slack`, which is not negative; none where all
        are 0.
    slack, damping : float

    Returns
    -------
    x : ndarray, shape (P,)
        0 for parameters without curvature in H, and one of several solutions where H is singular.
    decrease : float
        2 g.x - x.H.x: the decrease of chi-squared where H is half its second derivative.
    multiplier : float
        Multiplier of the limit on the sum; 0 where the limit is not active.
    """
    n = g.shape[0]
    scale = np.zeros(n)
    for j in range(n):
        scale[j] = 1.0 / np.sqrt(h[j, j]) if h[j, j] > 0.0 else 0.0
    m = np.zeros((n, n))
    lo, up, gs, cs = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    limited = False
    for j in range(n):
        if scale[j] == 0.0:
            continue
        gs[j], cs[j] = g[j] * scale[j], c[j] * scale[j]
        lo[j], up[j] = low[j] / scale[j], high[j] / scale[j]
        limited = limited or cs[j] != 0.0
        for k in range(n):
            m[j, k] = h[j, k] * scale[j] * scale[k]
        m[j, j] = 1.0 + damping
    y = _box(m, gs, lo, up)
    multiplier = 0.0
    excess = _dot(cs, y) - slack
    if limited and excess > 0.0:
        y, multiplier = _with_sum(m, gs, lo, up, cs, slack, excess, y)
    x = np.empty(n)
    for j in range(n):
        x[j] = y[j] * scale[j]
    decrease = 0.0
    for j in range(n):
        inner = 0.0
        for k in range(n):
            inner += h[j, k] * x[k]
        decrease += x[j] * (2.0 * g[j] - inner)
    return x, decrease, multiplier


@njit(nogil=True, cache=True, error_model="numpy")
def next_point(h, g, p, lower, upper, c, damping):
    """End of a Gauss-Newton step from p between the bounds, with c.p at most 1.

    Returns
    -------
    point : ndarray, shape (P,)
        Exactly on the bounds that it meets.
    decrease : float
        Decrease of chi-squared by the undamped step.
    limited : bool
        Whether it is c.p that ends the undamped step.
    """
    n = p.shape[0]
    low, high = np.empty(n), np.empty(n)
    for j in range(n):
        low[j], high[j] = lower[j] - p[j], upper[j] - p[j]
    slack = max(1.0 - _dot(c, p), 0.0)
    x, decrease, multiplier = constrained_step(h, g, low, high, c, slack, 0.0)
    if damping > 0.0:
        x = constrained_step(h, g, low, high, c, slack, damping)[0]
    for j in range(n):
        hair = 1e-15 * (upper[j] - lower[j])
        x[j] += p[j]
        if x[j] <= lower[j] + hair:
            x[j] = lower[j]
        elif x[j] >= upper[j] - hair:
            x[j] = upper[j]
    return x, decrease, multiplier > 0.0


@njit(nogil=True, error_model="numpy")
def _with_sum(m, g, lo, up, c, slack, excess, y):
    """The best y with c.y = slack, from the best without, whose sum exceeds it by `excess`.

    c.y falls with the multiplier of the sum, along a straight line from bound to bound.
    """
    below, at_below = 0.0, excess
    above, at_above = np.inf, 0.0
    middle = 1.0
    reduced = np.empty_like(g)
    for k in range(ROUNDS):
        for j in range(g.shape[0]):
            reduced[j] = g[j] - middle * c[j]
        y = _box(m, reduced, lo, up)
        at = _dot(c, y) - slack
        if abs(at) <= ROUNDING * max(slack, 1.0):
            break
        if at > 0.0:
            below, at_below = middle, at
        else:
            above, at_above = middle, at
        if above == np.inf:
            middle = 4.0 * middle
        else:
            share = 0.5 if k % 3 == 2 else at_below / (at_below - at_above)
            middle = below + share * (above - below)
    return y, middle


@njit(nogil=True, error_model="numpy")
def _box(m, g, lo, up):
    """The best point between the bounds alone: an active set that frees one bound at a time.

    The diagonal of m is 1 + damping, or 0 with all its row where there is no information.
    """
    n = g.shape[0]
    y, r = np.zeros(n), np.empty(n)
    status = np.zeros(n, np.int8)
    largest = 0.0
    for j in range(n):
        largest = max(largest, abs(g[j]))
        if m[j, j] == 0.0:
            status[j] = 2
        elif (lo[j] >= 0.0 and g[j] <= 0.0) or (up[j] <= 0.0 and g[j] >= 0.0):
            status[j] = 1
    for _ in range(10 * n + 10):
        _residual(m, g, y, r)
        d = _solved(m, r, status)
        step, blocking = 1.0, -1
        for j in range(n):
            if status[j] == 0 and d[j] != 0.0:
                room = (up[j] - y[j]) / d[j] if d[j] > 0.0 else (lo[j] - y[j]) / d[j]
                if room < step:
                    step, blocking = max(room, 0.0), j
        for j in range(n):
            if status[j] == 0:
                y[j] = min(max(y[j] + step * d[j], lo[j]), up[j])
        if blocking >= 0:
            y[blocking] = up[blocking] if d[blocking] > 0.0 else lo[blocking]
            status[blocking] = 1
            continue
        _residual(m, g, y, r)
        worst, freed = HELD * largest, -1
        for j in range(n):
            if status[j] == 1 and lo[j] < up[j]:
                inward = r[j] if y[j] <= lo[j] else -r[j]
                if inward > worst:
                    worst, freed = inward, j
        if freed < 0:
            break
        status[freed] = 0
    return y


@njit(nogil=True, error_model="numpy")
def _solved(m, r, status):
    """m d = r for parameters of status 0, by Cholesky; 0 where a pivot has no information."""
    n = r.shape[0]
    factor = np.zeros((n, n))
    d = np.zeros(n)
    for j in range(n):
        if status[j] != 0:
            continue
        pivot = m[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        if pivot <= UNDETERMINED:
            for k in range(j):
                factor[j, k] = 0.0
            continue
        root = np.sqrt(pivot)
        factor[j, j] = root
        total = r[j]
        for k in range(j):
            total -= factor[j, k] * d[k]
        d[j] = total / root
        for i in range(j + 1, n):
            if status[i] == 0:
                inner = m[i, j]
                for k in range(j):
                    inner -= factor[i, k] * factor[j, k]
                factor[i, j] = inner / root
    for back in range(n):
        j = n - 1 - back
        if factor[j, j] == 0.0:
            d[j] = 0.0
            continue
        total = d[j]
        for i in range(j + 1, n):
            total -= factor[i, j] * d[i]
        d[j] = total / factor[j, j]
    return d


@njit(nogil=True, error_model="numpy")
def _residual(m, g, y, out):
    for j in range(g.shape[0]):
        total = g[j]
        for k in range(g.shape[0]):
            total -= m[j, k] * y[k]
        out[j] = total


@njit(nogil=True, error_model="numpy")
def _dot(a, b):
    total = 0.0
    for j in range(a.shape[0]):
        total += a[j] * b[j]
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def solve_amplitudes(grams, points, linear, lower, upper, c, limit):
    """Put the linear parameters of many points at their best between the bounds.

    Parameters
    ----------
    grams : ndarray, shape (B, L + 1, L + 1)
        Weighted products of [residual, df/da_1, ...] at each point.
    points : ndarray, shape (B, P)
        Parameter vectors; the linear ones are changed in place.
    linear : ndarray of int64, shape (L,)
        Which parameters are linear.
    lower, upper, c : ndarray, shape (P,)
        Bounds, and coefficients of a sum that is at most `limit`; none where all are 0.
    limit : float

    Returns
    -------
    ndarray, shape (B,)
        chi-squared at the changed points.
    """
    n = linear.shape[0]
    out = np.empty(grams.shape[0])
    low, high, coefficients = np.empty(n), np.empty(n), np.empty(n)
    h, g = np.empty((n, n)), np.empty(n)
    for b in range(grams.shape[0]):
        slack = limit - _dot(c, points[b])
        for a in range(n):
            j = linear[a]
            low[a], high[a] = lower[j] - points[b, j], upper[j] - points[b, j]
            coefficients[a] = c[j]
            g[a] = grams[b, 0, a + 1]
            for e in range(n):
                h[a, e] = grams[b, a + 1, e + 1]
        x, decrease, _ = constrained_step(h, g, low, high, coefficients, max(slack, 0.0), 0.0)
        out[b] = grams[b, 0, 0] - decrease
        for a in range(n):
            j = linear[a]
            points[b, j] = min(max(points[b, j] + x[a], lower[j]), upper[j])
    return out
