"""How well a lobe about the mirror direction explains samples whose angles are read in some way."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

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
    root = 1 / (np.maximum(value, 0) + np.median(value))
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
    rough = min(fit.left((a, b, 6 * n)) for a, b in combinations(r, 2))
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
        self.total = max(self._left([0]), 1e-300)

    def left(self, lobes: Iterable[int]) -> float:
        """Share left by these lobes; one whose amplitude would be negative is dropped."""
        return self._left([0, *(k + 1 for k in lobes)]) / self.total

    def of_one(self, lobes: Sequence[int]) -> float:
        """The least share left by one of the lobes."""
        return min(self.left([k]) for k in lobes)

    def of_two(self, lobes: Sequence[int], others: Sequence[int]) -> float:
        """The share left by one lobe of each list, each the best beside the other's best."""
        first = min(lobes, key=lambda k: self.left([k]))
        second = min(others, key=lambda k: self.left([k]))
        return min(
            min(self.left([first, k]) for k in others),
            min(self.left([k, second]) for k in lobes),
        )

    def _left(self, use: list[int]) -> float:
        while True:
            sums = self.products[np.ix_(use, use)]
            scale = np.sqrt(np.maximum(np.diag(sums), 1e-300))
            ridge = sums / np.outer(scale, scale) + 1e-12 * np.eye(len(use))
            amplitude = np.linalg.solve(ridge, self.on_y[use] / scale) / scale
            kept = [k for k, a in zip(use, amplitude.tolist(), strict=True) if a >= 0 or k == 0]
            if len(kept) == len(use):
                return max(0.0, self.y2 - float(amplitude @ self.on_y[use]))
            use = kept
