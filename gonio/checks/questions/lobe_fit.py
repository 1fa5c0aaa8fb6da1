"""How well a lobe about the mirror direction explains samples whose angles are read in some way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray, unit_vectors

WIDTHS = np.geomspace(0.02, 0.8, 12)  # tan of the tilt where a lobe falls to 1/e
MOST = 1500  # samples that are looked at
LEAST = 20
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
    """

    as_written: float
    mirror: float
    azimuth_turned: float
    retro: float
    elevations: float


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
    mirror, retro, growing = _lobes(theta_i, theta_r, delta)
    turned, _, _ = _lobes(theta_i, theta_r, delta + np.pi)
    high, high_retro, _ = _lobes(np.pi / 2 - theta_i, np.pi / 2 - theta_r, delta)
    steep, flat = np.maximum(theta_i, theta_r), np.minimum(theta_i, theta_r)
    shading = np.maximum(np.cos(delta), 0) * np.sin(steep) * np.tan(flat)
    every = [mirror, retro, growing, turned, high, high_retro, [shading]]
    fit = _Fits(root * value, root, [lobe for lobes in every for lobe in lobes])
    if fit.total / len(value) < (VARIATION / 2) ** 2:
        return None
    n = len(WIDTHS)
    m, r, g, t, e, s = (list(range(k * n, (k + 1) * n)) for k in range(6))
    rough = float(np.min(fit.left([(a, b, 6 * n) for a, b in combinations(r, 2)])))
    return LobeFit(
        as_written=fit.of_two(m, r),
        mirror=fit.of_one(m),
        azimuth_turned=fit.of_one(t),
        retro=min(fit.of_one(r), fit.of_one(g), rough),
        elevations=fit.of_two(e, s),
    )


def _lobes(
    theta_i: FloatArray, theta_r: FloatArray, delta: FloatArray
) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
    """Lobes about the mirror direction, and of both kinds about the direction of the light."""
    w_i, w_r = unit_vectors(theta_i, np.zeros_like(theta_i)), unit_vectors(theta_r, delta)
    half = w_i + w_r
    height = np.maximum(half[:, 2], 1e-12)
    tan2 = (half[:, 0] ** 2 + half[:, 1] ** 2) / height**2
    level = 1 / np.sqrt(np.maximum(w_i[:, 2] * w_r[:, 2], 1e-6))
    off = np.arccos(np.clip(np.sum(w_i * w_r, axis=1), -1, 1)) / 2
    mirror = [level * np.exp(-np.minimum(tan2 / w**2, 700)) for w in WIDTHS]
    retro = [np.exp(-np.minimum((off / w) ** 2, 700)) for w in WIDTHS]
    return mirror, retro, [level * lobe for lobe in retro]


class _Fits:
    """Fits of a constant and some lobes, from the sums of products of all of them."""

    def __init__(self, y: FloatArray, root: FloatArray, lobes: Sequence[FloatArray]) -> None:
        columns = np.stack([root, *(root * lobe for lobe in lobes)], axis=1)
        self.products, self.on_y, self.y2 = columns.T @ columns, columns.T @ y, float(y @ y)
        self.scale = np.sqrt(np.maximum(np.diag(self.products), 1e-300))
        self.total = max(float(self._left(np.zeros((1, 1), np.int64))[0]), 1e-300)

    def left(self, lobes: Sequence[Sequence[int]]) -> FloatArray:
        """Share left by each set of lobes; one whose amplitude would be negative is dropped."""
        use = np.asarray(lobes, np.int64) + 1
        level = np.zeros((len(use), 1), np.int64)
        return np.asarray(self._left(np.concatenate([level, use], axis=1)) / self.total)

    def of_one(self, lobes: Sequence[int]) -> float:
        """The least share left by one of the lobes."""
        return float(np.min(self.left([(k,) for k in lobes])))

    def of_two(self, lobes: Sequence[int], others: Sequence[int]) -> float:
        """The share left by one lobe of each list, each the best beside the other's best."""
        first = lobes[int(np.argmin(self.left([(k,) for k in lobes])))]
        second = others[int(np.argmin(self.left([(k,) for k in others])))]
        sets = [*((first, k) for k in others), *((k, second) for k in lobes)]
        return float(np.min(self.left(sets)))

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
