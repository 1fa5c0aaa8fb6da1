"""Bracketed exposures: counts to photo-electrons a second, masked and merged.

Rate = sum of counts over sum of times, over the exposures that are safely unsaturated. For a
shot-limited signal these are the optimal weights, and they hold no noise, so they do not bias.
An exposure is left out when the eight neighbours predict more than 0.9 of the saturation from the
next shorter one: a pixel's own noisy value must not decide, or bright noise would count less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.metadata import Camera

GUARD = 0.9
SATURATED = 0.98


@dataclass(frozen=True)
class Rate:
    """A linear image: photo-electrons a second with its variance.

    Parameters
    ----------
    value : ndarray, shape (rows, columns)
        e-/s, dark current not yet subtracted.
    time : ndarray
        Total exposure used, s; 0 where every exposure was saturated.
    read_variance : ndarray
        Variance of `value` from read noise and rounding, (e-/s)^2; shot noise adds value/time.
    saturated : ndarray of bool
        No exposure could be used, or one that should not was saturated.
    """

    value: FloatArray
    time: FloatArray
    read_variance: FloatArray
    saturated: NDArray[np.bool_]

    def variance(self, expected: FloatArray) -> FloatArray:
        """Variance of `value` where its expectation is `expected`, (e-/s)^2."""
        safe = np.where(self.time > 0, self.time, 1.0)
        return np.asarray(self.read_variance + np.maximum(expected, 0) / safe)


def merge(bracket: NDArray[np.uint16], exposures_s: tuple[float, ...], camera: Camera) -> Rate:
    """Merge the exposures of one image.

    Parameters
    ----------
    bracket : ndarray of uint16, shape (exposures, rows, columns)
        Raw counts, shortest exposure first.
    exposures_s : tuple of float
        Exposure times, growing.
    camera : Camera
        Gain, black level, noise and limits of the counts.

    Returns
    -------
    Rate

    Notes
    -----
    The rounding of the counts adds 1/12 to their variance.
    """
    well_dn = camera.black_dn + camera.gain_dn_per_e * camera.full_well_e
    top = min(float(camera.saturation_dn), well_dn)
    shape = bracket.shape[1:]
    value, time = np.zeros(shape), np.zeros(shape)
    n_used = np.zeros(shape)
    saturated = np.zeros(shape, dtype=np.bool_)
    _merge(bracket, np.array(exposures_s), camera.black_dn, top, value, time, n_used, saturated)
    safe = np.where(time > 0, time, 1.0)
    noise_e2 = (camera.noise_dn**2 + 1 / 12) / camera.gain_dn_per_e**2
    return Rate(value / camera.gain_dn_per_e / safe, time, n_used * noise_e2 / safe**2, saturated)


def average(rates: list[Rate]) -> Rate:
    """Mean of repeated takes of the same image, each weighted by its exposure time."""
    if len(rates) == 1:
        return rates[0]
    time = sum((r.time for r in rates), np.zeros_like(rates[0].time))
    safe = np.where(time > 0, time, 1.0)
    value = sum((r.value * r.time for r in rates), np.zeros_like(time)) / safe
    noise = sum((r.read_variance * r.time**2 for r in rates), np.zeros_like(time)) / safe**2
    saturated = np.logical_or.reduce([r.saturated for r in rates])
    return Rate(value, time, noise, saturated)


@njit(cache=True, nogil=True)
def _merge(bracket, exposures, black, top, value, time, n_used, saturated):  # type: ignore[no-untyped-def]
    """Sum of counts above black and sum of times over the usable exposures of every pixel."""
    n, rows, columns = bracket.shape
    full = black + SATURATED * (top - black)
    usable = np.empty(columns, np.bool_)
    # Sums over three rows, with an empty column on either side.
    sums = np.zeros(columns + 2, np.int64)
    for i in range(rows):
        a, b = max(i - 1, 0), min(i + 2, rows)
        for j in range(columns):
            usable[j] = True
        for k in range(n):
            if k > 0:
                growth = exposures[k] / exposures[k - 1]
                for j in range(columns):
                    sums[j + 1] = 0
                for row in range(a, b):
                    for j in range(columns):
                        sums[j + 1] += bracket[k - 1, row, j]
            for j in range(columns):
                if not usable[j]:
                    continue
                if k > 0:
                    own = bracket[k - 1, i, j]
                    count = (b - a) * (min(j + 2, columns) - max(j - 1, 0)) - 1
                    total = sums[j] + sums[j + 1] + sums[j + 2] - own
                    neighbours = total / count if count else float(own)
                    # A pixel far brighter than its neighbours is not hidden by their mean.
                    if (neighbours - black) * growth > GUARD * (top - black) or (
                        own - black
                    ) * growth > SATURATED * (top - black):
                        usable[j] = False
                        continue
                if bracket[k, i, j] >= full:
                    # Saturated although not expected, or already in the shortest exposure.
                    saturated[i, j] = True
                    value[i, j] = 0.0
                    time[i, j] = 0.0
                    n_used[i, j] = 0.0
                    usable[j] = False
                    continue
                value[i, j] += bracket[k, i, j] - black
                time[i, j] += exposures[k]
                n_used[i, j] += 1.0
