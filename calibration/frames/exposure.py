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
from numpy.typing import ArrayLike, NDArray

from gonio.geometry import FloatArray
from gonio.metadata import Camera

GUARD = 0.9
SATURATED = 0.98
_PASSES = 12  # of a nonlinearity's inverse, each of which makes its error 50 times smaller


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
        Gain, black level, response, noise and range of the counts.

    Returns
    -------
    Rate

    Notes
    -----
    Counts are made linear before anything else (`response_tables`). Their rounding adds 1/12 to
    their variance.
    """
    well_dn = camera.black_dn + camera.gain_dn_per_e * camera.full_well_e
    top = min(float(camera.saturation_dn), well_dn)
    shape = bracket.shape[1:]
    value, time = np.zeros(shape), np.zeros(shape)
    n_used = np.zeros(shape, dtype=np.int64)
    saturated = np.zeros(shape, dtype=np.bool_)
    times = np.array(exposures_s)
    if camera.gamma == 1 and not camera.nonlinearity_per_decade:
        _merge(bracket, times, camera.black_dn, top, value, time, n_used, saturated)
        value /= camera.gain_dn_per_e
        noise_e2 = n_used * ((camera.noise_dn**2 + 1 / 12) / camera.gain_dn_per_e**2)
    else:
        electrons, variance = response_tables(camera)
        _merge(electrons[bracket], times, 0.0, _electrons(top, camera), value, time, n_used,
               saturated)  # fmt: skip
        # The exposures in use are the shortest n of them.
        summed = np.concatenate([np.zeros((1, *shape)), np.cumsum(variance[bracket], axis=0)])
        noise_e2 = np.take_along_axis(summed, n_used[None], axis=0)[0]
    safe = np.where(time > 0, time, 1.0)
    return Rate(value / safe, time, noise_e2 / safe**2, saturated)


def response_tables(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Electrons of every count from 0 to 65535, and their variance by read noise and rounding.

    Notes
    -----
    counts - black = gain y (1 + n log10(y/Q)) is inverted, with y = Q (e-/Q)^gamma, Q the full well
    and n the nonlinearity per decade, as an odd function so
    that noise about the black level has the mean 0. Read noise and rounding, s in counts, come
    after the response: on its curved inverse e(x) their mean is not 0, and what they add to
    second order, [e(x + s) + e(x - s)]/2 - e(x), is taken off. Their variance is the square of
    [e(x + s) - e(x - s)]/2, a slope that does not vanish at the black level. Within 5 s of it a
    bias of up to 0.15 of the standard deviation is left.

    Examples
    --------
    >>> camera = Camera(rows=1, columns=1, pitch_mm=(0.01, 0.01), gain_dn_per_e=0.025,
    ...                 black_dn=0, saturation_dn=255, full_well_e=10000, noise_dn=0,
    ...                 dark_e_per_s=0, gamma=0.5)
    >>> electrons, _ = response_tables(camera)
    >>> [round(float(e)) for e in electrons[[0, 50, 250]]]
    [0, 400, 10000]
    """
    counts = np.arange(65536.0)
    s = np.sqrt(camera.noise_dn**2 + 1 / 12)
    here, above, below = (_electrons(counts + step, camera) for step in (0.0, s, -s))
    return 2 * here - (above + below) / 2, ((above - below) / 2) ** 2


def _electrons(counts: ArrayLike, camera: Camera) -> FloatArray:
    """Inverse of the response, odd about the black level."""
    bent = (np.asarray(counts, float) - camera.black_dn) / camera.gain_dn_per_e
    x = straightened(bent, camera) / camera.full_well_e
    return np.asarray(camera.full_well_e * np.sign(x) * np.abs(x) ** (1 / camera.gamma))


def straightened(bent: FloatArray, camera: Camera) -> FloatArray:
    """y of y (1 + n log10(y/Q)) = bent, with n the nonlinearity per decade; odd about 0.

    The law ends at one electron, below which the response is in proportion.
    """
    y, n = bent, camera.nonlinearity_per_decade
    for _ in range(_PASSES if n else 0):
        y = bent / (1 + n * np.log10(np.maximum(np.abs(y), 1.0) / camera.full_well_e))
    return y


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
    """Sum of linear counts and sum of times over the usable exposures of every pixel."""
    n, rows, columns = bracket.shape
    full = black + SATURATED * (top - black)
    usable = np.empty(columns, np.bool_)
    # Sums over three rows, with an empty column on either side.
    sums = np.zeros(columns + 2)
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
                    n_used[i, j] = 0
                    usable[j] = False
                    continue
                value[i, j] += bracket[k, i, j] - black
                time[i, j] += exposures[k]
                n_used[i, j] += 1
