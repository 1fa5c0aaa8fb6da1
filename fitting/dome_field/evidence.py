"""Size and correlation length of the field by the marginal likelihood, about what is stated.

With the other unknowns eliminated, chi-squared of the nodes' values c is -2 h c + c S c + constant,
and with their prior covariance K = R R^T the logarithm of the marginal likelihood is

-1/2 log |1 + R^T S R| + 1/2 h^T R (1 + R^T S R)^-1 R^T h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.fitting.dome_field.state import Layout, State
from gonio.geometry import FloatArray
from gonio.tangent_field import Nodes

# A data sheet's size of slope errors and their correlation length are good to a factor of 1.4.
LOG_SD = 0.35
_EVALUATIONS = 16
_FARTHEST = 4.0  # of LOG_SD


@dataclass(frozen=True)
class FieldData:
    """What the samples say of the field, all other unknowns eliminated.

    Parameters
    ----------
    pull : ndarray, shape (2 K,)
        h.
    information : ndarray, shape (2 K, 2 K)
        S.
    """

    pull: FloatArray
    information: FloatArray

    @classmethod
    def of(
        cls, gradient: FloatArray, information: FloatArray, layout: Layout, state: State
    ) -> FieldData:
        """Eliminate parameters and draws.

        Parameters
        ----------
        gradient, information : ndarray
            With the prior of the draws and without that of the field.
        layout : Layout
        state : State
        """
        from scipy.linalg import cho_factor, cho_solve

        inside = np.zeros(layout.size, bool)
        inside[layout.field] = True
        others, across = information[np.ix_(~inside, ~inside)], information[np.ix_(~inside, inside)]
        scale = 1 / np.sqrt(np.maximum(np.diag(others), 1e-300))
        factor = cho_factor(others * np.outer(scale, scale) + 1e-14 * np.eye(len(others)))
        solved = scale[:, None] * cho_solve(
            factor, scale[:, None] * np.column_stack([across, gradient[~inside]])
        )
        left = information[np.ix_(inside, inside)] - across.T @ solved[:, :-1]
        left = (left + left.T) / 2
        pull = gradient[inside] - across.T @ solved[:, -1]
        return cls(pull + left @ state.field.ravel(), left)

    def whitened(self, nodes: Nodes) -> tuple[FloatArray, FloatArray]:
        """R^T S R and R^T h."""
        k, root = len(nodes), nodes.root
        s = self.information.reshape(2, k, 2, k)
        m = np.empty((2, k, 2, k))
        for a in range(2):
            for b in range(a + 1):
                m[a, :, b] = root.T @ s[a, :, b] @ root
                m[b, :, a] = m[a, :, b].T
        pull = self.pull.reshape(2, k) @ root
        return m.reshape(2 * k, 2 * k), pull.ravel()

    def log_evidence(self, nodes: Nodes) -> float:
        """Logarithm of the marginal likelihood over that of no field at all."""
        from scipy.linalg import solve_triangular

        m, pull = self.whitened(nodes)
        m[np.diag_indices_from(m)] += 1.0
        factor = np.linalg.cholesky(m)
        x = solve_triangular(factor, pull, lower=True)
        return float(x @ x / 2 - np.sum(np.log(np.diag(factor))))


def refined(data: FieldData, nodes: Nodes) -> tuple[float, float]:
    """Factors on the stated standard deviation and correlation length that are most probable.

    Each has a log-normal prior about 1.
    """
    from scipy.optimize import minimize

    def objective(x: FloatArray) -> float:
        if np.any(np.abs(x) > _FARTHEST):
            return 1e300
        factor, stretch = np.exp(LOG_SD * x)
        trial = Nodes(nodes.directions, nodes.prior.scaled(factor, stretch))
        try:
            return float(x @ x / 2 - data.log_evidence(trial))
        except np.linalg.LinAlgError:
            return 1e300

    start = np.array([[0.0, 0.0], [0.8, 0.0], [0.0, 0.5]])
    best = minimize(
        objective, start[0], method="Nelder-Mead",
        options={"initial_simplex": start, "maxfev": _EVALUATIONS, "xatol": 0.05, "fatol": 0.2},
    )  # fmt: skip
    factor, stretch = np.exp(LOG_SD * best.x)
    return float(factor), float(stretch)
