"""Photon and read noise from a counter-based generator: Philox 4x32-10.

Every pixel of every frame has its own random words, so the noise does not depend on the order in
which pixels are visited nor on the number of threads. Pixels are worked on in blocks whose loops
hold no branch and no call, which the compiler turns into vector instructions: words, then normal
numbers by Box and Muller, then Poisson numbers, then counts. Numbers are float32, which is finer
than any count; without contraction of products and sums the result is that of IEEE arithmetic on
every machine.

Poisson numbers of a mean of 64 and more are the inverse of the normal distribution with the
corrections of Giles up to 1/mean, exact to a hundredth of an electron within four standard
deviations. Smaller means are split in two: a multiple of 1/2, whose number is drawn from a table by
Walker's aliases, and a rest below 1/2, whose number is drawn by inversion. The sum of independent
Poisson numbers is one: this is exact to the 32 bits of a word.

References
----------
Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3", Proc. SC 2011.
Giles 2016, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function",
ACM Trans. Math. Softw. 42(1), article 7.
Walker 1977, "An efficient method for generating discrete random variables with general
distributions", ACM Trans. Math. Softw. 3(3), pp. 253-256.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.geometry import FloatArray
from gonio.kernels.threads import map_blocks

BLOCK = 1024  # pixels per block: their numbers stay in the first-level cache
_HALF = BLOCK // 2
_TASK = 32 * BLOCK  # pixels per task of a thread

_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _SHIFT = np.uint64(0xFFFFFFFF), np.uint64(32)
_NORMAL, _SMALL = np.uint64(0), np.uint64(1)  # streams of words: for all pixels, for dim ones

_BRIGHT = 64.0  # mean from which the corrected normal distribution is used
_STEP = 0.5  # of the means in the table
_COLUMNS = 256  # numbers from 0 to 255 in each row of it
_LARGEST = 2e9  # electrons that an integer holds

F = np.float32


@njit(inline="always")
def philox(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]
    """Ten rounds of Philox 4x32 on a counter of four words under a key of two."""
    for _ in range(10):
        p0 = c0 * _M0
        p1 = c2 * _M1
        c0, c1, c2, c3 = (p1 >> _SHIFT) ^ c1 ^ k0, p1 & _LOW, (p0 >> _SHIFT) ^ c3 ^ k1, p0 & _LOW
        k0 = (k0 + _W0) & _LOW
        k1 = (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@njit(error_model="numpy")
def _words(first, frame, stream, key0, key1, a, b):  # type: ignore[no-untyped-def]
    """Two words for each pixel of the block that begins at pixel `first`.

    A counter makes four: two for a pixel of the first half, two for its twin in the second.
    """
    for n in range(_HALF):
        c0, c1, c2, c3 = philox(np.uint64(first // 2 + n), frame, stream, np.uint64(0), key0, key1)
        a[n], b[n] = np.uint32(c0), np.uint32(c1)
        a[n + _HALF], b[n + _HALF] = np.uint32(c2), np.uint32(c3)


@njit(inline="always")
def _unit(word):  # type: ignore[no-untyped-def]
    """A number between 0 and 1 from a word; small ones keep all of their digits."""
    return (F(word) + F(0.5)) * F(2.0**-32)


@njit(error_model="numpy")
def _radii(a, u, exponent, mantissa):  # type: ignore[no-untyped-def]
    """sqrt(-2 ln u) with u from the words `a`, written to `u`; the others are room to work in.

    ln by exponent and mantissa in [0.7, 1.4), and the polynomial of Moshier's Cephes library
    (logf), good to 1e-7.
    """
    bits, mantissa_bits = u.view(np.int32), mantissa.view(np.int32)
    for k in range(BLOCK):
        u[k] = _unit(a[k])
    for k in range(BLOCK):
        n = np.int32(np.int32(bits[k] - np.int32(0x3F330000)) >> np.int32(23))
        exponent[k] = F(n)
        mantissa_bits[k] = np.int32(bits[k] - np.int32(n << np.int32(23)))
    for k in range(BLOCK):
        x = mantissa[k] - F(1)
        z = x * x
        p = F(7.0376836292e-2)
        p = p * x + F(-1.1514610310e-1)
        p = p * x + F(1.1676998740e-1)
        p = p * x + F(-1.2420140846e-1)
        p = p * x + F(1.4249322787e-1)
        p = p * x + F(-1.6668057665e-1)
        p = p * x + F(2.0000714765e-1)
        p = p * x + F(-2.4999993993e-1)
        p = p * x + F(3.3333331174e-1)
        y = p * x * z + exponent[k] * F(-2.12194440e-4) - F(0.5) * z
        ln = x + y + exponent[k] * F(0.693359375)
        u[k] = math.sqrt(F(-2) * (ln if ln < F(0) else F(0)))


@njit(inline="always")
def _sine(q):  # type: ignore[no-untyped-def]
    """sin(2 pi q) for |q| <= 1/4 by its Taylor series, to 1e-7."""
    s = q * q
    r = F(42.058693944897655) + s * F(-15.094642576822984)
    r = F(81.60524927607503) + s * (F(-76.70585975306136) + s * r)
    return q * (F(6.283185307179586) + s * (F(-41.341702240399755) + s * r))


@njit(error_model="numpy")
def _normals(radius, b, g, h):  # type: ignore[no-untyped-def]
    """Two independent normal numbers a pixel: the angle is the words `b` as parts of a turn."""
    for k in range(BLOCK):
        turn = F(np.int32(b[k])) * F(2.0**-32)  # -1/2 to 1/2
        distance = abs(turn)
        g[k] = radius[k] * _sine(F(0.25) - distance)
        h[k] = radius[k] * _sine(math.copysign(F(0.25) - abs(distance - F(0.25)), turn))


@njit(error_model="numpy")
def _bright(mean, g, electrons):  # type: ignore[no-untyped-def]
    """Poisson numbers of large means from normal numbers."""
    for k in range(BLOCK):
        m = mean[k] if mean[k] > F(_BRIGHT) else F(_BRIGHT)
        w = g[k]
        w2 = w * w
        inverse = F(1) / m
        root = math.sqrt(m)
        x = (
            m + root * w + (F(1 / 3) + w2 * F(1 / 6))
            - root * inverse * w * (F(1 / 36) + w2 * F(1 / 72))
            + inverse * (F(-8 / 405) + w2 * (F(7 / 810) + w2 * F(1 / 270)))
        )  # fmt: skip
        x = x if x > F(0) else F(0)
        x = x if x < F(_LARGEST) else F(_LARGEST)
        electrons[k] = F(np.int32(x))


@njit(error_model="numpy")
def _dim(mean, a, b, table, row, rest, number, electrons):  # type: ignore[no-untyped-def]
    """Poisson numbers of small means, which replace the values of these pixels in `electrons`."""
    for k in range(BLOCK):
        m = mean[k] if mean[k] < F(_BRIGHT) else F(0)
        r = np.int32(m * F(1 / _STEP))
        row[k] = np.uint32(r)
        rest[k] = m - F(r) * F(_STEP)
    for k in range(BLOCK):
        # The eight high bits of a word choose the column, the others between it and its alias.
        column = a[k] >> np.uint32(24)
        entry = table[row[k] * np.uint32(_COLUMNS) + column]
        own = (a[k] & np.uint32(0xFFFFFF)) < (entry >> np.uint32(8))
        row[k] = np.uint32(column if own else entry & np.uint32(0xFF))
    for k in range(BLOCK):
        number[k] = F(np.int32(row[k])) + _small_poisson(rest[k], _unit(b[k]))
    for k in range(BLOCK):
        small, large = number[k], electrons[k]
        electrons[k] = small if mean[k] < F(_BRIGHT) else large


@njit(inline="always")
def _small_poisson(mean, u):  # type: ignore[no-untyped-def]
    """A Poisson number of a mean below 1/2: how many of P(N >= 1), P(N >= 2), ... exceed u.

    u is small where the number is large: no digit is lost there. P(N >= 10) is 3e-10.
    """
    m = mean
    # exp(-m), Taylor.
    e = F(1) - m * F(1 / 8)
    e = F(1) - m * F(1 / 7) * e
    e = F(1) - m * F(1 / 6) * e
    e = F(1) - m * F(1 / 5) * e
    e = F(1) - m * F(1 / 4) * e
    e = F(1) - m * F(1 / 3) * e
    e = F(1) - m * F(1 / 2) * e
    p1 = m * (F(1) - m * e)
    p2 = p1 * m * F(1 / 2)
    p3 = p2 * m * F(1 / 3)
    p4 = p3 * m * F(1 / 4)
    p5 = p4 * m * F(1 / 5)
    p6 = p5 * m * F(1 / 6)
    p7 = p6 * m * F(1 / 7)
    p8 = p7 * m * F(1 / 8)
    p9 = p8 * m * F(1 / 9)
    number = F(0)
    tail = p9
    number += F(1) if u < tail else F(0)
    tail += p8
    number += F(1) if u < tail else F(0)
    tail += p7
    number += F(1) if u < tail else F(0)
    tail += p6
    number += F(1) if u < tail else F(0)
    tail += p5
    number += F(1) if u < tail else F(0)
    tail += p4
    number += F(1) if u < tail else F(0)
    tail += p3
    number += F(1) if u < tail else F(0)
    tail += p2
    number += F(1) if u < tail else F(0)
    tail += p1
    number += F(1) if u < tail else F(0)
    return number


@njit(error_model="numpy")
def _digitise(electrons, h, well, gain, gamma, bend, noise, black, top, out):  # type: ignore[no-untyped-def]
    """Full well, response, gain, read noise, black level, ADC: counts of the first pixels."""
    if gamma != 1.0:
        for k in range(out.shape[0]):
            share = min(np.float64(electrons[k]) / well, 1.0)
            electrons[k] = F(well * share**gamma)
    if bend != 0.0:
        for k in range(out.shape[0]):
            kept = np.float64(min(electrons[k], F(well)))
            electrons[k] = F(kept * (1.0 + bend * math.log10(max(kept, 1.0) / well)))
    for k in range(out.shape[0]):
        e = electrons[k] if electrons[k] < F(well) else F(well)
        x = F(gain) * e + F(noise) * h[k] + F(black + 0.5)
        x = x if x > F(0) else F(0)
        x = x if x < F(top) else F(top)
        out[k] = np.uint16(np.int32(x))


@njit(cache=True, nogil=True, error_model="numpy")
def _counts(  # type: ignore[no-untyped-def]
    rate, time, dark, well, gain, gamma, bend, noise, black, top,
    key0, key1, frame, first, table, out,
):  # fmt: skip
    """Counts of consecutive pixels; `first` is a multiple of BLOCK."""
    a, b = np.empty(BLOCK, np.uint32), np.empty(BLOCK, np.uint32)
    u, g, h = np.empty(BLOCK, F), np.empty(BLOCK, F), np.empty(BLOCK, F)
    mean, electrons, row = np.zeros(BLOCK, F), np.empty(BLOCK, F), np.empty(BLOCK, np.uint32)
    for start in range(0, out.shape[0], BLOCK):
        n = min(BLOCK, out.shape[0] - start)
        for k in range(n):
            mean[k] = F(time * (rate[start + k] + dark))
        _words(first + start, frame, _NORMAL, key0, key1, a, b)
        _radii(a, u, g, h)
        _normals(u, b, g, h)
        n_dim = np.int32(0)
        for k in range(BLOCK):
            n_dim = np.int32(n_dim + np.int32(mean[k] < F(_BRIGHT)))
        if n_dim < BLOCK:
            _bright(mean, g, electrons)
        if n_dim > 0:
            _words(first + start, frame, _SMALL, key0, key1, a, b)
            _dim(mean, a, b, table, row, u, g, electrons)
        _digitise(electrons, h, well, gain, gamma, bend, noise, black, top, out[start : start + n])


@cache
def _alias_table() -> NDArray[np.uint32]:
    """Rows of aliases for Poisson numbers of means 0, 1/2, 1, ... below 64, flat.

    An entry holds the 24 bits below which a word keeps the column's own number, and the eight
    bits of the number that it takes else.
    """
    rows = round(_BRIGHT / _STEP)
    numbers = np.arange(_COLUMNS)
    log_factorial = np.array([math.lgamma(n + 1.0) for n in numbers])
    table = np.empty((rows, _COLUMNS), np.uint32)
    for row in range(rows):
        mean = row * _STEP
        p = np.exp(numbers * math.log(mean) - mean - log_factorial) if row else numbers == 0
        share = (p / np.sum(p) * _COLUMNS).tolist()
        alias = numbers.tolist()
        poor = [n for n in numbers.tolist() if share[n] < 1]
        rich = [n for n in numbers.tolist() if share[n] >= 1]
        while poor and rich:
            n, giver = poor.pop(), rich[-1]
            alias[n] = giver
            share[giver] -= 1 - share[n]
            if share[giver] < 1:
                poor.append(rich.pop())
        kept = np.array([int(min(s * 2**24, 2**24 - 1)) for s in share], np.uint32)
        # Entries left over by rounding keep their own number, which is also their alias.
        for n in (*poor, *rich):
            alias[n] = n
        table[row] = (kept << 8) | np.array(alias, np.uint32)
    return table.ravel()


def expose(
    rate: FloatArray,
    time_s: float,
    *,
    dark_e_per_s: float = 0.0,
    full_well_e: float,
    gain_dn_per_e: float,
    noise_dn: float,
    black_dn: float,
    saturation_dn: int,
    seed: int,
    frame: int,
    gamma: float = 1.0,
    nonlinearity_per_decade: float = 0.0,
    threads: int | None = None,
) -> NDArray[np.uint16]:
    """One raw frame.

    Parameters
    ----------
    rate : ndarray, shape (rows, columns)
        Expected electrons a second, PRNU included.
    time_s : float
        Exposure.
    dark_e_per_s : float
        Added to the rate of every pixel.
    full_well_e, gain_dn_per_e, noise_dn, black_dn, saturation_dn
        Properties of the (binned) pixel; the read noise is in counts, after the response.
    seed, frame : int
        Key of the generator (64 bits) and number of the frame (32 bits): one pair, one frame.
    gamma : float
        Response: counts above black are gain full_well (electrons/full_well)^gamma.
    nonlinearity_per_decade : float
        What is left of a nonlinearity: counts above black are further times
        1 + nonlinearity_per_decade log10(electrons/full_well). Below one electron they are in
        proportion.
    threads : int, optional
        Number of threads; the result does not depend on it.

    Returns
    -------
    ndarray of uint16, shape (rows, columns)
    """
    flat = np.ascontiguousarray(rate, dtype=float).ravel()
    out = np.empty(flat.size, np.uint16)
    key0, key1 = np.uint64(seed & 0xFFFFFFFF), np.uint64((seed >> 32) & 0xFFFFFFFF)
    table = _alias_table()

    def work(start: int, stop: int) -> None:
        _counts(
            flat[start:stop], float(time_s), float(dark_e_per_s), float(full_well_e),
            float(gain_dn_per_e), float(gamma), float(nonlinearity_per_decade), float(noise_dn),
            float(black_dn), float(saturation_dn), key0, key1, np.uint64(frame), start, table,
            out[start:stop],
        )  # fmt: skip

    map_blocks(work, flat.size, threads=threads, block=_TASK)
    return out.reshape(rate.shape)
