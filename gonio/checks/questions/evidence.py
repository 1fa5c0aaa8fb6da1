"""What the questions look at: the samples of one wavelength and channel, and their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.checks.distinct import numbered
from gonio.checks.pairs import Pairs, azimuth_between, reciprocal_pairs
from gonio.checks.quantity import QuantityTest, quantity_of
from gonio.checks.questions.lobe_fit import LobeFit, lobe_fit
from gonio.geometry import FloatArray
from gonio.samples import ANGLES, BRDFSamples

NEIGHBOURS = 8
PAIRS = 800  # with light and viewer exchanged, which are enough
SHOWN = 5  # samples that a sentence names
OF_ANGLE = 1 << 20  # more than an angle has hundredths of a degree


class Evidence:
    """Samples of one wavelength and channel, with what several questions compute from them.

    Parameters
    ----------
    samples : BRDFSamples
    """

    def __init__(self, samples: BRDFSamples) -> None:
        self.samples = samples
        self.n = len(samples)
        self.value = samples.value
        self.u = samples.u_independent
        self.theta_i, self.phi_i, self.theta_r, self.phi_r = (
            np.broadcast_to(getattr(samples.directions, name), (self.n,)) for name in ANGLES
        )

    @cached_property
    def delta(self) -> FloatArray:
        """phi_r - phi_i in [-pi, pi), 0 where a direction is the normal."""
        return azimuth_between(self.theta_i, self.phi_i, self.theta_r, self.phi_r)

    @cached_property
    def pairs(self) -> Pairs:
        """Samples and their partners with light and viewer exchanged."""
        return reciprocal_pairs(self.samples, enough=PAIRS)

    @cached_property
    def quantity(self) -> QuantityTest:
        """Which quantity the reciprocal pairs say that the values hold."""
        return quantity_of(self.value, self.u, self.theta_i, self.theta_r, self.pairs)

    @cached_property
    def incidence(self) -> NDArray[np.int64]:
        """Index of the incident direction of each sample, to a hundredth of a degree."""
        per_radian = 18_000 / np.pi
        phi = np.rint(self.phi_i * per_radian).astype(np.int64) % 36_000
        phi *= self.theta_i >= 1e-6  # the normal has no azimuth
        return numbered(np.rint(self.theta_i * per_radian), phi)

    @cached_property
    def n_incidences(self) -> int:
        return int(self.incidence.max(initial=-1)) + 1

    def of_incidence(self, number: int) -> NDArray[np.int64]:
        """The samples of an incident direction."""
        return self._incidences[number]

    @cached_property
    def _incidences(self) -> list[NDArray[np.int64]]:
        few = self.n_incidences < 2**16  # such numbers are sorted without comparing them
        number = self.incidence.astype(np.uint16) if few else self.incidence
        order = np.argsort(number, kind="stable").astype(np.int64)
        return np.split(order, np.cumsum(np.bincount(self.incidence))[:-1])

    @cached_property
    def vectors(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors towards the light and towards the viewer, each (N, 3)."""
        w_i, w_r = self.samples.directions.vectors()
        return np.broadcast_to(w_i, (self.n, 3)), np.broadcast_to(w_r, (self.n, 3))

    @cached_property
    def repeated_values(self) -> int:
        """How many different values occur more than once."""
        ordered = np.sort(self.value)
        again = ordered[1:] == ordered[:-1]
        return int(np.count_nonzero(again[1:] & ~again[:-1])) + int(again[:1].sum())

    @cached_property
    def geometry_class(self) -> NDArray[np.int64]:
        """Samples of one class have the same value on a reciprocal isotropic surface."""
        return numbered(self.geometry_key)

    @cached_property
    def geometry_key(self) -> NDArray[np.int64]:
        """A number that the samples of one class have in common, in the order of the classes."""
        low, high = np.minimum(self.theta_i, self.theta_r), np.maximum(self.theta_i, self.theta_r)
        key = np.zeros(self.n, np.int64)
        for angle in (low, high, np.abs(self.delta)):
            key = key * OF_ANGLE + np.rint(100 * np.degrees(angle)).astype(np.int64)
        return key

    @cached_property
    def neighbours(self) -> NDArray[np.int64]:
        """The nearest samples of each sample with almost the same incidence, shape (N, k)."""
        return self.neighbours_of(np.arange(self.n))

    def neighbours_of(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """The same of some samples, shape (M, k): of many samples all take seconds."""
        k = min(NEIGHBOURS + 1, self.n)
        tree, points = self._tree
        nearest = np.atleast_2d(tree.query(points[index], k=k)[1]).reshape(len(index), k)
        own = nearest == index[:, None]
        own[~own.any(axis=1), -1] = True
        others: NDArray[np.int64] = nearest[~own].reshape(len(index), k - 1).astype(np.int64)
        return others

    @cached_property
    def _tree(self) -> tuple[Any, FloatArray]:
        """A tree of the samples and the points in it."""
        from scipy.spatial import cKDTree

        w_i, w_r = self.vectors
        # Samples of another incidence are near where an incidence has few samples only.
        points = np.hstack([3.0 * np.broadcast_to(w_i, (self.n, 3)), w_r])
        return cKDTree(points), points

    @cached_property
    def lobes(self) -> LobeFit | None:
        """How well lobes explain the values with the angles read in several ways."""
        return lobe_fit(self.theta_i, self.theta_r, self.delta, self.value)

    def where(self, samples: NDArray[np.int64] | Sequence[int]) -> str:
        """Lines of the first samples of a list, or their directions where there are no lines."""
        index = np.asarray(samples, np.int64)
        more = f" and {len(index) - SHOWN} more" if len(index) > SHOWN else ""
        if self.samples.line is not None:
            lines = sorted(self.samples.line[index].tolist())
            return f"{'line' if len(lines) == 1 else 'lines'} {_listed(lines[:SHOWN])}{more}"
        return "; ".join(self.direction(k) for k in index[:SHOWN].tolist()) + more

    def direction(self, k: int) -> str:
        """The four angles of a sample in words."""
        angles = (self.theta_i, self.phi_i, self.theta_r, self.phi_r)
        text = ", ".join(
            f"{name} {float(np.degrees(a[k])):.5g}" for name, a in zip(ANGLES, angles, strict=True)
        )
        return f"({text} deg)"

    def lines(self, samples: NDArray[np.int64] | Sequence[int]) -> tuple[int, ...]:
        """Lines of the file, where known."""
        if self.samples.line is None:
            return ()
        return tuple(sorted(self.samples.line[np.asarray(samples, np.int64)].tolist()))


def _listed(lines: Sequence[int]) -> str:
    return ", ".join(str(line) for line in lines)
