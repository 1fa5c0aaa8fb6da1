"""Samples with the unit vectors of their directions, as the loops over a model read them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import Directions, FloatArray, golden_fractions, rotated
from gonio.kernels import map_blocks
from gonio.samples import BRDFSamples, Cells

PASS = 65536  # points of one pass; small enough for the second cache, large enough for a thread


@dataclass(frozen=True)
class ViewedSamples:
    """Samples and the unit vectors towards the light and towards the viewer.

    Parameters
    ----------
    samples : BRDFSamples
    w_i : ndarray, shape (N, 3)
    cells : Cells
        Members over which a model is integrated; one a sample where the samples have none.
    threads : int, optional
        The result does not depend on it.
    given : ndarray, shape (6, N), optional
        `components`, where they are known already.
    """

    samples: BRDFSamples
    w_i: FloatArray
    cells: Cells
    threads: int | None = None
    given: FloatArray | None = None

    @classmethod
    def of(cls, samples: BRDFSamples, threads: int | None = None) -> ViewedSamples:
        """The samples in their own directions."""
        parts = components(samples.directions, threads)
        cells = samples.cells
        if cells is None:
            return cls(samples, parts[:3].T, points(parts), threads, parts)
        return cls(samples, np.ascontiguousarray(parts[:3].T), cells, threads, parts)

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def are_points(self) -> bool:
        """Whether the samples are points and not cells."""
        return self.samples.cells is None

    @cached_property
    def components(self) -> FloatArray:
        """x, y and z of the directions to the light, then to the viewer, (6, N), read-only.

        Of a cell it is its centroid that the viewer sees.
        """
        if self.given is not None:
            return self.given
        if self.are_points:
            return read_only(np.concatenate([self.w_i.T, self.cells.w_r.T]))
        centroids = components(self.samples.directions, self.threads)[3:]
        return read_only(np.concatenate([self.w_i.T, centroids]))

    @cached_property
    def value(self) -> FloatArray:
        """Values of the samples, read-only."""
        return read_only(self.samples.value)

    def with_values(self, value: FloatArray) -> ViewedSamples:
        """The samples with other values."""
        return replace(self, samples=replace(self.samples, value=value))

    def moved(self, shift: FloatArray | None, turn: float | FloatArray) -> ViewedSamples:
        """The samples with their directions elsewhere, as `Problem.with_directions` has it."""
        cells, w_i, w_r = self.cells, self.w_i, self.cells.w_r
        members = np.diff(cells.offsets)
        if shift is not None:
            each = shift if len(shift) == len(w_r) else np.repeat(shift, members, axis=0)
            w_r = w_r + each
            w_r /= np.sqrt(np.einsum("nk,nk->n", w_r, w_r))[:, None]
        if np.any(turn):
            each = np.broadcast_to(turn, len(self))
            w_i = np.ascontiguousarray(rotated(w_i, each))
            w_r = np.ascontiguousarray(rotated(w_r, np.repeat(each, members)))
        return replace(self, w_i=w_i, cells=replace(cells, w_r=w_r), given=None)

    def at(self, index: NDArray[np.int64]) -> ViewedSamples:
        """These samples alone, with their cells."""
        return replace(
            self,
            samples=self.samples.select(index, "some samples"),
            w_i=np.ascontiguousarray(self.w_i[index]),
            cells=self.cells.select(index),
            given=None,
        )

    def centroids(self, index: NDArray[np.int64] | None) -> ViewedSamples:
        """These samples, or all, taken at their centroids."""
        samples, parts = self.samples, self.components
        if index is not None:
            samples = samples.select(index, "start values")
            parts = read_only(parts[:, index])
        if samples.cells is not None:
            samples = replace(samples, cells=None)
        return ViewedSamples(samples, parts[:3].T, points(parts), 1, parts)


def bright_and_even(value: FloatArray, n: int) -> NDArray[np.int64]:
    """Indices of at most n samples: half the brightest, half evenly over all.

    A narrow lobe is a small part of the hemisphere; an even choice alone could miss it.
    """
    even = golden_fractions(n // 2) * len(value)
    taken = np.zeros(len(value), bool)
    taken[_brightest(value, n // 2)] = True
    taken[even.astype(np.int64)] = True
    return np.flatnonzero(taken)


def points(parts: FloatArray) -> Cells:
    """Cells of one member each; of many samples nothing is copied that only cells need."""
    n = parts.shape[1]
    return Cells(parts[3:].T, np.broadcast_to(1.0, n), np.arange(n + 1, dtype=np.int64))


def components(directions: Directions, threads: int | None = None) -> FloatArray:
    """Components (6, N) of the unit vectors towards the light and towards the viewer."""
    from gonio.kernels import angles

    (n,) = directions.shape
    out = np.empty((6, n))
    given = [
        np.ascontiguousarray(np.broadcast_to(getattr(directions, name), (n,)))
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    ]

    def work(a: int, b: int) -> None:
        for k in (0, 1):
            theta, phi = (read_only(each[a:b]) for each in given[2 * k : 2 * k + 2])
            angles.components(theta, phi, *(row[a:b] for row in out[3 * k : 3 * k + 3]))

    map_blocks(work, n, threads=threads, block=PASS)
    return read_only(out)


def read_only(array: FloatArray) -> FloatArray:
    """A view that may not be written: loops are compiled anew for arrays that may be."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def _brightest(value: FloatArray, n: int) -> NDArray[np.int64]:
    """Indices of the n largest values; of many, a threshold is found on a few of them first."""
    if len(value) > 16 * n:
        few = value[:: len(value) // (8 * n)]
        threshold = np.quantile(few, 1 - 2 * n / len(value))
        index = np.flatnonzero(value >= threshold)
        if len(index) >= n:
            return index[np.argpartition(value[index], -n)[-n:]]
    return np.argpartition(value, -n)[-n:]
