"""The larger of two covariances in each direction of parameter space."""

from __future__ import annotations

import numpy as np

from gonio.fitting.uncertainty.degrees_of_freedom import Spread, satterthwaite

NOTHING = 1e-13  # of the largest eigenvalue of the first: a direction without variance


def larger_of(first: Spread, second: Spread) -> Spread:
    """A covariance that is at least each of the two along every direction.

    Parameters
    ----------
    first : Spread
        Of full rank over the parameters that are determined.
    second : Spread
        Of any rank.

    Notes
    -----
    With a root A of the first, A A^T, and A^-1 S A^-T = U diag(l) U^T of the second it is
    A U diag(max(1, l)) U^T A^T. It does not depend on how parameters are written: with p' = T p
    both covariances and the result become T S T^T. Degrees of freedom are Satterthwaite's, of the
    parts that come from either.

    Examples
    --------
    >>> one = Spread(np.diag([1.0, 4.0]), np.array([9.0, 9.0]))
    >>> other = Spread(np.diag([3.0, 2.0]), np.array([5.0, 5.0]))
    >>> both = larger_of(one, other)
    >>> np.diag(both.covariance).round(6).tolist(), both.dof.round(6).tolist()
    ([3.0, 4.0], [5.0, 9.0])
    """
    size = np.sqrt(np.diag(first.covariance))
    index = np.flatnonzero(size > 0)
    total = np.zeros_like(first.covariance)
    dof = np.full(len(size), np.nan)
    if len(index) == 0:
        return Spread(total, dof)
    at, unit = np.ix_(index, index), np.outer(size[index], size[index])
    values, vectors = np.linalg.eigh(first.covariance[at] / unit)
    good = values > NOTHING * values[-1]
    root = vectors[:, good] * np.sqrt(values[good])
    inverse = vectors[:, good] / np.sqrt(values[good])
    ratio, turned = np.linalg.eigh(inverse.T @ (second.covariance[at] / unit) @ inverse)
    axes = root @ turned
    total[at] = (axes * np.maximum(ratio, 1.0)) @ axes.T * unit
    of_first = np.sum(axes[:, ratio <= 1] ** 2, axis=1)
    of_second = axes[:, ratio > 1] ** 2 @ ratio[ratio > 1]
    for k, j in enumerate(index.tolist()):
        freedoms = np.array([first.dof[j], second.dof[j]])
        freedoms = np.where(np.isnan(freedoms), np.inf, freedoms)
        dof[j] = satterthwaite(np.array([of_first[k], of_second[k]]), freedoms)
    return Spread(total, dof)
