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
    number = np.zeros(len(keys[0]), np.int64)
    for key in keys:
        own = _ranked(np.asarray(key, np.int64))
        number = _ranked(number * (int(own.max(initial=0)) + 1) + own)
    return number


def _ranked(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rank of each key among the different ones."""
    if not len(key):
        return key
    least = int(key.min())
    span = int(key.max()) - least + 1
    if span > 4 * len(key) + TABLE:
        return np.unique(key, return_inverse=True)[1].ravel().astype(np.int64)
    if span == 1:
        return np.zeros(len(key), np.int64)
    present = np.zeros(span, np.int64)
    present[key - least] = 1
    return np.asarray((np.cumsum(present) - 1)[key - least])
