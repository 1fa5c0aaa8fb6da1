"""What the data inform: residuals and derivatives in coordinates in which J^T W J is 1."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.curvature import marginal_root
from gonio.fitting.minimum.record import Minimum
from gonio.geometry import FloatArray


@dataclass(frozen=True)
class Informed:
    """Standardised residuals and the directions of the parameters that the data inform.

    With y the data, f the model, W the weights and J = df/dp, a change dp = `back` x of the
    parameters changes the standardised values W^1/2 f by `q` x, and q^T q is 1. A change dy of the
    data moves the parameters by `back` q^T W^1/2 dy.

    Parameters
    ----------
    determined : ndarray of bool, shape (P,)
        Parameters that the data determine.
    z : ndarray, shape (N,)
        W^1/2 (y - f), with f at the end of a step that the directions of `q` allow.
    q : ndarray, shape (N, R)
        Rows of what is profiled beside the parameters have a share in q^T q = 1 as well.
    whole : ndarray, shape (P, R)
        `back`, with rows of parameters that are not determined as well, which mean nothing alone.
    combinations : ndarray, shape (K, P), optional
        What stands in place of the parameters in all that is derived: linear combinations of them.

    Notes
    -----
    Shared errors that the fit profiles are further parameters, each with one more observation, its
    prior. These observations have no rows in `q` and are never left out.
    """

    determined: NDArray[np.bool_]
    z: FloatArray
    q: FloatArray
    whole: FloatArray
    combinations: FloatArray | None = None

    @classmethod
    def of(cls, minimum: Minimum) -> Informed:
        """The data about a minimum of chi-squared."""
        problem, optimum = minimum.problem, minimum.optimum
        n_p = len(optimum.p)
        f, jacobian = problem.jacobian(optimum.p)
        root = np.sqrt(problem.inverse_variance)
        z = root * (problem.samples.value - f)
        # One row for each parameter: sums over samples run along the memory.
        rows = jacobian.T
        if problem.profiled:
            rows = np.concatenate([rows, problem.profiled_columns().T])
            h = root * rows @ (root * rows).T
            prior = np.arange(n_p, len(h))
            h[prior, prior] += minimum.noise_scale**2
            among = np.concatenate([optimum.free, np.ones(len(prior), np.bool_)])
        else:
            h, among = optimum.curvature, optimum.free
        determined, back = marginal_root(h, among, optimum.limited)
        determined[list(optimum.limited)] = False
        rows = back.T @ rows
        rows *= root
        if not problem.profiled:
            # Nothing at a minimum. About a value that is held, it is what would move it.
            z -= (rows @ z) @ rows
        return cls(determined[:n_p], z, rows.T, back[:n_p])

    @property
    def back(self) -> FloatArray:
        """Change of each parameter along each direction, (P, R); 0 where it is not determined.

        Of the combinations of parameters, (K, R), where these stand in their place.
        """
        of_parameters = np.asarray(np.where(self.determined[:, None], self.whole, 0.0))
        return of_parameters if self.combinations is None else self.combinations @ of_parameters

    def of_combinations(self, combinations: FloatArray) -> Informed:
        """The same for linear combinations (K, P) of the parameters in place of them."""
        return replace(self, combinations=combinations)

    @cached_property
    def leverage(self) -> FloatArray:
        """Share of its own fitted value that each sample decides, (N,)."""
        return np.asarray(np.einsum("nr,nr->n", self.q, self.q))

    @cached_property
    def gain(self) -> FloatArray:
        """Change of the parameters for a change of each standardised value, (N, P)."""
        return np.asarray((self.back @ self.q.T).T)

    def of_noise(self, where: NDArray[np.bool_] | None = None) -> FloatArray:
        """Covariance (P, P) that unit noise of these samples, of all by default, gives."""
        gain = self.gain if where is None else self.gain[where]
        return np.asarray(gain.T @ gain)
