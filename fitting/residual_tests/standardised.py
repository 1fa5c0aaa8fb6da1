"""Residuals in units of the noise, with errors that samples share in their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.quadratic_forms import component_test
from gonio.fitting.residual_tests.smooth_basis import Columns
from gonio.fitting.residual_tests.whitened import ROUNDING, Base, scatter_weights
from gonio.geometry import FloatArray

LEAST = 8  # degrees of freedom that a test of structure needs
UNDETERMINED = 1e-10  # squared singular value of scaled columns that is no information

Noise = Literal["stated", "from the residuals"]


@dataclass(frozen=True)
class Standardised:
    """Residuals z ~ N(0, s^2 1) of a true model, and the directions Q that the fit can follow.

    With the covariance C = W^-1 + U U^T of independent and shared errors z = C^-1/2 (y - f), and
    everything that is compared with z is multiplied by C^-1/2 as well.

    Parameters
    ----------
    problem : Problem
        Over the samples that are examined.
    z : ndarray, shape (N,)
        With Q projected out.
    q : ndarray, shape (N, R)
        Orthonormal columns that span C^-1/2 df/dp.
    level : ndarray, shape (N,)
        Model values in units of the independent noise.
    root : ndarray, shape (N,)
        One over the independent noise.
    noise : {"stated", "from the residuals"}
        Whose size the noise has: s is 1, or unknown.
    n_all : int
        Samples of the fit, of which these are evenly chosen ones.
    shared : Any
        W^1/2 U, sparse (N, draws).
    inner : ndarray, shape (draws, draws)
        (1 + V^T V)^-1 with V = W^1/2 U, so that W^-1/2 C^-1 W^-1/2 = 1 - V inner V^T.
    """

    problem: Problem
    z: FloatArray
    q: FloatArray
    level: FloatArray
    root: FloatArray
    noise: Noise
    n_all: int
    shared: Any
    inner: FloatArray

    @property
    def dof(self) -> int:
        """Degrees of freedom of |z|^2."""
        return int(self.z.size - self.q.shape[1])

    def component_tests(self, columns: Columns, where: slice) -> dict[str, float]:
        """By kind the p-value of no error of the model with the covariance C C^T.

        Kinds that the samples cannot tell from the parameters are left out.

        Parameters
        ----------
        columns : Columns
            C, (n, C), in units of the independent noise, over the samples of one part; 0 in all
            others.
        where : slice
            Those samples.
        """
        found = {}
        for kind, (gram, on_vectors) in columns.sums(self._colored[where]).items():
            by_fit, by_residuals = on_vectors[:, :-1], on_vectors[:, -1]
            size2 = max(float(np.max(np.diag(gram))), 1e-300)
            gram = gram - by_fit @ by_fit.T
            if self.shared.shape[1]:
                by_shared = self.shared[where].T @ columns.full(kind)
                gram -= by_shared.T @ self.inner @ by_shared
            score = float(by_residuals @ by_residuals)
            p = component_test(gram / size2, score / size2, float(self.z @ self.z), self.dof)
            if p is not None:
                found[kind] = p
        return found

    @cached_property
    def _colored(self) -> FloatArray:
        """Q and z as they meet columns that are in units of the independent noise, (N, R + 1)."""
        return decorrelated(self.shared, np.column_stack([self.q, self.z]))


def standardise(base: Base, *, shared: bool = True) -> Standardised | None:
    """Residuals of a fit in units of the noise; None where fewer than 8 degrees of freedom remain.

    Parameters
    ----------
    base : Base
    shared : bool
        With errors that the samples share in the covariance; without, all is independent noise.
    """
    from scipy.sparse import csr_array, diags_array

    problem, f = base.problem, base.f
    residual = base.residual
    unit = float(np.max(np.abs(problem.samples.value))) or 1.0
    if not np.max(np.abs(residual)) > ROUNDING * unit:
        return None
    root, noise = _noise(problem, f, residual, unit)
    draws: Any = csr_array((problem.n, 0))
    if shared and base.shared.shape[1]:
        draws = csr_array(diags_array(root) @ base.shared)
        residual = residual + problem.profiled_change()
    whitened = decorrelated(draws, root[:, None] * np.column_stack([base.jacobian, residual]))
    q = orthonormal(whitened[:, :-1])
    z = whitened[:, -1]
    z = z - q @ (q.T @ z)
    inner = np.linalg.inv(np.eye(draws.shape[1]) + (draws.T @ draws).toarray())
    found = Standardised(problem, z, q, root * f, root, noise, base.n_all, draws, inner)
    return found if found.dof >= LEAST and float(z @ z) > 0 else None


def _noise(
    problem: Problem, f: FloatArray, residual: FloatArray, unit: float
) -> tuple[FloatArray, Noise]:
    """One over the noise as stated, or by part sd^2 = a + b f^2 from the scatter."""
    if problem.weights == "sd":
        return np.sqrt(problem.inverse_variance), "stated"
    if problem.weights == "relative":
        return np.sqrt(problem.inverse_variance), "from the residuals"
    if problem.samples.u_independent is not None:
        return 1 / np.sqrt(problem.variance(f, sharing=True)), "stated"
    root = np.empty(problem.n)
    for _, where, _ in problem.pieces():
        root[where] = scatter_weights(f[where] / unit, residual[where] / unit) / unit
    return root, "from the residuals"


def orthonormal(columns: FloatArray) -> FloatArray:
    """Orthonormal columns that span the given ones (N, k), those that rounding makes left out."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    columns = columns[:, size > 0] / size[size > 0]
    if columns.shape[1] == 0:
        return columns
    q, triangle = np.linalg.qr(columns)
    left, s, _ = np.linalg.svd(triangle)
    return np.asarray(q @ left[:, : len(s)][:, s**2 >= UNDETERMINED])


def decorrelated(v: Any, columns: FloatArray) -> FloatArray:
    """(1 + V V^T)^-1/2 times columns (N, k), V (N, draws) sparse.

    It is 1 + V K V^T, K having -1 / (r (1 + r)) with r^2 = 1 + e for each eigenvalue e of V^T V.
    """
    if v.shape[1] == 0:
        return columns
    values, vectors = np.linalg.eigh(np.asarray((v.T @ v).toarray()))
    r = np.sqrt(1 + np.maximum(values, 0.0))
    turned = vectors.T @ (v.T @ columns)
    return np.asarray(columns - v @ (vectors @ (turned / (r * (1 + r))[:, None])))
