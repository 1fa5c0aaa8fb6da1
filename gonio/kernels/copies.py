"""Numbers that may occur more than once in a long array, found without sorting.

Imported where a fit runs; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import numpy as np
from numba import njit

SPREAD = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: its top bits are well mixed


@njit(nogil=True, cache=True, error_model="numpy")
def suspects(value):
    """A mask of numbers that share a slot of a hash table; equal ones always do."""
    bits = 4
    while 1 << bits < 8 * value.shape[0]:
        bits += 1
    shift = np.uint64(64 - bits)
    counts = np.zeros(1 << bits, np.uint8)
    # 0.0 is added to make -0.0 the same number.
    bits_of = (value + 0.0).view(np.uint64)
    for k in range(bits_of.shape[0]):
        slot = (bits_of[k] * SPREAD) >> shift
        counts[slot] = min(counts[slot] + 1, 2)
    mask = np.empty(value.shape[0], np.bool_)
    for k in range(bits_of.shape[0]):
        mask[k] = counts[(bits_of[k] * SPREAD) >> shift] > 1
    return mask
