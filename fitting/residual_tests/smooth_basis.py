"""Columns whose outer products are covariances of errors of a model, and their sums of products."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from gonio.geometry import FloatArray


class Columns(Protocol):
    """Columns C, shape (N, K), so that C C^T is the covariance of an error."""

    @property
    def full(self) -> FloatArray:
        """The columns, (N, K)."""
        ...

    def gram(self) -> FloatArray:
        """C^T C, (K, K)."""
        ...

    def on(self, vectors: FloatArray) -> FloatArray:
        """C^T times vectors (N, R), (K, R)."""
        ...


@dataclass(frozen=True)
class FullColumns:
    """Columns of any kind.

    Parameters
    ----------
    full : ndarray, shape (N, K)
    """

    full: FloatArray

    def gram(self) -> FloatArray:
        """C^T C, (K, K)."""
        return np.asarray(self.full.T @ self.full)

    def on(self, vectors: FloatArray) -> FloatArray:
        """C^T times vectors (N, R), (K, R)."""
        return np.asarray(self.full.T @ vectors)


@dataclass(frozen=True)
class SineProducts:
    """Products of sines, one of each axis, with all combinations of their orders.

    Sums over samples are taken axis by axis: the columns themselves are seldom needed, and their
    products are cosines of sums and differences, of which there are few.

    Parameters
    ----------
    phases : sequence of ndarray, shape (N,)
        Phase of the sine of order 1 on each axis.
    sizes : sequence of ndarray, shape (M,)
        Amplitude of each order, from 1 on, on each axis.

    Examples
    --------
    >>> x = np.linspace(0.1, 3.0, 50)
    >>> c = SineProducts([x, x**2], [np.ones(3), np.array([1.0, 0.5])])
    >>> bool(np.allclose(c.gram(), c.full.T @ c.full)), c.full.shape
    (True, (50, 6))
    """

    phases: Sequence[FloatArray]
    sizes: Sequence[FloatArray]

    @cached_property
    def _waves(self) -> list[FloatArray]:
        return [
            size[:, None] * _multiples(np.sin(x), np.zeros_like(x), np.cos(x), len(size))
            for x, size in zip(self.phases, self.sizes, strict=True)
        ]

    @property
    def full(self) -> FloatArray:
        """The columns, (N, K)."""
        return np.asarray(_products(self._waves).T)

    def gram(self) -> FloatArray:
        """C^T C, (K, K)."""
        cosines = []
        for x, size in zip(self.phases, self.sizes, strict=True):
            first, one = np.cos(x), np.ones_like(x)
            others = _multiples(first, one, first, 2 * len(size))
            cosines.append(np.concatenate([one[None], others]))
        sums = (_products(cosines[:-1]) * one @ cosines[-1].T).reshape([len(c) for c in cosines])
        for size in self.sizes:
            # sin(i x) sin(k x) is half of cos((i - k) x) - cos((i + k) x).
            i = np.arange(1, len(size) + 1)
            pair = sums[np.abs(i[:, None] - i)] - sums[i[:, None] + i]
            amplitude = np.outer(size, size) / 2
            sums = np.moveaxis((pair.T * amplitude.T).T, (0, 1), (-2, -1))
        axes = range(0, 2 * len(self.sizes), 2)
        count = int(np.prod([len(size) for size in self.sizes]))
        return np.transpose(sums, (*axes, *(a + 1 for a in axes))).reshape(count, count)

    def on(self, vectors: FloatArray) -> FloatArray:
        """C^T times vectors (N, R), (K, R)."""
        first, last = _products(self._waves[:-1]), self._waves[-1].T
        found = np.empty((len(first) * last.shape[1], vectors.shape[1]))
        for k, v in enumerate(vectors.T):
            found[:, k] = ((first * v) @ last).ravel()
        return found


def _products(waves: Sequence[FloatArray]) -> FloatArray:
    """Products of one row of each, all combinations, (K, N)."""
    product: FloatArray = np.ones((1, 1))
    for more in waves:
        product = (product[:, None, :] * more[None]).reshape(-1, more.shape[1])
    return product


def _multiples(first: FloatArray, zeroth: FloatArray, cosine: FloatArray, most: int) -> FloatArray:
    """Sines or cosines of 1 to `most` times an angle, (most, N), from those of 0 and 1 times it."""
    found = np.empty((most, len(first)))
    found[0], before, twice = first, zeroth, 2 * cosine
    for k in range(1, most):
        np.multiply(twice, found[k - 1], out=found[k])
        found[k] -= before
        before = found[k - 1]
    return found
