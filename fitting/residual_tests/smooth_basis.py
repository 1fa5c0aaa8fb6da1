"""Columns whose outer products are covariances of errors of a model, and their sums of products."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gonio.geometry import FloatArray

BLOCK = 256  # samples whose products fit into the cache


class Columns(Protocol):
    """Columns C, (N, K), of one or more kinds of error, so that C C^T is the covariance of each."""

    def full(self, kind: str) -> FloatArray:
        """The columns of a kind, (N, K)."""
        ...

    def sums(self, vectors: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
        """By kind C^T C, (K, K), and C^T times vectors (N, R), (K, R)."""
        ...


@dataclass(frozen=True)
class FullColumns:
    """Columns of any sort, of one kind of error.

    Parameters
    ----------
    kind : str
    columns : ndarray, shape (N, K)
    """

    kind: str
    columns: FloatArray

    def full(self, kind: str) -> FloatArray:
        """The columns, (N, K)."""
        return self.columns

    def sums(self, vectors: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
        """By kind C^T C, (K, K), and C^T times vectors (N, R), (K, R)."""
        c = self.columns
        return {self.kind: (np.asarray(c.T @ c), np.asarray(c.T @ vectors))}


@dataclass(frozen=True)
class SineProducts:
    """Products of sines, one of each axis, with all combinations of their orders.

    Sums over samples are taken axis by axis: the columns themselves are seldom needed, and their
    products are cosines of sums and differences, of which there are few.

    Parameters
    ----------
    phases : sequence of ndarray, shape (N,)
        Phase of the sine of order 1 on each axis.
    sizes : mapping of str to sequence of ndarray, shape (M,)
        By kind the amplitude of each order, from 1 on, on each axis.

    Examples
    --------
    >>> x = np.linspace(0.1, 3.0, 50)
    >>> c = SineProducts([x, x**2], {"smooth": [np.ones(3), np.array([1.0, 0.5])]})
    >>> full = c.full("smooth")
    >>> full.shape, bool(np.allclose(c.sums(full)["smooth"], full.T @ full))
    ((50, 6), True)
    """

    phases: Sequence[FloatArray]
    sizes: Mapping[str, Sequence[FloatArray]]

    def full(self, kind: str) -> FloatArray:
        """The columns of a kind, (N, K)."""
        waves = [
            size[:, None] * np.sin(np.arange(1, len(size) + 1)[:, None] * x)
            for x, size in zip(self.phases, self.sizes[kind], strict=True)
        ]
        return np.asarray(_products(waves).T)

    def sums(self, vectors: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
        """By kind C^T C, (K, K), and C^T times vectors (N, R), (K, R)."""
        lengths = [[len(size) for size in sizes] for sizes in self.sizes.values()]
        orders = [max(of_axis) for of_axis in zip(*lengths, strict=True)]
        of_cosines = np.zeros((math.prod(2 * m + 1 for m in orders[:-1]), 2 * orders[-1] + 1))
        on_vectors = np.zeros((math.prod(orders[:-1]), orders[-1] * vectors.shape[1]))
        rows = np.ascontiguousarray(vectors.T)
        for start in range(0, len(vectors), BLOCK):
            some = slice(start, start + BLOCK)
            waves = [_waves(x[some], m) for x, m in zip(self.phases, orders, strict=True)]
            *cosines, last = (cosine for cosine, _ in waves)
            of_cosines += _products(cosines) @ last.T
            *sines, last = (sine for _, sine in waves)
            on_vectors += _products(sines) @ _products([last, rows[:, some]]).T
        of_cosines = of_cosines.reshape([2 * m + 1 for m in orders])
        on_vectors = on_vectors.reshape([*orders, -1])
        found = {}
        for kind, sizes in self.sizes.items():
            gram = _gram(of_cosines, sizes)
            own = on_vectors[tuple(slice(len(size)) for size in sizes)].reshape(len(gram), -1)
            found[kind] = gram, own * _products([size[:, None] for size in sizes])
        return found


def _gram(of_cosines: FloatArray, sizes: Sequence[FloatArray]) -> FloatArray:
    """C^T C from the sums of products of the cosines of all orders."""
    sums = of_cosines
    for size in sizes:
        # sin(i x) sin(k x) is half of cos((i - k) x) - cos((i + k) x).
        i = np.arange(1, len(size) + 1)
        pair = sums[np.abs(i[:, None] - i)] - sums[i[:, None] + i]
        amplitude = np.outer(size, size) / 2
        sums = np.moveaxis((pair.T * amplitude.T).T, (0, 1), (-2, -1))
    axes = range(0, 2 * len(sizes), 2)
    count = math.prod(len(size) for size in sizes)
    return np.transpose(sums, (*axes, *(a + 1 for a in axes))).reshape(count, count)


def _products(waves: Sequence[FloatArray]) -> FloatArray:
    """Products of one row of each, all combinations, (K, N)."""
    product, *others = waves or [np.ones((1, 1))]
    for more in others:
        product = (product[:, None, :] * more[None]).reshape(-1, more.shape[1])
    return product


def _waves(x: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Cosines of 0 to 2 M times an angle, (2 M + 1, N), and sines of 1 to M times it, (M, N)."""
    turns = np.empty((2 * most + 1, len(x)), np.complex128)
    turns[0], turns[1].real, turns[1].imag = 1.0, np.cos(x), np.sin(x)
    k = 1
    while k < 2 * most:  # from k times the angle on to 2 k times it at once
        n = min(k, 2 * most - k)
        np.multiply(turns[k], turns[1 : n + 1], out=turns[k + 1 : k + 1 + n])
        k += n
    return np.ascontiguousarray(turns.real), np.ascontiguousarray(turns.imag[1 : most + 1])
