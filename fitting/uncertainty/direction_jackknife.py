"""What leaving out all samples of one direction does to the parameters of a joint fit.

Parts that were measured at the same directions, and that the model fails in the same way, err
alike there: a direction, not a sample, is what another measurement would draw anew.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.uncertainty.degrees_of_freedom import Spread
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.sample_jackknife import newton_steps
from gonio.fitting.uncertainty.second_derivatives import Block
from gonio.geometry import FloatArray

NUMBERS = 20_000_000  # elements of curvatures that are held at once


def numbers_of_directions(problem: Problem) -> NDArray[np.int64]:
    """Number of the direction of each sample, (N,), in parts with the same directions in order."""
    number = np.empty(problem.n, np.int64)
    for part, where, _ in problem.pieces():
        number[where] = np.arange(part.n)
    return number


def by_directions(
    informed: Informed,
    direction: NDArray[np.int64],
    second: Iterable[Block] = (),
    where: NDArray[np.bool_] | None = None,
) -> Spread:
    """Covariance by leaving out each direction once, by one Newton step.

    Parameters
    ----------
    informed : Informed
    direction : ndarray of int64, shape (N,)
        Samples of one number are left out together.
    second : iterable of Block, optional
        Second derivatives of the model, gone through more than once. Without them J^T W J stands
        for the curvature of chi-squared.
    where : ndarray of bool, shape (N,), optional
        Samples that are left out; by default each.

    Notes
    -----
    As `sample_jackknife.by_samples`, with sums over the samples i of a direction:
    d = -back (C - sum_i (q_i q_i^T - z_i S_i))^-1 sum_i q_i z_i. The degrees of freedom are those
    of errors that all parts have in common.
    """
    every = np.ones(len(informed.z), np.bool_) if where is None else where
    rank = informed.q.shape[1]
    n = int(direction.max()) + 1
    curvature = np.eye(rank)
    for block in second:
        curvature -= _bent(informed, block).sum(axis=0)
    total = np.zeros((len(informed.back),) * 2)
    for start in range(0, n, max(NUMBERS // rank**2, 1)):
        stop = min(start + max(NUMBERS // rank**2, 1), n)
        inside = every & (direction >= start) & (direction < stop)
        rest = np.repeat(curvature[None], stop - start, axis=0)
        score = np.zeros((stop - start, rank))
        at, q = direction[inside] - start, informed.q[inside]
        np.subtract.at(rest, at, q[:, :, None] * q[:, None, :])
        np.add.at(score, at, q * informed.z[inside, None])
        for block in second:
            some = inside[block.samples]
            one = replace(block, samples=block.samples[some], second=block.second[some])
            np.add.at(rest, direction[one.samples] - start, _bent(informed, one))
        changes = newton_steps(rest, score) @ informed.back.T
        total += changes.T @ changes
    return Spread(total, _in_common(informed, direction, every).effective_samples)


def _bent(informed: Informed, block: Block) -> FloatArray:
    """Curvature z_i S_i of each sample of a block, (n, R, R)."""
    back = informed.whole[block.parameters]
    z = informed.z[block.samples]
    return np.asarray(np.einsum("pr,n,npq,qs->nrs", back, z, block.second, back, optimize=True))


def _in_common(
    informed: Informed, direction: NDArray[np.int64], where: NDArray[np.bool_]
) -> Informed:
    """The data with one sample for each direction: an error that its m samples have in common.

    Its row is the sum of theirs over sqrt(m), so that a unit of it has the length 1.
    """
    labels, number = np.unique(direction[where], return_inverse=True)
    count = np.sqrt(np.bincount(number))
    q = np.zeros((len(labels), informed.q.shape[1]))
    z = np.zeros(len(labels))
    np.add.at(q, number, informed.q[where])
    np.add.at(z, number, informed.z[where])
    return replace(informed, z=z / count, q=q / count[:, None])
