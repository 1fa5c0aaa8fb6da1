"""The compiled sum of plane waves behind the dome's slope errors and coating.

Every ray of every pixel needs 64 waves on two axes, some 3e8 cosines for one instrument: they are
summed wave by wave over runs of points, which the compiler turns into vector instructions.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

RUN = 512  # points whose coordinates and sums stay in the processor's first cache

# sin(2 pi q) = q (S[0] + S[1] q^2 + ...), the Taylor series: to 1e-9 for a quarter of a turn.
_S = tuple((-1) ** n * (2 * math.pi) ** (2 * n + 1) / math.factorial(2 * n + 1) for n in range(7))
_S0, _S1, _S2, _S3, _S4, _S5, _S6 = _S


@njit(inline="always", fastmath={"contract"})
def cosine(turns):  # type: ignore[no-untyped-def]
    """cos(2 pi turns) to 1e-9."""
    t = turns - math.floor(turns + 0.5)
    q = 0.25 - abs(t)
    s = q * q
    return q * (_S0 + s * (_S1 + s * (_S2 + s * (_S3 + s * (_S4 + s * (_S5 + s * _S6))))))


@njit(cache=True, nogil=True, fastmath={"contract"})
def sum_of_waves(point, k, phase, out):  # type: ignore[no-untyped-def]
    """out[n, axis] = sum over waves of cos(2 pi (k . point[n] + phase[axis])).

    Wave numbers `k` (waves, 3) and phases (2, waves) are in turns.
    """
    x, y, z, a, b = np.empty((5, RUN))
    for start in range(0, point.shape[0], RUN):
        n = min(RUN, point.shape[0] - start)
        for j in range(n):
            x[j], y[j], z[j] = point[start + j, 0], point[start + j, 1], point[start + j, 2]
            a[j], b[j] = 0.0, 0.0
        for wave in range(k.shape[0]):
            kx, ky, kz = k[wave, 0], k[wave, 1], k[wave, 2]
            pa, pb = phase[0, wave], phase[1, wave]
            for j in range(n):
                turns = kx * x[j] + ky * y[j] + kz * z[j]
                a[j] += cosine(turns + pa)
                b[j] += cosine(turns + pb)
        for j in range(n):
            out[start + j, 0], out[start + j, 1] = a[j], b[j]
