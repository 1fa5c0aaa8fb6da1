"""How well a lobe about the mirror direction explains samples whose angles are read in some way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray

WIDTHS = np.geomspace(0.02, 0.8, 12)  # tan of the tilt where a lobe falls to 1/e
MOST = 1500  # samples that are looked at
LEAST = 20
LEAST_LOG = -300.0  # of a lobe: squares of the smallest are still normal numbers
VARIATION = 0.1  # relative scatter of the values below which there is no lobe


@dataclass(frozen=True)
class LobeFit:
    """Share of the variation of the values that lobes leave unexplained.

    Each fit has a diffuse level beside its lobes.

    Parameters
    ----------
    as_written : float
        A lobe about the mirror direction and one about the direction of the light.
    mirror : float
        A lobe about the mirror direction.
    azimuth_turned : float
        The same with phi_r turned by 180 deg.
    retro : float
        What a surface may do about the direction of the light: one lobe of constant height, one
        that grows as a mirror lobe does, or two beside the shading of a rough surface.
    elevations : float
        As `as_written`, with 90 deg - theta in place of theta.
    elevation_i, elevation_r : float
        A lobe about the mirror direction with 90 deg - theta_i in place of theta_i, and with
        90 deg - theta_r in place of theta_r.
    """

    as_written: float
    mirror: float
    azimuth_turned: float
    retro: float
    elevations: float
    elevation_i: float
    elevation_r: float


def lobe_fit(
    theta_i: FloatArray, theta_r: FloatArray, delta: FloatArray, value: FloatArray
) -> LobeFit | None:
    """The shares, or None where the values hardly vary or are too few.

    Parameters
    ----------
    theta_i, theta_r, delta : ndarray, shape (N,)
        Polar angles and phi_r - phi_i, radians.
    value : ndarray, shape (N,)

    Notes
    -----
    Each lobe is exp(-tan^2(tilt)/w^2)/sqrt(cos theta_i cos theta_r) with the best of several
    widths, fitted with weights 1/(f + median f)^2 and amplitudes that are not negative.
    """
    usable = (np.maximum(theta_i, theta_r) < 1.53) & (np.minimum(theta_i, theta_r) > 0.04)
    keep = np.flatnonzero(usable)
    keep = keep[:: max(1, -(-len(keep) // MOST))]
    value, theta_i, theta_r, delta = (a[keep] for a in (value, theta_i, theta_r, delta))
    if len(value) < LEAST or np.median(value) <= 0:
        return None
    value = value / np.median(value)  # any unit, without overflow
    root = 1 / (np.maximum(value, 0) + 1)
    tilt, off, level = _tilts(theta_i, theta_r, delta)
    tilt_turned, _, _ = _tilts(theta_i, theta_r, delta + np.pi)
    tilt_high, off_high, level_high = _tilts(np.pi / 2 - theta_i, np.pi / 2 - theta_r, delta)
    tilt_i, _, level_i = _tilts(np.pi / 2 - theta_i, theta_r, delta)
    tilt_r, _, level_r = _tilts(theta_i, np.pi / 2 - theta_r, delta)
    steep, flat = np.maximum(theta_i, theta_r), np.minimum(theta_i, theta_r)
    shading = np.maximum(np.cos(delta), 0) * np.sin(steep) * np.tan(flat)
    n = len(WIDTHS)
    rows = np.empty((8 * n + 2, len(value)))
    rows[0], rows[-1] = root, root * shading
    one = np.ones(len(value))
    kinds = [(tilt, level), (off, one), (off, level), (tilt_turned, level),
             (tilt_high, level_high), (off_high, one),
             (tilt_i, level_i), (tilt_r, level_r)]  # fmt: skip
    for k, (square, factor) in enumerate(kinds):
        _lobes(square, root * factor, rows[1 + k * n : 1 + (k + 1) * n])
    fit = _Fits(root * value, rows)
    if fit.total / len(value) < (VARIATION / 2) ** 2:
        return None
    alone = fit.left([[k] for k in range(8 * n)])
    m, r, g, t, e, s, of_i, of_r = (alone[k * n : (k + 1) * n] for k in range(8))
    best_m, best_r, best_e, best_s = (int(np.argmin(x)) for x in (m, r, e, s))
    # One lobe of each kind, each the best beside the other's best.
    two = [*((best_m, n + k) for k in range(n)), *((k, n + best_r) for k in range(n))]
    two += [*((4 * n + best_e, 5 * n + k) for k in range(n)),
            *((4 * n + k, 5 * n + best_s) for k in range(n))]  # fmt: skip
    as_written, elevations = fit.left(two).reshape(2, -1).min(axis=1)
    rough = fit.left([(n + a, n + b, 8 * n) for a, b in combinations(range(n), 2)]).min()
    return LobeFit(
        as_written=float(as_written),
        mirror=float(m.min()),
        azimuth_turned=float(t.min()),
        retro=float(min(r.min(), g.min(), rough)),
        elevations=float(elevations),
        elevation_i=float(of_i.min()),
        elevation_r=float(of_r.min()),
    )


def _tilts(
    theta_i: FloatArray, theta_r: FloatArray, delta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Squares of tan(tilt) of the half vector and of half the angle from the light.

    The third array is 1/sqrt(cos theta_i cos theta_r).
    """
    sine_i, cosine_i = np.sin(theta_i), np.cos(theta_i)
    sine_r, cosine_r = np.sin(theta_r), np.cos(theta_r)
    cosine = np.cos(delta)
    across = sine_r * np.sin(delta)
    height = np.maximum(cosine_i + cosine_r, 1e-12)
    tan2 = ((sine_i + sine_r * cosine) ** 2 + across**2) / height**2
    level = 1 / np.sqrt(np.maximum(cosine_i * cosine_r, 1e-6))
    off = np.arccos(np.clip(sine_i * sine_r * cosine + cosine_i * cosine_r, -1, 1)) / 2
    return tan2, off**2, level


def _lobes(square: FloatArray, factor: FloatArray, out: FloatArray) -> None:
    """Lobes of all widths over the squares of an angle, times a factor, into (widths, N)."""
    np.multiply(square, -1 / WIDTHS[:, None] ** 2, out=out)
    np.maximum(out, LEAST_LOG, out=out)
    np.exp(out, out=out)
    out *= factor


class _Fits:
    """Fits of a constant, the first of some rows (K, N), and others, from their products."""

    def __init__(self, y: FloatArray, rows: FloatArray) -> None:
        self.products, self.on_y, self.y2 = rows @ rows.T, rows @ y, float(y @ y)
        self.scale = np.sqrt(np.maximum(np.diag(self.products), 1e-300))
        self.total = max(float(self._left(np.zeros((1, 1), np.int64))[0]), 1e-300)

    def left(self, lobes: Sequence[Sequence[int]]) -> FloatArray:
        """Share left by each set of lobes; one whose amplitude would be negative is dropped."""
        use = np.asarray(lobes, np.int64) + 1
        level = np.zeros((len(use), 1), np.int64)
        return np.asarray(self._left(np.concatenate([level, use], axis=1)) / self.total)

    def _left(self, use: NDArray[np.int64]) -> FloatArray:
        """Sum of squares left by each set of columns (M, K), of which the first is kept."""
        scale, on_y = self.scale[use], self.on_y[use]
        sums = self.products[use[:, :, None], use[:, None, :]]
        ridge = sums / (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(use.shape[1])
        kept = np.ones(use.shape, bool)
        while True:
            # Columns that are dropped have the row of a unit matrix and nothing to explain.
            among = kept[:, :, None] & kept[:, None, :]
            system = np.where(among, ridge, np.eye(use.shape[1]))
            wanted = np.where(kept, on_y / scale, 0.0)
            amplitude = np.linalg.solve(system, wanted[:, :, None])[:, :, 0] / scale
            negative = kept & (amplitude < 0)
            negative[:, 0] = False
            if not negative.any():
                return np.asarray(np.maximum(0.0, self.y2 - np.sum(amplitude * on_y, axis=1)))
            kept &= ~negative
