"""Second derivatives of the model at the samples, by central differences of its gradient."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray
from gonio.models import Parameter

STEP = 1e-4  # relative, over which a gradient is compared with itself
LEAST = 1e-3  # size of a parameter that a step is a part of, at least
NUMBERS = 5_000_000  # second derivatives that are held at once


@dataclass(frozen=True)
class Block:
    """Samples of one part, with the second derivatives of their standardised values.

    Parameters
    ----------
    samples : ndarray of int64, shape (n,)
        Numbers of the samples.
    parameters : ndarray of int64, shape (K,)
        Numbers of the parameters on which they depend.
    second : ndarray, shape (n, K, K)
    """

    samples: NDArray[np.int64]
    parameters: NDArray[np.int64]
    second: FloatArray


@dataclass(frozen=True)
class SecondDerivatives:
    """Second derivatives W^1/2 d2f/dp2 at a minimum, in blocks of samples.

    Iterating makes the blocks; they are kept where they are few.

    Parameters
    ----------
    minimum : Minimum
    """

    minimum: Minimum

    def __iter__(self) -> Iterator[Block]:
        problem = self.minimum.problem
        numbers = sum(piece.n * len(index) ** 2 for piece, _, index in problem.pieces())
        return iter(self._kept) if numbers <= NUMBERS else self._made()

    @cached_property
    def _kept(self) -> list[Block]:
        return list(self._made())

    def _made(self) -> Iterator[Block]:
        problem, optimum = self.minimum.problem, self.minimum.optimum
        for piece, where, index in problem.pieces():
            numbers = np.arange(problem.n)[where]
            root = np.sqrt(problem.inverse_variance[where])
            block = max(NUMBERS // len(index) ** 2, 1)
            for start in range(0, piece.n, block):
                some = np.arange(start, min(start + block, piece.n))
                here = piece if len(some) == piece.n else piece.at(some)
                second = _of(here, optimum.p[index], optimum.free[index])
                yield Block(numbers[some], index, second * root[some][:, None, None])


def beside(q: Parameter, value: float) -> tuple[float, float]:
    """Values of a parameter below and above one of them, over which derivatives are compared."""
    by_ratio = q.scale == "log" or (q.linear and value != 0)
    size = abs(value) if by_ratio else max(abs(value), LEAST)
    return max(value - STEP * size, q.lower), min(value + STEP * size, q.upper)


def _of(problem: Problem, p: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Second derivatives (n, K, K), 0 for parameters that are held."""
    found = np.zeros((problem.n, len(p), len(p)))
    for j in np.flatnonzero(free):
        ends = np.array([p, p])
        ends[:, j] = beside(problem.parameters[j], float(p[j]))
        below, above = (problem.jacobian(end)[1] for end in ends)
        found[:, :, j] = (above - below) / (ends[1, j] - ends[0, j])
    found[:, ~free, :] = 0.0
    return (found + found.transpose(0, 2, 1)) / 2
