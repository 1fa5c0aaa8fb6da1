"""Adaptive equal-area cells: thin the pixels without moving or blurring the lobe.

The pixels of an image are sorted once along a Morton curve through the equal-area map, so that
every cell of the quadtree is a run of consecutive pixels. A cell is split while its pixels differ
by more than their noise and by more than a few per cent; its value is the mean with weights that
hold no noise of the sample; and it keeps up to 16 members, with the first and second moments of
all its pixels' areas, so that a fit can integrate the model over the cell as the camera did. What
else averages directions, such as the lamp's cone, widens those moments.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.geometry import FloatArray

BASE = 10  # cells across the disc of the equal-area map before any split
DEPTH = 6  # levels of splitting
MAX_SPREAD = 0.05  # of the mean, in a cell of up to 64 pixels: range of a uniform distribution
MAX_CHI2 = 2.0  # per pixel, of a constant
MIN_PIXELS = 4
GROUPS = 4  # groups along each side of a cell with more points than it may keep
MAX_MEMBERS = GROUPS**2


def morton_keys(x: FloatArray, y: FloatArray) -> NDArray[np.int64]:
    """Key of the finest cell of each point of the disc; a prefix of it names the coarser ones.

    Examples
    --------
    >>> int(morton_keys(np.array([-1.0]), np.array([-1.0]))[0])
    0
    """
    fine = BASE << DEPTH
    ix = np.clip(((np.asarray(x) + 1) / 2 * fine).astype(np.int64), 0, fine - 1)
    iy = np.clip(((np.asarray(y) + 1) / 2 * fine).astype(np.int64), 0, fine - 1)
    key = (ix >> DEPTH) * BASE + (iy >> DEPTH)
    for bit in reversed(range(DEPTH)):
        key = (key << 2) | (((ix >> bit) & 1) << 1) | ((iy >> bit) & 1)
    return np.asarray(key)


@njit(cache=True, nogil=True)
def split(keys, guide, variance, weight):  # type: ignore[no-untyped-def]
    """Cells of one image as runs of pixels sorted by key: arrays of first and last-plus-one.

    Pixels of weight 0 are masked: they belong to cells but decide nothing. Cells without a good
    pixel are left out.
    """
    n = keys.shape[0]
    first = np.empty(n, np.int64)
    last = np.empty(n, np.int64)
    cells = 0
    stack = np.empty((4 * (DEPTH + 2), 3), np.int64)
    start = 0
    while start < n:
        stop = start
        base = keys[start] >> (2 * DEPTH)
        while stop < n and keys[stop] >> (2 * DEPTH) == base:
            stop += 1
        stack[0, 0], stack[0, 1], stack[0, 2] = start, stop, 0
        height = 1
        while height > 0:
            height -= 1
            a, b, level = stack[height, 0], stack[height, 1], stack[height, 2]
            good, must = _must_split(guide, variance, weight, a, b)
            if good == 0:
                continue
            if must and level < DEPTH:
                shift = 2 * (DEPTH - level - 1)
                child = a
                while child < b:
                    end = child
                    prefix = keys[child] >> shift
                    while end < b and keys[end] >> shift == prefix:
                        end += 1
                    stack[height, 0], stack[height, 1], stack[height, 2] = child, end, level + 1
                    height += 1
                    child = end
            else:
                first[cells], last[cells] = a, b
                cells += 1
        start = stop
    return first[:cells].copy(), last[:cells].copy()


@njit(cache=True, nogil=True)
def _must_split(guide, variance, weight, a, b):  # type: ignore[no-untyped-def]
    """Number of good pixels of a run, and whether they differ too much for one cell."""
    good = 0
    mean = 0.0
    for k in range(a, b):
        if weight[k] > 0:
            good += 1
            mean += guide[k]
    if good <= MIN_PIXELS:
        return good, False
    mean /= good
    chi2 = 0.0
    square = 0.0
    for k in range(a, b):
        if weight[k] > 0:
            d = guide[k] - mean
            square += d * d
            chi2 += d * d / variance[k]
    spread = math.sqrt(12 * square / good)
    # A lobe's foot in the corner of a large cell hardly spreads it, yet curves too much for 16
    # members: the larger the cell, the flatter it must be.
    limit = MAX_SPREAD * min(1.0, math.sqrt(4 * MAX_MEMBERS / good)) * abs(mean)
    return good, chi2 / good > MAX_CHI2 and spread > limit


@njit(cache=True, nogil=True)
def gather(first, last, weight, columns, vectors, area):  # type: ignore[no-untyped-def]
    """Weighted means of each cell.

    Parameters
    ----------
    columns : ndarray, shape (1 + k, n)
        value, and k terms of its variance, of every pixel.
    vectors : ndarray, shape (n, 3)
        Viewing direction of every pixel.
    area : ndarray, shape (n,)
        Solid angle of every pixel.

    Returns
    -------
    means : ndarray, shape (1 + k, cells)
        sum w v / sum w for the value, sum w^2 v / (sum w)^2 for the variance terms.
    centroid : ndarray, shape (cells, 3)
    solid_angle : ndarray, shape (cells,)
    partial : ndarray of bool, shape (cells,)
    """
    cells = first.shape[0]
    terms = columns.shape[0]
    means = np.zeros((terms, cells))
    centroid = np.zeros((cells, 3))
    solid_angle = np.zeros(cells)
    partial = np.zeros(cells, np.bool_)
    for c in range(cells):
        total = 0.0
        for k in range(first[c], last[c]):
            w = weight[k]
            if w <= 0:
                partial[c] = True
                continue
            total += w
            means[0, c] += w * columns[0, k]
            for j in range(1, terms):
                means[j, c] += w * w * columns[j, k]
            for j in range(3):
                centroid[c, j] += w * vectors[k, j]
            solid_angle[c] += area[k]
        means[0, c] /= total
        for j in range(1, terms):
            means[j, c] /= total * total
        x, y, z = centroid[c, 0], centroid[c, 1], centroid[c, 2]
        norm = math.sqrt(x * x + y * y + z * z)
        for j in range(3):
            centroid[c, j] /= norm
    return means, centroid, solid_angle, partial


@njit(cache=True, nogil=True)
def mean_of(first, last, weight, vectors):  # type: ignore[no-untyped-def]
    """Weighted mean of vectors (n, k) in each cell, shape (cells, k)."""
    n, k = first.shape[0], vectors.shape[1]
    mean = np.zeros((n, k))
    for c in range(n):
        total = 0.0
        for i in range(first[c], last[c]):
            if weight[i] > 0:
                total += weight[i]
                for j in range(k):
                    mean[c, j] += weight[i] * vectors[i, j]
        for j in range(k):
            mean[c, j] /= total
    return mean


@njit(cache=True, nogil=True)
def members(first, last, weight, points, centroid, blur=0.0):  # type: ignore[no-untyped-def]
    """Members of each cell: directions, weights and offsets.

    Every pixel brings its four Gauss points, which integrate over its area. Up to 16 points are
    kept as they are; more are merged into a grid of groups whose centroids are then stretched
    about the cell's mean until their second moments are those of all points. Points on a line
    cannot be stretched; four on a cross take their place.

    Parameters
    ----------
    points : ndarray, shape (n, 4, 3)
        Gauss points of every pixel.
    centroid : ndarray, shape (cells, 3)
    blur : float
        Standard deviation on each axis, radians, of whatever else the camera averages over: its
        square is added to the second moments of every cell.
    """
    cells = first.shape[0]
    w_r = np.empty((cells * MAX_MEMBERS, 3))
    share = np.empty(cells * MAX_MEMBERS)
    offsets = np.zeros(cells + 1, np.int64)
    count = 0
    most = 1
    for c in range(cells):
        most = max(most, last[c] - first[c])
    u = np.empty(4 * most)
    v = np.empty(4 * most)
    g = np.empty(4 * most)
    e1 = np.empty(3)
    e2 = np.empty(3)
    for c in range(cells):
        _tangents(centroid[c, 0], centroid[c, 1], centroid[c, 2], e1, e2)
        n = 0
        total = 0.0
        for k in range(first[c], last[c]):
            if weight[k] > 0:
                total += weight[k]
                for j in range(4):
                    x, y, z = points[k, j, 0], points[k, j, 1], points[k, j, 2]
                    u[n] = x * e1[0] + y * e1[1] + z * e1[2]
                    v[n] = x * e2[0] + y * e2[1] + z * e2[2]
                    g[n] = weight[k] / 4
                    n += 1
        for k in range(n):
            g[k] /= total
        n = _integrate(u, v, g, n, blur)
        for k in range(n):
            rest = math.sqrt(max(1 - u[k] * u[k] - v[k] * v[k], 0.0))
            for j in range(3):
                w_r[count, j] = u[k] * e1[j] + v[k] * e2[j] + rest * centroid[c, j]
            share[count] = g[k]
            count += 1
        offsets[c + 1] = count
    return w_r[:count].copy(), share[:count].copy(), offsets


@njit(cache=True, nogil=True)
def _integrate(u, v, g, n, blur):  # type: ignore[no-untyped-def]
    """Turn n points, four a pixel, into members in place; returns how many.

    Where every pixel keeps its points, those widen about the pixel's own middle: nearer to a
    convolution than a stretch of the whole cell, which moves the pixels apart.
    """
    if n <= MAX_MEMBERS:
        if blur > 0.0:
            for k in range(0, n, 4):
                _widen(u[k : k + 4], v[k : k + 4], g[k : k + 4], blur)
        return n
    wanted = _blurred(_moments(u, v, g, n), blur)
    n = _merge_points(u, v, g, n)
    if not _stretch(u, v, g, n, wanted):
        g[:4] = 0.25
        _cross(u, v, wanted)
        return 4
    return n


@njit(cache=True, nogil=True)
def _widen(u, v, g, blur):  # type: ignore[no-untyped-def]
    """Give a pixel's four points the second moments of the pixel and of a blur."""
    share = g / np.sum(g)
    wanted = _blurred(_moments(u, v, share, 4), blur)
    if not _stretch(u, v, share, 4, wanted):
        _cross(u, v, wanted)


@njit(cache=True, nogil=True)
def _blurred(moments, blur):  # type: ignore[no-untyped-def]
    """Moments (mu, mv, suu, suv, svv) after a blur of this standard deviation on each axis."""
    mu, mv, suu, suv, svv = moments
    return mu, mv, suu + blur * blur, suv, svv + blur * blur


@njit(cache=True, nogil=True)
def _cross(u, v, wanted):  # type: ignore[no-untyped-def]
    """Put four points of equal weight in place that have the moments that are wanted."""
    a11 = math.sqrt(max(wanted[2], 1e-300))
    a21 = wanted[3] / a11
    a22 = math.sqrt(max(wanted[4] - a21 * a21, 0.0))
    reach = math.sqrt(2.0)
    for k in range(4):
        s = reach * (1 - k) * ((k + 1) % 2)  # 1, 0, -1, 0
        t = reach * (2 - k) * (k % 2)  # 0, 1, 0, -1
        u[k] = wanted[0] + a11 * s
        v[k] = wanted[1] + a21 * s + a22 * t


@njit(cache=True, nogil=True)
def _tangents(x, y, z, e1, e2):  # type: ignore[no-untyped-def]
    """Fill e1, e2 with two unit vectors across the unit vector (x, y, z)."""
    if abs(x) < 0.9:
        e1[0], e1[1], e1[2] = 1 - x * x, -x * y, -x * z
    else:
        e1[0], e1[1], e1[2] = -y * x, 1 - y * y, -y * z
    norm = math.sqrt(e1[0] * e1[0] + e1[1] * e1[1] + e1[2] * e1[2])
    for j in range(3):
        e1[j] /= norm
    e2[0] = y * e1[2] - z * e1[1]
    e2[1] = z * e1[0] - x * e1[2]
    e2[2] = x * e1[1] - y * e1[0]


@njit(cache=True, nogil=True)
def _merge_points(u, v, g, n):  # type: ignore[no-untyped-def]
    """Merge n weighted points in place into the centroids of a grid; returns how many."""
    u0, u1, v0, v1 = u[0], u[0], v[0], v[0]
    for k in range(1, n):
        u0, u1 = min(u0, u[k]), max(u1, u[k])
        v0, v1 = min(v0, v[k]), max(v1, v[k])
    u1 += 1e-12
    v1 += 1e-12
    side = GROUPS
    grid = np.zeros((side * side, 3))
    for k in range(n):
        i = min(int((u[k] - u0) / (u1 - u0) * side), side - 1)
        j = min(int((v[k] - v0) / (v1 - v0) * side), side - 1)
        grid[i * side + j, 0] += g[k] * u[k]
        grid[i * side + j, 1] += g[k] * v[k]
        grid[i * side + j, 2] += g[k]
    m = 0
    for k in range(side * side):
        if grid[k, 2] > 0:
            u[m], v[m], g[m] = grid[k, 0] / grid[k, 2], grid[k, 1] / grid[k, 2], grid[k, 2]
            m += 1
    return m


@njit(cache=True, nogil=True)
def _stretch(u, v, g, n, wanted):  # type: ignore[no-untyped-def]
    """Stretch n points in place about their mean until they have the moments that are wanted.

    False, and nothing done, where the points lie on a line or in one place.
    """
    now = _moments(u, v, g, n)
    # Lower Cholesky factors of both covariances; their quotient maps one onto the other.
    a11, b11 = math.sqrt(wanted[2]), math.sqrt(max(now[2], 0.0))
    a21 = wanted[3] / a11
    a22 = math.sqrt(max(wanted[4] - a21 * a21, 0.0))
    if b11 < 1e-9:
        return False
    b21 = now[3] / b11
    b22 = math.sqrt(max(now[4] - b21 * b21, 0.0))
    if b22 < 1e-9:
        return False
    for k in range(n):
        du, dv = u[k] - now[0], v[k] - now[1]
        s = du / b11
        t = (dv - b21 * s) / b22
        u[k] = wanted[0] + a11 * s
        v[k] = wanted[1] + a21 * s + a22 * t
    return True


@njit(cache=True, nogil=True)
def _moments(u, v, g, n):  # type: ignore[no-untyped-def]
    """Means, variances and covariance (mu, mv, suu, suv, svv) of weighted points."""
    mu = mv = 0.0
    for k in range(n):
        mu += g[k] * u[k]
        mv += g[k] * v[k]
    suu = suv = svv = 0.0
    for k in range(n):
        du, dv = u[k] - mu, v[k] - mv
        suu += g[k] * du * du
        suv += g[k] * du * dv
        svv += g[k] * dv * dv
    return mu, mv, suu, suv, svv


@njit(cache=True, nogil=True)
def median(image):  # type: ignore[no-untyped-def]
    """Median of each pixel and its eight neighbours; the edge's pixels count twice at the edge.

    Each column of three is sorted once; the median of nine is the middle one of the largest
    low, the middle middle and the smallest high.
    """
    rows, columns = image.shape
    out = np.empty_like(image)
    low = np.empty(columns + 2)
    mid = np.empty(columns + 2)
    high = np.empty(columns + 2)
    for i in range(rows):
        up, down = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(columns):
            a, b, c = image[up, j], image[i, j], image[down, j]
            low[j + 1] = min(min(a, b), c)
            mid[j + 1] = _middle(a, b, c)
            high[j + 1] = max(max(a, b), c)
        for row in (low, mid, high):
            row[0], row[columns + 1] = row[1], row[columns]
        for j in range(columns):
            out[i, j] = _middle(
                max(max(low[j], low[j + 1]), low[j + 2]),
                _middle(mid[j], mid[j + 1], mid[j + 2]),
                min(min(high[j], high[j + 1]), high[j + 2]),
            )
    return out


@njit(cache=True, nogil=True, inline="always")
def _middle(a, b, c):  # type: ignore[no-untyped-def]
    return max(min(a, b), min(max(a, b), c))
