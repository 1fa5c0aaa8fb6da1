"""Tests for structure in residuals: groups against their scatter, and neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.groups import (
    LEAST,
    Grouping,
)
from gonio.fitting.residual_tests.whitened import (
    Whitened,
)
from gonio.geometry import FloatArray

NEIGHBOURS = 4000  # samples that are compared with their neighbour


@dataclass(frozen=True)
class Test:
    """A test for structure that white noise would not have.

    Parameters
    ----------
    name : str
        Against what the residuals were compared.
    statistic : float
        Fisher's F, or for neighbours the self-normalised sum of products (standard normal).
    groups : int
        Degrees of freedom of the numerator; pairs for neighbours.
    p_value : float
    share : float
        Share of the residual variance that the structure makes, noise taken off; for neighbours
        their correlation.
    """

    __test__ = False

    name: str
    statistic: float
    groups: int
    p_value: float
    share: float


NEIGHBOURING = "neighbouring samples"


def _sums(left: Whitened, grouping: Grouping) -> tuple[FloatArray, FloatArray]:
    """Sums of z over the groups and their covariance under unit noise."""
    from scipy.sparse import csr_array

    inside = np.flatnonzero(grouping.group >= 0)
    group, k = grouping.group[inside], len(grouping.words)
    counts = np.bincount(group, minlength=k)
    t = np.bincount(group, weights=left.z[inside], minlength=k)
    if left.dense is None:
        b = csr_array((np.ones(len(inside)), (inside, group)), (len(left.z), k))
        cross = np.asarray((b.T @ left.columns).toarray())
    else:
        cross = np.zeros((k, left.dense.shape[1]))
        for c in range(left.dense.shape[1]):
            cross[:, c] = np.bincount(group, weights=left.dense[inside, c], minlength=k)
    return np.asarray(t, float), np.diag(counts) - cross @ left.inverse @ cross.T


def group_test(left: Whitened, name: str, grouping: Grouping) -> Test | None:
    """Fisher's test of the sums over groups against the scatter inside them."""
    from scipy.special import fdtrc

    if len(grouping.words) < 2:
        return None
    t, covariance = _sums(left, grouping)
    scale = np.sqrt(np.maximum(np.bincount(grouping.group[grouping.group >= 0]), 1.0))
    t, covariance = t / scale, covariance / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(covariance)
    good = values > 1e-6
    rank = int(np.count_nonzero(good))
    rest = left.dof - rank
    if rank == 0 or rest < LEAST:
        return None
    between = float(np.sum((vectors[:, good].T @ t) ** 2 / values[good]))
    total = float(left.z @ left.z)
    within = max(total - between, 1e-300 + 1e-12 * total) / rest
    statistic = between / rank / within
    share = float(np.clip((between - rank * within) / total, 0.0, 1.0))
    return Test(name, statistic, rank, float(fdtrc(rank, rest, statistic)), share)


def neighbour_test(problem: Problem, left: Whitened) -> Test | None:
    """Whether neighbouring samples err alike: products of neighbours, self-normalised.

    Each product has expectation 0 and no correlation with the others where errors are independent
    and symmetric, whatever their size (Moran 1950 with weights 0 and 1).
    """
    from scipy.spatial import cKDTree
    from scipy.special import ndtr

    d = problem.samples.directions
    w_i, w_r = d.vectors()
    # Another incidence is no neighbour unless it is as near as the viewing directions are.
    point = np.column_stack([np.broadcast_to(w, (problem.n, 3)) for w in (w_i, w_r)])
    some = np.unique(np.linspace(0, problem.n - 1, min(problem.n, NEIGHBOURS)).astype(np.int64))
    _, near = cKDTree(point).query(point[some], k=2)
    other = np.where(near[:, 0] == some, near[:, 1], near[:, 0])
    low, high = np.minimum(some, other), np.maximum(some, other)
    pairs = np.column_stack(np.divmod(np.unique(low * problem.n + high), problem.n))
    products = left.z[pairs[:, 0]] * left.z[pairs[:, 1]]
    size = float(np.sqrt(np.sum(products**2)))
    if len(products) < 3 * LEAST or size == 0:
        return None
    statistic = float(np.sum(products)) / size
    share = float(2 * np.sum(products) / np.sum(left.z[pairs] ** 2))
    p_value = float(ndtr(-statistic))
    return Test(NEIGHBOURING, statistic, len(products), p_value, float(np.clip(share, 0.0, 1.0)))
