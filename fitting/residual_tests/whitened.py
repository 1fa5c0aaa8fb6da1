"""Whitened residuals, with what parameters and shared errors could do projected out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_columns import shared_columns, thinned
from gonio.fitting.residual_tests.groups import (
    LEAST,
)
from gonio.geometry import FloatArray

ROUNDING = 1e-10  # of the largest value: smaller residuals are no residuals


FEW = 16  # columns that are quicker as a full array
MOST = 20_000  # samples that are examined: enough for any error of the model that matters


@dataclass(frozen=True)
class Base:
    """A problem at its minimum, over at most so many samples that all tests of residuals share.

    Parameters
    ----------
    problem : Problem
        Over the samples that are examined, evenly chosen.
    f : ndarray, shape (N,)
        Fitted values.
    jacobian : ndarray, shape (N, free)
        Derivatives by the free parameters that the samples tell of.
    shared : Any
        Change of the samples by one standard deviation of each shared draw, sparse (N, draws).
    n_all : int
        Samples of the fit.
    """

    problem: Problem
    f: FloatArray
    jacobian: FloatArray
    shared: Any
    n_all: int

    @classmethod
    def of(cls, minimum: Minimum, most: int = MOST) -> Base:
        """The base of a fit; more than `most` samples are thinned evenly."""
        problem, optimum = thinned(minimum.problem, most), minimum.optimum
        f, jacobian = problem.jacobian(optimum.p)
        used = optimum.free & (np.diag(optimum.curvature) > 0)
        shared = shared_columns(problem, optimum.p, f)
        return cls(problem, f, jacobian[:, used], shared, minimum.problem.n)

    def thinned(self, most: int) -> Base:
        """The base over at most so many of its samples, evenly chosen."""
        n = self.problem.n
        if n <= most:
            return self
        index = evenly(n, most)
        return replace(
            self,
            problem=self.problem.at(index),
            f=self.f[index],
            jacobian=self.jacobian[index],
            shared=self.shared[index],
        )

    @cached_property
    def found(self) -> dict[Any, Any]:
        """What tests of these residuals found, so that each is made once."""
        return {}

    @cached_property
    def vectors(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors towards the light and towards the viewer, each (N, 3)."""
        w_i, w_r = self.problem.samples.directions.vectors()
        return np.broadcast_to(w_i, (self.problem.n, 3)), np.broadcast_to(w_r, (self.problem.n, 3))

    @property
    def residual(self) -> FloatArray:
        """Measured less fitted values, (N,)."""
        return np.asarray(self.problem.samples.value - self.f)


@dataclass(frozen=True)
class Whitened:
    """Whitened residuals with what parameters and shared errors could do projected out."""

    z: FloatArray  # (N,)
    columns: Any  # whitened, (N, C); sparse where they are many
    root_inverse: FloatArray  # (C, R), root of the pseudo-inverse of columns^T columns
    dof: int
    root: FloatArray  # square root of the weights (N,)
    f: FloatArray
    residual: FloatArray

    @classmethod
    def of(cls, base: Base) -> Whitened | None:
        """None where too few samples are left to say anything."""
        problem = base.problem
        # In units of the largest value: squares of what is left neither overflow nor vanish.
        unit = float(np.max(np.abs(problem.samples.value))) or 1.0
        f, residual = base.f / unit, base.residual / unit
        if not np.max(np.abs(residual)) > ROUNDING:
            return None
        root = np.sqrt(problem.inverse_variance) * unit
        if problem.weights not in ("sd", "relative"):
            root = scatter_weights(f, residual)
        columns = _columns(base, root / unit)
        root_inverse = pseudo_root(np.asarray(_full(columns.T @ columns)))
        z = root * residual
        z = z - columns @ (root_inverse @ (root_inverse.T @ (columns.T @ z)))
        dof = problem.n - root_inverse.shape[1]
        if dof < 3 * LEAST or not np.max(np.abs(z)) > ROUNDING * np.max(root):
            return None
        return cls(z, columns, root_inverse, dof, root, f, residual)

    @property
    def mean(self) -> float:
        """Mean fitted value."""
        return float(np.mean(self.f))

    @property
    def variance(self) -> float:
        """Mean square of the residuals in the unit of f."""
        return float(np.mean(self.residual**2))


def evenly(n: int, most: int) -> NDArray[np.int64]:
    """Numbers of at most so many of n samples, evenly chosen."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))


def scatter_weights(f: FloatArray, residual: FloatArray) -> FloatArray:
    """One over the noise where nobody stated it: sd^2 = a + b f^2 from the scatter itself.

    Neighbours in f share their noise; a and b are the best non-negative ones for the mean squares
    of groups.
    """
    from scipy.optimize import nnls

    order = np.array_split(np.argsort(f), int(np.clip(len(f) // 20, 1, 40)))
    squares = np.array([np.mean(residual[k] ** 2) for k in order])
    levels = np.array([np.mean(f[k] ** 2) for k in order])
    if not np.all(squares > 0):
        return np.full(len(f), 1 / max(float(np.sqrt(np.mean(residual**2))), 1e-300))
    design = np.column_stack([np.ones(len(order)), levels]) / squares[:, None]
    (a, b), _ = nnls(design, np.ones(len(order)))
    variance = a + b * f**2
    return np.asarray(1 / np.sqrt(np.maximum(variance, 1e-3 * np.mean(variance) + 1e-300)))


def pseudo_root(square: FloatArray) -> FloatArray:
    """Root (C, R) of the pseudo-inverse of a matrix (C, C) of rank R."""
    if len(square) == 0:
        return square
    values, vectors = np.linalg.eigh(square)
    good = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, good] / np.sqrt(values[good]))


def _columns(base: Base, root: FloatArray) -> Any:
    """Columns of parameters and shared errors times the root of the weights, of unit length."""
    if base.jacobian.shape[1] + base.shared.shape[1] <= FEW:
        rows = root * np.concatenate([base.jacobian.T, base.shared.toarray().T])
        size = np.sqrt(np.maximum(np.einsum("cn,cn->c", rows, rows), 1e-300))
        return (rows / size[:, None]).T
    from scipy.sparse import csr_array, diags_array, hstack

    parts = csr_array(hstack([csr_array(base.jacobian), base.shared]))
    columns = csr_array(diags_array(root) @ parts)
    size = np.sqrt(np.maximum(np.asarray(columns.multiply(columns).sum(axis=0)), 1e-300))
    return csr_array(columns @ diags_array(1 / size.ravel()))


def _full(matrix: Any) -> Any:
    """A matrix that may be sparse as a full array."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
