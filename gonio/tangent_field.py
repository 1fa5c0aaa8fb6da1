"""A smooth field of small displacements of directions on the hemisphere: a Gaussian process.

The field has two tangent components at nodes. A minimal rotation carries the tangents x and y of
the zenith to every direction: they are smooth over the whole hemisphere, as polar angle and
azimuth are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray, from_equal_area

NEIGHBOURS = 12  # nodes from which a displacement between them is interpolated
SPACING = (
    0.64  # of the correlation length: distance of the nodes; between them 1 % of the sd is lost
)
RIM_POWER = 6  # slope errors grow towards the rim as (theta / 90 deg)^6
_NUGGET = 0.005  # of the sd, added to it at a node so that close nodes can be told apart
_BLOCK = 16384


@dataclass(frozen=True)
class FieldPrior:
    """What is stated of the displacements before any is measured.

    Parameters
    ----------
    zenith, rim : float
        Standard deviation of each component at the zenith, and what is added to it at the rim as
        (theta / 90 deg)^6, radians.
    correlation : float
        Correlation length c, radians: the correlation at an angle s is exp(-s^2 / 2 c^2).

    Examples
    --------
    >>> prior = FieldPrior(0.001, 0.007, 0.17)
    >>> [round(float(sd), 4) for sd in prior.sd(np.array([[0, 0, 1.0], [1.0, 0, 0]]))]
    [0.001, 0.008]
    """

    zenith: float
    rim: float
    correlation: float

    def sd(self, directions: FloatArray) -> FloatArray:
        """Standard deviation (N,) of each component at unit vectors (N, 3), radians."""
        theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
        return np.asarray(self.zenith + self.rim * (theta / (np.pi / 2)) ** RIM_POWER)

    def scaled(self, factor: float, stretch: float = 1.0) -> FieldPrior:
        """With the standard deviation and the correlation length multiplied by these factors."""
        return FieldPrior(factor * self.zenith, factor * self.rim, stretch * self.correlation)

    def correlations(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Correlation between unit vectors (..., A, 3) and (..., B, 3), shape (..., A, B)."""
        cosine = np.clip(a @ np.swapaxes(b, -1, -2), -1, 1)
        return np.asarray(np.exp(-0.5 * (np.arccos(cosine) / self.correlation) ** 2))

    def covariance(self, nodes: FloatArray) -> FloatArray:
        """Covariance (K, K) of one component at nodes (K, 3), rad^2."""
        sd = self.sd(nodes)
        within = self.correlations(nodes, nodes) + _NUGGET**2 * np.eye(len(nodes))
        return np.asarray(within * np.outer(sd, sd))


@dataclass(frozen=True)
class Interpolation:
    """Weights of the nodes in the displacement at each of N directions.

    Parameters
    ----------
    index : ndarray of int64, shape (N, M)
        Neighbouring nodes.
    weight : ndarray, shape (N, M)
    """

    index: NDArray[np.int64]
    weight: FloatArray

    def __call__(self, values: FloatArray) -> FloatArray:
        """Values (N, ...) of a component that the nodes have as (K, ...)."""
        return np.asarray(np.einsum("nm,nm...->n...", self.weight, values[self.index]))


@dataclass(frozen=True)
class Nodes:
    """Nodes of a field with its prior.

    Parameters
    ----------
    directions : ndarray, shape (K, 3)
        Unit vectors.
    prior : FieldPrior
    """

    directions: FloatArray
    prior: FieldPrior

    @classmethod
    def on_cap(cls, prior: FieldPrior, theta_max: float, most: int) -> Nodes:
        """Nodes over all polar angles up to `theta_max` (radians), at most so many.

        Examples
        --------
        >>> nodes = Nodes.on_cap(FieldPrior(0.001, 0.0, np.radians(10)), np.radians(80), 1500)
        >>> len(nodes)
        443
        """
        # A margin keeps the last directions between nodes.
        end = min(theta_max + 0.5 * SPACING * prior.correlation, np.radians(100.0))
        area = 2 * np.pi * (1 - np.cos(end))
        n = int(np.clip(area / (SPACING * prior.correlation) ** 2, NEIGHBOURS + 1, most))
        # A sunflower: equal areas, without rows that a lobe could lie along.
        q = (np.arange(n) + 0.5) / n * (1 - np.cos(end))
        azimuth = np.arange(n) * np.pi * (3 - np.sqrt(5))
        radius = np.sqrt(q)
        nodes = from_equal_area(radius * np.cos(azimuth), radius * np.sin(azimuth))
        return cls(nodes, prior)

    def __len__(self) -> int:
        return len(self.directions)

    @cached_property
    def root(self) -> FloatArray:
        """Lower Cholesky factor (K, K) of the covariance of a component."""
        return np.asarray(np.linalg.cholesky(self.prior.covariance(self.directions)))

    def interpolation(self, directions: FloatArray) -> Interpolation:
        """The most likely displacements at unit vectors (N, 3), given those of near nodes."""
        from scipy.spatial import cKDTree

        near = min(NEIGHBOURS, len(self))
        _, index = cKDTree(self.directions).query(directions, near)
        index = np.sort(index.reshape(len(directions), near), axis=1).astype(np.int64)
        # Directions that lie close together have the same neighbours, and one matrix.
        sets, of_set = _distinct_rows(index, len(self))
        inverse = self._inverses(sets)
        weight = np.empty(index.shape)
        sd = self.prior.sd(directions)
        for a in range(0, len(directions), _BLOCK):
            part = slice(a, a + _BLOCK)
            nodes = self.directions[index[part]]
            towards = self.prior.correlations(directions[part, None], nodes)[:, 0]
            weight[part] = np.einsum("nab,nb->na", inverse[of_set[part]], towards)
        weight *= sd[:, None] / self.prior.sd(self.directions)[index]
        return Interpolation(index, weight)

    def _inverses(self, sets: NDArray[np.int64]) -> FloatArray:
        inverse = np.empty((*sets.shape, sets.shape[1]))
        nugget = _NUGGET**2 * np.eye(sets.shape[1])
        for a in range(0, len(sets), _BLOCK):
            nodes = self.directions[sets[a : a + _BLOCK]]
            inverse[a : a + _BLOCK] = np.linalg.inv(self.prior.correlations(nodes, nodes) + nugget)
        return inverse


def tangents(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tangents (N, 3) at unit vectors, x and y of the zenith carried by the minimal rotation.

    Examples
    --------
    >>> along_x, along_y = tangents(np.array([[0.0, 0.0, 1.0]]))
    >>> bool(np.all(along_x == [1, 0, 0])), bool(np.all(along_y == [0, 1, 0]))
    (True, True)
    """
    x, y, z = directions.T
    k = 1 / (1 + z)
    along_x = np.stack([1 - x * x * k, -x * y * k, -x], axis=1)
    along_y = np.stack([-x * y * k, 1 - y * y * k, -y], axis=1)
    return along_x, along_y


def _distinct_rows(
    index: NDArray[np.int64], n_nodes: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Distinct rows of sorted indices, and the number of its row for each."""
    # A random projection to one number is unique for distinct rows but for chances of 2^-60.
    key = np.random.default_rng(0).integers(1, 2**62, size=n_nodes, dtype=np.int64)
    with np.errstate(over="ignore"):
        hashed = key[index].sum(axis=1)
    _, first, of_row = np.unique(hashed, return_index=True, return_inverse=True)
    return index[first], of_row.astype(np.int64)
