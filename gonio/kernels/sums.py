"""Weighted sums of products over a block of samples: what the loops of all models share.

Imported only where loops are compiled; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from numba import njit

# A sum over SIMD lanes is another order of additions, which only these flags allow. The order is
# that of the machine code, the same for every number of threads.
_SUMS = {"reassoc", "contract", "nsz"}


@njit(nogil=True, error_model="numpy", fastmath=_SUMS)
def add_products(columns, rows, weight, work, out):
    """Add sum_t weight[t] columns[rows[a], t] columns[rows[b], t] to out[a, b], for b <= a."""
    n = weight.shape[0]
    for a in range(rows.shape[0]):
        left = columns[rows[a]]
        for t in range(n):
            work[t] = weight[t] * left[t]
        for b in range(a + 1):
            right = columns[rows[b]]
            total = 0.0
            for t in range(n):
                total += work[t] * right[t]
            out[a, b] += total


@njit(nogil=True, error_model="numpy")
def mirror(out):
    """Copy the lower triangle of each matrix out[k] to its upper one."""
    for k in range(out.shape[0]):
        for a in range(out.shape[1]):
            for b in range(a):
                out[k, b, a] = out[k, a, b]


@njit(nogil=True, error_model="numpy", fastmath=_SUMS)
def sum_of_squares(value, f, weight):
    """sum_t weight[t] (value[t] - f[t])^2."""
    total = 0.0
    for t in range(f.shape[0]):
        r = value[t] - f[t]
        total += weight[t] * r * r
    return total
