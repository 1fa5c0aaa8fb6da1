"""Photon and read noise from a counter-based generator: Philox 4x32-10.

Every pixel of every frame has its own counter, so the noise does not depend on the order in which
pixels are visited nor on the number of threads. Salmon et al., "Parallel random numbers: as easy
as 1, 2, 3" (SC 2011). Poisson numbers: inversion by sequential search below a mean of 30, above it
the inverse of the normal distribution with the corrections of Giles, "Algorithm 955" (ACM TOMS
2016), which is exact to a few hundredths of an electron there.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.kernels.threads import map_blocks

_M0 = np.uint64(0xD2511F53)
_M1 = np.uint64(0xCD9E8D57)
_W0 = np.uint32(0x9E3779B9)
_W1 = np.uint32(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
_SMALL_MEAN = 30.0
_TO_UNIT = 2.0**-32


@njit(cache=True, nogil=True, inline="always")
def philox(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]
    """Ten rounds of Philox 4x32 on a counter of four words under a key of two."""
    for _ in range(10):
        p0 = np.uint64(c0) * _M0
        p1 = np.uint64(c2) * _M1
        h0, l0 = np.uint32(p0 >> _SHIFT), np.uint32(p0 & _LOW)
        h1, l1 = np.uint32(p1 >> _SHIFT), np.uint32(p1 & _LOW)
        c0, c1, c2, c3 = (
            np.uint32(h1 ^ c1 ^ k0),
            l1,
            np.uint32(h0 ^ c3 ^ k1),
            l0,
        )
        k0 = np.uint32(k0 + _W0)
        k1 = np.uint32(k1 + _W1)
    return c0, c1, c2, c3


@njit(cache=True, nogil=True, inline="always")
def poisson(mean, uniform, normal):  # type: ignore[no-untyped-def]
    """A Poisson number from one uniform (small means) or one normal number (large means)."""
    if mean < _SMALL_MEAN:
        term = math.exp(-mean)
        total = term
        n = 0.0
        while uniform > total and n < 200.0:
            n += 1.0
            term *= mean / n
            total += term
        return n
    root = math.sqrt(mean)
    w2 = normal * normal
    x = mean + root * normal + (1 / 3 + w2 / 6) - normal * (1 / 36 + w2 / 72) / root
    return max(math.floor(x), 0.0)


@njit(cache=True, nogil=True)
def _counts(rate, time, dark, well, gain, noise, black, top, key0, key1, frame, first, out):  # type: ignore[no-untyped-def]
    """Counts of consecutive pixels: shot noise, full well, read noise, gain, black level, ADC."""
    for k in range(out.shape[0]):
        a, b, c, _ = philox(
            np.uint32(first + k), np.uint32(frame), np.uint32(0), np.uint32(0), key0, key1
        )
        u = (np.float64(a) + 0.5) * _TO_UNIT
        radius = math.sqrt(-2 * math.log(u))
        angle = 2 * math.pi * (np.float64(b) + 0.5) * _TO_UNIT
        electrons = poisson(
            time * (rate[k] + dark), (np.float64(c) + 0.5) * _TO_UNIT, radius * math.cos(angle)
        )
        electrons = min(electrons, well)
        counts = math.floor(gain * electrons + noise * radius * math.sin(angle) + black + 0.5)
        out[k] = np.uint16(min(max(counts, 0.0), top))


def expose(
    rate: FloatArray,
    time_s: float,
    *,
    dark_e_per_s: float,
    full_well_e: float,
    gain_dn_per_e: float,
    noise_dn: float,
    black_dn: float,
    saturation_dn: int,
    seed: int,
    frame: int,
    threads: int | None = None,
) -> NDArray[np.uint16]:
    """One raw frame.

    Parameters
    ----------
    rate : ndarray, shape (rows, columns)
        Expected photo-electrons a second, PRNU included.
    time_s : float
        Exposure.
    dark_e_per_s, full_well_e, gain_dn_per_e, noise_dn, black_dn, saturation_dn
        Figures of the (binned) pixel; the read noise is in counts.
    seed, frame : int
        Key of the generator (64 bits) and number of the frame (32 bits): one pair, one frame.
    threads : int, optional
        Number of threads; the result does not depend on it.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
    """
    flat = np.ascontiguousarray(rate, dtype=float).ravel()
    out = np.empty(flat.size, np.uint16)
    key0, key1 = np.uint32(seed & 0xFFFFFFFF), np.uint32((seed >> 32) & 0xFFFFFFFF)

    def work(start: int, stop: int) -> None:
        _counts(
            flat[start:stop], time_s, dark_e_per_s, full_well_e, gain_dn_per_e, noise_dn,
            black_dn, float(saturation_dn), key0, key1, frame, start, out[start:stop],
        )  # fmt: skip

    map_blocks(work, flat.size, threads=threads, block=1 << 15)
    return out.reshape(rate.shape)
