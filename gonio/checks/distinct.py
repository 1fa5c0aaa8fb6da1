"""Samples whose keys are equal, numbered without sorting rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray

TABLE = 65_536  # entries that a table of possible keys may have besides 4 for each sample


def numbered(*keys: FloatArray | NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the combination of keys of each sample, (N,), in the order of the keys.

    The same as of the rows in ``np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)``.

    Parameters
    ----------
    *keys : ndarray, shape (N,)
        Whole numbers.

    Examples
    --------
    >>> numbered(np.array([7.0, 3.0, 7.0]), np.array([0.0, 1.0, 2.0])).tolist()
    [1, 0, 2]
    """
    first, *others = (np.asarray(key, np.int64) for key in keys)
    number = _ranked(first)
    for key in others:
        least = int(key.min(initial=0))
        span = int(key.max(initial=0)) - least + 1
        if (int(number.max(initial=0)) + 1) * span > _table(len(key)):
            key, least = _ranked(key), 0
            span = int(key.max(initial=0)) + 1
        number = _ranked(number * span + (key - least))
    return number


def _table(n: int) -> int:
    """Entries of the largest table of possible keys of so many samples."""
    return 4 * n + TABLE


def _ranked(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rank of each key among the different ones."""
    if not len(key):
        return key
    least = int(key.min())
    span = int(key.max()) - least + 1
    if span > _table(len(key)):
        return np.unique(key, return_inverse=True)[1].ravel().astype(np.int64)
    if span == 1:
        return np.zeros(len(key), np.int64)
    present = np.zeros(span, np.int64)
    present[key - least] = 1
    return np.asarray((np.cumsum(present) - 1)[key - least])
