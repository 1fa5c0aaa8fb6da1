"""What the data inform: residuals and derivatives in coordinates in which J^T W J is 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.curvature import marginal_root
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.uncertainty.degrees_of_freedom import of_quadratic_form
from gonio.geometry import FloatArray

NEGLIGIBLE = 1e-4  # of tr A^2: what shares of single samples in their own values add to it
LEVERAGE = 1e-4  # least 1 - h that a residual is divided by


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

    @classmethod
    def once(cls, minimum: Minimum) -> Callable[[], Informed]:
        """`of`, made when it is first asked for and then kept: of 10^5 samples it takes long."""
        return cache(partial(cls.of, minimum))

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

    @cached_property
    def effective_samples(self) -> FloatArray:
        """How many samples carry each parameter, (P,): the degrees of freedom of its variance."""
        return self.effective_among(None)

    def effective_among(self, where: NDArray[np.bool_] | None) -> FloatArray:
        """The same where these samples alone are left out in turn; all by default.

        Notes
        -----
        The variance of parameter j is estimated by z^T A z, A = diag(a) (1 - H) diag(a) with a_i
        the gain of sample i over 1 - h_i and H = q q^T. With b = a^2 its traces are
        tr A = sum b (1 - h) and tr A^2 = sum b^2 (1 - 2 h) + |q^T diag(b) q|^2.
        """
        h, gain = self.leverage, self.gain.T
        inverse = 1 / np.maximum(1 - h, LEVERAGE) ** 2
        if where is not None:
            inverse *= where
        trace, square = np.zeros(len(gain)), np.zeros(len(gain))
        for j, row in enumerate(gain):
            b = row**2
            b *= inverse
            b /= max(float(b.max(initial=0.0)), 1e-300)
            shared = float(b @ h)  # its square is at least |q^T diag(b) q|^2
            trace[j] = b.sum() - shared
            square[j] = b @ b - 2 * np.einsum("n,n,n->", b, b, h)
            if shared**2 > NEGLIGIBLE * square[j]:
                square[j] += np.sum((self.q.T * b @ self.q) ** 2)
        return of_quadratic_form(trace, square)

    def of_noise(self, where: NDArray[np.bool_] | None = None) -> FloatArray:
        """Covariance (P, P) that unit noise of these samples, of all by default, gives."""
        gain = self.gain if where is None else self.gain[where]
        return np.asarray(gain.T @ gain)
