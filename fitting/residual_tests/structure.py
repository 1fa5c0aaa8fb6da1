"""Tests for structure in residuals: groups against their scatter, and neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.residual_tests.groups import (
    LEAST,
    Grouping,
)
from gonio.fitting.residual_tests.whitened import (
    Base,
    Whitened,
    evenly,
)
from gonio.geometry import FloatArray

NEIGHBOURS = 2000  # samples that are compared with their neighbour,
AMONG = 8000  # which is looked for among so many


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
    """Sums of z over the groups, (K,), and of what the fit can follow, X (K, R).

    Both are over the root of the number of samples: the covariance of the first is 1 - X X^T.
    """
    from scipy.sparse import csr_array

    number, k = grouping.group + 1, len(grouping.words)  # 0 for samples of no group

    def total(weights: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(number, weights=weights, minlength=k + 1)[1:])

    scale = np.sqrt(np.maximum(np.bincount(number, minlength=k + 1)[1:], 1.0))
    if isinstance(left.columns, np.ndarray):
        cross = np.empty((k, left.columns.shape[1]))
        for c, column in enumerate(left.columns.T):
            cross[:, c] = total(column)
    else:
        groups = csr_array((np.ones(len(number)), (np.arange(len(number)), number)))
        cross = np.asarray((groups.T @ left.columns).toarray())[1 : k + 1]
    return total(left.z) / scale, cross @ left.root_inverse / scale[:, None]


def group_test(left: Whitened, name: str, grouping: Grouping) -> Test | None:
    """Fisher's test of the sums over groups against the scatter inside them."""
    from scipy.special import fdtrc

    if len(grouping.words) < 2:
        return None
    t, followed = _sums(left, grouping)
    vectors, s, _ = np.linalg.svd(followed, full_matrices=False)
    kept = 1 - s**2  # eigenvalues of the covariance that are not 1
    good = kept > 1e-6
    rank = len(t) - int(np.count_nonzero(~good))
    rest = left.dof - rank
    if rank == 0 or rest < LEAST:
        return None
    along = (vectors.T @ t) ** 2
    between = float(t @ t - np.sum(along) + np.sum(along[good] / kept[good]))
    total = float(left.z @ left.z)
    within = max(total - between, 1e-300 + 1e-12 * total) / rest
    statistic = between / rank / within
    share = float(np.clip((between - rank * within) / total, 0.0, 1.0))
    return Test(name, statistic, rank, float(fdtrc(rank, rest, statistic)), share)


def neighbour_test(base: Base, left: Whitened) -> Test | None:
    """Whether neighbouring samples err alike: products of neighbours, self-normalised.

    Each product has expectation 0 and no correlation with the others where errors are independent
    and symmetric, whatever their size (Moran 1950 with weights 0 and 1).
    """
    from scipy.spatial import cKDTree
    from scipy.special import ndtr

    some = evenly(base.problem.n, AMONG)
    z = left.z[some]
    # Another incidence is no neighbour unless it is as near as the viewing directions are.
    point = np.column_stack([w[some] for w in base.vectors])
    n = len(point)
    some = evenly(n, NEIGHBOURS)
    _, near = cKDTree(point).query(point[some], k=2)
    other = np.where(near[:, 0] == some, near[:, 1], near[:, 0])
    low, high = np.minimum(some, other), np.maximum(some, other)
    pairs = np.column_stack(np.divmod(np.unique(low * n + high), n))
    products = z[pairs[:, 0]] * z[pairs[:, 1]]
    size = float(np.sqrt(np.sum(products**2)))
    if len(products) < 3 * LEAST or size == 0:
        return None
    statistic = float(np.sum(products)) / size
    share = float(2 * np.sum(products) / np.sum(z[pairs] ** 2))
    p_value = float(ndtr(-statistic))
    return Test(NEIGHBOURING, statistic, len(products), p_value, float(np.clip(share, 0.0, 1.0)))
