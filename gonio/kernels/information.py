"""Sums over samples that each depend on a few of many unknowns: gradient and information.

Imported only where many unknowns are solved for; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from numba import njit


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def add_information(index, column, residual, start, stop, gradient, information):
    """Add columns^T residual to `gradient` (U,) and columns^T columns to `information` (U, U).

    Sample n has the values column[n] (M,) at the unknowns index[n] (M,). Of the information the
    lower triangle is filled.
    """
    m = index.shape[1]
    for n in range(start, stop):
        r = residual[n]
        for a in range(m):
            i, x = index[n, a], column[n, a]
            gradient[i] += x * r
            row = information[i]
            for b in range(a + 1):
                j = index[n, b]
                if j <= i:
                    row[j] += x * column[n, b]
                else:
                    information[j, i] += x * column[n, b]
