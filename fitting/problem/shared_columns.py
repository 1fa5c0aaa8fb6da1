"""Errors that many samples share, as sparse columns beside the derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_change import shared_change
from gonio.geometry import FloatArray, golden_fractions


def shared_columns(problem: Problem, p: FloatArray, f: FloatArray) -> Any:
    """Change of every sample for one standard deviation of every draw of every shared error.

    Parameters
    ----------
    problem : Problem
    p : ndarray, shape (P,)
    f : ndarray, shape (N,)
        Model values at p.

    Returns
    -------
    scipy.sparse.csr_array, shape (N, draws)
    """
    from scipy.sparse import csr_array, hstack

    parts = [csr_array((problem.n, 0))]
    for term in problem.samples.shared:
        parts.append(term.columns(shared_change(problem, term, p, f)))
    return csr_array(hstack(parts))


def thinned(problem: Problem, most: int) -> Problem:
    """At most so many samples, spread evenly over all, with their cells and weights."""
    if problem.n <= most:
        return problem
    index = golden_fractions(most) * problem.n
    return problem.at(np.unique(index.astype(np.int64)))


def weighted_square(u: Any, weight: FloatArray) -> FloatArray:
    """U^T W U (draws, draws) of sparse columns."""
    from scipy.sparse import diags_array

    return np.asarray((u.T @ diags_array(weight) @ u).toarray())
