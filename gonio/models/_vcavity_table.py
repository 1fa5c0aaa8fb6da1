"""A table of the shares d1 and d2 of `_vcavity.gaussian`, for fits that ask for them often.

Four axes: the steeper of the two polar angles (alpha), the ratio to the other (beta), the
difference of azimuth, and sigma. The surface has a kink where theta_i = theta_r and dphi = 0, and
no smooth interpolant may run across it. As beta <= alpha the kink lies in a corner of the table,
and square roots as coordinates crowd the nodes there:

    x = A(alpha)                   A(theta) = tan(theta)/(2 + tan(theta))
    y = sqrt(1 - A(beta)/A(alpha))
    z = r/(1 + r)                  r^2 = tan(|dphi|/2)

which also serves the milder kink of d2 at theta_i = theta_r, dphi = pi. Along these the nodes are
even and Lagrange's cubic runs through the four nearest. Along sigma they are Chebyshev's in
asinh(sigma/0.1), summed up once for each sigma. What lies outside of the table, polar angles beyond
85 deg and sigma below 0.5 deg, is integrated.
"""

from __future__ import annotations

import hashlib
import logging
import math
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.cache import folder as cache_folder
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks
from gonio.kernels.scalar import compiled
from gonio.models import _vcavity, torrance_sparrow
from gonio.models._vcavity import _SLOPE, _pair, _ring, gaussian
from gonio.models.torrance_sparrow import slope_norm

STEPS = 40
SIGMAS = 24
SIGMA_RANGE = (math.radians(0.5), math.radians(60))
_BEND = 0.1
THETA_MAX = math.radians(85)
_TOP = math.tan(THETA_MAX) / (2 + math.tan(THETA_MAX))
# sigma from 0.5 to 60 deg on one set of slopes: the range is cut where narrow lobes end.
_CUTS = (0.03, 0.09, 0.27, 0.8, 0.5 * math.pi)

log = logging.getLogger(__name__)


class Table:
    """The model `oren_nayar_numeric` by interpolation.

    Parameters
    ----------
    values : ndarray, shape (SIGMAS, 2 STEPS^3)
        d1 and d2 at the nodes.
    """

    def __init__(self, values: NDArray[np.float32]) -> None:
        self.values = values
        self._last: tuple[float, NDArray[np.float32]] | None = None

    def shares(
        self, w_i: FloatArray, w_r: FloatArray, sigma: float, *, derivative: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """d1 and d2, or their derivatives by sigma.

        Parameters
        ----------
        w_i, w_r : ndarray, shape (..., 3)
            Unit vectors towards the light and towards the viewer.
        sigma : float
            Spread of the facets' slope angle in [0, 60 deg], radians.
        derivative : bool
            Whether to give d(d1)/dsigma and d(d2)/dsigma instead.
        """
        w_i, w_r = np.broadcast_arrays(np.asarray(w_i, float), np.asarray(w_r, float))
        a, b = (np.ascontiguousarray(w.reshape(-1, 3)) for w in (w_i, w_r))
        out = np.empty((len(a), 2))
        inside = SIGMA_RANGE[0] <= sigma <= SIGMA_RANGE[1] * (1 + 1e-12)
        empty = np.empty((0, 2), np.float32)
        slab = self.slabs(float(sigma))[int(derivative)] if inside else empty
        work = self.look_up_loop()
        map_blocks(
            lambda s, e: work(a[s:e], b[s:e], slab, sigma, 2 * int(derivative), out[s:e]), len(a)
        )
        shape = w_i.shape[:-1]
        return out[:, 0].reshape(shape), out[:, 1].reshape(shape)

    def evaluate(self, w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> FloatArray:
        """f in sr^-1 for (rho, sigma), as the model's own `evaluate`."""
        rho = float(p[0])
        d1, d2 = self.shares(w_i, w_r, float(p[1]))
        return rho / np.pi * (d1 + rho * d2)

    def gradient(
        self, w_i: FloatArray, w_r: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """f and its derivatives by rho and sigma (..., 2), as the model's own `gradient`."""
        rho, sigma = float(p[0]), float(p[1])
        d1, d2 = self.shares(w_i, w_r, sigma)
        s1, s2 = self.shares(w_i, w_r, sigma, derivative=True)
        slopes = np.stack([d1 + 2 * rho * d2, rho * (s1 + rho * s2)], -1) / np.pi
        return rho / np.pi * (d1 + rho * d2), slopes

    def slabs(self, sigma: float) -> NDArray[np.float32]:
        """d1 and d2 at one sigma, then their derivatives, shape (2, STEPS^3, 2).

        Those of the last sigma that was asked for are kept.
        """
        if self._last is None or self._last[0] != sigma:
            weights = _sigma_weights(sigma).astype(np.float32)
            self._last = (sigma, (weights @ self.values).reshape(2, -1, 2))
        return self._last[1]

    @staticmethod
    def look_up_loop() -> Callable[..., Any]:
        """The compiled loop over pairs of directions, see `_look_up`."""
        return _loop(_look_up)


@cache
def table() -> Table:
    """The table of this machine's cache folder, computed if it is not there."""
    sources = [_vcavity.__file__, torrance_sparrow.__file__, __file__]
    digest = hashlib.sha256(b"".join(Path(source).read_bytes() for source in sources)).hexdigest()
    path = cache_folder() / f"oren_nayar_numeric_{digest[:16]}.npy"
    try:
        return Table(np.load(path))
    except (OSError, ValueError, EOFError):
        log.warning("computing the table of oren_nayar_numeric once, into %s", path)
    values = _build()
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
        np.save(file, values)
    Path(file.name).replace(path)
    return Table(values)


def _sigma_nodes() -> FloatArray:
    """Chebyshev's nodes of the first kind in asinh(sigma/0.1)."""
    low, high = np.arcsinh(np.divide(SIGMA_RANGE, _BEND))
    s = np.polynomial.chebyshev.chebpts1(SIGMAS)
    nodes: FloatArray = _BEND * np.sinh(low + (high - low) * (s + 1) / 2)
    return nodes


def _sigma_weights(sigma: float) -> FloatArray:
    """Weights (2, SIGMAS) of the nodes for the value at sigma and for the derivative by sigma."""
    low, high = np.arcsinh(np.divide(SIGMA_RANGE, _BEND))
    s = 2 * (math.asinh(sigma / _BEND) - low) / (high - low) - 1
    ds = 2 / ((high - low) * math.hypot(sigma, _BEND))
    chebyshev = np.polynomial.chebyshev
    basis = np.eye(SIGMAS)
    value = chebyshev.chebval(s, basis)
    slope = chebyshev.chebval(s, chebyshev.chebder(basis)) * ds
    at_nodes = chebyshev.chebvander(chebyshev.chebpts1(SIGMAS), SIGMAS - 1)
    weights: FloatArray = np.stack([value, slope]) @ np.linalg.inv(at_nodes)
    return weights


def _build() -> NDArray[np.float32]:
    """d1 and d2 at all nodes, shape (SIGMAS, 2 STEPS^3)."""
    sigmas = _sigma_nodes()
    norms = np.array([slope_norm(float(sigma))[0] for sigma in sigmas])
    out = np.empty((SIGMAS, STEPS**3, 2), np.float32)
    work = _loop(_fill)
    map_blocks(lambda s, e: work(s, sigmas, norms, out[:, s:e]), STEPS**3, block=1024)
    return out.reshape(SIGMAS, -1)


@cache
def _loop(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` compiled so that several threads may run it."""
    from numba import njit

    twin: Any = compiled(function)
    # Fused multiply-adds: a fifth more look-ups a second.
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
    result: Callable[..., Any] = njit(**options)(twin.py_func)
    return result


def _fill(first: int, sigmas: FloatArray, norms: FloatArray, out: NDArray[np.float32]) -> None:
    """Integrals for nodes `first` and following, all sigmas in one pass over the slopes."""
    scratch = [0.0] * 11
    edges = [0.0] * 9
    total = np.empty((len(sigmas), 2))
    for node in range(out.shape[1]):
        rest, k = divmod(first + node, STEPS)
        i, j = divmod(rest, STEPS)
        a = _TOP * i / (STEPS - 1)
        y = j / (STEPS - 1)
        z = k / (STEPS - 1)
        b = a * (1 - y * y)
        tan_i = 2 * a / (1 - a)
        tan_r = 2 * b / (1 - b)
        dphi = 2 * math.atan2(z * z, (1 - z) * (1 - z))
        zi = 1 / math.sqrt(1 + tan_i * tan_i)
        zr = 1 / math.sqrt(1 + tan_r * tan_r)
        sin_r = tan_r * zr
        pair = _pair(tan_i * zi, 0.0, zi, sin_r * math.cos(dphi), sin_r * math.sin(dphi), zr)
        n = 0
        for cut in _CUTS:
            edges[n] = cut
            n += 1
        edges[n] = math.atan2(1.0, pair[0])
        edges[n + 1] = math.atan2(1.0, pair[1])
        edges[n + 2] = math.atan2(1.0, pair[6])
        edges[n + 3] = math.atan2(1.0, pair[8])
        edges.sort()
        total[:, :] = 0.0
        start = 0.0
        for stop in edges:
            if stop <= start:
                continue
            for u, weight in _SLOPE:
                t = start + (stop - start) * u * u
                g1, g2 = _ring(pair, math.cos(t), math.sin(t), scratch)
                share = 2 * weight * u * (stop - start) * math.sin(t)
                for m in range(len(sigmas)):
                    q = 0.5 * (t / sigmas[m]) * (t / sigmas[m])
                    if q < 40:
                        g = share * math.exp(-q)
                        total[m, 0] += g * g1
                        total[m, 1] += g * g2
            start = stop
        for m in range(len(sigmas)):
            out[m, node, 0] = total[m, 0] / norms[m]
            out[m, node, 1] = total[m, 1] / norms[m]


def _cubic(u: float) -> tuple[int, tuple[float, float, float, float]]:
    """First of four nodes around u, in steps, and Lagrange's weights of the four."""
    first = min(max(int(u) - 1, 0), STEPS - 4)
    s = u - first
    return first, (
        (1 - s) * (s - 2) * (s - 3) / 6,
        s * (s - 2) * (s - 3) / 2,
        s * (s - 1) * (3 - s) / 2,
        s * (s - 1) * (s - 2) / 6,
    )


def _look_up(
    w_i: FloatArray,
    w_r: FloatArray,
    slab: NDArray[np.float32],
    sigma: float,
    column: int,
    out: FloatArray,
) -> None:
    """Two columns for n pairs, from the table where they lie in it; `column` of `gaussian` else."""
    for n in range(out.shape[0]):
        xi, yi, zi = w_i[n, 0], w_i[n, 1], w_i[n, 2]
        xr, yr, zr = w_r[n, 0], w_r[n, 1], w_r[n, 2]
        out[n, 0] = 0.0
        out[n, 1] = 0.0
        if zi <= 0 or zr <= 0:
            continue
        sin_i = math.sqrt(xi * xi + yi * yi)
        sin_r = math.sqrt(xr * xr + yr * yr)
        # tan/(2 + tan) without a division by a small cosine.
        a = sin_i / (2 * zi + sin_i)
        b = sin_r / (2 * zr + sin_r)
        if a < b:
            a, b = b, a
        if a > _TOP or len(slab) == 0:
            four = gaussian(xi, yi, zi, xr, yr, zr, sigma)
            if column == 0:
                out[n, 0], out[n, 1] = four[0], four[1]
            else:
                out[n, 0], out[n, 1] = four[2], four[3]
            continue
        y = math.sqrt(1 - b / a) if a > 0 else 0.0
        z = 0.0
        if b > 0:
            # The fourth roots of sin^2(dphi/2) and cos^2(dphi/2), times a factor.
            cos_dphi = (xi * xr + yi * yr) / (sin_i * sin_r)
            retro = math.sqrt(math.sqrt(max(1 - cos_dphi, 0.0)))
            forward = math.sqrt(math.sqrt(max(1 + cos_dphi, 0.0)))
            z = retro / (retro + forward)
        i, along_a = _cubic(a / _TOP * (STEPS - 1))
        j, along_y = _cubic(y * (STEPS - 1))
        k, (z0, z1, z2, z3) = _cubic(z * (STEPS - 1))
        p0 = p1 = p2 = p3 = q0 = q1 = q2 = q3 = 0.0
        for di in range(4):
            for dj in range(4):
                w = along_a[di] * along_y[dj]
                at = ((i + di) * STEPS + j + dj) * STEPS + k
                p0 += w * slab[at, 0]
                q0 += w * slab[at, 1]
                p1 += w * slab[at + 1, 0]
                q1 += w * slab[at + 1, 1]
                p2 += w * slab[at + 2, 0]
                q2 += w * slab[at + 2, 1]
                p3 += w * slab[at + 3, 0]
                q3 += w * slab[at + 3, 1]
        out[n, 0] = z0 * p0 + z1 * p1 + z2 * p2 + z3 * p3
        out[n, 1] = z0 * q0 + z1 * q1 + z2 * q2 + z3 * q3
